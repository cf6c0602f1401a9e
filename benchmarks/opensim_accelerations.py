"""Accelerations of our step (float32) beside OpenSim's in random states, and those of float64.

    python tests/data/record_opensim_accelerations.py MODEL.osim ...
        --states 100 --share 1 --mass 0.05 -o RECORDED
    python -m benchmarks.opensim_accelerations MODEL.osim ... --recorded RECORDED

The first needs OpenSim 4.6 and records; the second needs none, and writes
benchmarks/results/opensim_accelerations.json. Errors are |a - a_OpenSim| / |a_OpenSim| over all free
coordinates; limits, muscles and contacts are off. Bodies of a document that weighs nothing get the mass that
the recording gave them.
"""

import argparse
import dataclasses
import json
import tempfile
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
import warp as wp

from myowarp.coordinates.free_coordinates import document_model, inertia_of
from myowarp.osim.bundle.couplings import couplings, follow, jacobian
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.document.model import Model
from myowarp.osim.document.read.model import read_model
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import pose_task

RESULT = Path(__file__).parent / "results" / "opensim_accelerations.json"
MASS, INERTIA = 0.05, 1e-4  # kg, kg m^2; as `--mass` of the recording


def weighed(model: Model) -> Model:
    """Return a model; one that weighs nothing with masses."""
    if any(body.mass for body in model.bodies.values()):
        return model
    inertia = np.array([INERTIA] * 3 + [0.0] * 3)
    bodies = {name: dataclasses.replace(b, mass=MASS, inertia=inertia) for name, b in model.bodies.items()}
    return dataclasses.replace(model, bodies=MappingProxyType(bodies))


def compare(source: Path, recorded: Path) -> dict[str, Any]:
    """Return median and worst errors of one model, and how its mass matrices are conditioned."""
    record = np.load(recorded / f"accelerations_{source.stem}.npz")
    converted = convert(weighed(read_model(source)))
    spec = converted.spec
    for element in [*spec.actuators, *spec.tendons]:
        spec.delete(element)
    entries = {entry.name: entry for entry in converted.coordinates.coordinates}
    for entry in entries.values():
        if entry.kind == "free":
            spec.add_actuator(name=entry.name, target=entry.joint, trntype=0, ctrlrange=(-1, 1))
    for joint in spec.joints:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(mjcf(spec))
        (path.parent / "couplings.json").write_text(converted.couplings.as_json())
        count = len(record["values"])
        sim = Simulation(pose_task(path), count, device="cpu", graph=False, progress=False)
    model, data = sim.scene.oracle, sim.scene.data
    names = [str(name) for name in record["coordinates"]]
    joints = [model.joint(entries[name].joint).id for name in names]
    scale = np.array([entries[name].scale for name in names])
    states = {key: np.zeros((count, model.nv)) for key in ("values", "speeds", "forces")}
    for key, power in (("values", 1), ("speeds", 1), ("forces", -1)):
        states[key][:, joints] = record[key] * scale**power
    data.qpos.assign(states["values"])
    data.qvel.assign(states["speeds"])
    data.qfrc_applied.assign(states["forces"])
    data.qacc_warmstart.zero_()
    with wp.ScopedDevice(sim.scene.device):
        sim.shards[0].launch_physics()
    single = data.qacc.numpy()[:, joints] / scale
    double, conditions = zip(*(_double(sim, *row) for row in zip(*states.values(), strict=True)), strict=True)
    exact = np.array(double)[:, joints] / scale
    wanted = record["accelerations"]
    return {
        "step_float32": _spread(_error(single, wanted)),
        "float64": _spread(_error(exact, wanted)),
        "condition_of_scaled_mass_matrix": _spread(np.array(conditions)),
    }


def _double(
    sim: Simulation, q: np.ndarray, speeds: np.ndarray, forces: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return M_r^-1 J'(forces - c - M a) of one state in float64, and the condition of M_r, scaled."""
    model, host, ties = sim.scene.oracle, document_model(sim.scene.oracle), couplings(sim.scene.oracle)
    data = mujoco.MjData(host)
    follow(model, q)
    reduced, _ = inertia_of(host, ties, q)
    free, slopes, bends = jacobian(model, ties, q)
    data.qpos[:], data.qvel[:] = q, slopes @ speeds[free]
    data.qacc[:] = 0.0
    for tie in ties:
        data.qacc[tie.joint] = bends[tie.joint] * (speeds[tie.driver] ** 2 if tie.driver >= 0 else 0.0)
    for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_crb, mujoco.mj_comVel):
        compute(host, data)
    bias = np.zeros(model.nv)
    mujoco.mj_rne(host, data, 1, bias)
    found = np.zeros(model.nv)
    found[free] = np.linalg.solve(reduced, forces[free] - slopes.T @ bias)
    size = np.sqrt(np.diag(reduced))
    return found, float(np.linalg.cond(reduced / np.outer(size, size)))


def _error(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)


def _spread(values: np.ndarray) -> dict[str, float]:
    return {"median": float(f"{np.median(values):.3g}"), "worst": float(f"{values.max():.3g}")}


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--recorded", type=Path, required=True)
    options = parser.parse_args()
    result = json.loads(RESULT.read_text()) if RESULT.is_file() else {"models": {}}
    for source in options.models:
        result["models"][source.stem] = compare(source, options.recorded)
        print(source.stem, json.dumps(result["models"][source.stem]))
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
