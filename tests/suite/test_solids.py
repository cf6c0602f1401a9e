"""Objects of solids drawn per world against what MuJoCo compiles for each of them."""

import mujoco
import numpy as np
import pytest
import warp as wp

from myowarp.apps.rollouts.objects import host_model
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.tasks.euler_angles import quat_of
from myowarp.tasks.solids import principal_axes

NUM_WORLDS = 37
SINGLE = 2e-5  # relative, float32; moments are found from a matrix of other moments
DENSITY, DISC_DENSITY, MASS = 1500.0, 1000.0, 1.2
DISC = (0.013, 0.002, 0.0)  # m
NUM_TENSORS = 20_000
AXES = 5e-6  # of the largest moment; measured 1.6e-6, and 3e-3 with one pass of Warp's `eig3`


def compiled(kind, size, free):
    """Return the model that MuJoCo compiles for an object to reorient."""
    height = {3: 1.3 * size[1], 4: size[2], 5: size[1], 6: size[2]}[kind]
    scale = 1.0
    for _ in range(2):
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name="Object")
        if free:
            body.add_freejoint()
        for joint in () if free else (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
            for axis in np.eye(3):
                body.add_joint(type=joint, axis=axis)
        body.add_geom(type=mujoco.mjtGeom(kind), size=size, density=scale * DENSITY)
        for end in (-height, height):
            disc = body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=DISC, pos=(0.0, 0.0, end))
            disc.density = scale * DISC_DENSITY
        model = spec.compile()
        scale *= MASS / model.body_mass[1]
    return model


@wp.kernel(enable_backward=False)
def find_axes(inertia: wp.array[wp.mat33], axes: wp.array[wp.mat33]):
    """Of one tensor in each thread."""
    i = wp.tid()
    axes[i] = principal_axes(inertia[i])


