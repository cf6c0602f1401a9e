"""A recorded motion as pictures show it: bones, muscles along OpenSim's paths, forces from outside as arrows.

Nothing is simulated. A frame of the motion is one `Snapshot`, with what `myowarp motion` found of it: what is
in the tables of a folder is taken at the time of the frame.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import mujoco
import numpy as np

from myowarp.motion.gait import gait_cycles
from myowarp.motion.loads import loads_at
from myowarp.motion.movement import motion_in, read_motion
from myowarp.motion.storage import Storage, read_storage
from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.body.moment_arm import Poses, poses_of, stacked
from myowarp.osim.body.path_solution import solve
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.convert.compose.convert import Options, convert
from myowarp.osim.document.kinematics import Frames
from myowarp.osim.document.model import GROUND, Model
from myowarp.view.drawing.framing import Framing
from myowarp.view.drawing.snapshot import Snapshot

TABLES = {
    "activation": ("activations.sto", "1"),
    "force": ("forces.sto", "N"),
    "joint moment": ("moments.sto", "N m"),
    "reserve": ("reserves.sto", "N m"),
    "muscle power": ("powers.sto", "W"),
    "metabolic power": ("metabolic_powers.sto", "W"),
}
"""Files of a folder of `myowarp motion`, by quantity: name and unit."""
REACTIONS = "joint_reactions.sto"
EMG = "emg.sto"
MOST_FRAMES = 3000
"""Frames that are shown; of more some are left out."""
SAMPLES = 50
"""Frames that say from where a motion is seen."""
SLACK = 1e-6
"""[s] of rounding between the times of two files."""
LONGEST = 0.9
"""Length of the arrow of the greatest force, in units of the framed radius."""


@dataclass(frozen=True, eq=False)
class Course:
    """A quantity over the frames.

    Attributes:
        unit: Its unit; "1" for none.
        items: What has it.
        values: NaN where nothing is known, shape (frames, items).
        measured: What was measured of it, likewise; None: nothing.
    """

    unit: str
    items: tuple[str, ...]
    values: np.ndarray
    measured: np.ndarray | None = None


class Recorded:
    """A motion, frame by frame.

    Attributes:
        model: MuJoCo's, to be posed.
        time: Of the frames [s], shape (frames,).
        courses: What can be traced, by name.
        newtons_per_metre: Force over the length of its arrow [N/m]; 0 without loads.
        mass: Of the body [kg].
        gravity: [m/s^2].
        cycles: Begin and end [s] of a gait cycle by side, "l" or "r": of those that the recorded loads have
            whole, the one that the motion covers most.
    """

    def __init__(
        self, source: Path, motion: Path, results: Path | None = None, loads: Path | None = None
    ) -> None:
        """Read it, and follow the muscles.

        Args:
            source: The model, .osim.
            motion: Joint angles, .mot or .sto, or a folder that has them.
            results: Folder of `myowarp motion`; by default that of the motion.
            loads: A file of OpenSim's `ExternalLoads`.

        Raises:
            ValueError: A file is not what it should be.
            NotImplementedError: The model has something that is not supported.
            OSError: A file cannot be read.
        """
        motion = motion_in(motion)
        bones = Bones.read(source, "cpu")
        moved, folder = read_motion(motion, bones), results or motion.parent
        kept = np.flatnonzero(_within(moved.time, folder))
        kept = kept[:: -(-len(kept) // MOST_FRAMES)]
        self.time, values = moved.time[kept], moved.values[kept]
        angles = dict(zip(bones.coordinates, values.T, strict=True))
        converted = convert(bones.model, Options((source.parent, source.parent / "Geometry"), tendons=False))
        self.model = converted.couplings.put_into(converted.spec).compile(dict(converted.meshes) or None)
        free = {name: angles[name] for name in converted.coordinates.free() if name in angles}
        shape = len(self.time), self.model.nq
        self._qpos = np.broadcast_to(converted.coordinates.qpos(self.model, free), shape)
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        self._turn = data.body(converted.bodies[GROUND]).xmat.reshape(3, 3).copy()
        on_tendon = self.model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        self._muscles = [self.model.actuator(int(k)).name for k in np.flatnonzero(on_tendon)]
        poses = poses_of(bones.model, angles, [])
        self._paths = [self._path(bones.model, name, poses) for name in self._muscles]
        self.courses = _courses(bones.model, angles, self.time, folder)
        self._known = self._of_muscles(bones.model)
        self.mass = bones.model.mass
        self.gravity = float(np.linalg.norm(self.model.opt.gravity))
        self.cycles: dict[str, tuple[float, float]] = {}
        self._arrows, self.newtons_per_metre = np.zeros((len(self.time), 0, 2, 3)), 0.0
        if loads is not None:
            self._point_forces(loads, poses.frames)
            for side, cycles in gait_cycles(loads).items():
                self.cycles[side] = max(cycles, key=self._covered)

    def seen(self, frame: int) -> Snapshot:
        """Return what a frame looks like."""
        muscles = {name: values[frame] for name, values in self._known.items()}
        paths = [points[frame][order[frame] >= 0] for points, order in self._paths]
        arrows = self._arrows[frame]
        pressed = np.linalg.norm(arrows[:, 1] - arrows[:, 0], axis=1) > 1e-3
        return Snapshot(self._qpos[frame], muscles, paths=paths, arrows=arrows[pressed])

    def frame_at(self, time: float) -> int:
        """Return the frame that is nearest to a time [s]."""
        return int(np.abs(self.time - time).argmin())

    def cycle_of(self, side: str) -> tuple[float, float]:
        """Return the cycle of a side, "" for what has none; never (NaN) where it is not known whole."""
        return self.cycles.get(side or next(iter(self.cycles), ""), (np.nan, np.nan))

    def _covered(self, cycle: tuple[float, float]) -> float:
        """Return how much of a cycle the motion covers [s]."""
        return float(min(cycle[1], self.time[-1]) - max(cycle[0], self.time[0]))

    @property
    def across(self) -> np.ndarray:
        """Level direction (3,) in which bodies move least about their middle: of a gait from its right."""
        data, places = mujoco.MjData(self.model), []
        for qpos in self._qpos[:: max(1, len(self._qpos) // SAMPLES)]:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(self.model, data)
            places.append(data.xpos[1:, :2] - data.xpos[1:, :2].mean(axis=0))
        moved = np.array(places) - np.mean(places, axis=0)
        least = np.linalg.eigh(np.einsum("nbi,nbj->ij", moved, moved))[1][:, 0]
        left = -self._turn[:2, 2]
        return np.array((*(least if least @ left > 0.0 else -least), 0.0))

    @property
    def colored(self) -> str:
        """Return the quantity that colours muscles by default."""
        return next((kind for kind in ("force", "activation") if kind in self.courses), "fiber_length")

    def _path(self, model: Model, name: str, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of a path in MuJoCo's world, in its order [m], and their numbers, -1 for none."""
        path = (
            model.muscles[name].path
            if name in model.muscles
            else {one.name: one for one in model.path_actuators}[name].path
        )
        solution = solve(model, path, *stacked(model, path, poses, []))
        order = solution.order
        points = np.take_along_axis(solution.location, np.maximum(order, 0)[:, :, None], axis=1)
        return points @ self._turn.T, order

    def _of_muscles(self, model: Model) -> dict[str, np.ndarray]:
        """Return what is known of muscles, shape (frames, muscles) each; see `Snapshot.muscles`."""
        shape = len(self.time), len(self._muscles)
        known: dict[str, np.ndarray] = {}
        for kind in ("activation", "force"):
            if kind in self.courses:
                known[kind] = np.full(shape, np.nan)
                for column, name in enumerate(self.courses[kind].items):
                    if name in self._muscles:
                        known[kind][:, self._muscles.index(name)] = self.courses[kind].values[:, column]
        if "force" in known and "activation" not in known:
            known["activation"] = np.zeros(shape)
        for what, field in (
            ("strength", "max_isometric_force"),
            ("optimal_fiber_length", "optimal_fiber_length"),
            ("tendon_length", "tendon_slack_length"),
        ):
            known[what] = np.tile(
                [HillMuscle.of(model.muscles[name]).values[field] if name in model.muscles else np.nan
                 for name in self._muscles], (shape[0], 1),
            )  # fmt: skip
        return known

    def _point_forces(self, path: Path, frames: Frames) -> None:
        """Find the arrows of the loads."""
        starts, forces = [], []
        for load in loads_at(path, self.time):
            axes = frames[load.force_frame][0]
            forces.append(np.einsum("nij,nj->ni", axes, load.force))
            rotation, origin = frames[load.point_frame]
            starts.append(origin + np.einsum("nij,nj->ni", rotation, load.point))
        if not forces:
            return
        start, force = np.stack(starts, axis=1), np.stack(forces, axis=1)
        most = np.linalg.norm(force, axis=2).max()
        if most > 0.0:
            self.newtons_per_metre = float(most / (LONGEST * Framing(self.model).radius))
            ends = start + force / self.newtons_per_metre
            self._arrows = np.stack((start, ends), axis=2) @ self._turn.T


