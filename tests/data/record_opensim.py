"""Record the frames of OpenSim: bodies, markers and moving path points in random poses.

    python tests/data/record_opensim.py tests/data/osim/*.osim -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Every model gives
`frames_<model>.npz`. Poses are random and independent per coordinate; locked coordinates stand at their
default, coupled ones follow their couplers. Arrays, for n poses, float64, m and rad, in ground:

    coordinates (c,), values (n, c)          names and values of all coordinates
    bodies (b,), origin (n, b, 3), rotation (n, b, 3, 3)
    markers (m,), marker (n, m, 3)           empty without markers
    points (p,), point (n, p, 3)             moving path points, `muscle/number from 0`
    version ()                               of OpenSim
"""

import argparse
from pathlib import Path

import numpy as np
import opensim

NUM_POSES = 16
WIDE = 20.0  # rad or m: nobody set such a range


def members(collection):
    """Return the members of one of OpenSim's sets."""
    return [collection.get(index) for index in range(collection.getSize())]


def pose(model, state, rng):
    """Set random values, and return those of all coordinates."""
    coordinates = {item.getName(): item for item in members(model.getCoordinateSet())}
    couplers = {}
    for item in members(model.getConstraintSet()):
        coupler = opensim.CoordinateCouplerConstraint.safeDownCast(item)
        if coupler is not None:
            couplers[coupler.getDependentCoordinateName()] = coupler
    values = {}
    while len(values) < len(coordinates):
        for name, item in coordinates.items():
            low, high = item.getRangeMin(), item.getRangeMax()
            low, high = (low, high) if high - low < WIDE else (-1.0, 1.0)
            if name in values:
                continue
            if name in couplers:
                source = couplers[name].getIndependentCoordinateNames().get(0)
                if source in values:
                    values[name] = couplers[name].getFunction().calcValue(opensim.Vector(1, values[source]))
            elif item.get_locked():
                values[name] = item.getDefaultValue()
            else:
                values[name] = rng.uniform(low, high)
    for name, value in values.items():
        coordinates[name].setLocked(state, False)
        coordinates[name].setValue(state, value, False)
    model.realizePosition(state)
    return [values[name] for name in coordinates]


def record(path, folder):
    """Record one model."""
    model = opensim.Model(str(path))
    state = model.initSystem()
    bodies, markers = members(model.getBodySet()), members(model.getMarkerSet())
    points = {}
    for muscle in members(model.getMuscles()):
        path_points = muscle.getGeometryPath().getPathPointSet()
        for number, point in enumerate(members(path_points)):
            if point.getConcreteClassName() == "MovingPathPoint":
                points[f"{muscle.getName()}/{number}"] = point
    rng = np.random.default_rng(0)
    data = {"values": [], "origin": [], "rotation": [], "marker": [], "point": []}
    for _ in range(NUM_POSES):
        data["values"].append(pose(model, state, rng))
        frames = [body.getTransformInGround(state) for body in bodies]
        data["origin"].append([frame.p().to_numpy() for frame in frames])
        axes = [[[frame.R().get(i, j) for j in range(3)] for i in range(3)] for frame in frames]
        data["rotation"].append(axes)
        data["marker"].append([marker.getLocationInGround(state).to_numpy() for marker in markers])
        data["point"].append([point.getLocationInGround(state).to_numpy() for point in points.values()])
    np.savez_compressed(
        folder / f"frames_{path.stem}.npz",
        coordinates=[item.getName() for item in members(model.getCoordinateSet())],
        bodies=[body.getName() for body in bodies],
        markers=np.array([marker.getName() for marker in markers], str),
        points=np.array(list(points), str),
        version=opensim.GetVersion(),
        **{name: np.array(values) for name, values in data.items()},
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    for model_path in arguments.models:
        record(model_path, arguments.output)
