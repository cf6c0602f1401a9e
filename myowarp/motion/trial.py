"""A trial: from files of a recorded motion to files of joint angles, joint moments and muscle forces.

Each step is a function of a model and of files, and writes what OpenSim's tools of the same name read: angles
in degrees in `.mot`, all else in `.sto`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.disk import write_rows
from myowarp.motion.actuators import actuators_of
from myowarp.motion.inverse_dynamics import Load, Needed, inverse_dynamics
from myowarp.motion.inverse_kinematics import Fitted, inverse_kinematics
from myowarp.motion.joint_reactions import JointReactions, joint_reactions
from myowarp.motion.loads import Loads, loads_at, prescribed_loads
from myowarp.motion.markers import Markers, MarkerStream, read_trc
from myowarp.motion.metabolic_power import metabolic_power
from myowarp.motion.muscle_forces import Mode, MuscleForces, muscle_forces, rigid_capacity
from myowarp.motion.orientation_kinematics import Turned, orientation_kinematics
from myowarp.motion.orientations import axes_of_sensors, read_orientations
from myowarp.motion.scaling import Scaled, read_setup, scale, write_factors
from myowarp.motion.setup import TrialSetup
from myowarp.motion.smooth import derivatives
from myowarp.motion.storage import Storage, Tables, read_storage, tables_in, write_storage
from myowarp.motion.streams import Margin, Stream, is_long
from myowarp.motion.tool_setup import read_tool_setup
from myowarp.motion.tracking import Tracked, track
from myowarp.motion.units import Angles
from myowarp.osim.body.contacts import Contacts
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.body.model_forces import acts, left_out
from myowarp.osim.body.muscle_paths import MusclePaths, muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, floating, forward, station
from myowarp.osim.document.model import Model
from myowarp.osim.document.read.element import write

ANGLES = "Coordinates"
"""Name of a file of joint angles, in its header."""
NO_MOTION = ("Speeds", "Accelerations", "PositionErrors")
"""Names of files of OpenSim's tools whose columns are named by coordinates and hold none."""
HELD = 0.05
"""Share of the weight that a root may give without external loads, unsaid."""

logger = logging.getLogger("myowarp")


@dataclass(frozen=True, eq=False)
class Movement:
    """A motion in the independent coordinates of a model.

    Attributes:
        time: [s], shape (frames,).
        values: [rad] or [m], shape (frames, coordinates).
        speeds: Their derivatives by time.
        accelerations: Their second derivatives.
        absent: Coordinates that the file has not, which stand at their default.
        first: Number of the first frame, where these are a part of a motion.
        total: Frames of the motion; None: these are all.
    """

    time: np.ndarray
    values: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    absent: tuple[str, ...]
    first: int = 0
    total: int | None = None

    def between(self, start: float, end: float) -> Movement:
        """Return the frames from `start` to `end` [s], both included; the filter has seen all.

        Raises:
            ValueError: There is none.
        """
        kept = (self.time >= start - 1e-9) & (self.time <= end + 1e-9)
        if not kept.any():
            raise ValueError(
                f"no frame between {start:g} and {end:g} s; the motion is from {self.time[0]:g} to "
                f"{self.time[-1]:g} s"
            )
        return self._part(kept)

    def _part(self, frames: Any) -> Movement:
        """Return some frames."""
        rows = self.values[frames], self.speeds[frames], self.accelerations[frames]
        return Movement(self.time[frames], *rows, self.absent)


def read_motion(path: Path, bones: Bones, cutoff: float | None = None) -> Movement:
    """Return the motion of a `.mot` or `.sto` file, smoothed and differentiated.

    Columns are named by coordinates, or as OpenSim's states, `/jointset/knee_r/knee_angle_r/value`. Others
    are left alone. Coordinates that follow others do so, whatever the file says.

    Args:
        path: The file.
        bones: The model.
        cutoff: Frequency of the filter [Hz]; None: none.

    Raises:
        ValueError: The file is none, has no coordinate of the model, or is too short.
        OSError: It cannot be read.
    """
    return _moved(Angles(path, bones.model), read_storage(path), bones, cutoff)


