"""Record the accelerations of OpenSim in random states with velocities, gravity and torques.

    python tests/data/record_opensim_accelerations.py tests/data/osim/leg6dof9musc.osim -o tests/data/opensim

(`--states 100 --share 1` for `benchmarks.opensim_dynamics`; `--mass 0.05` where a document weighs nothing)
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

MASSIVE = 1e-6  # kg; what weighs less weighs nothing
INERTIA = 1e-4  # kg m^2, of a body that is given a mass
WIDE = 20.0  # rad or m: nobody set such a range
SPEED = {True: 5.0, False: 1.0}  # rad/s, m/s
FORCE = {True: 20.0, False: 200.0}  # N m, N


def members(collection):
    """Return the members of one of OpenSim's sets."""
    return [collection.get(index) for index in range(collection.getSize())]


def weigh(model, mass):
    """Give all bodies of a model that weighs nothing a mass [kg]."""
    bodies = members(model.updBodySet())
    if mass and sum(body.getMass() for body in bodies) < MASSIVE:
        for body in bodies:
            body.setMass(mass)
            body.setInertia(opensim.Inertia(INERTIA, INERTIA, INERTIA))


def record(path, states, share, mass):
    """Return the arrays of one model."""
    model = opensim.Model(str(path))
    weigh(model, mass)
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
    for _ in range(states):
        values, speeds, torques = [], [], []
        for name, actuator in zip(names, actuators, strict=True):
            item = coordinates[name]
            low, high = item.getRangeMin(), item.getRangeMax()
            low, high = (low, high) if high - low < WIDE else (-1.0, 1.0)
            turns = item.getMotionType() != 2
            values.append((low + high) / 2 + share * (high - low) * rng.uniform(-0.5, 0.5))
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
    parser.add_argument("--states", type=int, default=12)
    parser.add_argument("--share", type=float, default=0.9, help="of the ranges of coordinates")
    parser.add_argument("--mass", type=float, default=0.0, help="[kg] of each body of a massless document")
    options = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    for path in options.models:
        arrays = record(path, options.states, options.share, options.mass)
        np.savez_compressed(options.output / f"accelerations_{path.stem}.npz", **arrays)


if __name__ == "__main__":
    main()
