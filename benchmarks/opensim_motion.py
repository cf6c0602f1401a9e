"""Recorded motions beside live OpenSim: scaling, angles, moments, static optimisation, joint reactions.

    .venv-opensim/bin/python benchmarks/opensim_motion_record.py MODEL.osim ... --trial FOLDER -o out/motion
    python -m benchmarks.opensim_motion MODEL.osim ... --trial FOLDER --recorded out/motion

or `make opensim-check`. The first needs OpenSim 4.6. The second needs none, and writes
benchmarks/results/opensim_motion.json. Each step begins at what OpenSim's tool began at: dynamics at its
angles, joint reactions at its muscle forces. Muscles and reactions are compared in frames in which OpenSim's
forces meet its own moments.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.machine import processor
from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.motion.inverse_kinematics import inverse_kinematics
from myowarp.motion.joint_reactions import joint_reactions
from myowarp.motion.loads import loads_at
from myowarp.motion.markers import Markers, read_trc
from myowarp.motion.muscle_forces import muscle_forces
from myowarp.motion.scaling import read_setup, scale
from myowarp.motion.smooth import derivatives
from myowarp.motion.tasks import tasks_of
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.read.element import parse
from myowarp.osim.document.read.model import read_model

RESULT = Path(__file__).parent / "results" / "opensim_motion.json"
RESERVE, AT_ROOT = 10.0, 100.0
"""[N m, N] at control 1, and what those of the pelvis are over it."""
MET = 1e-3
"""Share of the greatest moment up to which OpenSim's forces meet a frame."""
LEAST = 1e-3
"""[m] of a marker's place from which on a factor is told from it."""
GOALS = {
    "factors": 1e-6,
    "angles, deg": 0.05,
    "marker errors, mm": 0.05,
    "moments / peak": 1e-3,
    "activations, median": 1e-3,
    "activations, worst": 0.02,
    "forces / peak": 0.01,
    "reaction forces / peak": 0.01,
    "reaction moments / peak": 0.01,
}
"""Bounds of deviations."""


def of_angles(bones: Bones, there: Any, markers: Markers, **wanted: Any) -> dict[str, float]:
    """Return how far our angles, and the errors of markers in them, are from OpenSim's."""
    ours = inverse_kinematics(bones, markers, **wanted)
    held = inverse_kinematics(
        bones, markers, wanted.get("marker_weights"),
        dict.fromkeys(bones.coordinates, 1e12),
        dict(zip(bones.coordinates, there["fitted"].T, strict=True)), near=there["fitted"],
    )  # fmt: skip
    turns = np.array([bones.model.coordinates[name].rotational for name in bones.coordinates])
    off = np.abs(ours.values - there["fitted"]).max(axis=0)
    fit, theirs = (np.nanmean(one.error**2, axis=1) for one in (ours, held))
    return {
        "angles, deg": float(np.degrees(off[turns]).max()),
        "squared errors / OpenSim's - 1": float((fit / theirs).max() - 1.0),
        "slides, mm": float(1e3 * off[~turns].max(initial=0.0)),
        "marker errors, mm": float(1e3 * np.nanmax(np.abs(ours.error - held.error))),
    }


def of_forces(bones: Bones, there: Any, values: np.ndarray, loads: list[Load]) -> dict[str, float]:
    """Return how far moments, activations, forces and reactions are from OpenSim's."""
    time = there["time"]
    q, u, a = derivatives(time, values, time, 6.0)
    needed = inverse_dynamics(bones, q, u, a, loads)
    peak = np.maximum(np.abs(there["moments"]).max(axis=0), 1e-9)
    found = {"moments / peak": float((np.abs(needed.joint_moment - there["moments"]) / peak.max()).max())}
    acting_on = {f"reserve_{c}": c for c in bones.coordinates}
    acting_on |= {one.name: one.coordinate for one in bones.model.coordinate_actuators}
    reserves = {c: RESERVE * (AT_ROOT if c.startswith("pelvis") else 1.0) for c in bones.coordinates}
    for one in bones.model.coordinate_actuators:  # two at one coordinate cost as much as one of this force
        if one.coordinate in reserves:
            reserves[one.coordinate] = float(np.hypot(reserves[one.coordinate], one.optimal_force))
    paths = muscle_paths(bones, q, u)
    got = muscle_forces(
        bones.model, bones.coordinates, paths, needed.joint_moment, mode="opensim", reserves=reserves
    )
    actuators = list(map(str, there["actuators"]))
    place = [actuators.index(muscle) for muscle in got.muscles]
    given = np.einsum("nmk,nm->nk", paths.moment_arm, there["forces"][:, place])
    for name, force in zip(actuators, there["forces"].T, strict=True):
        coordinate = acting_on.get(name)
        if coordinate in bones.coordinates:
            given[:, bones.coordinates.index(coordinate)] += force
    met = np.abs(given - needed.joint_moment).max(axis=1) <= MET * peak.max()
    off = np.abs(got.activation - there["controls"][:, place])[met]
    strength = np.array([bones.model.muscles[m].max_isometric_force for m in got.muscles])
    worst = np.unravel_index(off.argmax(), off.shape)
    cost = (got.activation**2).sum(axis=1) + ((got.reserve / list(reserves.values())) ** 2).sum(axis=1)
    found |= {
        "activations, median": float(np.median(off)),
        "activations, worst": float(off.max()),
        "worst muscle": f"{got.muscles[worst[1]]} at {time[met][worst[0]]:.3f} s",
        "frames beyond 0.02": int((off.max(axis=1) > GOALS["activations, worst"]).sum()),
        "forces / peak": float((np.abs(got.force - there["forces"][:, place])[met] / strength).max()),
        "cost / OpenSim's - 1": float((cost / (there["controls"] ** 2).sum(axis=1))[met].max() - 1.0),
        "frames": len(time),
        "frames that OpenSim misses": int((~met).sum()),
        "most that it misses / peak": float(np.abs(given - needed.joint_moment).max() / peak.max()),
    }
    tension = {m: there["forces"][:, actuators.index(m)] for m in got.muscles}
    acting = joint_reactions(bones, q, needed, tension)
    order = [list(map(str, there["joints"])).index(joint) for joint in acting.joints]
    force, moment, _ = np.split(there["reactions"][:, order], 3, axis=2)
    for name, own, wanted in (("forces", acting.force, force), ("moments", acting.moment, moment)):
        found[f"reaction {name} / peak"] = float(np.abs(own - wanted)[met].max() / np.abs(wanted).max())
    return found


