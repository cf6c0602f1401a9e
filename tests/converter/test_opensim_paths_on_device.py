"""Whole muscle paths in a kernel: against OpenSim 4.6, recorded, and the float64 NumPy."""

import dataclasses
from pathlib import Path as FilePath

import numpy as np
import pytest
import warp as wp
from often import often
from reference.osim_paths.path import solve as reference_solve

from myowarp.laws.paths.tables import TURNS, PathMemory
from myowarp.osim.body.described import described
from myowarp.osim.body.moment_arm import crossed, own_reference, poses_of
from myowarp.osim.body.path_solution import lengths_and_moment_arms, solve
from myowarp.osim.document.elements import (
    ConditionalPathPoint,
    MovingPathPoint,
    Path,
    PathPoint,
    PathWrap,
    Pose,
)
from myowarp.osim.document.functions import Linear, Polynomial, SimmSpline
from myowarp.osim.document.kinematics import about, forward, random_poses
from myowarp.osim.document.model import WrapObject
from myowarp.osim.document.read.model import read_model

DATA = FilePath(__file__).parents[1] / "data"
MODELS = ("arm26", "gait10dof18musc", "leg6dof9musc")

LENGTH_TOLERANCE = 1e-9
"""m. Only rounding differs, also in OpenSim's iterations."""

MOMENT_ARM_TOLERANCE = 2e-9
"""m. Of the reference's differences with a step of 1e-5; ours are derivatives."""

SAMPLED_TOLERANCE = 1e-5
"""m. What most rays of an ellipsoid's fan on cubics may change; in 25,000 paths of MoBL-ARMS 5e-7 at most."""

SIZES = {"cylinder": (0.04, 0.3), "sphere": (0.05,), "ellipsoid": (0.05, 0.03, 0.04), "torus": (0.02, 0.06)}


def recorded(name, kind="paths"):
    """Return a model and the recorded arrays."""
    return read_model(DATA / "osim" / f"{name}.osim"), np.load(DATA / "opensim" / f"{kind}_{name}.npz")


def followed(model, paths, values, guard=0.0):
    """Return paths in poses, the coordinates at rest."""
    speeds = np.zeros((len(next(iter(values.values()))), len(model.independent)))
    return lengths_and_moment_arms(model, paths, values, speeds, guard)


@pytest.mark.parametrize(
    ("name", "kind"), [*((name, "paths") for name in MODELS), ("gait10dof18musc", "beyond")]
)
def test_recorded_lengths_and_moment_arms(name, kind):
    model, arrays = recorded(name, kind)
    values = dict(zip(arrays["coordinates"].tolist(), arrays["values"].T, strict=True))
    free, muscles = model.independent, arrays["muscles"].tolist()
    paths = {muscle: model.muscles[muscle].path for muscle in muscles}
    found = followed(model, paths, {name: values[name] for name in free})
    assert np.abs(found.length - arrays["length"]).max() < LENGTH_TOLERANCE
    np.testing.assert_array_equal(found.size, arrays["size"])
    recorded_free = arrays["free"].tolist()
    columns = [free.index(recorded_free[coordinate]) for _, coordinate in arrays["pairs"]]
    arms = found.moment_arm[:, arrays["pairs"][:, 0], columns]
    assert np.abs(arms - arrays["moment_arm"]).max() < MOMENT_ARM_TOLERANCE
    assert np.abs(arrays["moment_arm"]).max() > 1e6 * MOMENT_ARM_TOLERANCE