def _within(time: np.ndarray, folder: Path) -> np.ndarray:
    """Return the frames at which muscle forces are known; all where they are for none, shape (frames,)."""
    inside = np.ones(len(time), bool)
    for kind in ("force", "activation"):
        if (path := folder / TABLES[kind][0]).is_file():
            first, last = read_storage(path).time[[0, -1]]
            inside &= (time >= first - SLACK) & (time <= last + SLACK)
    return inside if inside.any() else np.ones(len(time), bool)


def _courses(
    model: Model, angles: Mapping[str, np.ndarray], time: np.ndarray, folder: Path
) -> dict[str, Course]:
    """Return what can be traced: tables of a folder, and joint angles.

    Raises:
        ValueError: A table is none.
    """

    def at(table: Storage) -> np.ndarray:
        """Return a table at the frames, NaN outside of it."""
        known = (time >= table.time[0] - SLACK) & (time <= table.time[-1] + SLACK)
        columns = [np.interp(time, table.time, column) for column in table.values.T]
        return np.where(known[:, None], np.stack(columns, axis=1), np.nan)

    found: dict[str, Course] = {}
    for kind, (file, unit) in TABLES.items():
        if (folder / file).is_file():
            table = read_storage(folder / file)
            values = at(table)
            if not np.isfinite(values).any():
                continue
            if unit != "N m":
                found[kind] = Course(unit, table.labels, values)
                continue
            names = tuple(re.sub("_(moment|force)$", "", label) for label in table.labels)
            slides = np.array([label.endswith("_force") for label in table.labels])
            found |= _split(kind, unit, f"{kind} along a slide", "N", names, values, slides)
    if (folder / REACTIONS).is_file():
        table = read_storage(folder / REACTIONS)
        first = np.flatnonzero([label.endswith("_fx") for label in table.labels])
        size = np.linalg.norm(at(table).reshape(len(time), -1)[:, np.add.outer(first, range(3))], axis=2)
        names = tuple(table.labels[k].partition("_on_")[0] for k in first)
        if names:
            found["joint reaction"] = Course("N", names, size)
    if "activation" in found and (folder / EMG).is_file():
        emg, own = read_storage(folder / EMG, gaps=True), found["activation"]
        measured = np.full_like(own.values, np.nan)
        for column, name in zip(at(emg).T, emg.labels, strict=True):
            if name in own.items:
                measured[:, own.items.index(name)] = column
        found["activation"] = Course(own.unit, own.items, own.values, measured)
    turns = np.array([model.coordinates[name].rotational for name in angles])
    shown = np.stack(list(angles.values()), axis=1) * np.where(turns, np.degrees(1.0), 1.0)
    return found | _split("joint angle", "°", "joint translation", "m", tuple(angles), shown, ~turns)


def _split(
    kind: str,
    unit: str,
    other: str,
    its_unit: str,
    labels: tuple[str, ...],
    values: np.ndarray,
    mask: np.ndarray,
) -> dict[str, Course]:
    """Return columns as two quantities, the second of those in a mask; none that has no column."""
    parts = ((kind, unit, ~mask), (other, its_unit, mask))
    return {
        name: Course(measure, tuple(compress(labels, own)), values[:, own])
        for name, measure, own in parts
        if own.any()
    }
