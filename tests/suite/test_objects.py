"""Object hold and pen twirl: what the recordings of MyoSuite cannot say, most of it about our versions 1."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from stepping import engine_alone

from myowarp.definitions.task import TASKS
from myowarp.sim.build import full_spec
from myowarp.sim.simulation import Simulation

NUM_WORLDS = 33
SINGLE = 2e-6  # relative, float32
OVERLAP = 0.005  # m
NUM_GOALS = 400
NUM_STATES = 60


def simulation(key, num_worlds=NUM_WORLDS):
    """Return a freshly reset simulation."""
    sim = Simulation(TASKS[key], num_worlds, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(num_worlds))
    return sim


def hold_model(size):
    """Return the model that MuJoCo compiles for an object of this size, of a corrected task."""
    spec = full_spec(TASKS["myoHandObjHoldRandom-v1"])
    spec.geom("object").size = size
    return spec.compile()


def test_object_of_a_world_is_what_mujoco_compiles():
    """Size, bounds, mass, inertia and inverse weight; the hand stays as it is."""
    sim = simulation("myoHandObjHoldRandom-v1")
    program, oracle = sim.shards[0].program, sim.scene.oracle
    for world in (0, NUM_WORLDS - 1):
        expected = hold_model(program.object_size.numpy()[world].astype(float))
        for name in TASKS["myoHandObjHoldRandom-v1"].batched:
            kind, ours = name.split("_")[0], getattr(sim.scene.model, name).numpy()[world]
            row = getattr(program, f"object_{kind}")
            theirs = getattr(expected, name)[getattr(expected, kind)("object").id]
            np.testing.assert_allclose(np.ravel(ours[row]), np.ravel(theirs), rtol=SINGLE, err_msg=name)
            others = np.delete(np.arange(len(ours)), [0, row])  # the world's subtree weighs the object
            untouched = getattr(oracle, name)[others].reshape(ours[others].shape)
            np.testing.assert_allclose(ours[others], untouched, rtol=SINGLE, err_msg=name)
    assert np.ptp(sim.scene.model.body_mass.numpy()[:, program.object_body]) > 0.02


def test_every_object_weighs_the_same_in_version_0():
    sim = simulation("myoHandObjHoldRandom-v0")
    assert sim.scene.model.body_mass.shape[0] == 1
    assert sim.scene.oracle.body("object").mass == pytest.approx(0.1130973, rel=1e-6)
    assert sim.scene.oracle.body("object").inertia == pytest.approx(1e-4)
    assert np.ptp(sim.shards[0].program.object_size.numpy(), axis=0).min() > 0.005


def overlap(model, data, program, world):
    """Return how deep the object, put at its goal, is in the open hand [m]."""
    geom = model.geom("object").id
    model.geom_size[geom] = size = program.object_size.numpy()[world]
    model.geom_rbound[geom], model.geom_aabb[geom, 3:] = size.max(), size
    data.qpos[-7:-4] = program.goal.numpy()[world]
    mujoco.mj_fwdPosition(model, data)
    touching = (data.contact.geom == geom).any(axis=1)
    return -data.contact.dist[touching].min(initial=0.0)


@pytest.mark.parametrize(("version", "low", "high"), [(0, 0.4, 0.6), (1, 0.0, 0.03)])
def test_goals_leave_room_for_the_hand(version, low, high):
    sim = simulation(f"myoHandObjHoldRandom-v{version}", NUM_GOALS)
    model = sim.scene.oracle
    data = mujoco.MjData(model)
    data.qpos[:] = sim.scene.spec.start(model)
    deep = [overlap(model, data, sim.shards[0].program, world) > OVERLAP for world in range(NUM_GOALS)]
    assert low <= np.mean(deep) <= high


def test_mocap_target_touches_like_a_static_body():
    """MuJoCo C, target turned and put where it meets pen and hand: same contacts, same accelerations."""
    spec = full_spec(TASKS["myoHandPenTwirlRandom-v0"])
    moved = spec.copy().compile()
    spec.body("target").mocap = False
    static = spec.compile()
    body, geom, rng, met = static.body("target").id, static.geom("target").id, np.random.default_rng(0), 0
    for _ in range(NUM_STATES):
        pos, quat = np.array([-0.23, -0.53, 1.42]) + rng.normal(scale=0.01, size=3), rng.normal(size=4)
        quat /= np.linalg.norm(quat)
        qpos, qvel = rng.uniform(-0.1, 0.1, static.nq), rng.normal(size=static.nv)
        qpos[0] = -1.5
        static.body_pos[body], static.body_quat[body] = pos, quat
        both = [mujoco.MjData(model) for model in (moved, static)]
        both[0].mocap_pos[0], both[0].mocap_quat[0] = pos, quat
        for model, data in zip((moved, static), both, strict=True):
            data.qpos[:], data.qvel[:] = qpos, qvel
            mujoco.mj_forward(model, data)
        np.testing.assert_array_equal(both[0].contact.geom, both[1].contact.geom)
        np.testing.assert_array_equal(both[0].qacc, both[1].qacc)
        met += int((both[1].contact.geom == geom).any())
    assert met > NUM_STATES / 2


@pytest.mark.parametrize("version", [0, 1])
def test_pen_is_the_same_pen(version):
    """Both versions start from one place and weigh the same; version 1 has its true inertia."""
    sim = simulation(f"myoHandPenTwirlFixed-v{version}")
    pen = sim.scene.oracle.body("Object")
    assert pen.mass == pytest.approx(0.1820379, rel=1e-6)
    # About the long axis: m r^2 / 2 of shaft, cap, end (1.55, 0.52, 0.02), and the clip (0.14), 1e-5 kg m^2.
    assert pen.inertia[2] == pytest.approx(1e-4 if version == 0 else 2.23e-5, rel=0.01)
    columns = {column.name: column.size for column in sim.columns}
    first = np.cumsum([0, *columns.values()])[list(columns).index("obj_pos")]
    np.testing.assert_allclose(sim.transition.obs.numpy()[0, first : first + 3], (-0.23, -0.53, 1.445))
    axis = sim.transition.obs.numpy()[0, first + 9 : first + 12]
    np.testing.assert_allclose(axis, (np.sin(1.27), 0.0, np.cos(1.27)), atol=1e-6)


def test_rates_of_the_free_pen_are_those_of_the_world():
    """obj_vel of version 1 against the displacement and the turn of the pen over a short time."""
    sim = simulation("myoHandPenTwirlRandom-v1")
    data, spec, body = sim.scene.data, sim.scene.spec, sim.shards[0].program.object_body
    rng = np.random.default_rng(0)
    data.qpos.assign(np.tile(spec.start(sim.scene.oracle), (NUM_WORLDS, 1)))
    qvel = np.zeros((NUM_WORLDS, sim.scene.oracle.nv))
    qvel[:, -6:] = rng.normal(size=(NUM_WORLDS, 6))
    quat = rng.normal(size=(NUM_WORLDS, 4))
    qpos = data.qpos.numpy().astype(float)
    qpos[:, -4:] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    data.qpos.assign(qpos)
    data.qvel.assign(qvel)
    engine_alone(mjw.kinematics)(sim.scene.model, data)
    sim.shards[0].program.observe(wp.ones(NUM_WORLDS, dtype=bool), sim.transition.obs)
    rates = sim.transition.obs.numpy()[:, 26:32] / spec.control_dt
    moving = mujoco.MjData(sim.scene.oracle)
    for world in range(NUM_WORLDS):
        moving.qpos[:], moving.qvel[:] = qpos[world], qvel[world]
        mujoco.mj_forward(sim.scene.oracle, moving)
        expected = np.zeros(6)
        mujoco.mj_objectVelocity(sim.scene.oracle, moving, mujoco.mjtObj.mjOBJ_XBODY, body, expected, 0)
        np.testing.assert_allclose(rates[world], [*expected[3:], *expected[:3]], atol=1e-5)
