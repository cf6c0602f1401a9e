"""Record the accelerations of OpenSim in random states with velocities, gravity and torques.

    python tests/data/record_opensim_accelerations.py tests/data/osim/leg6dof9musc.osim -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Every model gives
`accelerations_<model>.npz`. All its forces are switched off, then every free coordinate gets a generalised
force; coordinates that follow others do so in value and speed. Arrays, for n states and c free coordinates,
float64, SI and rad:

    coordinates (c,), values, speeds, forces, accelerations (n, c), version ()
"""

import argparse
from pathlib import Path

import numpy as np
import opensim

NUM_STATES = 12
SHARE = 0.9  # of the ranges
WIDE = 20.0  # rad or m: nobody set such a range
SPEED = {True: 5.0, False: 1.0}  # rad/s, m/s
FORCE = {True: 20.0, False: 200.0}  # N m, N


def members(collection):
    """Return the members of one of OpenSim's sets."""
    return [collection.get(index) for index in range(collection.getSize())]


def record(path):
    """Return the arrays of one model."""
    model = opensim.Model(str(path))
    for force in members(model.updForceSet()):
        force.set_appliesForce(False)
    couplers = []
    for item in members(model.getConstraintSet()):
        found = opensim.CoordinateCouplerConstraint.safeDownCast(item)
        source = found.getIndependentCoordinateNames().get(0)
        couplers.append((found.getDependentCoordinateName(), source, found.getFunction()))
    following = {name for name, _, _ in couplers}
    names = []
    for item in members(model.updCoordinateSet()):
        item.set_clamped(False)
        if not item.get_locked() and item.getName() not in following:
            names.append(item.getName())
    for name in names:
        actuator = opensim.CoordinateActuator(name)
        actuator.setName(f"force_{name}")
        actuator.setOptimalForce(1.0)
        model.addForce(actuator)
    state = model.initSystem()
    coordinates = {item.getName(): item for item in members(model.getCoordinateSet())}
    forces = model.getForceSet()
    actuators = [opensim.CoordinateActuator.safeDownCast(forces.get(f"force_{name}")) for name in names]
    rng, first = np.random.default_rng(0), opensim.StdVectorInt()
    first.append(0)
    rows = {"values": [], "speeds": [], "forces": [], "accelerations": []}
    for _ in range(NUM_STATES):
        values, speeds, torques = [], [], []
        for name, actuator in zip(names, actuators, strict=True):
            item = coordinates[name]
            low, high = item.getRangeMin(), item.getRangeMax()
            low, high = (low, high) if high - low < WIDE else (-1.0, 1.0)
            turns = item.getMotionType() != 2
            values.append((low + high) / 2 + SHARE * (high - low) * rng.uniform(-0.5, 0.5))
            speeds.append(SPEED[turns] * rng.uniform(-1, 1))
            torques.append(FORCE[turns] * rng.uniform(-1, 1))
            actuator.overrideActuation(state, True)
            actuator.setOverrideActuation(state, torques[-1])
            item.setValue(state, values[-1], False)
        for assembled in (False, True):
            for name, speed in zip(names, speeds, strict=True):
                coordinates[name].setSpeedValue(state, speed)
            for name, source, function in couplers:
                x = opensim.Vector(1, coordinates[source].getValue(state))
                coordinates[name].setValue(state, function.calcValue(x), False)
                slope = function.calcDerivative(first, x)
                coordinates[name].setSpeedValue(state, slope * coordinates[source].getSpeedValue(state))
            if not assembled:
                model.assemble(state)
        model.realizeAcceleration(state)
        found = [coordinates[name].getAccelerationValue(state) for name in names]
        for key, row in zip(rows, (values, speeds, torques, found), strict=True):
            rows[key].append(row)
    return {"coordinates": names, "version": opensim.GetVersion(), **rows}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    for path in options.models:
        np.savez_compressed(options.output / f"accelerations_{path.stem}.npz", **record(path))


if __name__ == "__main__":
    main()
