"""Record what OpenSim makes of documents of all its versions.

    python tests/data/record_opensim_vintage.py -o tests/data/opensim

needs an interpreter with `opensim` (4.6) only; nothing of ours is imported. Gives `vintage.json`; by model of
`MODELS`: coordinates (name, default, low, high, clamped), masses, actuators (what they act on and along) and
in `POSES` poses their values, origins and rotations of bodies in ground, and lengths of muscles.
"""

import argparse
import json
import random
from pathlib import Path

import opensim

MODELS = ("vintage_1", "vintage_alpha", "stations")
POSES = 4


def members(collection):
    """Return the members of one of OpenSim's sets."""
    return [collection.get(index) for index in range(collection.getSize())]


def vector(numbers):
    """Return three numbers."""
    return [numbers.get(k) for k in range(3)]


def actuator(force):
    """Return bodies and direction of a torque or point actuator, None of another force."""
    if torque := opensim.TorqueActuator.safeDownCast(force):
        return [torque.getBodyA().getName(), torque.getBodyB().getName(), vector(torque.get_axis())]
    if push := opensim.PointActuator.safeDownCast(force):
        return [push.get_body(), vector(push.get_point()), vector(push.get_direction())]
    return None


def record(path):
    """Return what is recorded of a model."""
    model = opensim.Model(str(path))
    state = model.initSystem()
    coordinates, bodies = members(model.getCoordinateSet()), members(model.getBodySet())
    rng, poses = random.Random(0), []
    for _ in range(POSES):
        for one in coordinates:
            one.setValue(state, rng.uniform(one.getRangeMin(), one.getRangeMax()), False)
        model.realizePosition(state)
        frames = [body.getTransformInGround(state) for body in bodies]
        poses.append(
            {
                "values": [one.getValue(state) for one in coordinates],
                "origins": [vector(frame.p()) for frame in frames],
                "rotations": [[[f.R().get(i, j) for j in range(3)] for i in range(3)] for f in frames],
                "lengths": [muscle.getLength(state) for muscle in members(model.getMuscles())],
            }
        )
    acting = {force.getName(): actuator(force) for force in members(model.getForceSet())}
    return {
        "coordinates": [
            [c.getName(), c.getDefaultValue(), c.getRangeMin(), c.getRangeMax(), c.getDefaultClamped()]
            for c in coordinates
        ],
        "masses": {body.getName(): body.getMass() for body in bodies},
        "muscles": [muscle.getName() for muscle in members(model.getMuscles())],
        "actuators": {name: found for name, found in acting.items() if found},
        "poses": poses,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    folder = Path(__file__).parent / "osim"
    found = {name: record(folder / f"{name}.osim") for name in MODELS}
    text = json.dumps({"opensim": opensim.GetVersion(), **found}, indent=None)
    (arguments.output / "vintage.json").write_text(text + "\n")