def _moved(angles: Angles, table: Storage, bones: Bones, cutoff: float | None) -> Movement:
    """Return the motion of a table.

    Raises:
        ValueError: It has no coordinate of the model, is too short, or its unit is in doubt.
    """
    if table.title in NO_MOTION:
        raise ValueError(
            f"{str(angles.path)!r} calls itself {table.title!r}; a motion holds coordinates, as OpenSim's "
            "tools write them into the file that ends in _Kinematics_q.sto"
        )
    found = angles.of(table, bones.coordinates)
    if not found:
        raise ValueError(
            f"{str(angles.path)!r} has no column of a coordinate; the model has "
            f"{', '.join(bones.coordinates)}"
        )
    still = np.full(len(table.time), 1.0)
    defaults = (bones.model.coordinates[name].default for name in bones.coordinates)
    columns = {name: still * x for name, x in zip(bones.coordinates, defaults, strict=True)} | found
    values = np.stack(list(columns.values()), axis=1)
    return Movement(
        table.time,
        *derivatives(table.time, values, table.time, cutoff),
        tuple(name for name in bones.coordinates if name not in found),
    )


def read_parts(
    path: Path, bones: Bones, cutoff: float | None = None, span: tuple[float, float] | None = None
) -> Iterator[Movement]:
    """Yield the motion of a long file in parts; what is written of them one after the other is one file.

    A file that is not long gives one part. Times of a long one must increase. The filter and the splines see
    so much of the frames before and after a part that nothing but rounding differs from those of all.

    Args:
        path: The file.
        bones: The model.
        cutoff: Frequency of the filter [Hz]; None: none.
        span: First and last time [s]; None: all.

    Raises:
        ValueError: As `read_motion`; or there is no frame in the span.
        OSError: The file cannot be read.
    """
    if not is_long(path):
        motion = read_motion(path, bones, cutoff)
        yield motion if span is None else motion.between(*span)
        return
    begin, end = span or (-np.inf, np.inf)
    angles, first = Angles(path, bones.model), 0
    with Stream(path) as stream:
        total = stream.count(span)
        if not total:
            raise ValueError(f"no frame of {str(path)!r} is between {begin:g} and {end:g} s")
        for table, own in stream.parts(Margin(cutoff=cutoff)):
            kept = np.zeros(len(table.time), bool)
            kept[own] = (table.time[own] >= begin - 1e-9) & (table.time[own] <= end + 1e-9)
            if kept.any():
                part = _moved(angles, table, bones, cutoff)._part(kept)
                yield replace(part, first=first, total=total)
                first += len(part.time)


def scale_to(
    source: Path, output: Path, setup: Path, static: Path | None = None, device: Any = "cpu"
) -> Scaled:
    """Scale a model to a person; write `scaled.osim`, `scale_factors.xml` and, posed, `static.mot`.

    Args:
        source: The generic model, .osim.
        output: Folder, which exists.
        setup: A set-up file of OpenSim's `ScaleTool`.
        static: Markers of the person who stands still; by default those that the set-up file names.
        device: Where the pose is found.

    Raises:
        ValueError: A file is not what it should be.
        NotImplementedError: The model has something that is not supported.
        OSError: A file cannot be read or written.
    """
    scaled = scale(source, read_setup(setup), static, device)
    write(output / "scaled.osim", scaled.document.root)
    write_factors(output / "scale_factors.xml", scaled.factors)
    if scaled.pose is not None:
        pose, model = scaled.pose, scaled.document.model
        write_angles(output / "static.mot", model, pose.coordinates, pose.time, pose.values)
    return scaled