def test_principal_axes():
    """Right-handed and orthonormal, and nothing is left beside the diagonal; also of equal moments."""
    rng = np.random.default_rng(0)
    moments = rng.uniform(2e-5, 1.3e-4, (NUM_TENSORS, 3))
    moments[::4, 1] = moments[::4, 0] * (1.0 + 1e-4 * rng.random(NUM_TENSORS // 4))
    turns, _ = np.linalg.qr(rng.standard_normal((NUM_TENSORS, 3, 3)))
    tensors = ((turns * moments[:, None]) @ turns.transpose(0, 2, 1)).astype(np.float32)
    found = wp.zeros(NUM_TENSORS, dtype=wp.mat33, device="cpu")
    inputs = [wp.array(tensors, dtype=wp.mat33, device="cpu"), found]
    wp.launch(find_axes, NUM_TENSORS, inputs=inputs, device="cpu")
    axes = found.numpy().astype(float)
    np.testing.assert_allclose(
        axes.transpose(0, 2, 1) @ axes, np.broadcast_to(np.eye(3), axes.shape), atol=AXES
    )
    assert (np.linalg.det(axes) > 0.0).all()
    turned = axes.transpose(0, 2, 1) @ tensors @ axes
    beside = np.abs(turned * (1.0 - np.eye(3))).max(axis=(1, 2)) / moments.max(axis=1)
    assert beside.max() < AXES


@pytest.mark.parametrize("key", ["myoHandReorient100-v0", "myoHandReorient100-v1"])
def test_objects_to_reorient(key):
    """Mass, inertia and inverse weights, by hinges and free; bounds of the geom that is there."""
    sim = Simulation(TASKS[key], NUM_WORLDS, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    program, model = sim.shards[0].program, sim.scene.model
    drawn = program.table.numpy()[program.row.numpy()[:, 0].astype(int)].astype(float)
    assert set(drawn[:, 0]) == {3, 4, 5, 6}
    dofs = slice(23, 29)
    for world, (kind, *size) in enumerate(drawn):
        expected = compiled(int(kind), np.array(size), "v1" in key)
        geom = program.object_geom + int(kind) - 3
        for field in ("body_mass", "body_invweight0"):
            ours = getattr(model, field).numpy()[world, program.object_body]
            np.testing.assert_allclose(ours, getattr(expected, field)[1], rtol=SINGLE, err_msg=field)
        inertia = np.sort(model.body_inertia.numpy()[world, program.object_body])
        np.testing.assert_allclose(inertia, np.sort(expected.body_inertia[1]), rtol=SINGLE)
        weights = model.dof_invweight0.numpy()[world, dofs]
        np.testing.assert_allclose(weights, expected.dof_invweight0, rtol=SINGLE)
        np.testing.assert_allclose(
            model.geom_rbound.numpy()[world, geom], expected.geom_rbound[0], rtol=SINGLE
        )
        box = model.geom_aabb.numpy()[world, geom].ravel()
        np.testing.assert_allclose(box, expected.geom_aabb[0], rtol=SINGLE, atol=1e-9)
    spread = model.body_inertia.numpy()[:, program.object_body]
    assert spread.max() > 2 * spread.min()


@pytest.mark.parametrize("key", ["myoChallengeRelocateP2-v1"])
def test_free_objects_to_relocate(key):
    """Mass, center, inertia and inverse weights of three solids that overlap; without a floor."""
    sim = Simulation(TASKS[key], NUM_WORLDS, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    program, model = sim.shards[0].program, sim.scene.model
    kinds = np.hstack([getattr(program, f"kind_{part}").numpy() for part in range(3)]).astype(int)
    sizes, shares, turns, frictions = (
        getattr(program, f"part_{name}").numpy().reshape(NUM_WORLDS, 3, 3).astype(float)
        for name in ("size", "place", "turn", "friction")
    )
    body, dofs = program.object_body, slice(38, 44)
    for world in range(NUM_WORLDS):
        spec = mujoco.MjSpec()
        solid = spec.worldbody.add_body()
        solid.add_freejoint()
        for part in range(3):
            geom = solid.add_geom(type=mujoco.mjtGeom(kinds[world, part]), size=sizes[world, part])
            geom.pos, geom.quat = sizes[world, part] * shares[world, part], quat_of(turns[world, part])
        density = 1000.0 * program.object_mass.numpy()[world, 0] / spec.copy().compile().body_mass[1]
        for geom in spec.geoms:
            geom.density = density
        expected = spec.compile()
        for field in ("body_mass", "body_ipos", "body_invweight0"):
            ours = getattr(model, field).numpy()[world, body]
            theirs = getattr(expected, field)[1]
            np.testing.assert_allclose(ours, theirs, rtol=SINGLE, atol=1e-8, err_msg=field)
        moments = np.sort(model.body_inertia.numpy()[world, body])
        np.testing.assert_allclose(moments, np.sort(expected.body_inertia[1]), rtol=SINGLE)
        weights = model.dof_invweight0.numpy()[world, dofs]
        np.testing.assert_allclose(weights, expected.dof_invweight0, rtol=SINGLE)
        geoms = program.object_geom + 5 * np.arange(3) + kinds[world] - 2
        np.testing.assert_allclose(model.geom_friction.numpy()[world, geoms], frictions[world], rtol=SINGLE)
    assert model.body_inertia.numpy()[:, body].min() < 5e-5
    assert (sim.scene.oracle.geom_priority[geoms] == 1).all()


@pytest.mark.slow
def test_a_free_object_breaks_nothing():
    """Where the hinges of version 0 lose a direction: MyoSuite, too, has steps without a result."""
    sim = Simulation(TASKS["myoHandReorientOOD-v1"], 48, device="cpu", autoreset="same_step", progress=False)
    sim.reset(seeds=np.arange(48))
    rng = np.random.default_rng(0)
    for _ in range(60):
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
        assert not sim.transition.fault.numpy().any()


@pytest.mark.slow
def test_an_object_starts_apart_from_the_bin():
    """In MuJoCo C nothing touches the object where an episode of phase 2 starts."""
    sim = Simulation(TASKS["myoChallengeRelocateP2-v0"], 400, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(400))
    scene, program = sim.scene, sim.shards[0].program
    data = mujoco.MjData(scene.oracle)
    qpos, places = scene.data.qpos.numpy(), program.goal_place.numpy()
    start = np.array([-0.2, 0.0, -0.02])
    near = np.linalg.norm(program.object_place.numpy() + start - places, axis=1)
    assert (near < 0.25).sum() > 20
    for world in np.argsort(near)[:40]:
        model = host_model(scene, int(world))
        model.geom_sameframe[:] = model.body_sameframe[:] = 0
        data.qpos[:] = qpos[world]
        data.mocap_pos[:], data.mocap_quat[:] = places[world], scene.data.mocap_quat.numpy()[world]
        mujoco.mj_forward(model, data)
        touching = model.geom_bodyid[data.contact.geom] == program.object_body
        deep = data.contact.dist[touching.any(axis=1)]
        assert not (deep < 0.0).any()
