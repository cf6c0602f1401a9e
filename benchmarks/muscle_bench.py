"""Hill muscles on OpenSim's own bench, and their forces on prescribed paths beside finer steps.

    python -m benchmarks.muscle_bench

The bench is that of OpenSim's testMuscles.cpp (tests/muscle_bench.py): a mass that hangs from a muscle, a
ball that it pulls, and a path that is prescribed, without pennation and with 45 degrees of it, under every
model, at four time steps. Motions and forces are compared with OpenSim 4.6 at an accuracy of 1e-6 (recorded,
see tests/data/record_opensim_bench.py). Work of the muscle is compared with the change of energy: with states
and tensions as they are, and with velocities at the times of the positions and the force that the body feels.
Forces on four prescribed paths are compared with those of steps of 0.01 ms: root mean square over time, and
at the worst moment; the worst muscle counts. Writes benchmarks/results/muscle_bench.json. Takes five minutes.
"""

import json
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.definitions.muscle import MUSCLES
from myowarp.models.muscles.hill import Hill
from myowarp.muscle import NAMES, Muscles
from tests.muscle_bench import (
    PEAK,
    PENNATIONS,
    PROTOCOLS,
    RECORDED,
    SCENES,
    deviations,
    parameters,
    swing,
    trajectory,
    unbalanced,
)

RESULT = Path(__file__).parent / "results" / "muscle_bench.json"
BENCH = ("hanging", "ball", "sine")
"""OpenSim's scenes."""
STEPS = (0.0005, 0.001, 0.002, 0.005)  # s
FINE = 1e-5  # s
WITHOUT = "millard2012_rigid"
"""Beginning of the name of each model that OpenSim lacks."""


def on_bench(folder: Path, scene: str, name: str, number: int) -> dict[str, Any]:
    """Return errors of a case, by time step [ms]."""
    case, like = f"{scene} {name} {number}", f"{scene} {WITHOUT} {number}"
    known, row = case in RECORDED, {}
    for dt in STEPS:
        motion = swing(folder, case, dt, case if known else like)
        errors = {}
        if known:
            off, rms = deviations(case, dt, motion)
            errors = {"position [of its range]": off, "force, RMS [of the peak]": rms}
        if scene != "sine":
            errors["work and energy [of all work]"] = unbalanced(scene, motion)
            errors["work and energy, as felt"] = unbalanced(scene, motion.between())
        row[f"{1e3 * dt:g} ms"] = {key: float(value) for key, value in errors.items()}
    if known:
        start, speed, force = RECORDED[case][0]
        held = Muscles(name, **parameters(PENNATIONS[number])).equilibrium(
            SCENES[scene].activation, start, speed
        )
        row["force at the start [of the peak]"] = {
            "float32": abs(float(motion.tension[0]) - force) / PEAK,
            "float64": abs(float(held.tendon_force[0]) - force) / PEAK,
        }
    return row


def on_paths(name: str) -> dict[str, Any]:
    """Return how far forces are off those of fine steps [of the peak], by time step [ms] and path."""
    times, exact = trajectory(name, FINE)
    row = {}
    for dt in STEPS:
        at, found = trajectory(name, dt)
        near = np.searchsorted(times, at - 1e-9).clip(max=len(times) - 1)
        error = found - exact[near]
        rms, worst = np.sqrt(np.mean(error**2, axis=0)).max(axis=1), np.abs(error).max(axis=(0, 2))
        row[f"{1e3 * dt:g} ms"] = {
            path: {"RMS": float(rms[i]), "worst moment": float(worst[i])} for i, path in enumerate(PROTOCOLS)
        }
    return row


def main() -> None:
    """Run, print and write."""
    result: dict[str, Any] = {"bench": {}, "paths": {}}
    with tempfile.TemporaryDirectory() as folder:
        for scene, name, number in product(BENCH, NAMES, range(len(PENNATIONS))):
            case = f"{scene} {name} {round(np.degrees(PENNATIONS[number]))} deg"
            result["bench"][case] = on_bench(Path(folder), scene, name, number)
            print(case, json.dumps(result["bench"][case]), flush=True)
    for name in NAMES:
        if "fiber_length" in MUSCLES[name].STATE and issubclass(MUSCLES[name], Hill):
            result["paths"][name] = on_paths(name)
            print(name, json.dumps(result["paths"][name]), flush=True)
    RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