def kinematics(
    bones: Bones,
    markers: Path,
    output: Path,
    setup: Path | None = None,
    span: tuple[float, float] | None = None,
    fill: float | None = None,
) -> Fitted:
    """Find the joint angles of recorded markers; write `ik.mot`, `marker_errors.sto` and `gaps.csv`.

    Args:
        bones: The model.
        markers: A `.trc` file.
        output: Folder, which exists.
        setup: An OpenSim set-up file with weights; markers that were not recorded do not count.
        span: First and last time [s].
        fill: Longest gap of a marker that a spline bridges [s]; None: none is bridged.

    Returns:
        The joint angles, of a long recording those of its last part.

    Raises:
        ValueError: A file is not what it should be.
        OSError: A file cannot be read or written.
    """
    said = TrialSetup() if setup is None else read_tool_setup(setup)
    *_, last = kinematics_in_parts(bones, output, said.stating(markers=markers, span=span, fill=fill))
    return last


def kinematics_in_parts(bones: Bones, output: Path, setup: TrialSetup) -> Iterator[Fitted]:
    """Do what `kinematics` does, and yield the joint angles part by part; each begins at the one before.

    Raises:
        As `kinematics`; or the set-up has no file of markers.
    """
    gaps, start = Gaps(), None
    with Tables(output) as tables:
        for seen, recorded, total in _marker_parts(setup):
            gaps.add(seen, recorded)
            fitted = inverse_kinematics(bones, recorded, **targets(bones, setup, recorded), start=start)
            start = dict(zip(fitted.coordinates, fitted.values[-1], strict=True))
            angles = angles_table(bones.model, fitted.coordinates, fitted.time, fitted.values)
            tables.write("ik.mot", ANGLES, angles, total)
            error = Storage(fitted.markers, fitted.time, fitted.error)
            tables.write("marker_errors.sto", "distances of markers, m", error, total)
            yield fitted
        gaps.write(output / "gaps.csv")


def kinematics_of_sensors(bones: Bones, output: Path, setup: TrialSetup) -> Turned:
    """Find the joint angles of recorded orientations; write `ik.mot` and `orientation_errors.sto`.

    Args:
        bones: The model, with a frame of the name of each sensor.
        output: Folder, which exists.
        setup: With a file of orientations.

    Raises:
        ValueError: A file is not what it should be, or the model has no frame of a sensor.
        OSError: A file cannot be read or written.
    """
    if setup.orientations is None:
        raise ValueError("joint angles of sensors need a file of quaternions; give --orientations FILE")
    recorded = read_orientations(setup.orientations).turned(axes_of_sensors(setup.sensor_angles))
    if setup.span is not None:
        recorded = recorded.between(*setup.span)
    turned = orientation_kinematics(bones, recorded, setup.sensor_weights)
    with Tables(output) as tables:
        angles = angles_table(bones.model, turned.coordinates, turned.time, turned.values)
        tables.write("ik.mot", ANGLES, angles)
        error = Storage(turned.sensors, turned.time, turned.error)
        tables.write("orientation_errors.sto", "angles of sensors, rad", error)
    return turned


def targets(bones: Bones, setup: TrialSetup, recorded: Markers) -> dict[str, Any]:
    """Return what a set-up has a pose fit, as `inverse_kinematics` takes it: weights, and wanted values.

    Raises:
        ValueError: The set-up file has no weights, or lacks the values of a coordinate.
        OSError: The file of the values cannot be read.
    """
    tasks = setup.tasks
    if tasks is None and setup.file is not None:
        raise ValueError(
            f"{str(setup.file)!r} has no <IKMarkerTask>; a set-up file of inverse kinematics or scaling has"
        )
    if tasks is None:
        return {}
    values: dict[str, float | np.ndarray] = {**tasks.values}
    if tasks.recorded:
        values |= _recorded(bones, setup, tasks.recorded, recorded.time)
    return {
        "marker_weights": tasks.among(recorded.names),
        "coordinate_weights": tasks.coordinates,
        "coordinate_values": values,
    }


