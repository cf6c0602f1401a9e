"""Validation: moment arms and static forces of elbow and hand beside OpenSim's."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from myowarp.apps.reports.result import POSITIVE, Merit, both, rises
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab, Tick
from myowarp.definitions.body import BODIES
from myowarp.inks import INKS, VERMILION
from myowarp.osim.bundle.couplings import follow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RECORD = Path(__file__).with_name("opensim_arms.json")
BODY = {"arm26": "elbow", "MoBL_ARMS": "hand"}
PAPER_ARM = {"arm26": (0.44, 0.9), "MoBL_ARMS": (3.8, 5.7)}  # mm; printed: 0.044 +- 0.09, 0.38 +- 0.57 %
PAPER_FORCE = {"arm26": (2.2, 1.4), "MoBL_ARMS": (4.1, 2.0)}  # % of maximum isometric force
AS_CM = "the paper prints it as %; by all signs it is centimetres"
JOINTS = {  # coordinate of OpenSim: joint of the body, its sign
    "r_elbow_flex": ("r_elbow_flex", 1.0),
    "pro_sup": ("pro_sup_r", 1.0),
    "deviation": ("deviation_r", -1.0),  # ulnar is positive in OpenSim, radial in MyoSuite
    "flexion": ("flexion_r", 1.0),
}
FINGERS = {"L": "5", "R": "4", "M": "3", "I": "2"}  # FDSL is FDS5, and so on
STEP = 1e-5  # rad
CONSISTENT = 1e-4  # m
SAME_PEAK = 0.05  # share by which maximum isometric forces may differ
SAME_PLACE = 1.0  # mm
FLOOR = 1e-3  # mm or %, of what the figure shows
MARKER_FLOOR = 1e-5  # mm, likewise
OVERSTRETCHED = 1.2  # Fmax of static force; more is the passive force of a fiber far beyond its optimum


@dataclass(frozen=True)
class Pair:
    """A muscle and a coordinate over K angles and A activations.

    Attributes:
        muscle: Its name in OpenSim.
        coordinate: Name of the coordinate.
        angle: [rad], shape (K,).
        arm: Moment arms [m], shape (K,): ours and OpenSim's.
        force: Static forces [OpenSim's maximum isometric force], shape (K, 1 + A): ours and OpenSim's; the
            first column is the passive force alone, the others are of A activations.
        kept: Where OpenSim's moment arm is the slope of its length, shape (K,).
        fitted: Whether the muscle's length stays within the range that its parameters were made for, to 1 %
            of that range, its greatest force is OpenSim's to 5 %, and OpenSim does not overstretch it.
    """

    muscle: str
    coordinate: str
    angle: np.ndarray
    arm: tuple[np.ndarray, np.ndarray]
    force: tuple[np.ndarray, np.ndarray]
    kept: np.ndarray
    fitted: bool

    @property
    def arm_rms(self) -> float:
        """Root mean square difference of the moment arms [mm]."""
        return 1e3 * rms((self.arm[0] - self.arm[1])[self.kept])

    @property
    def passive_torque(self) -> tuple[np.ndarray, np.ndarray]:
        """Passive torque over OpenSim's maximum isometric force [m], shape (K,): ours and OpenSim's."""
        ours, theirs = (arm * force[:, 0] for arm, force in zip(self.arm, self.force, strict=True))
        return ours, theirs


@dataclass(frozen=True)
class Path3D:
    """The path of a marker while a coordinate moves, ours and OpenSim's, in the ground frame [m], (K, 3)."""

    marker: str
    coordinate: str
    ours: np.ndarray
    theirs: np.ndarray

    @property
    def apart(self) -> float:
        """Root mean square distance [mm]."""
        return 1e3 * rms(np.linalg.norm(self.ours - self.theirs, axis=1))


@dataclass(frozen=True)
class Conversion:
    """A conversion of a file beside OpenSim.

    Attributes:
        fitted: With fitted paths and forces, as `myowarp convert` writes it.
        plain: Straight through the fixed points of the paths and with MuJoCo's own force curves.
        markers: How they move; no fit touches them.
    """

    fitted: list[Pair]
    plain: list[Pair]
    markers: list[Path3D]


def rms(values: np.ndarray) -> float:
    """Return a root mean square of what is finite."""
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


@cache
def recorded() -> dict[str, Any]:
    """Return what OpenSim said."""
    record: dict[str, Any] = json.loads(RECORD.read_text())
    return record


def pairs(
    model: mujoco.MjModel,
    record: Mapping[str, Any],
    joints: Mapping[str, tuple[str, float]],
    names: Mapping[str, str],
    activations: tuple[float, ...],
    points: int,
) -> list[Pair]:
    """Return all pairs of a recorded model that a MuJoCo model has.

    Args:
        model: With muscles.
        record: One of the models in `recorded()`.
        joints: Coordinate to joint, and what to multiply its values with.
        names: OpenSim's names of muscles to the model's; the others are left out.
        activations: Of the record's forces.
        points: Angles of a curve.
    """
    found = []
    for coordinate, (first, last) in record["ranges"].items():
        if coordinate not in joints:
            continue  # the file locks it
        joint, sign = joints[coordinate]
        angle = np.linspace(first, last, points)
        length, arm, force = curves(model, model.joint(joint).id, sign * angle, (0.0, *activations))
        for row in (r for r in record["curves"] if r["coordinate"] == coordinate and r["muscle"] in names):
            muscle = model.actuator(names[row["muscle"]]).id
            peak, (low, high) = row["max_isometric_force"], model.actuator_lengthrange[muscle]
            slack, own = 0.01 * (high - low), length[:, muscle]
            within = own.min() > low - slack and own.max() < high + slack
            load = np.column_stack((row["passive"], row["force"])).astype(float) / peak
            theirs, slope = np.array(row["moment_arm"]), np.array(row["slope"])
            found.append(
                Pair(
                    row["muscle"],
                    coordinate,
                    angle,
                    (sign * arm[:, muscle], theirs),
                    (force[:, :, muscle] / peak, load),
                    np.abs(theirs - slope) < CONSISTENT,
                    bool(
                        within
                        and abs(model.actuator_gainprm[muscle, 2] / peak - 1.0) < SAME_PEAK
                        and np.nanmax(load) < OVERSTRETCHED
                    ),
                )
            )
    return found


def curves(
    model: mujoco.MjModel, joint: int, angles: np.ndarray, activations: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lengths, moment arms and static forces of all actuators over the angles of a joint.

    Returns:
        Lengths [m] and moment arms -dl/dq [m], shape (K, nu), forces [N], shape (K, A, nu).
    """
    data = mujoco.MjData(model)
    length = np.zeros((3, len(angles), model.nu))
    force = np.zeros((len(angles), len(activations), model.nu))
    for row, angle in enumerate(angles):
        for side, shift in enumerate((-STEP, STEP, 0.0)):
            turn(model, data, joint, angle + shift)
            mujoco.mj_fwdPosition(model, data)
            length[side, row] = data.actuator_length
        for column, activation in enumerate(activations):
            data.act[:] = data.ctrl[:] = activation
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            force[row, column] = -data.actuator_force
    return length[2], -(length[1] - length[0]) / (2.0 * STEP), force


def turn(model: mujoco.MjModel, data: mujoco.MjData, joint: int, angle: float) -> None:
    """Put a model at rest into its default posture, but for one joint and those that follow it."""
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "default")
    data.qpos[:], data.qvel[:] = model.qpos0 if key < 0 else model.key_qpos[key], 0.0
    data.qpos[model.jnt_qposadr[joint]] = angle
    follow(model, data.qpos)


def markers(
    model: mujoco.MjModel, record: Mapping[str, Any], joints: Mapping[str, tuple[str, float]]
) -> list[Path3D]:
    """Return the paths of all recorded markers that a converted model has, over each of its coordinates."""
    data, found = mujoco.MjData(model), []
    there = {model.site(i).name for i in range(model.nsite)}
    for coordinate, (joint, sign) in joints.items():
        paths = record["markers"].get(coordinate, {})
        names = [name for name in paths if name in there]
        ours: dict[str, list[np.ndarray]] = {name: [] for name in names}
        first, last = record["ranges"].get(coordinate, (0.0, 0.0))
        for angle in np.linspace(first, last, recorded()["points"]):
            turn(model, data, model.joint(joint).id, sign * angle)
            mujoco.mj_kinematics(model, data)
            ground = data.body("ground")
            for name in names:
                ours[name].append((data.site(name).xpos - ground.xpos) @ ground.xmat.reshape(3, 3))
        found += [Path3D(name, coordinate, np.array(ours[name]), np.array(paths[name])) for name in names]
    return found


def muscles_of(model: mujoco.MjModel, record: Mapping[str, Any], suffix: str = "") -> dict[str, str]:
    """Return OpenSim's names of muscles to those of a model, where it has them."""
    there = {model.actuator(i).name for i in range(model.nu)}
    found = {}
    for name in dict.fromkeys(row["muscle"] for row in record["curves"]):
        split = name[:3] in ("FDS", "FDP", "EDC") and name[3:] in FINGERS
        own = (name[:3] + FINGERS[name[3:]] if split and suffix else name) + suffix
        if own in there:
            found[name] = own
    return found


def force_rms(found: list[Pair], only_fitted: bool = False, passive: bool = False) -> dict[str, float]:
    """Return the root mean square difference of each muscle's force [%], over all its coordinates."""
    table: dict[str, list[np.ndarray]] = {}
    unfit = {pair.muscle for pair in found if not pair.fitted}
    which = slice(0, 1) if passive else slice(1, None)
    for pair in found:
        if not (only_fitted and pair.muscle in unfit):
            table.setdefault(pair.muscle, []).append((pair.force[0] - pair.force[1])[:, which].ravel())
    return {muscle: 100.0 * rms(np.concatenate(parts)) for muscle, parts in table.items()}


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    record, bodies, converted = recorded(), {}, dict[str, Conversion]()
    points, activations = record["points"], tuple(record["activations"])
    for name, body in BODY.items():
        model, curves_of = BODIES[body].build().compile(), record["models"][name]
        names = muscles_of(model, curves_of, "" if body == "elbow" else "_r")
        bodies[name] = pairs(model, curves_of, JOINTS, names, activations, points)
    files = {path.stem: path for path in lab.models}
    for name in files:
        if name not in BODY:
            raise ValueError(f"--models compares {' and '.join(BODY)}, got {str(files[name])!r}")
    lab.expect(len(files))
    for name, path in files.items():
        (model, plain), joints = _converted(lab, path), _joints(lab, path)
        curves_of = record["models"][name]
        names = muscles_of(model, curves_of)
        fitted, bare = (pairs(one, curves_of, joints, names, activations, points) for one in (model, plain))
        converted[name] = Conversion(fitted, bare, markers(model, curves_of, joints))
    return findings(bodies, converted)


def _folder(lab: Lab, path: Path) -> Path:
    """Return where a file's conversion is."""
    return lab.folder / "converted" / path.stem


def _joints(lab: Lab, path: Path) -> dict[str, tuple[str, float]]:
    """Return joint and scale of the coordinates of a converted file."""
    table = json.loads((_folder(lab, path) / "coordinates.json").read_text())["coordinates"]
    return {row["name"]: (row["joint"], row["scale"]) for row in table if row["joint"]}


def _converted(lab: Lab, path: Path) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """Return the converted model of a file, with and without fitted paths and forces."""
    from myowarp.disk import files_digest
    from myowarp.osim.bundle.mjcf import mjcf
    from myowarp.osim.convert.compose.convert import convert as compose
    from myowarp.osim.convert.run import run as convert
    from myowarp.osim.document.read.model import read_model
    from myowarp.sim.converted_step import OurStep

    folder = _folder(lab, path)

    def measure(_: Tick) -> dict[str, np.ndarray]:
        convert(path, folder, OurStep)
        return {}

    lab.kept(f"convert_{path.stem}", {"file": files_digest([path])}, measure)
    plain = compose(read_model(path))
    bare = mujoco.MjModel.from_xml_string(mjcf(plain.spec), {**plain.meshes})
    return mujoco.MjModel.from_xml_path(str(folder / "model.xml")), bare


def findings(bodies: dict[str, list[Pair]], converted: dict[str, Conversion]) -> Findings:
    """Return figures of merit, claims and figure."""
    rows: list[Merit] = []
    sets = [(name, BODY[name], found) for name, found in bodies.items()]
    sets += [(name, f"{name}, our converter", one.fitted) for name, one in converted.items()]
    what, fmax = "static force, RMS difference", "% Fmax"

    def add(
        quantity: str,
        unit: str,
        who: str,
        values: Iterable[float],
        paper: tuple[float, float] | tuple[None, None] = (None, None),
        note: str = "",
    ) -> None:
        own = list(values)
        rows.append(Merit(quantity, unit, who, own, paper[0], paper[1], note, POSITIVE))
        if len(own) > 1:
            rows.append(Merit(f"{quantity}, median", unit, who, [float(np.nanmedian(own))]))

    for name, who, found in sets:
        forces, note = force_rms(found), AS_CM
        add("moment arms, RMS difference", "mm", who, [p.arm_rms for p in found], PAPER_ARM[name], note)
        worst = max(forces, key=forces.__getitem__)
        note = f"worst: {worst}, {forces[worst]:.0f} %"
        add(what, fmax, who, forces.values(), PAPER_FORCE[name], note)
        add("passive force, RMS difference", fmax, who, force_rms(found, passive=True).values())
    for name, one in converted.items():
        who, bare = f"{name}, our converter without its fits", force_rms(one.plain)
        add("moment arms, RMS difference", "mm", who, [p.arm_rms for p in one.plain])
        add(what, fmax, who, bare.values())
        who = f"{name}, our converter, {len({p.marker for p in one.markers})} markers"
        add("markers, RMS distance", "mm", who, [p.apart for p in one.markers])
    for name, found in bodies.items():
        fitted, all_of = list(force_rms(found, only_fitted=True).values()), force_rms(found)
        who, note = f"{BODY[name]}, muscles within their range", f"{len(fitted)} of {len(all_of)} muscles"
        add(what, fmax, who, fitted, PAPER_FORCE[name], note)
    for name, conversion in converted.items():
        own = [p for p in conversion.fitted if p.coordinate in JOINTS]
        coordinates = ", ".join(dict.fromkeys(p.coordinate for p in own))
        add(
            "moment arms, RMS difference",
            "mm",
            f"{name}, our converter, {coordinates} alone",
            [p.arm_rms for p in own],
            PAPER_ARM[name],
            AS_CM,
        )
    holds = {}
    for name, found in bodies.items():
        arms, loads = [p.arm_rms for p in found], list(force_rms(found).values())
        holds[f"{BODY[name]}, moment arms"] = rises(sum(PAPER_ARM[name]) - np.array(arms))
        holds[f"{BODY[name]}, forces"] = rises(sum(PAPER_FORCE[name]) - np.array(loads))
    gained = [(one.plain, one.fitted) for one in converted.values()]
    arms_gained = [
        np.nan_to_num([p.arm_rms - q.arm_rms for p, q in zip(*two, strict=True)]) for two in gained
    ]
    holds["path fit"] = both(*map(rises, arms_gained)) if gained else None
    loads_gained = [
        np.array(list(force_rms(plain).values())) - np.array(list(force_rms(fitted).values()))
        for plain, fitted in gained
    ]
    holds["force fit"] = both(*map(rises, loads_gained)) if gained else None
    apart = [path.apart for one in converted.values() for path in one.markers]
    holds["markers"] = max(apart) < SAME_PLACE if apart else None
    return Findings(
        rows,
        holds,
        lambda figure: draw(figure, bodies, converted),
        measured(bodies, converted),
        over="pairs of muscle (or marker) and coordinate, or muscles",
    )


def mean_arm(found: list[Pair]) -> float:
    """Return the mean over all pairs of their moment arms' RMS difference [mm]."""
    return float(np.nanmean([pair.arm_rms for pair in found]))


def median_arm(found: list[Pair]) -> float:
    """Return the median over all pairs of their moment arms' RMS difference [mm]."""
    return float(np.nanmedian([pair.arm_rms for pair in found]))


def mean_force(found: list[Pair]) -> float:
    """Return the mean over all muscles of their forces' RMS difference [%]."""
    return float(np.mean(list(force_rms(found).values())))


def passive_torque(angle: float) -> tuple[float, float]:
    """Return the passive torque of all muscles about the elbow at an angle [rad]: ours, OpenSim's [N m]."""
    record = recorded()
    model, own = BODIES["elbow"].build().compile(), record["models"]["arm26"]
    names = muscles_of(model, own)
    found = pairs(model, own, JOINTS, names, tuple(record["activations"]), record["points"])
    peaks = {row["muscle"]: row["max_isometric_force"] for row in own["curves"]}
    total = [
        sum(peaks[p.muscle] * np.interp(angle, p.angle, p.passive_torque[i]) for p in found) for i in (0, 1)
    ]
    return float(total[0]), float(total[1])


def measured(bodies: dict[str, list[Pair]], converted: dict[str, Conversion]) -> dict[str, Any]:
    """Return the values of the essay."""
    elbow, hand = bodies["arm26"], bodies["MoBL_ARMS"]
    forces = force_rms(hand)
    largest = sorted(forces, key=lambda name: -forces[name])[:6]
    unfit = sorted({p.muscle for p in hand if not p.fitted})
    ours, theirs = (np.array([[p.force[i][k, -1] for k in (0, -1)] for p in elbow]) for i in range(2))
    short = [(i, int(np.argmin(row))) for i, row in enumerate(ours)]
    fits = "; ".join(
        f"{name}: {mean_arm(one.fitted):.2g} mm and {mean_force(one.fitted):.2g} % of Fmax"
        for name, one in converted.items()
    )
    hardest = []
    for name, one in converted.items():
        found = one.fitted
        own = force_rms(found)
        worst = max(own, key=own.__getitem__)
        others = [value for muscle, value in own.items() if muscle != worst]
        pair = max(found, key=lambda p: np.nan_to_num(p.arm_rms))
        hardest.append(
            f"{name}: forces of {worst} {own[worst]:.0f} % and of the other {len(others)} muscles "
            f"{np.mean(others):.2g} % on average, median {np.median(others):.2g} %; moment arms of "
            f"{pair.muscle} over {pair.coordinate} {pair.arm_rms:.3g} mm, median of {len(found)} pairs "
            f"{np.nanmedian([p.arm_rms for p in found]):.2g} mm"
        )
    passive = passive_torque(np.radians(90.0))
    return {
        "elbow": mean_arm(elbow),
        "elbow_force": mean_force(elbow),
        "hand": mean_arm(hand),
        "hand_force": mean_force(hand),
        "ends": "; ".join(f"{elbow[i].muscle} {theirs[i, k]:.2f} and {ours[i, k]:.2f}" for i, k in short),
        "after": f"The same file by our converter: {fits}." if fits else "`--models` measures it.",
        "hardest": ". ".join(hardest) or "`--models` measures it",
        "passive": passive,
        "fits": "; ".join(
            f"{name}: moment arms {mean_arm(one.plain):.2g} to {mean_arm(one.fitted):.2g} mm (medians "
            f"{median_arm(one.plain):.2g} to {median_arm(one.fitted):.2g}), "
            f"forces {mean_force(one.plain):.2g} to {mean_force(one.fitted):.2g} % of Fmax"
            for name, one in converted.items()
        )
        or "`--models` measures it",
        "markers": "; ".join(
            f"{name}: {max(path.apart for path in one.markers):.2g} mm, {len(one.markers)} paths"
            for name, one in converted.items()
            if one.markers
        )
        or "`--models` measures it",
        "per": {c: mean_arm([p for p in hand if p.coordinate == c]) for c in {p.coordinate for p in hand}},
        "left_out": sum(int((~p.kept).sum()) for p in hand),
        "angles": sum(p.kept.size for p in hand),
        "number_unfit": len(unfit),
        "number": len(forces),
        "unfit": ", ".join(unfit),
        "worst": ", ".join(f"{name} {forces[name]:.0f} %" for name in largest),
    }


def draw(figure: Figure, bodies: dict[str, list[Pair]], converted: dict[str, Conversion]) -> None:
    """Draw curves over the elbow, paths of markers, and differences of all muscles."""
    figure.set_size_inches(8.5, 12.0)
    (arms, loads), (pulls, slack), bottom, (course, apart) = figure.subplots(4, 2)
    elbow = bodies["arm26"]
    curves_of = (
        (arms, 1e3, "moment arms [mm]", lambda p, i: p.arm[i]),
        (loads, 1.0, "static force at full activation [Fmax]", lambda p, i: p.force[i][:, -1]),
        (pulls, 1.0, "passive force [Fmax]", lambda p, i: p.force[i][:, 0]),
    )
    for axes, scale, title, of in curves_of:
        for color, pair in zip(INKS, elbow, strict=False):
            angle = np.degrees(pair.angle)
            axes.plot(angle, scale * of(pair, 1), color=color, linewidth=4.0, alpha=0.3)
            axes.plot(angle, scale * of(pair, 0), color=color, linewidth=1.2, label=pair.muscle)
        axes.set(title=f"Elbow: {title}", xlabel="elbow angle [°]")
    loads.set_ylim(0.0, None)
    arms.plot([], [], color="0.5", linewidth=4.0, alpha=0.4, label="OpenSim, broad")
    arms.set_ylim(-30.0, 95.0)
    arms.legend(ncols=2, fontsize=7, loc="upper left")
    sets = [(BODY[name], name, found, "o") for name, found in bodies.items()]
    for name, one in converted.items():
        short = name.partition("_")[0]
        sets += [(f"{short},\nno fits", name, one.plain, "v"), (f"{short},\nfitted", name, one.fitted, "^")]
    colors = [INKS[i] for i in (0, 1, 2, 2, 3, 3)]
    differences: tuple[tuple[Axes, Any, str, Callable[[list[Pair]], Iterable[float]]], ...] = (
        (slack, None, "passive force [% Fmax]", lambda found: force_rms(found, passive=True).values()),
        (bottom[0], PAPER_ARM, "moment arms [mm]", lambda found: [p.arm_rms for p in found]),
        (bottom[1], PAPER_FORCE, "static force [% Fmax]", lambda found: force_rms(found).values()),
    )
    for axes, paper, title, values_of in differences:
        for x, (_, name, found, marker) in enumerate(sets):
            values = np.array(list(values_of(found)))
            spots = x + np.linspace(-0.28, 0.28, len(values))
            look: dict[str, Any] = {"markersize": 3, "alpha": 0.6, "color": colors[x]}
            axes.plot(spots, np.maximum(values, FLOOR), marker, **look)
            axes.plot([x - 0.3, x + 0.3], [np.nanmean(values)] * 2, "k", linewidth=1.5)
            axes.plot([x - 0.2, x + 0.2], [np.nanmedian(values)] * 2, "k:", linewidth=1.5)
            if paper:
                axes.plot([x - 0.4, x + 0.4], [paper[name][0]] * 2, color=VERMILION, linewidth=1.5)
        axes.set_xticks(range(len(sets)), [label for label, *_ in sets], fontsize=8)
        axes.set(yscale="log", title=f"RMS difference, {title}")
    draw_markers(course, apart, converted)


def draw_markers(course: Axes, apart: Axes, converted: dict[str, Conversion]) -> None:
    """Draw the paths of arm26's markers over the elbow, and how far all markers are from OpenSim's."""
    moving = [path for one in converted.values() for path in one.markers if path.coordinate in JOINTS]
    moving = [path for path in moving if np.ptp(path.theirs, axis=0).max() > CONSISTENT]
    for color, path in zip(INKS * len(moving), moving, strict=False):
        course.plot(*path.theirs[:, :2].T, color=color, linewidth=4.0, alpha=0.3)
        course.plot(*path.ours[:, :2].T, color=color, linewidth=1.2)
    course.set(title="Paths of markers, converted", xlabel="forward [m]", ylabel="upward [m]", aspect="equal")
    for x, (_, one) in enumerate(converted.items()):
        values = np.array([path.apart for path in one.markers])
        spots = x + np.linspace(-0.28, 0.28, len(values))
        apart.plot(spots, np.maximum(values, MARKER_FLOOR), "^", markersize=3, color=INKS[2 + x], alpha=0.6)
    apart.set_xticks(range(len(converted)), list(converted))
    apart.set(yscale="log", title="RMS distance of markers [mm]", xlim=(-0.6, max(len(converted), 1) - 0.4))
    if not moving:
        course.text(0.5, 0.5, "--models draws them", ha="center", transform=course.transAxes)


EXPERIMENT = Experiment("validation", run, ignores=("seeds", "num_worlds", "retrain", "device"))
