"""Motions of Moco's walking example beside OpenSim's, from states of its own, with contact and muscles.

    .venv-opensim/bin/python benchmarks/opensim_playback_record.py EXAMPLE3DWALKING -o FOLDER
    python -m benchmarks.opensim_playback FOLDER

The first needs OpenSim 4.6, and records. The second runs `whole.osim` as `myowarp.from_osim` loads it, with
OpenSim's contact, without stops, from the same coordinates, speeds, activations and fibers, at the model's
own physics step and at shorter ones. Ground force is the sum of all contacts, where OpenSim's carries more
than 50 N.
Writes benchmarks/results/opensim_playback.json.
"""

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import processor
from myowarp.osim.bundle.coordinate_map import CoordinateMap
from myowarp.osim.convert.load import load
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import place
from myowarp.tasks.from_file import from_osim

RESULT = Path(__file__).parent / "results" / "opensim_playback.json"
SHORTER = 1e-3, 5e-4
"""s: shorter physics steps."""
CARRIES = 50.0
"""N."""
FAR = 1e6
"""Pose error at which an episode ends early: none does."""


def played(file: Path, record: Any, step: float | None) -> dict[str, Any]:
    """Return how far motions are from OpenSim's; physics steps are the model's own, or of a length [s]."""
    meta = json.loads(str(record["meta"]))
    task = from_osim(file, stops=False, contact="opensim", far=FAR, horizon=10_000, replace=True)
    dt = task.physics_dt if step is None else step
    task = dataclasses.replace(task, physics_dt=dt, num_substeps=1)
    number = len(record["values"])
    sim = Simulation(task, number, device="cpu", autoreset="disabled", progress=False)
    scene, mapped = sim.scene, CoordinateMap.read(load(file, contact="opensim").with_name("coordinates.json"))
    columns = {name: k for k, name in enumerate(meta["coordinates"])}
    free = [name for name in mapped.free() if name in columns]
    own = [columns[name] for name in free]
    qpos, slope = mapped.rates(scene.oracle, {n: record["values"][:, 0, columns[n]] for n in free})
    kept = [mapped.free().index(name) for name in free]
    qvel = np.einsum("nij,nj->ni", slope[:, :, kept], record["speeds"][:, 0, own])
    muscles = [meta["muscles"].index(name) for name in scene.muscles.names]
    sim.reset(seeds=np.zeros(number, int))
    place(sim, {"data.qpos": qpos, "data.qvel": qvel}, np.arange(number))
    scene.muscles.activation.assign(record["activation"][:, muscles].astype(np.float32))
    scene.muscles.fiber_length.assign(record["fibers"][:, muscles].astype(np.float32))
    action = np.zeros(sim.action.shape, np.float32)
    u = record["excitation"][:, muscles]
    action[:, scene.muscles.actuator_id] = 0.5 + np.log(u / (1.0 - u)) / 5.0
    sim.action.assign(action)
    shown = {one.name: one for one in mapped.coordinates if one.joint is not None}
    free = [name for name in free if name in shown]
    joints = [scene.oracle.joint(str(shown[name].joint)) for name in free]
    places, scale = [joint.qposadr[0] for joint in joints], np.array([shown[name].scale for name in free])
    hinge = np.array([shown[name].rotational for name in free])
    every, samples = round(meta["every"] / dt), record["values"].shape[1]
    values, forces = [], []
    for k in range(every * (samples - 1) + 1):
        if k % every == 0:
            values.append(scene.data.qpos.numpy()[:, places] / scale)
        sim.step()
        if k % every == 0:
            forces.append(scene.forces.pushes.force.numpy().sum(axis=1))  # type: ignore[union-attr]
    sim.close()
    theirs = record["values"][:, :, [columns[name] for name in free]]
    off = np.abs(np.array(values).transpose(1, 0, 2) - theirs) * np.where(hinge, np.degrees(1.0), 1e3)
    force, wanted = np.array(forces).transpose(1, 0, 2), record["contact"].sum(axis=2)
    found, carried = np.linalg.norm(force, axis=2), np.linalg.norm(wanted, axis=2)
    loaded = carried > CARRIES
    share = np.abs(found - carried)[loaded] / carried[loaded]
    worst = np.unravel_index(off[:, :, hinge].argmax(), off[:, :, hinge].shape)
    return {
        "step [ms]": 1e3 * dt,
        "angles [deg]": {
            "median": float(np.median(off[:, 1:, hinge])),
            "at the end": float(np.median(off[:, -1, hinge])),
            "worst": float(off[:, :, hinge].max()),
            "where": f"{np.array(free)[hinge][worst[2]]}, start {worst[0]}, sample {worst[1]}",
        },
        "slides [mm]": {
            "median": float(np.median(off[:, 1:, ~hinge])),
            "worst": float(off[:, :, ~hinge].max()),
        },
        "ground force": {
            "median": float(np.median(share)),
            "p90": float(np.quantile(share, 0.9)),
            "at the start": float(np.median((np.abs(found - carried) / carried)[:, 0])),
            "worst over the greatest": float(np.abs(found - carried).max() / carried.max()),
            "greatest [N]": float(carried.max()),
        },
    }


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("out/playback"))
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--steps", type=float, nargs="*", default=SHORTER, help="s")
    options = parser.parse_args()
    record, rows = np.load(options.folder / "playback.npz"), []
    for step in (None, *options.steps):
        rows.append(played(options.folder / "whole.osim", record, step))
        print(json.dumps(rows[-1]), flush=True)
    meta = json.loads(str(record["meta"]))
    result = {"processor": processor(), "opensim": meta["opensim"], "starts": meta["starts"], "steps": rows}
    options.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
