"""Record what contact forces of OpenSim do in random states.

    python tests/data/record_opensim_contacts.py tests/data/osim/contacts.osim -o contacts.npz

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. States are random: n
poses over the ranges, speeds normal with `SPEED`. Arrays, float64, SI units, k forces and c coordinates:

    coordinates (c,), values (n, c), speeds (n, c)
    forces (k,)
    acting (n, k, c)          what each force does about the coordinates
    accelerations (n, c)      under all forces and gravity
    version ()                of OpenSim
"""

import argparse
from pathlib import Path

import numpy as np
import opensim
from record_opensim_paths import Posed

COUNT, SEED, SPEED = 300, 60, 0.5
KINDS = ("SmoothSphereHalfSpaceForce", "HuntCrossleyForce", "ElasticFoundationForce")


def recorded(file, count=COUNT):
    """Return the arrays of a model."""
    posed, random = Posed(file), np.random.default_rng(SEED)
    solver, state = opensim.InverseDynamicsSolver(posed.model), posed.state
    found = [one for one in posed.model.getComponentsList() if one.getConcreteClassName() in KINDS]
    forces = [opensim.Force.safeDownCast(one) for one in found]
    free, still = len(posed.free), opensim.Vector(state.getNU(), 0.0)
    values, speeds, acting, accelerations, slopes = [], [], [], [], []
    for item in posed.free:  # speeds of OpenSim's state have an order of their own
        item.setSpeedValue(state, 1.0)
        slopes.append(state.getU().to_numpy())
        item.setSpeedValue(state, 0.0)
    for pose in random.uniform(*posed.ranges(), (count, free)):
        posed.set(pose)
        values.append(pose)
        speeds.append(random.normal(0.0, SPEED, free))
        for item, speed in zip(posed.free, speeds[-1], strict=True):
            item.setSpeedValue(state, float(speed))
        posed.model.realizeAcceleration(state)
        accelerations.append([item.getAccelerationValue(state) for item in posed.free])
        for force in forces:
            force.setAppliesForce(state, False)
        posed.model.realizeDynamics(state)
        rest = solver.solve(state, still).to_numpy()
        row = []
        for force in forces:
            force.setAppliesForce(state, True)
            posed.model.realizeDynamics(state)
            row.append(slopes @ (rest - solver.solve(state, still).to_numpy()))
            force.setAppliesForce(state, False)
        acting.append(row)
        for force in forces:
            force.setAppliesForce(state, True)
    return {
        "coordinates": [item.getName() for item in posed.free],
        "values": np.array(values),
        "speeds": np.array(speeds),
        "forces": [item.getName() for item in forces],
        "acting": np.array(acting),
        "accelerations": np.array(accelerations),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    asked = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    arrays = recorded(asked.model)
    np.savez_compressed(asked.output, version=opensim.GetVersion(), **arrays)
    for name, force in zip(arrays["forces"], np.moveaxis(arrays["acting"], 1, 0), strict=True):
        print(name, np.abs(force).max(axis=0).round(3).tolist(), (np.abs(force) > 1e-9).any(axis=1).mean())
