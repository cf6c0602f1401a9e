"""Record muscle paths of OpenSim: lengths, both moment arms, and single wraps over every kind of object.

    python tests/data/record_opensim_paths.py MODEL.osim... -o tests/data/opensim

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Every model gives
`paths_<model>.npz`. Poses are random and independent per coordinate over the full ranges. Arrays, for n
poses, float64, m and rad:

    coordinates (c,), values (n, c)      names and values of all coordinates
    free (f,), muscles (m,)              names
    length (n, m), size (n, m)           getLength; points of the current path, wrap points included
    pairs (p, 2)                         muscle and free coordinate whose moment arm is not always zero
    moment_arm (n, p)                    computeMomentArm
    slope (n, p)                         minus the central difference of getLength
    version ()                           of OpenSim

`beyond_<model>.npz` has the same arrays in poses up to `--beyond` of each range outside of it.
`paths_wraps.npz` has lines over one object in ground, for each row of `CASES`: `<case>_start`, `<case>_end`
(n, 3), `<case>_length`, `<case>_size` (n,). The double ones have a second object far away, which is enough
for OpenSim to adjust tangent points. Lengths may be NaN: so OpenSim says.
"""

import argparse
from pathlib import Path

import numpy as np
import opensim

STEP = 1e-5  # rad or m
PRESENT = 1e-7  # m
WIDE = 20.0  # rad or m: nobody set such a range

METHODS = {"hybrid": 0, "midpoint": 1, "axial": 2}

CASES = {
    "cylinder": ("cylinder", (0.3, 1.0), "all", "hybrid", False),
    "cylinder_x": ("cylinder", (0.3, 1.0), "x", "hybrid", False),
    "cylinder_-y": ("cylinder", (0.3, 0.5), "-y", "hybrid", False),
    "cylinder_x_double": ("cylinder", (0.3, 1.0), "x", "hybrid", True),
    "sphere": ("sphere", (0.3,), "all", "hybrid", False),
    "sphere_y": ("sphere", (0.3,), "y", "hybrid", False),
    "ellipsoid": ("ellipsoid", (0.3, 0.2, 0.25), "all", "hybrid", False),
    "ellipsoid_y": ("ellipsoid", (0.03, 0.02, 0.025), "y", "hybrid", False),
    "ellipsoid_-z_midpoint": ("ellipsoid", (0.3, 0.2, 0.25), "-z", "midpoint", False),
    "ellipsoid_-x_axial": ("ellipsoid", (0.3, 0.2, 0.25), "-x", "axial", False),
    "torus": ("torus", (0.1, 0.3), "all", "hybrid", False),
    "torus_x": ("torus", (0.1, 0.3), "x", "hybrid", False),
}


def members(collection):
    """Return the members of one of OpenSim's sets."""
    return [collection.get(index) for index in range(collection.getSize())]


class Posed:
    """A model that can be put into poses."""

    def __init__(self, file):
        self.model = opensim.Model(str(file))
        self.state = self.model.initSystem()
        self.coordinates = members(self.model.getCoordinateSet())
        self.names = [item.getName() for item in self.coordinates]
        self.couplers = {}
        for item in members(self.model.getConstraintSet()):
            coupler = opensim.CoordinateCouplerConstraint.safeDownCast(item)
            if coupler is not None:
                self.couplers[coupler.getDependentCoordinateName()] = coupler
        self.free = [
            item for item in self.coordinates if item.getName() not in self.couplers and not item.get_locked()
        ]
        self.muscles = members(self.model.getMuscles())

    def ranges(self):
        """Return lower and upper ends for the free coordinates, shape (2, f)."""
        ends = np.array([(item.getRangeMin(), item.getRangeMax()) for item in self.free]).T
        return np.where(ends[1] - ends[0] < WIDE, ends, [[-1.0], [1.0]])

    def set(self, free):
        """Set the free coordinates, and return the values of all."""
        values = {item.getName(): item.getDefaultValue() for item in self.coordinates}
        values |= {item.getName(): value for item, value in zip(self.free, free, strict=True)}
        for name, coupler in self.couplers.items():
            source = opensim.Vector(1, values[coupler.getIndependentCoordinateNames().get(0)])
            values[name] = coupler.getFunction().calcValue(source)
        for item in self.coordinates:
            item.setValue(self.state, float(values[item.getName()]), False)
        self.model.realizePosition(self.state)
        return [values[name] for name in self.names]

    def rates(self, free, values):
        """Return the speeds of all coordinates; `free` are those of the free ones, `values` those of all."""
        rates = dict.fromkeys(self.names, 0.0)
        rates |= {item.getName(): rate for item, rate in zip(self.free, free, strict=True)}
        at, order = dict(zip(self.names, values, strict=True)), opensim.StdVectorInt()
        order.append(0)
        for name, coupler in self.couplers.items():
            other = coupler.getIndependentCoordinateNames().get(0)
            slope = coupler.getFunction().calcDerivative(order, opensim.Vector(1, at[other]))
            rates[name] = slope * rates[other]
        return [rates[name] for name in self.names]

    def lengths(self):
        """Return the lengths of all muscles [m]."""
        return np.array([muscle.getLength(self.state) for muscle in self.muscles])


