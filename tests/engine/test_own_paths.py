"""Paths that a model brings along, in the physics step: against the float64 of OpenSim's paths."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.coordinates.step import step_of
from myowarp.definitions.body import BODIES
from myowarp.laws.paths.tables import TURNS, OsimPath, OsimPaths, Over, Via, WrapSurface
from myowarp.models.bodies.from_file import register_body
from myowarp.osim.body.path_solution import lengths_and_moment_arms
from myowarp.osim.bundle.mjcf import mjcf
from myowarp.osim.bundle.paths import DocumentPaths
from myowarp.osim.convert.compose.convert import convert
from myowarp.osim.document.kinematics import random_poses
from myowarp.osim.document.read.model import read_model
from myowarp.sim.build import compile_scene, stepped_of
from myowarp.tasks.from_file import pose_task
from tests.converted import OSIM, simulation

WORLDS = 7
TOLERANCE = 2e-6
"""m. Poses of bodies are float32; measured 5e-7."""
SPEED = 2e-5
"""m/s, at up to 1 m/s."""


def written(folder, name):
    """Write a model that is not fitted, with its own paths; returns the conversion and the model's path."""
    converted = convert(read_model(OSIM / f"{name}.osim"))
    path = folder / "model.xml"
    path.write_text(mjcf(converted.spec))
    (folder / "couplings.json").write_text(converted.couplings.as_json())
    (folder / "paths.json").write_text(converted.paths.as_json())
    return converted, path


def beyond(model, values):
    """Return the same poses with knees two tenths of a radian straighter than their ranges go."""
    knees = {name: model.coordinates[name].range[1] + 0.2 for name in values if name.startswith("knee_angle")}
    return {**values, **{name: np.full(WORLDS, knee) for name, knee in knees.items()}}


@pytest.mark.parametrize(
    ("name", "within"),
    [("arm26", True), ("leg6dof9musc", True), ("gait10dof18musc", True), ("gait10dof18musc", False)],
)
def test_tendons_are_opensims_paths(name, within, tmp_path):
    """Lengths, moment arms and speeds of all muscles; the tendons of the same names are far off."""
    converted, path = written(tmp_path, name)
    model, free = converted.model, converted.model.independent
    paths = {muscle: one.path for muscle, one in model.muscles.items()}
    values = random_poses(model, WORLDS, 3)
    values = values if within else beyond(model, values)
    speeds = np.random.default_rng(0).normal(size=(WORLDS, len(free)))
    expected = lengths_and_moment_arms(model, paths, {k: values[k] for k in free}, speeds, TURNS)
    scene = compile_scene(pose_task(path), WORLDS, device="cpu")
    step = step_of(stepped_of(scene))
    order = converted.coordinates.free()
    qpos, slope = converted.coordinates.rates(scene.oracle, {k: values[k] for k in order})
    columns = [free.index(k) for k in order]
    data, model_ = scene.data, scene.model
    data.qpos.assign(qpos)
    data.qvel.assign(np.einsum("nij,nj->ni", slope, speeds[:, columns]))
    data.ten_J.fill_(np.nan)
    data.ten_length.fill_(np.nan)
    step.launches()()
    tendons = [scene.oracle.tendon(muscle).id for muscle in paths]
    rows = np.repeat(np.arange(scene.oracle.ntendon), model_.ten_J_rownnz.numpy())
    jacobian = np.zeros((WORLDS, scene.oracle.ntendon, scene.oracle.nv))
    jacobian[:, rows, model_.ten_J_colind.numpy()] = data.ten_J.numpy()
    arms = -np.einsum("ntj,njk->ntk", jacobian[:, tendons], slope)
    assert np.abs(data.ten_length.numpy()[:, tendons] - expected.length).max() < TOLERANCE
    assert np.abs(arms - expected.moment_arm[:, :, columns]).max() < TOLERANCE
    assert np.abs(data.ten_velocity.numpy()[:, tendons] - expected.velocity).max() < SPEED
    muscles = [scene.oracle.actuator(muscle).id for muscle in paths]
    np.testing.assert_array_equal(
        data.actuator_length.numpy()[:, muscles], data.ten_length.numpy()[:, tendons]
    )
    state, straight = mujoco.MjData(scene.oracle), np.zeros_like(expected.length)
    for world in range(WORLDS):
        state.qpos = qpos[world]
        mujoco.mj_fwdPosition(scene.oracle, state)
        straight[world] = state.ten_length[tendons]
    assert np.abs(straight - expected.length).max() > 1000 * TOLERANCE


@pytest.mark.slow
def test_worlds_do_not_depend_on_neighbours_and_stages_are_verified(tmp_path):
    """Three worlds and the same one alone; the engine's own stages go on beside paths of ours."""
    _, path = written(tmp_path, "leg6dof9musc")
    states = []
    for count in (3, 1):
        sim = simulation(path, count)
        sim.reset(seeds=np.arange(count))
        sim.action.fill_(0.3)
        for _ in range(5):
            sim.step()
        states.append(sim.scene.data.qpos.numpy()[:1].copy())
        kinds = {type(stage).__name__ for stage in sim.shards[0].stages}
        assert "RigidBody" in kinds
        assert "MusclePath" not in kinds
    np.testing.assert_array_equal(*states)


