"""Validation: moment arms and static forces of elbow and hand beside OpenSim's."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from myowarp.apps.reports.result import Merit
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab, Tick
from myowarp.coordinates.couplings import follow
from myowarp.definitions.body import BODIES

if TYPE_CHECKING:
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
OVERSTRETCHED = 1.2  # Fmax of static force; more is the passive force of a fiber far beyond its optimum


@dataclass(frozen=True)
class Pair:
    """A muscle and a coordinate over K angles and A activations.

    Attributes:
        muscle: Its name in OpenSim.
        coordinate: Name of the coordinate.
        angle: [rad], shape (K,).
        arm: Moment arms [m], shape (K,): ours and OpenSim's.
        force: Static forces [OpenSim's maximum isometric force], shape (K, A): ours and OpenSim's.
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
        length, arm, force = curves(model, model.joint(joint).id, sign * angle, activations)
        for row in (r for r in record["curves"] if r["coordinate"] == coordinate and r["muscle"] in names):
            muscle = model.actuator(names[row["muscle"]]).id
            peak, (low, high) = row["max_isometric_force"], model.actuator_lengthrange[muscle]
            slack, own = 0.01 * (high - low), length[:, muscle]
            within = own.min() > low - slack and own.max() < high + slack
            load = np.array(row["force"], dtype=float) / peak
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
    data, address = mujoco.MjData(model), model.jnt_qposadr[joint]
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "default")
    rest = model.qpos0 if key < 0 else model.key_qpos[key]
    length = np.zeros((3, len(angles), model.nu))
    force = np.zeros((len(angles), len(activations), model.nu))
    for row, angle in enumerate(angles):
        for side, shift in enumerate((-STEP, STEP, 0.0)):
            data.qpos[:], data.qvel[:] = rest, 0.0
            data.qpos[address] = angle + shift
            follow(model, data.qpos)
            mujoco.mj_fwdPosition(model, data)
            length[side, row] = data.actuator_length
        for column, activation in enumerate(activations):
            data.act[:] = data.ctrl[:] = activation
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            force[row, column] = -data.actuator_force
    return length[2], -(length[1] - length[0]) / (2.0 * STEP), force


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


def force_rms(found: list[Pair], only_fitted: bool = False) -> dict[str, float]:
    """Return the root mean square difference of each muscle's force [%], over all its coordinates."""
    table: dict[str, list[np.ndarray]] = {}
    unfit = {pair.muscle for pair in found if not pair.fitted}
    for pair in found:
        if not (only_fitted and pair.muscle in unfit):
            table.setdefault(pair.muscle, []).append((pair.force[0] - pair.force[1]).ravel())
    return {muscle: 100.0 * rms(np.concatenate(parts)) for muscle, parts in table.items()}


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    record, bodies, converted = recorded(), {}, {}
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
        model, joints = _converted(lab, path)
        curves_of = record["models"][name]
        names = muscles_of(model, curves_of)
        converted[name] = pairs(model, curves_of, joints, names, activations, points)
    return findings(bodies, converted)


def _converted(lab: Lab, path: Path) -> tuple[mujoco.MjModel, dict[str, tuple[str, float]]]:
    """Return the converted model of a file, and joint and scale of its coordinates."""
    from myowarp.disk import files_digest
    from myowarp.opensim.convert import run as convert

    folder = lab.folder / "converted" / path.stem

    def measure(_: Tick) -> dict[str, np.ndarray]:
        convert(path, folder)
        return {}

    lab.kept(f"convert_{path.stem}", {"file": files_digest([path])}, measure)
    table = json.loads((folder / "coordinates.json").read_text())["coordinates"]
    joints = {row["name"]: (row["joint"], row["scale"]) for row in table if row["joint"]}
    return mujoco.MjModel.from_xml_path(str(folder / "model.xml")), joints


def findings(bodies: dict[str, list[Pair]], converted: dict[str, list[Pair]]) -> Findings:
    """Return figures of merit, claims and figure."""
    rows = []
    what, fmax = "static force, RMS difference", "% Fmax"

    def compare(name: str, who: str, found: list[Pair]) -> dict[str, float]:
        by_muscle, arms = force_rms(found), [pair.arm_rms for pair in found]
        rows.append(Merit("moment arms, RMS difference", "mm", who, arms, *PAPER_ARM[name], AS_CM))
        rows.append(Merit(what, fmax, who, list(by_muscle.values()), *PAPER_FORCE[name]))
        return by_muscle

    for name, found in bodies.items():
        by_muscle, body = compare(name, BODY[name], found), BODY[name]
        median = float(np.median(list(by_muscle.values())))
        rows.append(Merit("median of the muscles' forces", fmax, body, [median]))
        fitted = list(force_rms(found, only_fitted=True).values())
        who, note = f"{body}, muscles within their range", f"{len(fitted)} of {len(by_muscle)} muscles"
        rows.append(Merit(what, fmax, who, fitted, *PAPER_FORCE[name], note))
    for name, found in converted.items():
        compare(name, f"{name}, our converter", found)
    holds = {}
    for name, found in bodies.items():
        holds[f"{BODY[name]}, moment arms"] = mean_arm(found) < sum(PAPER_ARM[name])
        holds[f"{BODY[name]}, forces"] = mean_force(found) < sum(PAPER_FORCE[name])
    return Findings(
        rows,
        holds,
        lambda figure: draw(figure, bodies, converted),
        measured(bodies, converted),
        over="pairs of muscle and coordinate, or muscles",
    )