def hostile(seed):
    """Return arm26 with random paths over random surfaces, through points that move and that come and go.

    Several wraps share a surface, ranges leave out ends, quadrants cannot always be met.
    """
    random = np.random.default_rng(seed)
    model = read_model(DATA / "osim" / "arm26.osim")
    bodies = ["base", "r_humerus", "r_ulna_radius_hand"]

    def place(spread):
        return np.array([0.0, -0.1, 0.0]) + random.uniform(-spread, spread, 3)

    wraps = {}
    for number in range(8):
        kind = list(SIZES)[number % 4]
        axis = random.normal(size=3)
        turned = about(axis / np.linalg.norm(axis), random.uniform(0, 3, 1))[0]
        side = random.choice(["all", "x", "-y", "z"])
        body, frame = bodies[number % 3], Pose(place(0.05), turned)
        wraps[f"{kind}{number}"] = WrapObject(
            f"{kind}{number}", kind, body, frame, SIZES[kind], side, number != 5
        )
    knots = SimmSpline((-1.0, 0.5, 1.5, 3.0), (0.0, 0.02, -0.01, 0.03))
    paths = {}
    for number in range(12):
        points = [PathPoint("p0", bodies[0], place(0.2)), PathPoint("p1", bodies[number % 3], place(0.2))]
        points.append(ConditionalPathPoint("p2", bodies[1], place(0.2), "r_elbow_flex", (0.5, 1.5)))
        frame = Pose(place(0.1), about(np.array([0.0, 0.6, 0.8]), np.ones(1))[0])
        functions = (knots, Linear(0.0, 0.03), Polynomial((0.02, -0.01, 0.04)))
        points.append(
            MovingPathPoint("p3", bodies[2], frame, functions, ("r_elbow_flex", None, "r_shoulder_elev"))
        )
        points.append(PathPoint("p4", bodies[2], place(0.2)))
        over = random.choice(list(wraps), number % 5)
        methods = random.choice(["hybrid", "midpoint"], 5)
        ranges = [(-1, -1), (2, 4), (1, 3), (3, 9), (4, 2)]
        used = tuple(
            PathWrap(str(name), str(method), ranges[random.integers(5)])
            for name, method in zip(over, methods, strict=False)
        )
        paths[f"muscle{number}"] = Path(tuple(points), used)
    return dataclasses.replace(model, wraps=wraps), paths


@pytest.mark.parametrize("seed", often(range(3), [0]))
def test_hostile_paths_go_as_in_numpy(seed):
    model, paths = hostile(seed)
    values = random_poses(model, 23, seed)
    free, frames = model.independent, forward(model, values)
    with np.errstate(all="ignore"):
        references = [reference_solve(model, path, frames, values) for path in paths.values()]
        solutions = [solve(model, path, frames, values) for path in paths.values()]
        found = followed(model, paths, {name: values[name] for name in free})
    expected = np.stack([reference.length for reference in references], axis=1)
    sane = np.isfinite(expected) & (expected < 2.0)  # what runs away does so differently with each rounding
    assert sane.mean() > 0.9
    assert np.abs(found.length - expected)[sane].max() < LENGTH_TOLERANCE
    for ours, theirs, rows in zip(solutions, references, sane.T, strict=True):
        np.testing.assert_array_equal(ours.order[rows], theirs.order[rows])
        for name in ("length", "location", "cached", "arc"):
            np.testing.assert_allclose(
                getattr(ours, name)[rows], getattr(theirs, name)[rows], atol=LENGTH_TOLERANCE, err_msg=name
            )
    chain = followed(model, {n: Path(p.points, ()) for n, p in paths.items()}, {n: values[n] for n in free})
    assert (np.abs(found.length - chain.length)[sane] > 1e-3).mean() > 0.1
    assert np.isfinite(found.length).all()


def test_hostile_moment_arms_and_speeds():
    model, paths = hostile(1)
    free = model.independent
    values = {name: value for name, value in random_poses(model, 13, 1).items() if name in free}
    speeds = np.random.default_rng(2).normal(size=(13, len(free)))
    with np.errstate(all="ignore"):
        found = lengths_and_moment_arms(model, paths, values, speeds)
        poses = poses_of(model, values, free)
        for number, path in enumerate(paths.values()):
            reference = own_reference(model, path, poses, crossed(model, path))
            sane = np.isfinite(reference.length) & (reference.length < 2.0)
            arms = np.stack([reference.moment_arm[name] for name in free], axis=1)
            assert np.abs(found.moment_arm[:, number] - arms)[sane].max() < MOMENT_ARM_TOLERANCE
    step = 1e-6

    def moved(by):
        beside = {name: value + by * speeds[:, k] for k, (name, value) in enumerate(values.items())}
        return followed(model, {n: Path(p.points, ()) for n, p in paths.items()}, beside).length

    straight = {n: Path(p.points, ()) for n, p in paths.items()}
    speed = lengths_and_moment_arms(model, straight, values, speeds).velocity
    slope = (moved(step) - moved(-step)) / (2 * step)
    # The last two points share a body, and one moves in it: that is no moment arm, but counts for the speed.
    np.testing.assert_allclose(speed, slope, atol=1e-8)
    pulled = -np.einsum(
        "npk,nk->np", lengths_and_moment_arms(model, straight, values, speeds).moment_arm, speeds
    )
    assert np.abs(pulled - speed).max() > 1e-3


