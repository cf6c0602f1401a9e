"""Record the accelerations of OpenSim in random states of a model whose constraints close loops.

    python tests/data/record_opensim_loops.py tests/data/osim/loops.osim -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Every model gives
`accelerations_<model>.npz`, with the arrays of `record_opensim_accelerations.py`, and the pose `default` (c,)
that OpenSim assembles of the document's. Poses are drawn and assembled, speeds are drawn and lose what the
constraints forbid (G u = 0, G of Simbody), and a force gives a coordinate that is alone up to `ACCELERATION`.
"""

import argparse
from pathlib import Path

import numpy as np
import opensim

SHARE, SPEED, ACCELERATION = 0.8, 3.0, 10.0  # of ranges; rad/s or m/s; rad/s^2 or m/s^2


def members(collection):
    """Return the members of one of OpenSim's sets."""
    return [collection.get(index) for index in range(collection.getSize())]


def array(matrix):
    """Return a SimTK matrix."""
    rows, columns = range(matrix.nrow()), range(matrix.ncol())
    return np.array([[matrix.getElt(i, j) for j in columns] for i in rows])


def allowed(model, state):
    """Take out of the speeds of a state what constraints forbid."""
    model.realizeVelocity(state)
    G = opensim.Matrix()
    model.getMatterSubsystem().calcG(state, G)
    u = np.array([state.getU().get(i) for i in range(state.getNU())])
    u -= np.linalg.pinv(array(G), rcond=1e-9) @ (array(G) @ u)
    speeds = opensim.Vector(len(u), 0.0)
    for i, value in enumerate(u):
        speeds.set(i, float(value))
    state.setU(speeds)


def record(path, states):
    """Return the arrays of one model."""
    model = opensim.Model(str(path))
    for force in members(model.updForceSet()):
        force.set_appliesForce(False)
    constraints = map(opensim.CoordinateCouplerConstraint.safeDownCast, members(model.getConstraintSet()))
    following = {coupler.getDependentCoordinateName() for coupler in constraints if coupler is not None}
    names = [item.getName() for item in members(model.getCoordinateSet()) if item.getName() not in following]
    for name in names:
        actuator = opensim.CoordinateActuator(name)
        actuator.setName(f"force_{name}")
        actuator.setOptimalForce(1.0)
        model.addForce(actuator)
    start = model.initSystem()
    coordinates = [model.getCoordinateSet().get(name) for name in names]
    forces = model.getForceSet()
    actuators = [opensim.CoordinateActuator.safeDownCast(forces.get(f"force_{name}")) for name in names]
    default = [item.getValue(start) for item in coordinates]
    mass = opensim.Matrix()
    rng, rows = np.random.default_rng(0), {"values": [], "speeds": [], "forces": [], "accelerations": []}
    while len(rows["values"]) < states:
        state = opensim.State(start)
        for item in coordinates:
            low, high = item.getRangeMin(), item.getRangeMax()
            item.setValue(state, (low + high) / 2 + SHARE * (high - low) * rng.uniform(-0.5, 0.5), False)
            item.setSpeedValue(state, SPEED * rng.uniform(-1, 1))
        try:
            model.assemble(state)
        except RuntimeError:
            continue  # no pose near this one closes all loops
        allowed(model, state)
        model.getMatterSubsystem().calcM(state, mass)
        torques = []
        for item, actuator in zip(coordinates, actuators, strict=True):
            alone, still = opensim.State(state), opensim.Vector(state.getNU(), 0.0)
            alone.setU(still)
            item.setSpeedValue(alone, 1.0)
            k = int(np.argmax([alone.getU().get(i) for i in range(alone.getNU())]))
            torques.append(ACCELERATION * mass.getElt(k, k) * rng.uniform(-1, 1))
            actuator.overrideActuation(state, True)
            actuator.setOverrideActuation(state, torques[-1])
        model.realizeAcceleration(state)
        rows["values"].append([item.getValue(state) for item in coordinates])
        rows["speeds"].append([item.getSpeedValue(state) for item in coordinates])
        rows["forces"].append(torques)
        rows["accelerations"].append([item.getAccelerationValue(state) for item in coordinates])
    return {"coordinates": names, "version": opensim.GetVersion(), "default": default, **rows}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    for model_path in options.models:
        np.savez_compressed(options.output / f"accelerations_{model_path.stem}.npz", **record(model_path, 12))