SURFACE = WrapSurface(
    "sphere", "b", (0.0, 0.0, 0.0), ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)), (0.1, 0.0, 0.0)
)
PATH = OsimPath((Via("world", (0.0, 0.0, 0.3)), Via("b", (0.0, 0.2, 0.0))), (Over("s", "hybrid", 0, 1),))
SAID = DocumentPaths(OsimPaths({"t": PATH}, {"s": SURFACE}), ())
MJCF = """<mujoco model="own">
<worldbody>
  <site name="a" pos="0 0 .3"/>
  <body name="b"><joint name="j" axis="1 0 0"/><geom size=".1" mass="1"/><site name="c" pos="0 .2 0"/></body>
</worldbody>
<tendon><spatial name="t"><site site="a"/><site site="c"/></spatial>{more}</tendon>
<actuator><muscle name="m" tendon="t" lengthrange=".1 .5"/></actuator>
</mujoco>"""


def broken(change):
    """Return the text of a path after a change of its JSON."""
    entry = json.loads(SAID.as_json())
    change(entry)
    return json.dumps(entry)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "must be JSON with 'guard', 'exact', 'values', 'surfaces' and 'paths'"),
        ("[1", "must be JSON"),
        (broken(lambda e: e.update(guard=-1)), "guard must be at least 0, got -1.0"),
        (broken(lambda e: e["paths"]["t"]["points"].pop()), "path 't' needs at least 2 points, got 1"),
        (broken(lambda e: e["paths"]["t"]["points"][0].update(condition=3)), "a value that does not exist"),
        (broken(lambda e: e["paths"]["t"]["points"][0].update(location=[0, 0, 1e999])), "numbers are not"),
        (broken(lambda e: e["paths"]["t"]["wraps"][0].update(surface="x")), "a surface, or by a method"),
        (broken(lambda e: e["paths"]["t"]["wraps"][0].update(last=2)), "between points that it has not"),
        (broken(lambda e: e["surfaces"]["s"].update(kind="cone")), "surface 's' has a kind"),
        (broken(lambda e: e["surfaces"]["s"].update(size=[-1, 0, 0])), "finite and not negative"),
        (broken(lambda e: e["surfaces"]["s"].update(body="x")), "name 'x', and the model has no body"),
        (broken(lambda e: e["paths"].update(u=e["paths"]["t"])), "name 'u', and the model has no tendon"),
        (
            broken(lambda e: e.update(values=[{"of": "x", "curves": []}])),
            "name 'x', and the model has no hinge or slide",
        ),
    ],
)
def test_errors_of_a_text_are_one_sentence(text, message, tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(MJCF.format(more=""))
    (tmp_path / "paths.json").write_text(text)
    with pytest.raises(ValueError, match=f"paths.json' must belong to model.xml: .*{message}"):
        register_body(path)


def test_a_wrapping_tendon_needs_a_path_and_one_of_sites_does_not(tmp_path):
    path = tmp_path / "model.xml"
    more = '<spatial name="u"><site site="a"/><site site="c"/></spatial>'
    more += '<fixed name="f"><joint joint="j" coef="2"/></fixed>'
    path.write_text(MJCF.format(more=more))
    (tmp_path / "paths.json").write_text(SAID.as_json())
    scene = compile_scene(pose_task(path), 3, device="cpu")
    scene.data.qpos.assign(np.array([[0.0], [-0.5], [-1.0]]))
    step_of(stepped_of(scene)).launches()()
    own, sites, fixed = scene.data.ten_length.numpy().T
    angle = np.array([0.0, -0.5, -1.0])
    straight = np.hypot(0.2 * np.cos(angle), 0.3 - 0.2 * np.sin(angle))
    np.testing.assert_allclose(sites, straight, atol=1e-6)
    np.testing.assert_allclose(fixed, 2 * angle, atol=1e-6)
    # A path over a sphere of radius r about the origin: two tangents and an arc, if it is in the way.
    tangents = np.sqrt(0.3**2 - 0.1**2) + np.sqrt(0.2**2 - 0.1**2)
    arc = 0.1 * (np.pi / 2 - angle - np.arccos(0.1 / 0.3) - np.arccos(0.1 / 0.2))
    assert ((arc > 0) == [False, False, True]).all()
    np.testing.assert_allclose(own, np.where(arc > 0, tangents + arc, straight), atol=1e-6)
    assert abs(own - straight)[2] > 1e-3
    wrapping = '<spatial name="u"><site site="a"/><geom geom="g"/><site site="c"/></spatial>'
    path.write_text(MJCF.format(more=wrapping).replace("<geom size", '<geom name="g" size'))
    with pytest.raises(ValueError, match="must name tendon 'u', which wraps; they do not"):
        register_body(path)


def test_a_text_reads_back_as_written(tmp_path):
    converted, path = written(tmp_path, "gait10dof18musc")
    assert DocumentPaths.read(converted.paths.as_json()) == converted.paths
    said = DocumentPaths.of(BODIES[register_body(path)[0]].build().compile())
    assert said == converted.paths
    assert DocumentPaths.NAME == "paths"
    assert Path(tmp_path / "paths.json").is_file()
