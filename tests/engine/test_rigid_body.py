"""Kinematics, inertia, bias and passive forces in one launch, against MuJoCo C in float64."""

import copy
from types import SimpleNamespace

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from stepping import forward

from myowarp.definitions.task import TASKS
from myowarp.engine.stages.rigid_body import RigidBody
from myowarp.sim.simulation import Simulation

NUM_WORLDS = 8
ROUNDING = 5e-6  # of the largest entry of a field; float32
POSES = ("xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat")
MOTIONS = ("subtree_com", "cinert", "crb", "cdof", "cdof_dot", "cvel", "M")
FORCES = ("qfrc_bias", "qfrc_spring", "qfrc_damper", "qfrc_passive")
TREES = """
<mujoco>
  <option {option}><flag contact="disable"/></option>
  <worldbody>
    <geom pos="1 2 3" size=".1"/>
    <body mocap="true" pos=".1 .2 .3" quat="1 2 0 0"><geom size=".1" contype="0" conaffinity="0"/>
      <body pos="0 0 .3"><geom size=".1 .2" type="capsule" euler="10 20 30"/></body>
    </body>
    <body pos="0 1 0" euler="20 30 40">
      <freejoint/><geom size=".1 .2 .3" type="ellipsoid" pos=".1 0 .1" euler="0 40 50"/>
      <body pos=".2 .1 0"><joint type="ball" pos=".05 0 0" damping=".3"/><geom size=".05 .2" type="capsule"/>
        <body pos="0 .1 .2" euler="50 0 10">
          <joint axis="1 1 0" pos="0 .02 0" springref="20" stiffness="2 3 4" damping=".2 .1 .3"
                 armature=".1"/>
          <joint axis="0 1 1" type="slide" stiffness="5" damping=".4" ref=".1"/>
          <joint axis="0 0 1" pos=".03 0 0" ref="15"/>
          <geom size=".04 .1" type="capsule" pos=".1 0 0" euler="0 30 0"/>
          <site name="tip" pos=".1 .1 .1" euler="5 6 7"/>
        </body>
        <body pos="0 -.1 .2"><joint axis="0 1 0"/><geom size=".04 .1" type="capsule" euler="0 30 0"/></body>
      </body>
    </body>
    <body pos="0 -1 0"><joint axis="0 1 0" limited="true" range="-1 1"/><geom size=".1" pos=".2 0 0"/>
      <site name="other"/>
    </body>
  </worldbody>
  <tendon><spatial {tendon}><site site="tip"/><site site="other"/></spatial></tendon>
</mujoco>
"""
MODELS = {
    "gravity": {"option": 'gravity="1 2 -9"', "tendon": ""},
    "other forces": {"option": 'wind="1 2 3" density="5"', "tendon": 'stiffness="3" damping=".5"'},
}


def stepping(model, num_worlds):
    """Return what a stage needs of a scene."""
    engine = mjw.put_model(model)
    data = mjw.make_data(model, nworld=num_worlds, nconmax=16, njmax=40)
    sites = (model.site("tip").id,)
    return SimpleNamespace(oracle=model, model=engine, data=data, sites=sites, device=wp.get_device("cpu"))


def random_states(model, seed=0):
    """Return MuJoCo C's data of random states, with moved mocap bodies."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(NUM_WORLDS):
        data = mujoco.MjData(model)
        data.qpos[:] += rng.normal(size=model.nq)
        data.qvel[:] = rng.normal(size=model.nv)
        data.mocap_pos[:] += rng.normal(size=data.mocap_pos.shape)
        data.mocap_quat[:] += rng.normal(size=data.mocap_quat.shape)
        found.append(data)
    return found


def given(scene, states):
    """Have the states in the scene's worlds."""
    for name in ("qpos", "qvel", "mocap_pos", "mocap_quat"):
        getattr(scene.data, name).assign(np.array([getattr(data, name) for data in states]))


def filled_with_nan(data, names):
    for name in names:
        getattr(data, name).fill_(np.nan)