def record_model(file, count, seed, beyond=0.0):
    """Return the arrays of one model; `beyond` is by what share of a range poses leave it on either side."""
    posed = Posed(file)
    low, high = posed.ranges()
    margin = beyond * (high - low)
    poses = np.random.default_rng(seed).uniform(low - margin, high + margin, (count, len(posed.free)))
    paths = [opensim.GeometryPath.safeDownCast(muscle.getPath()) for muscle in posed.muscles]
    values, length, size = [], [], []
    slope = np.zeros((count, len(posed.muscles), len(posed.free)))
    for row, pose in enumerate(poses):
        values.append(posed.set(pose))
        length.append(posed.lengths())
        size.append([path.getCurrentPath(posed.state).getSize() for path in paths])
        for column in range(len(pose)):
            ends = []
            for step in (-STEP, STEP):
                beside = pose.copy()
                beside[column] += step
                posed.set(beside)
                ends.append(posed.lengths())
            slope[row, :, column] = -(ends[1] - ends[0]) / (2 * STEP)
    pairs = np.argwhere(np.abs(slope).max(axis=0) > PRESENT)
    arm = np.zeros((count, len(pairs)))
    for row, pose in enumerate(poses):
        posed.set(pose)
        for column, (muscle, free) in enumerate(pairs):
            arm[row, column] = posed.muscles[muscle].computeMomentArm(posed.state, posed.free[free])
    return {
        "coordinates": posed.names,
        "values": values,
        "free": [item.getName() for item in posed.free],
        "muscles": [muscle.getName() for muscle in posed.muscles],
        "length": length,
        "size": np.array(size, np.int8),
        "pairs": pairs.astype(np.int16),
        "moment_arm": arm,
        "slope": slope[:, pairs[:, 0], pairs[:, 1]],
        "version": opensim.GetVersion(),
    }


def wrap_object(kind, size, quadrant, name):
    """Return a wrap object."""
    if kind == "cylinder":
        wrap = opensim.WrapCylinder()
        wrap.set_radius(size[0])
        wrap.set_length(size[1])
    elif kind == "sphere":
        wrap = opensim.WrapSphere()
        wrap.set_radius(size[0])
    elif kind == "ellipsoid":
        wrap = opensim.WrapEllipsoid()
        wrap.set_dimensions(opensim.Vec3(*size))
    else:
        wrap = opensim.WrapTorus()
        wrap.set_inner_radius(size[0])
        wrap.set_outer_radius(size[1])
    wrap.set_quadrant(quadrant)
    wrap.setName(name)
    return wrap


def record_wrap(kind, size, quadrant, method, double, count, seed):
    """Return start, end, length and size of random lines over one object."""
    model = opensim.Model()
    ground = model.getGround()
    ends = []
    for name in ("one", "other"):
        body = opensim.Body(name, 1.0, opensim.Vec3(0), opensim.Inertia(1))
        model.addBody(body)
        model.addJoint(opensim.FreeJoint(f"{name}_joint", ground, body))
        ends.append(body)
    ground.addWrapObject(wrap_object(kind, size, quadrant, "here"))
    if double:
        away = wrap_object(kind, size, "all", "away")
        away.set_translation(opensim.Vec3(50, 0, 0))
        ground.addWrapObject(away)
    puller = opensim.PathActuator()
    for body in ends:
        puller.addNewPathPoint(f"at_{body.getName()}", body, opensim.Vec3(0))
    model.addForce(puller)
    model.finalizeConnections()
    path = opensim.GeometryPath.safeDownCast(puller.getGeometryPath())
    path.addPathWrap(ground.getWrapObject("here"))
    if double:
        path.addPathWrap(ground.getWrapObject("away"))
    model.finalizeFromProperties()
    path.getWrapSet().get(0).setMethod(METHODS[method])
    state = model.initSystem()
    coordinates = members(model.getCoordinateSet())
    reach = 2.2 * max(size[:1] if kind == "cylinder" else size)
    points = np.random.default_rng(seed).uniform(-reach, reach, (count, 2, 3))
    length, sizes = [], []
    for start, end in points:
        for index, value in zip((3, 4, 5, 9, 10, 11), (*start, *end), strict=True):
            coordinates[index].setValue(state, float(value), False)
        model.realizePosition(state)
        length.append(path.getLength(state))
        sizes.append(path.getCurrentPath(state).getSize())
    return {"start": points[:, 0], "end": points[:, 1], "length": length, "size": np.array(sizes, np.int8)}


def main():
    """Record what the command line names."""
    parser = argparse.ArgumentParser()
    parser.add_argument("models", nargs="*", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--beyond", type=float, default=0.0)
    parser.add_argument("--count", type=int, default=40)
    arguments = parser.parse_args()
    opensim.Logger.setLevelString("Off")
    for file in arguments.models:
        found = record_model(file, arguments.count, 0, arguments.beyond)
        kind = "beyond" if arguments.beyond else "paths"
        np.savez_compressed(arguments.output / f"{kind}_{file.stem}.npz", **found)
    if arguments.beyond:
        return
    wraps = {
        f"{case}_{name}": array
        for case, (*arrangement, double) in CASES.items()
        for name, array in record_wrap(*arrangement, double, 150, 0).items()
    }
    np.savez_compressed(arguments.output / "paths_wraps.npz", version=opensim.GetVersion(), **wraps)


if __name__ == "__main__":
    main()
