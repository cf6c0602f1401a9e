"""Motions of Moco's walking example in OpenSim, for `benchmarks.opensim_playback`; needs opensim 4.6.

    .venv-opensim/bin/python benchmarks/opensim_playback_record.py EXAMPLE3DWALKING -o FOLDER

The model gets its function paths, contact and expression forces, as Moco's example adds them, and is written
to `whole.osim`. Each motion begins in a pose of the recorded walk, with its speeds, muscles in OpenSim's
equilibrium at `ACTIVATION`, and runs under constant excitations, integrated to 1e-7. The recorded pose
presses feet into the ground with up to 6 kN; `SETTLE` later the motion that is compared begins.
`playback.npz` has, every 10 ms from then on, coordinates and speeds, shape (starts, samples, coordinates),
and the force of each contact on its sphere's body [N], (starts, samples, contacts, 3); where it begins,
activations, fiber lengths [m], tendon forces [N] and accelerations; and excitations.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import opensim

STARTS = (0.5, 0.75, 1.0, 1.25, 1.5)
"""s of the recorded walk."""
SETTLE, SECONDS, EVERY = 0.05, 0.2, 0.01
ACTIVATION = 0.1
ACCURACY = 1e-7
SETS = ("ContactGeometrySet", "ContactForceSet", "ExpressionBasedCoordinateForceSet", "FunctionBasedPathSet")


def whole(folder: Path, output: Path) -> Path:
    """Write the model with all its parts; returns the file."""
    files = {name: str(next(folder.glob(f"*_{name}.xml"))) for name in SETS}
    source = str(next(folder.glob("*.osim")))
    processor = opensim.ModelProcessor(source)
    processor.append(opensim.ModOpReplacePathsWithFunctionBasedPaths(files["FunctionBasedPathSet"]))
    model = processor.process()
    shapes = opensim.ContactGeometrySet(files["ContactGeometrySet"])
    for k in range(shapes.getSize()):
        model.addContactGeometry(shapes.get(k).clone())
    for name in ("ContactForceSet", "ExpressionBasedCoordinateForceSet"):
        forces = opensim.ForceSet(files[name])
        for k in range(forces.getSize()):
            model.addForce(forces.get(k).clone())
    model.finalizeConnections()
    file = output / "whole.osim"
    model.printToXML(str(file))
    return file


def members(found: Any) -> list[Any]:
    """Return the members of a set."""
    return [found.get(k) for k in range(found.getSize())]


def motion(file: Path, walk: Any, begin: float, excitation: np.ndarray) -> dict[str, np.ndarray]:
    """Return one motion."""
    model = opensim.Model(str(file))
    controller = opensim.PrescribedController()
    for muscle, value in zip(members(model.getMuscles()), excitation, strict=True):
        controller.addActuator(muscle)
        controller.prescribeControlForActuator(muscle.getName(), opensim.Constant(float(value)))
    model.addController(controller)
    state = model.initSystem()
    coordinates, muscles = members(model.getCoordinateSet()), members(model.getMuscles())
    labels, at = list(walk.getColumnLabels()), np.array(walk.getIndependentColumn())
    for coordinate in coordinates:
        path = f"{coordinate.getAbsolutePathString()}/value"
        if path not in labels or coordinate.isConstrained(state):
            continue
        values = walk.getDependentColumn(path).to_numpy()
        coordinate.setValue(state, float(np.interp(begin, at, values)), False)
        speeds = np.gradient(values, at)
        coordinate.setSpeedValue(state, float(np.interp(begin, at, speeds)))
    model.assemble(state)
    for muscle in muscles:
        muscle.setActivation(state, ACTIVATION)
    model.equilibrateMuscles(state)
    found: dict[str, list[Any]] = {"values": [], "speeds": [], "contact": []}
    forces = [one for one in members(model.getForceSet()) if one.getConcreteClassName().startswith("Smooth")]
    manager = opensim.Manager(model)
    manager.setIntegratorAccuracy(ACCURACY)
    manager.initialize(state)
    for k in range(round(SECONDS / EVERY) + 1):
        state = manager.integrate(SETTLE + k * EVERY)
        model.realizeAcceleration(state)
        if not k:
            start = {
                "activation": [muscle.getActivation(state) for muscle in muscles],
                "fibers": [muscle.getFiberLength(state) for muscle in muscles],
                "tension": [muscle.getTendonForce(state) for muscle in muscles],
                "accelerations": [coordinate.getAccelerationValue(state) for coordinate in coordinates],
            }
        found["values"].append([coordinate.getValue(state) for coordinate in coordinates])
        found["speeds"].append([coordinate.getSpeedValue(state) for coordinate in coordinates])
        found["contact"].append([[one.getRecordValues(state).get(i) for i in range(3)] for one in forces])
    return {name: np.array(rows) for name, rows in (start | found).items()}


def main() -> None:
    """Record all motions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/playback"))
    parser.add_argument("--starts", type=float, nargs="+", default=STARTS, help="s of the recorded walk")
    options = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    options.output.mkdir(parents=True, exist_ok=True)
    file = whole(options.folder, options.output)
    walk = opensim.TimeSeriesTable(str(options.folder / "coordinates.sto"))
    model = opensim.Model(str(file))
    model.initSystem()
    muscles = [muscle.getName() for muscle in members(model.getMuscles())]
    excitation = np.random.default_rng(0).uniform(0.02, 0.4, (len(options.starts), len(muscles)))
    rows = []
    for begin, of_start in zip(options.starts, excitation, strict=True):
        clock = time.perf_counter()
        rows.append(motion(file, walk, begin, of_start))
        print(begin, "s of the walk:", round(time.perf_counter() - clock, 1), "s", flush=True)
    meta = {
        "opensim": opensim.GetVersion(),
        "coordinates": [one.getName() for one in members(model.getCoordinateSet())],
        "muscles": muscles,
        "starts": list(options.starts),
        "every": EVERY,
    }
    arrays = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    np.savez_compressed(
        options.output / "playback.npz", meta=json.dumps(meta), excitation=excitation, **arrays
    )


if __name__ == "__main__":
    main()