def error(field, expected):
    """Return the largest difference, as a share of the largest entry."""
    expected = np.array(expected, dtype=float)
    assert np.abs(expected).max() > 0.1
    return np.abs(field.numpy().reshape(expected.shape) - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("name", MODELS)
def test_every_field_is_that_of_mujoco(name):
    model = mujoco.MjModel.from_xml_string(TREES.format(**MODELS[name]))
    states = random_states(model)
    with wp.ScopedDevice("cpu"):
        scene = stepping(model, NUM_WORLDS)
        assert RigidBody.obstacle(scene) is None
        given(scene, states)
        filled_with_nan(scene.data, (*MOTIONS[:1], *MOTIONS[3:], "qfrc_bias", "qfrc_passive", "site_xpos"))
        forward(scene, [RigidBody(scene)])
    for data in states:
        # MuJoCo normalises in place what the engine leaves as it is.
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
    for field in (*POSES, "site_xpos", "site_xmat", *MOTIONS, *FORCES):
        expected = [getattr(data, field) for data in states]
        assert error(getattr(scene.data, field), expected) <= ROUNDING, field


def test_worlds_have_their_own_bodies():
    """Masses, springs and gravity of world 3 are its own, and show in that world alone."""
    model = mujoco.MjModel.from_xml_string(TREES.format(**MODELS["gravity"]))
    changed = {
        "body_mass": 2.0,
        "body_pos": 1.5,
        "jnt_stiffness": 3.0,
        "dof_damping": 2.0,
        "dof_armature": 5.0,
    }
    states = random_states(model, seed=1)
    with wp.ScopedDevice("cpu"):
        scene = stepping(model, NUM_WORLDS)
        given(scene, states)
        for name, factor in changed.items():
            values = np.repeat(getattr(scene.model, name).numpy(), NUM_WORLDS, axis=0)
            values[3] *= factor
            setattr(scene.model, name, wp.array(values, dtype=getattr(scene.model, name).dtype))
        subtree = np.repeat(scene.model.body_subtreemass.numpy(), NUM_WORLDS, axis=0)
        subtree[3] *= changed["body_mass"]
        scene.model.body_subtreemass = wp.array(subtree, dtype=float)
        gravity = np.tile(model.opt.gravity, (NUM_WORLDS, 1))
        gravity[3] *= -1.0
        scene.model.opt.gravity = wp.array(gravity, dtype=wp.vec3)
        forward(scene, [RigidBody(scene)])
    other = mujoco.MjModel.from_xml_string(TREES.format(**MODELS["gravity"]))
    for name, factor in changed.items():
        getattr(other, name)[:] *= factor
    other.body_subtreemass[:] *= changed["body_mass"]
    other.opt.gravity[:] *= -1.0
    for world, data in enumerate(states):
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_fwdPosition(other if world == 3 else model, data)
        mujoco.mj_fwdVelocity(other if world == 3 else model, data)
    for field in ("xpos", "M", "qfrc_bias", "qfrc_passive"):
        assert error(getattr(scene.data, field), [getattr(data, field) for data in states]) <= ROUNDING, field


@pytest.mark.parametrize("num_worlds", [2, 17, 35])
def test_bits_of_a_world_depend_on_no_other(num_worlds):
    """Worlds with bodies of their own: the same bits in lanes, in blocks that are not full, and alone."""
    model = mujoco.MjModel.from_xml_string(TREES.format(**MODELS["gravity"]))
    states = (5 * random_states(model, seed=3))[:num_worlds]
    for world, data in enumerate(states):
        states[world] = data = copy.copy(data)
        data.qpos[:] += 0.01 * world
    factors = np.random.default_rng(4).uniform(0.5, 2.0, num_worlds)
    fields = ("site_xpos", *POSES, *MOTIONS, *FORCES)

    def moved(worlds):
        with wp.ScopedDevice("cpu"):
            scene = stepping(model, len(worlds))
            given(scene, [states[world] for world in worlds])
            for name in ("body_mass", "body_pos", "jnt_stiffness", "dof_damping"):
                values = np.repeat(getattr(scene.model, name).numpy(), len(worlds), axis=0)
                scale = factors[worlds].astype(np.float32).reshape((-1,) + (1,) * (values.ndim - 1))
                setattr(scene.model, name, wp.array(values * scale, dtype=getattr(scene.model, name).dtype))
            RigidBody(scene).launch(scene.model, scene.data)
            return {name: getattr(scene.data, name).numpy() for name in fields}

    together = moved(np.arange(num_worlds))
    order = np.random.default_rng(5).permutation(num_worlds)
    shuffled = moved(order)
    alone = [moved(np.array([world])) for world in range(num_worlds)]
    for name in fields:
        assert np.ptp(together[name], axis=0).max() > 100 * ROUNDING, name
        np.testing.assert_array_equal(shuffled[name], together[name][order], err_msg=name)
        np.testing.assert_array_equal(
            np.concatenate([one[name] for one in alone]), together[name], err_msg=name
        )


def test_poses_alone():
    """Outside a step: only bodies, in the worlds of a mask, and the sites that the task reads."""
    model = mujoco.MjModel.from_xml_string(TREES.format(**MODELS["gravity"]))
    states = random_states(model, seed=2)
    with wp.ScopedDevice("cpu"):
        scene = stepping(model, NUM_WORLDS)
        given(scene, states)
        filled_with_nan(scene.data, ("site_xpos", "geom_xpos", "M"))
        mask = np.arange(NUM_WORLDS) != 2
        stage = RigidBody(scene)
        before = scene.data.xpos.numpy()[2].copy()
        stage.refresh(scene.model, scene.data, wp.array(mask, dtype=bool))
        np.testing.assert_array_equal(scene.data.xpos.numpy()[2], before)
        assert np.isnan(scene.data.site_xpos.numpy()[2]).all()
        stage.refresh(scene.model, scene.data, wp.array(~mask, dtype=bool))
    for data in states:
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_kinematics(model, data)
    for field in ("xpos", "xquat", "xmat"):
        assert error(getattr(scene.data, field), [getattr(data, field) for data in states]) <= ROUNDING, field
    tip, other = model.site("tip").id, model.site("other").id
    sites = scene.data.site_xpos.numpy()
    np.testing.assert_allclose(sites[:, tip], [data.site_xpos[tip] for data in states], atol=1e-5)
    assert np.isnan(sites[:, other]).all()
    assert np.isnan(scene.data.M.numpy()).all()
    assert np.isnan(scene.data.geom_xpos.numpy()).all()


@pytest.mark.parametrize("key", ["myoHandPoseRandom-v0", "myoHandKeyTurnRandom-v0"])
def test_a_control_step_leaves_what_its_last_physics_step_found(key, monkeypatch):
    """All that others read afterwards, as where each physics step writes it; with contacts and without."""
    seen = []
    for all_ours in (True, False):
        monkeypatch.setattr("myowarp.sim.shard.is_ours", lambda *definers, ours=all_ours: ours)
        sim = Simulation(TASKS[key], 9, device="cpu", shards=1, graph=False, progress=False)
        assert (sim.shards[0].physics_step.stepped.remaining is not None) == all_ours
        sim.reset(seeds=np.arange(9))
        sim.action.fill_(0.5)
        sim.step()
        data = sim.shards[0].scene.data
        fields = *POSES, *MOTIONS, *FORCES, "cacc", "cfrc_int", "ten_J", "actuator_moment"
        seen.append({name: getattr(data, name).numpy() for name in fields})
    for name, values in seen[0].items():
        np.testing.assert_array_equal(values, seen[1][name], err_msg=name)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda model: model.jnt_stiffness.__setitem__(1, 1.0), "a ball or free joint has a spring"),
        (lambda model: None, None),
    ],
)
def test_obstacles(change, reason):
    model = mujoco.MjModel.from_xml_string(TREES.format(**MODELS["gravity"]))
    change(model)
    with wp.ScopedDevice("cpu"):
        assert RigidBody.obstacle(stepping(model, 1)) == reason


def test_observations_are_those_of_the_engine():
    """The tips of a reach task after resets and steps, with the stage alone and without any."""
    seen = []
    for stages in ((), ("rigid_body",)):
        sim = Simulation(
            TASKS["myoHandReachRandom-v0"], 3, device="cpu", graph=False, progress=False, stages=stages
        )
        assert len(sim.shards[0].stages) == len(stages)
        sim.reset(seeds=np.arange(3))
        sim.action.fill_(0.5)
        for _ in range(2):
            sim.step()
        seen.append(sim.transition.obs.numpy().copy())
    assert np.abs(seen[0]).max() > 0.1
    np.testing.assert_allclose(seen[1], seen[0], atol=2e-5, rtol=0)