def mean_arm(found: list[Pair]) -> float:
    """Return the mean over all pairs of their moment arms' RMS difference [mm]."""
    return float(np.nanmean([pair.arm_rms for pair in found]))


def mean_force(found: list[Pair]) -> float:
    """Return the mean over all muscles of their forces' RMS difference [%]."""
    return float(np.mean(list(force_rms(found).values())))


def measured(bodies: dict[str, list[Pair]], converted: dict[str, list[Pair]]) -> dict[str, Any]:
    """Return the values of the essay."""
    elbow, hand = bodies["arm26"], bodies["MoBL_ARMS"]
    forces = force_rms(hand)
    largest = sorted(forces, key=lambda name: -forces[name])[:6]
    unfit = sorted({p.muscle for p in hand if not p.fitted})
    ours, theirs = (np.array([[p.force[i][k, -1] for k in (0, -1)] for p in elbow]) for i in range(2))
    short = [(i, int(np.argmin(row))) for i, row in enumerate(ours)]
    fits = "; ".join(
        f"{name}: {mean_arm(found):.2g} mm and {mean_force(found):.2g} % of Fmax"
        for name, found in converted.items()
    )
    return {
        "elbow": mean_arm(elbow),
        "ends": "; ".join(f"{elbow[i].muscle} {theirs[i, k]:.2f} and {ours[i, k]:.2f}" for i, k in short),
        "after": f"The same muscles by our converter: {fits}." if fits else "`--models` measures it.",
        "per": {c: mean_arm([p for p in hand if p.coordinate == c]) for c in {p.coordinate for p in hand}},
        "left_out": sum(int((~p.kept).sum()) for p in hand),
        "angles": sum(p.kept.size for p in hand),
        "number_unfit": len(unfit),
        "number": len(forces),
        "unfit": ", ".join(unfit),
        "worst": ", ".join(f"{name} {forces[name]:.0f} %" for name in largest),
    }


def draw(figure: Figure, bodies: dict[str, list[Pair]], converted: dict[str, list[Pair]]) -> None:
    """Draw moment arms and forces over the elbow, and both differences for all muscles."""
    figure.set_figheight(7.0)
    top, bottom = figure.subplots(2, 2)
    for i, pair in enumerate(bodies["arm26"]):
        for axes, (own, ref), scale in ((top[0], pair.arm, 1e3), (top[1], pair.force, 1.0)):
            for values, style in ((own, "-"), (ref, ":")):
                y = scale * (values if values.ndim == 1 else values[:, -1])
                label = pair.muscle if style == "-" else None
                axes.plot(np.degrees(pair.angle), y, style, color=f"C{i}", label=label)
    top[0].set(title="Elbow: moment arms; dotted: OpenSim", xlabel="elbow angle [°]", ylabel="[mm]")
    top[1].set(
        title="Elbow: static force, full activation", xlabel="elbow angle [°]", ylabel="[Fmax]", ylim=0
    )
    top[1].legend(ncols=2, fontsize=7)
    sets = [(BODY[name], found, "o") for name, found in bodies.items()]
    sets += [(f"{name},\nconverted", found, "^") for name, found in converted.items()]
    papers = [PAPER_ARM[n] for n in (*bodies, *converted)], [PAPER_FORCE[n] for n in (*bodies, *converted)]
    labels = ("RMS difference of moment arms [mm]", "RMS difference of forces [% Fmax]")
    for axes, paper, label, forces in zip(bottom, papers, labels, (False, True), strict=True):
        for x, (_, found, marker) in enumerate(sets):
            values = np.array(list(force_rms(found).values()) if forces else [p.arm_rms for p in found])
            spots = x + np.linspace(-0.28, 0.28, len(values))
            axes.plot(spots, np.maximum(values, 1e-4), marker, markersize=3, alpha=0.6, color=f"C{x}")
            axes.plot(x, np.nanmean(values), "_", color="k", markersize=30)
            axes.plot(x + 0.42, paper[x][0], "<", color="0.4", label="paper's mean" if x == 0 else None)
        axes.set_xticks(range(len(sets)), [name for name, *_ in sets])
        axes.set(yscale="log", title=label)
    bottom[0].legend(loc="center left", bbox_to_anchor=(0.5, 0.8))


EXPERIMENT = Experiment("validation", run, ignores=("seeds", "num_worlds", "retrain", "device"))
