"""MuJoCo tendons for OpenSim's muscle paths: wrap and gradients against MuJoCo C, fits against OpenSim."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.osim.body.moment_arm import crossed, own_reference, poses_of
from myowarp.osim.convert.check.muscles import motion
from myowarp.osim.convert.compose.convert import Stages, convert
from myowarp.osim.convert.tendon.choice import fit_path
from myowarp.osim.convert.tendon.fit import PathProblem, fit_surfaces, turn_sides
from myowarp.osim.convert.tendon.path import Over, TendonPath, Via, lengths
from myowarp.osim.convert.tendon.surface import Surface, over_surface
from myowarp.osim.document.kinematics import random_poses
from myowarp.osim.document.read.model import read_model

OSIM = Path(__file__).parents[1] / "data" / "osim"

LENGTH_TOLERANCE = 1e-12
"""m. Against MuJoCo C, both in float64."""

GRADIENT_TOLERANCE = 1e-6
"""m. Of central differences with a step of 1e-6; the point of an inside wrap is solved to 1e-6."""

MODEL_TOLERANCE = 1e-8
"""m. Length of a compiled tendon against our own: frames are exact where no spline moves a body."""

GATES = {"arm26": 0.3e-3, "leg6dof9musc": 0.7e-3, "gait10dof18musc": 0.7e-3}
"""m. Mean over pairs of muscle and coordinate of the RMS moment arm error over consistent samples."""


def turned(turn):
    """Return the rotation of a rotation vector."""
    quaternion, matrix = np.zeros(4), np.zeros(9)
    angle = np.linalg.norm(turn)
    mujoco.mju_axisAngle2Quat(quaternion, turn / angle, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def surface(kind, mode):
    """Return a surface in a general position."""
    side = np.array([0.6, -0.48, 0.64])
    rotation = turned(np.array([0.3, -0.9, 0.5]))
    return Surface(
        kind, np.array([0.03, -0.1, 0.07]), rotation, 0.3, None if mode == "none" else side, mode == "inside"
    )


def compiled_lengths(over, start, end):
    """Return what MuJoCo says about lines over a surface."""
    spec = mujoco.MjSpec()
    for name in ("start", "end"):
        body = spec.worldbody.add_body(name=name)
        for axis in np.eye(3):
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], mass=1)
        body.add_site(name=name)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, over.rotation.ravel())
    kind = mujoco.mjtGeom.mjGEOM_SPHERE if over.kind == "sphere" else mujoco.mjtGeom.mjGEOM_CYLINDER
    spec.worldbody.add_geom(
        name="over", type=kind, size=[over.radius, 1, 0], pos=over.centre, quat=quaternion
    )
    if over.side is not None:
        reach = 0.0 if over.inside else 1.3 * over.radius
        spec.worldbody.add_site(name="side", pos=over.centre + reach * over.side)
    tendon = spec.add_tendon()
    tendon.wrap_site("start")
    tendon.wrap_geom("over", "" if over.side is None else "side")
    tendon.wrap_site("end")
    model = spec.compile()
    data, found = mujoco.MjData(model), []
    for pose in np.concatenate([start, end], axis=1):
        data.qpos[:] = pose
        mujoco.mj_fwdPosition(model, data)
        found.append(data.ten_length[0])
    return np.array(found)


@pytest.mark.parametrize("mode", ["none", "side", "inside"])
@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_wrap_is_that_of_mujoco(kind, mode):
    over = surface(kind, mode)
    start, end = np.random.default_rng(0).uniform(-1, 1, (2, 400, 3))
    path = over_surface(over, start, end)
    assert 20 < path.wrapped.sum() < 380
    assert np.abs(path.length - compiled_lengths(over, start, end)).max() < LENGTH_TOLERANCE
    straight = np.linalg.norm(start - end, axis=1)
    assert np.abs(path.length - straight)[path.wrapped].mean() > 1e-3


@pytest.mark.parametrize("mode", ["none", "side", "inside"])
@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_gradients_are_differences(kind, mode):
    over, step = surface(kind, mode), 1e-6
    start, end = np.random.default_rng(1).uniform(-1, 1, (2, 300, 3))
    path = over_surface(over, start, end)

    def moved(number, size):
        if number < 3:
            return replace(over, centre=over.centre + size * np.eye(3)[number])
        if number == 3:
            return replace(over, radius=over.radius * np.exp(size))
        return replace(over, rotation=turned(size * np.eye(3)[number - 4]) @ over.rotation)

    for number in range(7):
        below, above = (over_surface(moved(number, size), start, end) for size in (-step, step))
        kept = (below.wrapped == path.wrapped) & (above.wrapped == path.wrapped)
        slope = (above.length - below.length) / (2 * step)
        assert kept.mean() > 0.99
        assert np.abs(slope - path.gradient[:, number])[kept].max() < GRADIENT_TOLERANCE
    assert np.abs(path.gradient[:, :4]).max(axis=0).min() > 0.1
    assert (np.abs(path.gradient[:, 4:]).max() > 0.1) == (kind == "cylinder")


def disturbed():
    """Return the problem of a muscle whose path has a surface, and a path with a wrong surface."""
    model = read_model(OSIM / "arm26.osim")
    poses = poses_of(model, random_poses(model, 100, 0), model.independent)
    path = model.muscles["BRA"].path
    (over,) = (exact := fit_path(model, "BRA", path, poses).tendon).surfaces
    wrong = Surface(
        over.surface.kind,
        over.surface.centre + np.array([0.002, -0.001, 0.001]),
        turned(np.array([0.05, 0.1, 0.0])) @ over.surface.rotation,
        1.1 * over.surface.radius,
        over.surface.side,
    )
    return PathProblem(model, "BRA", path, poses, None), exact.with_surfaces([wrong])


@pytest.mark.parametrize(
    ("method", "share"), [("least_squares", 0.05), pytest.param("annealing", 0.9, marks=pytest.mark.slow)]
)
def test_a_wrong_surface_is_found_again(method, share):
    """The fit undoes a shift, a growth and a turn of a surface that is exact as the file has it."""
    problem, start = disturbed()
    worse = np.linalg.norm(problem.residual(start))
    assert np.linalg.norm(problem.residual(fit_surfaces(problem, start, method))) < share * worse


def test_a_side_is_turned_to_where_the_point_is_let_go():
    """A path that OpenSim lets go of a conditional point keeps it with a side in the mean direction."""
    model = read_model(OSIM / "gait10dof18musc.osim")
    poses = poses_of(model, random_poses(model, 150, 0), model.independent)
    path = model.muscles["iliopsoas_r"].path
    problem = PathProblem(model, "iliopsoas_r", path, poses, None)
    point = path.points[2]
    sphere = Surface("sphere", point.location, np.eye(3), 0.001, np.array([1.0, 0.0, 0.0]))
    start = TendonPath("iliopsoas_r", (Via(0), Via(1), Over("P3", point.body, sphere), Via(3), Via(4)))
    before = np.linalg.norm(problem.residual(start))
    assert np.linalg.norm(problem.residual(turn_sides(problem, start))) < 0.7 * before


def test_side_sites_are_added():
    """A conditional point on the way over the hip, whose frames are exact: the path may leave one side."""
    model = read_model(OSIM / "leg6dof9musc.osim")
    poses = poses_of(model, random_poses(model, 40, 0), model.independent)
    path = model.muscles["psoas_r"].path
    fit = fit_path(model, "psoas_r", path, poses)
    assert any(over.surface.side is not None for over in fit.tendon.surfaces)
    converted = convert(model, stages=Stages(tendons={"psoas_r": fit.tendon}))
    compiled = converted.spec.compile()
    data, found = mujoco.MjData(compiled), []
    for position in converted.coordinates.qpos(compiled, {k: poses.coordinates[k] for k in poses.beside}):
        data.qpos[:] = position
        mujoco.mj_fwdPosition(compiled, data)
        found.append(data.tendon("psoas_r").length[0])
    problem = PathProblem(model, "psoas_r", path, poses, None)
    own = lengths(fit.tendon, problem.points[:40], poses.frames).length
    assert np.abs(own - found).max() < MODEL_TOLERANCE
    straight = TendonPath("psoas_r", tuple(e for e in fit.tendon.elements if isinstance(e, Via)))
    without = lengths(straight, problem.points[:40], poses.frames).length
    assert np.abs(own - without).max() > 1e-3


@pytest.mark.parametrize(
    "name", ["arm26", *(pytest.param(name, marks=pytest.mark.slow) for name in list(GATES)[1:])]
)
def test_compiled_tendons(name):
    """Length and moment arms of the compiled model, in poses that the fit has not seen."""
    model = read_model(OSIM / f"{name}.osim")
    poses = poses_of(model, random_poses(model, 150, 0), model.independent)
    fits = {key: fit_path(model, key, muscle.path, poses) for key, muscle in model.muscles.items()}
    converted = convert(model, stages=Stages(tendons={key: fit.tendon for key, fit in fits.items()}))
    compiled = converted.spec.compile()
    free = converted.coordinates.free()
    poses = poses_of(model, random_poses(model, 100, 1), model.independent)
    found = motion(converted, compiled, poses)
    errors = []
    for muscle, fit in fits.items():
        path, column = model.muscles[muscle].path, compiled.tendon(muscle).id
        reference = own_reference(model, path, poses, crossed(model, path))
        for coordinate, arm in reference.moment_arm.items():
            kept = reference.consistent(coordinate)
            error = found.moment_arm[:, column, free.index(coordinate)] - arm
            errors.append(np.sqrt(np.mean(error[kept] ** 2)))
            assert np.abs(arm).max() > 10 * GATES[name]
        if name == "arm26":
            problem = PathProblem(model, muscle, path, poses, None)
            own = problem.residual(fit.tendon)[-100:] + problem.target.value[-100:]
            weights = problem.target.length_weights
            assert np.abs(own - weights * found.length[:, column]).max() < MODEL_TOLERANCE
    assert np.mean(errors) < GATES[name]