def runaway():
    """Return arm26 with two thin cylinders, along which OpenSim slides tangent points far for some lines."""
    model = read_model(DATA / "osim" / "arm26.osim")
    frame = Pose(np.array([0.0, -0.15, 0.0]), np.eye(3))
    wrap = WrapObject("thin", "cylinder", "r_humerus", frame, (0.005, 10.0), "x", True)
    also = dataclasses.replace(wrap, name="also", size=(0.006, 10.0))
    over = tuple(PathWrap(name, "hybrid", (-1, -1)) for name in ("thin", "also"))
    return dataclasses.replace(model, wraps={"thin": wrap, "also": also}), over


def test_the_guard_bounds_a_path_and_counts():
    random = np.random.default_rng(0)
    model, over = runaway()
    paths = {}
    for number in range(400):
        points = [PathPoint(str(k), "r_humerus", random.uniform(-0.3, 0.3, 3)) for k in range(2)]
        paths[str(number)] = Path(tuple(points), over)
    values = {name: np.zeros(1) for name in model.independent}
    with np.errstate(all="ignore"):
        free, held = followed(model, paths, values), followed(model, paths, values, TURNS)
        chain = followed(model, {n: Path(p.points, ()) for n, p in paths.items()}, values)
    most = chain.length + 2 * TURNS * 2 * np.pi * (0.005 + 0.006)
    assert (free.length > most).any()
    assert (held.length <= most).all()
    assert not free.jumps.any()
    assert held.jumps[free.length > most].all()
    assert 0 < held.jumps.mean() < 0.5
    same = held.length == free.length
    assert same[~held.jumps].all()


def test_a_sampled_fan_is_within_a_hundredth_of_a_millimetre():
    """Random lines over ellipsoids: flat ones too, in which rays turn round suddenly."""
    random = np.random.default_rng(0)
    model, _ = runaway()
    here, wraps, paths = Pose(np.array([0.0, -0.15, 0.0]), np.eye(3)), {}, {}
    for number, size in enumerate(((0.05, 0.03, 0.04), (0.03, 0.03, 0.06), (0.08, 0.01, 0.05))):
        wraps[str(number)] = WrapObject(str(number), "ellipsoid", "r_humerus", here, size, "all", True)
    for number in range(600):
        ends = np.array([0.0, -0.15, 0.0]) + random.uniform(-0.1, 0.1, (2, 3))
        points = tuple(PathPoint(str(k), "r_humerus", end) for k, end in enumerate(ends))
        paths[str(number)] = Path(points, (PathWrap(str(number % 3), "hybrid", (-1, -1)),))
    model = dataclasses.replace(model, wraps=wraps)
    frames = forward(model, {name: np.zeros(1) for name in model.coordinates})
    paths_of, _ = described(model, paths)
    found = []
    for exact in (True, False):
        with wp.ScopedDevice("cpu"):
            memory = PathMemory(paths_of, 1, 0, exact=exact)
            memory.frames.origin.assign(np.stack([frames[name][1] for name in paths_of.bodies], axis=1))
            memory.frames.rotation.assign(np.stack([frames[name][0] for name in paths_of.bodies], axis=1))
            memory.launch()
            wrapped = memory.pulls.size.numpy() == 4
            found.append((memory.pulls.length.numpy(), memory.pulls.size.numpy()))
    assert 50 < wrapped.sum() < 550
    np.testing.assert_array_equal(found[0][1], found[1][1])
    off = np.abs(found[0][0] - found[1][0])
    assert 1e-12 < off.max() < SAMPLED_TOLERANCE


def test_a_world_does_not_depend_on_its_neighbours_or_on_old_memory():
    model, paths = hostile(2)
    values = random_poses(model, 5, 0)
    frames = forward(model, values)
    paths_of, needed = described(model, paths)

    def pulls(rows):
        with wp.ScopedDevice("cpu"):
            memory = PathMemory(paths_of, len(rows), len(needed))
            found, inner = memory.pulls, memory.memory
            arrays = (found.length, found.force, found.torque, found.along, found.within)
            for array in (*arrays, inner.location, inner.cached, inner.arc):
                array.fill_(np.nan)
            at = memory.frames
            at.origin.assign(np.stack([frames[name][1][rows] for name in paths_of.bodies], axis=1))
            at.rotation.assign(np.stack([frames[name][0][rows] for name in paths_of.bodies], axis=1))
            at.value.assign(np.stack([f.value(values[name][rows]) for f, name in needed], axis=1))
            memory.launch()
            return [array.numpy().copy() for array in arrays]

    together = pulls(np.arange(5))
    alone = pulls(np.array([3]))
    for many, one in zip(together, alone, strict=True):
        assert np.isfinite(many).all()
        np.testing.assert_array_equal(many[3:4], one)
