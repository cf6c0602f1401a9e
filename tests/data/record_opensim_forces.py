"""Record what forces and actuators of OpenSim do beside muscles, and a motion under all of them.

    python tests/data/record_opensim_forces.py tests/data/osim/forces.osim -o tests/data/opensim/forces.npz
    python tests/data/record_opensim_forces.py tests/data/osim/devices.osim -o tests/data/opensim/devices.npz

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. States are random: n
poses over the ranges, speeds normal with `SPEED`. Arrays, float64, SI units, k forces and f free coordinates:

    coordinates (c,), values (n, c), rates (n, c)   of all coordinates
    free (f,), forces (k,)                          names
    acting (n, k, f)                                what each force does about the free coordinates at `TIME`
    control (k,)                                    of actuators, else NaN
    time (t,), motion (t, c)                        from the default pose, controls held, all forces on
    version ()                                      of OpenSim
"""

import argparse
from pathlib import Path

import numpy as np
import opensim
from record_opensim_paths import Posed, members

COUNT, SEED, SPEED = 40, 4, 3.0
CONTROL = {"cable": 0.4, "push": 0.6, "belt": 0.7, "piston": -0.5, "twist": 0.3, "thrust": 0.8}
TIME = 0.37
DURATION, EVERY, ACCURACY = 0.5, 0.01, 1e-8


def acting(file):
    """Return values, rates, and what every force does about the free coordinates.

    It is the difference of inverse dynamics with the force and without; coordinates that follow a free one
    count with their slope.
    """
    posed = Posed(file)
    solver, random = opensim.InverseDynamicsSolver(posed.model), np.random.default_rng(SEED)
    forces = members(posed.model.getForceSet())
    actuators = {item.getName(): opensim.ScalarActuator.safeDownCast(item) for item in forces}
    state = posed.state
    state.setTime(TIME)
    still = opensim.Vector(state.getNU(), 0.0)
    for name, item in actuators.items():
        if item is not None:
            item.overrideActuation(state, True)
            item.setOverrideActuation(state, CONTROL[name] * item.getOptimalForce())
    count = len(posed.free)
    values, rates, found = [], [], []
    for pose in random.uniform(*posed.ranges(), (COUNT, count)):
        values.append(posed.set(pose))
        slopes = []
        for one in np.eye(count):
            for item, rate in zip(posed.coordinates, posed.rates(one, values[-1]), strict=True):
                item.setSpeedValue(state, float(rate))
            slopes.append(state.getU().to_numpy())
        rates.append(posed.rates(random.normal(0.0, SPEED, count), values[-1]))
        for item, rate in zip(posed.coordinates, rates[-1], strict=True):
            item.setSpeedValue(state, float(rate))
        for force in forces:
            force.setAppliesForce(state, False)
        posed.model.realizeDynamics(state)
        rest = solver.solve(state, still).to_numpy()
        row = []
        for force in forces:
            force.setAppliesForce(state, True)
            posed.model.realizeDynamics(state)
            row.append(np.array(slopes) @ (rest - solver.solve(state, still).to_numpy()))
            force.setAppliesForce(state, False)
        found.append(row)
    return {
        "coordinates": posed.names,
        "values": np.array(values),
        "rates": np.array(rates),
        "free": [item.getName() for item in posed.free],
        "forces": [item.getName() for item in forces],
        "acting": np.array(found),
        "control": [CONTROL.get(item.getName(), np.nan) for item in forces],
    }


def motion(file):
    """Return times and coordinates from the default pose at rest, all forces on."""
    model = opensim.Model(str(file))
    controller = opensim.PrescribedController()
    driven = members(model.getActuators())
    for name, value in ((item.getName(), CONTROL[item.getName()]) for item in driven):
        controller.addActuator(model.getActuators().get(name))
        controller.prescribeControlForActuator(name, opensim.Constant(value))
    model.addController(controller)
    state = model.initSystem()
    manager = opensim.Manager(model)
    manager.setIntegratorAccuracy(ACCURACY)
    manager.initialize(state)
    rows = []
    for k in range(round(DURATION / EVERY) + 1):
        if k:
            state = manager.integrate(k * EVERY)
        rows.append([item.getValue(state) for item in members(model.getCoordinateSet())])
    return {"time": EVERY * np.arange(len(rows)), "motion": np.array(rows)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    asked = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    arrays = acting(asked.model) | motion(asked.model)
    np.savez_compressed(asked.output, version=opensim.GetVersion(), **arrays)
    for name, force in zip(arrays["forces"], np.moveaxis(arrays["acting"], 1, 0), strict=True):
        print(name, np.abs(force).max(axis=0).round(3).tolist(), (np.abs(force) > 1e-9).any(axis=1).mean())
    print("motion", np.ptp(arrays["motion"], axis=0).round(3).tolist())