def read_markers(setup: TrialSetup) -> tuple[Markers, Markers]:
    """Return the markers of a set-up in its times: as they were seen, and with gaps filled.

    Raises:
        ValueError: The file is not what it should be, or there is no frame in the times.
        OSError: It cannot be read.
    """
    seen = read_trc(setup.recording)
    recorded = seen if setup.fill is None else seen.filled(setup.fill)
    if setup.span is not None:
        seen, recorded = seen.between(*setup.span), recorded.between(*setup.span)
    return seen, recorded


def _marker_parts(setup: TrialSetup) -> Iterator[tuple[Markers, Markers, int]]:
    """Yield the markers of a file in parts: as they were seen, with gaps filled, and the frames of all.

    Raises:
        As `read_markers`.
    """
    path, span, fill = setup.recording, setup.span, setup.fill
    if not is_long(path):
        seen, recorded = read_markers(setup)
        yield seen, recorded, len(seen.time)
        return
    begin, end = span or (-np.inf, np.inf)
    with MarkerStream(path) as stream:
        total = stream.count(span)
        if not total:
            raise ValueError(f"no frame of {str(path)!r} is between {begin:g} and {end:g} s")
        for table, own in stream.parts(Margin(seconds=2.0 * (fill or 0.0))):
            seen = stream.placed(table)
            recorded = seen if fill is None else seen.filled(fill)
            inside = [max(begin, seen.time[own][0]), min(end, seen.time[own][-1])]
            if inside[0] <= inside[1]:
                yield seen.between(*inside), recorded.between(*inside), total


class Gaps:
    """When markers were not seen, of all parts of a recording, and which gaps a spline bridged."""

    def __init__(self) -> None:
        """Begin with none."""
        self._rows: list[tuple[str, float, float, bool]] = []
        self._open: dict[str, tuple[float, bool]] = {}

    def add(self, seen: Markers, filled: Markers) -> None:
        """Note the gaps of a part; one that the part before ended with goes on."""
        left, before, self._open = filled.gaps(), self._open, {}
        for name, gaps in seen.gaps().items():
            for first, last in gaps:
                bridged = (first, last) not in left.get(name, ())
                if first == seen.time[0] and name in before:
                    first, bridged = before[name][0], bridged and before[name][1]
                    self._rows.pop(next(k for k, row in enumerate(self._rows) if row[:2] == (name, first)))
                if last == seen.time[-1]:
                    self._open[name] = first, bridged
                self._rows.append((name, first, last, bridged))

    def write(self, path: Path) -> None:
        """Write them, the longest first.

        Raises:
            OSError: The file cannot be written.
        """
        rows = sorted(self._rows, key=lambda row: row[1] - row[2])
        table = [(name, f"{a:.9g}", f"{b:.9g}", "yes" if there else "no") for name, a, b, there in rows]
        write_rows(path, [("marker", "first [s]", "last [s]", "filled"), *table])


