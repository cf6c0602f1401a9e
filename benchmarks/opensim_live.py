"""OpenSim's values of a model's muscles, for `benchmarks.opensim_muscles`; needs opensim==4.6 and NumPy.

    .venv-opensim/bin/python benchmarks/opensim_live.py MODEL.osim -o FILE.npz

Static tendon forces in random poses at six activations; joint torques of all muscles there, each pose from a
fresh state; tendon force and fiber velocity of fibers off their equilibrium; motions from the default pose
under three patterns of excitation and under the least one, integrated to 1e-6.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import opensim

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "data"))
from record_opensim_muscles import ACTIVATIONS, parameters, poses, static
from record_opensim_paths import Posed

POSES = 40
DURATION, HELD, EVERY = 0.5, 0.05, 0.01  # s
START = 0.01  # activation
ACCURACY = 1e-6


def patterns(names: list[str]) -> dict[str, np.ndarray]:
    """Return excitations of each interval of 50 ms, shape (intervals, muscles): held, bursts, waves."""
    count, rng = round(DURATION / HELD), np.random.default_rng(0)
    time_, phase = HELD * np.arange(count)[:, None], rng.uniform(0.0, 2.0 * np.pi, len(names))
    return {
        "held": np.full((count, len(names)), 0.2),
        "bursts": np.where(rng.uniform(size=(count, len(names))) < 0.3, 0.7, 0.03),
        "waves": 0.25 + 0.2 * np.sin(2.0 * np.pi * 2.0 * time_ + phase),
        "free swing": np.full((count, len(names)), START),
    }


def torques(file: Path) -> dict[str, np.ndarray]:
    """Return poses, lengths, and what all muscles together do about each free coordinate [N m] or [N].

    It is the difference of inverse dynamics with muscles and without, shape (poses, activations, free);
    coordinates that follow a free one count with their slope. NaN where a muscle has no equilibrium.
    """
    posed = Posed(file)
    initial, solver = opensim.State(posed.state), opensim.InverseDynamicsSolver(posed.model)
    still = opensim.Vector(posed.state.getNU(), 0.0)
    free, muscles = len(posed.free), posed.muscles
    # Speeds of the tree in Simbody's order, of a unit of each coordinate.
    values, lengths, found = [], [], []
    for pose in np.random.default_rng(2).uniform(*posed.ranges(), (POSES, free)):
        posed.state = state = opensim.State(initial)
        values.append(posed.set(pose))
        lengths.append(posed.lengths())
        slopes = []
        for one in np.eye(free):
            for item, rate in zip(posed.coordinates, posed.rates(one, values[-1]), strict=True):
                item.setSpeedValue(state, float(rate))
            slopes.append(state.getU().to_numpy())
        for item in posed.coordinates:
            item.setSpeedValue(state, 0.0)
        sums = []
        for muscle in muscles:
            muscle.setAppliesForce(state, False)
        posed.model.realizeDynamics(state)
        rest = solver.solve(state, still).to_numpy()
        for muscle in muscles:
            muscle.setAppliesForce(state, True)
        for activation in ACTIVATIONS:
            for muscle in muscles:
                muscle.setActivation(state, activation)
            posed.model.realizeVelocity(state)
            try:
                for muscle in muscles:
                    muscle.computeEquilibrium(state)
            except RuntimeError:
                sums.append(np.full(free, np.nan))
                continue
            posed.model.realizeDynamics(state)
            sums.append(np.array(slopes) @ (rest - solver.solve(state, still).to_numpy()))
        found.append(sums)
    return {
        "torque values": np.array(values),
        "torque lengths": np.array(lengths),
        "torque": np.array(found),
        "torque free": np.array([item.getName() for item in posed.free]),
    }


def moving(model: Any, state: Any, muscles: list[Any]) -> dict[str, np.ndarray]:
    """Return activation, length, fiber length, fiber velocity and tendon force off the equilibrium."""
    rng, rows = np.random.default_rng(1), []
    for _ in poses(model, state, POSES, seed=1):
        for muscle in muscles:
            muscle.setActivation(state, rng.uniform(0.05, 1.0))
        try:
            model.equilibrateMuscles(state)
        except RuntimeError:
            continue
        for muscle in muscles:
            names = muscle.getStateVariableNames()
            which = [names.get(i) for i in range(names.getSize()) if names.get(i).endswith("/fiber_length")]
            if which:
                fiber = muscle.getStateVariableValue(state, which[0])
                muscle.setStateVariableValue(state, which[0], fiber * rng.uniform(0.995, 1.005))
        model.realizeDynamics(state)
        of = [m.getActivation for m in muscles], [m.getLength for m in muscles]
        of += [m.getFiberLength for m in muscles], [m.getFiberVelocity for m in muscles]
        of += ([m.getTendonForce for m in muscles],)
        rows.append([[read(state) for read in reads] for reads in of])
    return {"moving": np.array(rows)}


def forward(model_path: Path, accuracy: float, limit: float) -> dict[str, Any]:
    """Return coordinates over time under each pattern, (samples, coordinates), and how long each took.

    A motion ends early with the first sample after a limit [s].
    """
    found: dict[str, Any] = {}
    model = opensim.Model(str(model_path))
    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    controls = patterns([muscle.getName() for muscle in muscles])
    for name, excitations in controls.items():
        model = opensim.Model(str(model_path))
        controller = opensim.PrescribedController()
        for i in range(model.getMuscles().getSize()):
            muscle, function = model.getMuscles().get(i), opensim.PiecewiseConstantFunction()
            for k, value in enumerate(excitations[:, i]):
                function.addPoint(k * HELD, value)
            controller.addActuator(muscle)
            controller.prescribeControlForActuator(muscle.getName(), function)
        model.addController(controller)
        state = model.initSystem()
        for i in range(model.getMuscles().getSize()):
            model.getMuscles().get(i).setActivation(state, START)
        model.equilibrateMuscles(state)
        manager = opensim.Manager(model)
        manager.setIntegratorAccuracy(accuracy)
        manager.initialize(state)
        coordinates = [model.getCoordinateSet().get(i) for i in range(model.getCoordinateSet().getSize())]
        begin, rows = time.perf_counter(), []
        for k in range(round(DURATION / EVERY) + 1):
            if k:
                state = manager.integrate(k * EVERY)
            rows.append([coordinate.getValue(state) for coordinate in coordinates])
            if time.perf_counter() - begin > limit:
                break
        found[f"forward {name}"] = np.array(rows)
        found[f"seconds {name}"] = np.array(time.perf_counter() - begin)
        found[f"excitation {name}"] = excitations
    return found


def main() -> None:
    """Record one model."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--accuracy", type=float, default=ACCURACY, help="of motions")
    parser.add_argument("--limit", type=float, default=float("inf"), help="seconds after which a motion ends")
    arguments = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    model = opensim.Model(str(arguments.model))
    state = model.initSystem()
    muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
    lengths, forces = [], []
    for _ in poses(model, state, POSES):
        lengths.append([muscle.getLength(state) for muscle in muscles])
        forces.append(static(model, state, muscles))
    coordinates = model.getCoordinateSet()
    meta = {
        "opensim": opensim.GetVersion(),
        "muscles": [muscle.getName() for muscle in muscles],
        "classes": [muscle.getConcreteClassName() for muscle in muscles],
        "parameters": [parameters(muscle) for muscle in muscles],
        "coordinates": [coordinates.get(i).getName() for i in range(coordinates.getSize())],
    }
    force, velocity = np.moveaxis(forces, 1, 0)
    arrays = {"length": np.array(lengths), "tendon_force": force, "static_velocity": velocity}
    arrays |= moving(model, state, muscles)
    arrays |= torques(arguments.model)
    try:
        arrays |= forward(arguments.model, arguments.accuracy, arguments.limit)
    except RuntimeError as error:
        meta["no forward simulation"] = " ".join(str(error).split())[:300]
    np.savez_compressed(arguments.output, meta=json.dumps(meta), activation=np.array(ACTIVATIONS), **arrays)


if __name__ == "__main__":
    main()