def of_model(source: Path, recorded: Path) -> dict[str, Any]:
    """Return the deviations on a motion that the project made."""
    there, bones = np.load(recorded / f"motion_{source.stem}.npz"), Bones(read_model(source))
    found: dict[str, Any] = {"model": source.stem, "opensim": str(there["version"])}
    if len(there["markers"]):
        markers = Markers(tuple(map(str, there["markers"])), there["time"], there["seen"])
        found |= of_angles(bones, there, markers)
    load = Load(str(there["body"]), there["force"], there["point"], np.zeros_like(there["force"]))
    return found | of_forces(bones, there, there["values"], [load])


def of_trial(trial: Path, generic: Path, recorded: Path) -> dict[str, Any]:
    """Return the deviations on the public trial."""
    there, bones = np.load(recorded / "trial.npz"), Bones.read(trial / "reference_subject01_simbody.osim")
    scaled = scale(generic, read_setup(trial / "subject01_Setup_Scale.xml"))
    bodies = scaled.document.model
    own = np.array([scaled.factors[bodies.markers[m].body] for m in map(str, there["scaled/markers"])])
    told = np.abs(there["scaled/before"]) > LEAST
    ratio = there["scaled/after"][told] / there["scaled/before"][told]
    tasks = tasks_of(parse(trial / "subject01_Setup_IK.xml")[0])
    markers = read_trc(trial / "subject01_walk1.trc").between(there["time"][0], there["time"][-1])
    weights = {name: weight for name, weight in tasks.markers.items() if name in markers.names}
    mass = sum(body.mass for body in bodies.bodies.values())
    return {
        "model": "gait2354, public trial",
        "opensim": str(there["version"]),
        "factors": float(np.abs(own[told] - ratio).max()),
        "mass / OpenSim's - 1": float(mass / there["scaled/mass"] - 1.0),
        **of_angles(bones, there, markers, marker_weights=weights, coordinate_weights=tasks.coordinates),
        **of_forces(
            bones, there, there["fitted"], loads_at(trial / "subject01_walk1_grf.xml", there["time"])
        ),
    }


def main() -> None:
    """Compare, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="*", type=Path)
    parser.add_argument("--trial", type=Path, help="folder of OpenSim's Gait2354 example")
    parser.add_argument("--generic", type=Path, help="gait2354_simbody.osim; default: beside the models")
    parser.add_argument("--recorded", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    options = parser.parse_args()
    rows = [of_model(source, options.recorded) for source in options.models]
    if options.trial is not None:
        generic = options.generic or options.trial.resolve().parents[1] / "gait2354_simbody.osim"
        rows.append(of_trial(options.trial, generic, options.recorded))
    table = Table("deviation from OpenSim", "may be", *(row["model"] for row in rows))
    for name in dict.fromkeys(name for row in rows for name in row if name not in ("model", "opensim")):
        cells = [row.get(name, "") for row in rows]
        shown = [f"{cell:.2g}" if isinstance(cell, float) else str(cell) for cell in cells]
        table.add_row(name, f"{GOALS[name]:g}" if name in GOALS else "", *shown)
    Console().print(table)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    result = {"processor": processor(), "goals": GOALS, "models": rows}
    options.output.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