def _recorded(
    bones: Bones, setup: TrialSetup, names: Sequence[str], time: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the values that coordinates have in the file of joint angles of a set-up.

    Raises:
        ValueError: The set-up file names none, or the file lacks a coordinate or the time.
    """
    path = setup.coordinates
    if path is None:
        raise ValueError(
            f"{str(setup.file)!r} has coordinates whose values are in a file, and names no <coordinate_file>"
        )
    motion = read_motion(path, bones)
    if unknown := [name for name in names if name in motion.absent or name not in bones.coordinates]:
        raise ValueError(f"{str(path)!r} has no column of the coordinate {unknown[0]!r}")
    if time[0] < motion.time[0] - 1e-6 or time[-1] > motion.time[-1] + 1e-6:
        raise ValueError(
            f"{str(path)!r} is from {motion.time[0]:g} to {motion.time[-1]:g} s; the markers are from "
            f"{time[0]:g} to {time[-1]:g} s"
        )
    columns = (motion.values[:, bones.coordinates.index(name)] for name in names)
    return {name: np.interp(time, motion.time, column) for name, column in zip(names, columns, strict=True)}


def marker_places(bones: Bones, time: np.ndarray, values: np.ndarray) -> Markers:
    """Return where the model's markers are along a motion: what cameras without noise would see.

    Args:
        bones: The model.
        time: [s], shape (frames,).
        values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).

    Raises:
        ValueError: The model has no marker.
    """
    model = bones.model
    if not model.markers:
        raise ValueError(f"model {model.name!r} has no marker; give a MarkerSet")
    whole = complete(model, dict(zip(bones.coordinates, np.asarray(values).T, strict=True)), len(time))
    frames = forward(model, whole)
    places = [station(frames, marker.body, marker.location) for marker in model.markers.values()]
    return Markers(tuple(model.markers), np.asarray(time, float), np.stack(places, axis=1))


def angles_table(model: Model, coordinates: Sequence[str], time: np.ndarray, values: np.ndarray) -> Storage:
    """Return a motion in degrees, with all coordinates of the model, as it is written."""
    whole = complete(model, dict(zip(coordinates, values.T, strict=True)), len(time))
    columns = [np.degrees(v) if model.coordinates[name].rotational else v for name, v in whole.items()]
    return Storage(tuple(whole), time, np.stack(columns, axis=1), True)


def write_angles(
    path: Path, model: Model, coordinates: Sequence[str], time: np.ndarray, values: np.ndarray
) -> None:
    """Write a motion in degrees, with all coordinates of the model.

    Raises:
        OSError: The file cannot be written.
    """
    write_storage(path, ANGLES, angles_table(model, coordinates, time, values))


def dynamics(
    bones: Bones, motion: Movement, output: Path | Tables, loads: Path | Loads | None = None
) -> Needed:
    """Find what a motion takes; write `moments.sto`, and what the model's springs do, `passive_moments.sto`.

    Args:
        bones: The model.
        motion: From `read_motion`, or a part from `read_parts`.
        output: Folder, which exists, or its tables: those of a motion in parts are written into one.
        loads: A file of OpenSim's `ExternalLoads`, or what it says.

    Raises:
        ValueError: A file is not what it should be.
        OSError: A file cannot be read or written.
    """
    acting = _acting(bones, loads, motion)
    needed = inverse_dynamics(bones, motion.values, motion.speeds, motion.accelerations, acting)
    with tables_in(output) as tables:
        _write_moments(tables, bones, motion, needed, acting)
    return needed


def held_up(bones: Bones, time: np.ndarray, moment: np.ndarray) -> str:
    """Return what stands for the weight at a root without external loads; "": less than `HELD` of it.

    Args:
        bones: The model.
        time: [s], shape (frames,).
        moment: What the motion takes along independent coordinates [N m] or [N], shape (frames, coordinates).
    """
    model = bones.model
    weight = sum(body.mass for body in model.bodies.values()) * float(np.linalg.norm(model.gravity))
    slides = [name for name in floating(model) if not model.coordinates[name].rotational]
    roots = list(dict.fromkeys(model.coordinates[name].joint for name in slides))
    forces = [
        np.linalg.norm(moment[:, [bones.coordinates.index(name) for name in slides
                                  if model.coordinates[name].joint == root]], axis=1)
        for root in roots
    ]  # fmt: skip
    if not roots or not np.max(forces) > HELD * weight:
        return ""
    root, frame = np.unravel_index(int(np.argmax(forces)), np.shape(forces))
    body = model.joints[roots[int(root)]].child
    worst = f"{np.max(forces):.0f} N at the {body}, at {time[frame]:.4g} s"
    return f"no external loads: {worst}, carry the weight"


def _acting(bones: Bones, loads: Path | Loads | None, motion: Movement) -> Sequence[Load]:
    """Return the loads of a motion, and what forces of the model prescribe."""
    known_loads = Loads(loads) if isinstance(loads, Path) else loads
    own = prescribed_loads(bones, motion.time)
    return own if known_loads is None else [*known_loads.at(motion.time), *own]


def _write_moments(
    tables: Tables, bones: Bones, motion: Movement, needed: Needed, acting: Sequence[Load]
) -> None:
    """Write the joint moments that a motion takes under loads, and what springs of the model do."""
    title = "joint moments, N m and N"
    if not acting and (sentence := held_up(bones, motion.time, needed.joint_moment)):
        title = f"{title}; {sentence}"
        if not motion.first:
            logger.warning("%s", sentence)
    _write_along(tables, "moments", title, bones, motion, needed.joint_moment)
    _write_passive(tables, bones, motion, needed.passive)
    _write_contacts(tables, bones, motion, needed.contacts)


def _write_passive(tables: Tables, bones: Bones, motion: Movement, passive: np.ndarray) -> None:
    """Write what springs, limits, bushings and ligaments of a model do; no file of a model without them."""
    if not acts(bones.model):
        tables.remove("passive_moments.sto")
        return
    title = "what springs, limits, bushings and ligaments of the model give, N m and N"
    _write_along(tables, "passive_moments", title, bones, motion, passive)


def _write_contacts(tables: Tables, bones: Bones, motion: Movement, found: Contacts | None) -> None:
    """Write what contact forces of a model do to the second geometry of each pair; none: no file."""
    if found is None:
        tables.remove("contact_forces.sto")
        return
    labels = [
        f"{pair.force}.{pair.second.name}.{part}.{axis}"
        for pair in found.pairs
        for part in ("force", "point")
        for axis in "XYZ"
    ]
    table = np.concatenate([found.force, found.location], axis=2).reshape(len(motion.time), -1)
    title = _titled(
        "contact forces on the geometry that a label names, N, and where they act, m; in ground", bones
    )
    _write(tables, "contact_forces", title, labels, motion, table)


def analyze(bones: Bones, motion: Movement, output: Path | Tables) -> MusclePaths:
    """Follow the muscles along a motion; write lengths, velocities, moment arms, forces and powers.

    Forces are those at full activation with a rigid tendon, and passive ones in equilibrium; powers those of
    both together.

    Args:
        bones: The model.
        motion: From `read_motion`, or a part from `read_parts`.
        output: Folder, which exists, or its tables: those of a motion in parts are written into one.

    Raises:
        ValueError: The model has no muscle.
        OSError: A file cannot be written.
    """
    paths = muscle_paths(bones, motion.values, motion.speeds)
    arms = {
        f"{muscle}.{coordinate}": paths.moment_arm[:, i, k]
        for i, (muscle, crossed) in enumerate(zip(paths.muscles, paths.crossed, strict=True))
        for k, coordinate in enumerate(bones.coordinates)
        if k in crossed
    }
    active, passive = np.zeros_like(paths.length), np.zeros_like(paths.length)
    for i, name in enumerate(paths.muscles):
        muscle = known(HillMuscle.of(bones.model.muscles[name]))[0]
        length, velocity = paths.length[:, i], paths.velocity[:, i]
        active[:, i] = rigid_capacity(muscle, length, velocity)
        passive[:, i] = muscle.values["max_isometric_force"] * muscle.tendon_force(0.0, length, velocity)
    power = -(active + passive) * paths.velocity
    moved = motion.values, motion.speeds, motion.accelerations
    found = inverse_dynamics(bones, *moved)
    with tables_in(output) as tables:
        for name, title, values in (
            ("lengths", "lengths of muscle and tendon, m", paths.length),
            ("velocities", "velocities of muscle and tendon, m/s, lengthening > 0", paths.velocity),
            ("active_forces", "active forces at full activation, rigid tendon, N", active),
            ("passive_forces", "passive forces, N", passive),
            ("full_powers", "powers at full activation, W, shortening > 0", power),
        ):
            _write(tables, name, title, paths.muscles, motion, values)
        _write(tables, "moment_arms", "moment arms, m", arms, motion, np.stack(list(arms.values()), axis=1))
        _write_passive(tables, bones, motion, found.passive)
        _write_contacts(tables, bones, motion, found.contacts)
    return paths


def forces(
    bones: Bones,
    motion: Movement,
    output: Path | Tables,
    loads: Path | Loads | None = None,
    *,
    mode: Mode = "equilibrium",
    exponent: float = 2.0,
    reserves: Mapping[str, float] | None = None,
) -> MuscleForces:
    """Find muscle forces; write what they are, do and burn, joint reactions, reserves, what is missing.

    Args:
        bones: The model.
        motion: From `read_motion`, or a part from `read_parts`.
        output: Folder, which exists, or its tables: those of a motion in parts are written into one.
        loads: A file of OpenSim's `ExternalLoads`, or what it says.
        mode: What a muscle can give, see `muscle_forces`.
        exponent: p of the cost, the sum of a^p.
        reserves: By coordinate, the force of a reserve at cost 1 [N m] or [N].

    Raises:
        ValueError: A file is not what it should be, or the model has no muscle.
        OSError: A file cannot be read or written.
    """
    paths = muscle_paths(bones, motion.values, motion.speeds)
    acting = _acting(bones, loads, motion)
    needed = inverse_dynamics(bones, motion.values, motion.speeds, motion.accelerations, acting)
    actuators = actuators_of(bones, motion.values)
    found = muscle_forces(
        bones.model,
        bones.coordinates,
        paths,
        needed.joint_moment,
        mode=mode,
        exponent=exponent,
        reserves=reserves,
        actuators=actuators,
        device=bones.device,
    )
    burnt = metabolic_power(bones.model, found, paths, bones.device)
    tension, under = dict(zip(found.muscles, found.force.T, strict=True)), needed
    given = None if actuators is None else found.control * actuators.optimal
    if actuators is not None and given is not None:
        pulls = zip(found.motors, given.T, strict=True)
        tension |= {name: force for name, force in pulls if name in actuators.paths}
        if pushed := actuators.acting(found.control):
            moved = motion.values, motion.speeds, motion.accelerations
            under = inverse_dynamics(bones, *moved, [*acting, *pushed])
    reactions = joint_reactions(bones, motion.values, under, tension)
    with tables_in(output) as tables:
        _write_moments(tables, bones, motion, needed, acting)
        for name, title, values in (
            ("activations", "activations", found.activation),
            ("forces", "forces of muscles, N", found.force),
            ("powers", "powers of muscles, W, shortening > 0", found.power),
            ("metabolic_powers", "metabolic powers of muscles, W, without the rate at rest", burnt),
        ):
            _write(tables, name, _titled(title, bones), found.muscles, motion, values)
        if given is None:
            tables.remove("actuators.sto")
        else:
            title = _titled("what motors give, N m and N", bones)
            _write(tables, "actuators", title, found.motors, motion, given)
        _write_reactions(tables, bones, motion, reactions)
        title = "what reserves and motors give, N m and N"
        _write_along(tables, "reserves", title, bones, motion, found.reserve)
        _write_along(tables, "missing", "what nobody gives, N m and N", bones, motion, found.missing)
    return found


def follow(
    bones: Bones,
    motion: Movement,
    output: Path,
    loads: Path | None = None,
    *,
    reserves: Mapping[str, float],
    factors: Mapping[str, float] | None = None,
    gains: Mapping[str, float] | None = None,
    controls: Mapping[str, tuple[float, float]] | None = None,
    span: tuple[float, float] | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> Tracked:
    """Simulate a motion by computed muscle control; write angles, excitations, activations, forces, reserves.

    Args:
        bones: The model.
        motion: From `read_motion`.
        output: Folder, which exists.
        loads: A file of OpenSim's `ExternalLoads`.
        reserves: By coordinate, the force of a reserve at cost 1 [N m] or [N].
        factors: On maximum isometric forces, by muscle.
        gains: Ways back to the motion [1/s^2], by coordinate, where they are not `tracking.KP`.
        controls: Least and greatest excitation [1], by muscle, where they are not the model's.
        span: First and last time [s].
        advance: Is told how many windows are done.

    Raises:
        ValueError: A file is not what it should be, a muscle is unknown, or the simulation is lost.
        OSError: A file cannot be read or written.
    """
    names = [name for name, muscle in bones.model.muscles.items() if muscle.applies_force]
    if unknown := set(factors or {}) - set(names):
        raise ValueError(f"muscle {sorted(unknown)[0]!r} unknown; available: {', '.join(names)}")
    if loads is None:
        needed = inverse_dynamics(bones, motion.values, motion.speeds, motion.accelerations)
        if sentence := held_up(bones, motion.time, needed.joint_moment):
            logger.warning("%s", sentence)
    strength = np.array([(factors or {}).get(name, 1.0) for name in names])
    if not ((strength >= 0.0) & np.isfinite(strength)).all():
        raise ValueError("the strength of a muscle must be at least 0 and finite")
    found = track(
        bones,
        motion.time,
        motion.values,
        lambda times: [
            *(() if loads is None else loads_at(loads, times)),
            *prescribed_loads(bones, times),
        ],
        reserves=reserves,
        strength=strength,
        gains=gains,
        controls=controls,
        span=span,
        advance=advance,
    )
    simulated = replace(motion, time=found.time)
    with Tables(output) as tables:
        angles = angles_table(bones.model, bones.coordinates, found.time, found.values[:, 0])
        tables.write("tracked.mot", ANGLES, angles)
        for name, title, values in (
            ("excitations", "excitations", found.excitation),
            ("activations", "activations", found.activation),
            ("fiber_lengths", "fiber lengths, m", found.fiber_length),
            ("forces", "forces of muscles, N", found.force),
        ):
            _write(tables, name, _titled(title, bones), found.muscles, simulated, values[:, 0])
        given = found.reserve[:, 0]
        title = "what reserves and motors give, N m and N"
        _write_along(tables, "reserves", title, bones, simulated, given)
    return found


def _write_reactions(tables: Tables, bones: Bones, motion: Movement, found: JointReactions) -> None:
    """Write joint reactions with the labels of OpenSim's `JointReaction`: on the child, in ground.

    Raises:
        OSError: The file cannot be written.
    """
    labels = [
        f"{joint}_on_{child}_in_ground_{part}{axis}"
        for joint, child in zip(found.joints, found.children, strict=True)
        for part in "fmp"
        for axis in "xyz"
    ]
    table = np.concatenate([found.force, found.moment, found.point], axis=2).reshape(len(motion.time), -1)
    title = _titled("joint reactions, N, N m and m", bones)
    _write(tables, "joint_reactions", title, labels, motion, table)


def _write_along(
    tables: Tables, name: str, title: str, bones: Bones, motion: Movement, values: np.ndarray
) -> None:
    """Write what acts along the coordinates, named as OpenSim names it; the title has what is left out."""
    turns = [bones.model.coordinates[name].rotational for name in bones.coordinates]
    labels = (f"{n}_{'moment' if t else 'force'}" for n, t in zip(bones.coordinates, turns, strict=True))
    _write(tables, name, _titled(title, bones), labels, motion, values)


def _titled(title: str, bones: Bones) -> str:
    """Return the title of a result of joint moments: with what acts in OpenSim and is left out here."""
    lost = left_out(bones.model)
    return f"{title}; {lost}" if lost else title


def _write(
    tables: Tables, name: str, title: str, labels: Iterable[str], motion: Movement, values: np.ndarray
) -> None:
    """Write a table of a motion, or of a part of it behind the parts before."""
    tables.write(f"{name}.sto", title, Storage(tuple(labels), motion.time, values), motion.total)
