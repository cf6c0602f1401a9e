"""The policy "muscle-control" beside MuJoCo C, and the postures that it was written for."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from myowarp.apps.policies import muscle_control
from myowarp.apps.policies.find import acting, find_policy
from myowarp.apps.policies.muscle_control import MuscleControl
from myowarp.apps.rollouts.episodes import Episodes
from myowarp.apps.rollouts.run import run
from myowarp.definitions.task import TASKS
from myowarp.models.conditions.sarcopenia import Sarcopenia
from myowarp.osim.bundle.couplings import jacobian
from myowarp.sim.build import full_model
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state, set_state
from myowarp.tasks.from_file import pose_task

ELBOW, FINGER = "myoElbowPose1D6MRandom-v0", "myoFingerPoseRandom-v0"
EXAMPLE = Path(__file__).parents[2] / "examples/hand_pose.sto"
HANDS = ("myoHandPoseFixed-v0", "myoHandPoseFixed-v1")


def moving(task, steps, **fields):
    """Return worlds on their way under random actions."""
    sim = Simulation(TASKS[task], 8, device="cpu", progress=False, **fields)
    sim.reset(seeds=np.arange(8))
    rng = np.random.default_rng(0)
    for _ in range(steps):
        sim.action.assign(rng.uniform(-1.0, 0.2, sim.action.shape).astype(np.float32))
        sim.step()
    return sim


@pytest.mark.parametrize("task", [ELBOW, FINGER])
def test_its_activations_give_the_wanted_accelerations_in_mujoco_c(task):
    """M v. = M (v' - v) / T_v + D (v' - v) without contacts and limits, where no activation is at a bound."""
    sim = moving(task, 5)
    control = MuscleControl(sim)
    control(sim.transition.obs.numpy())
    found = control.problems.x.numpy()
    model = full_model(sim.scene.spec)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, checked = mujoco.MjData(model), 0
    mass = np.zeros((model.nv, model.nv))
    for world, activation in enumerate(found):
        if (activation > 0.92).any():
            continue
        data.qpos[:], data.qvel[:] = (getattr(sim.scene.data, n).numpy()[world] for n in ("qpos", "qvel"))
        data.act[:] = activation
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        way = sim.shards[0].program.goal_pose(world) - data.qpos
        wanted = np.clip(way / muscle_control.REACH, -muscle_control.MOST_SPEED, muscle_control.MOST_SPEED)
        change = wanted - data.qvel
        expected = change / muscle_control.REACTION + np.linalg.solve(mass, model.dof_damping * change)
        missed = np.linalg.solve(mass, control_residual(control, world))
        np.testing.assert_allclose(
            data.qacc, expected + missed, rtol=2e-3, atol=0.02 * np.abs(expected).max()
        )
        checked += 1
    assert checked >= 3


def control_residual(control, world):
    """Return the torque that the bounds leave missing [N m]: R F a - tau of the weighted problem."""
    problems = control.problems
    matrix, right = problems.matrix.numpy()[world], problems.right.numpy()[world]
    damping = control.model.dof_damping.clip(muscle_control.LEAST_DAMPING)
    return (matrix @ problems.x.numpy()[world] - right) * damping


@pytest.mark.parametrize("physics", ["parity", "fast"])
@pytest.mark.parametrize("task", HANDS)
def test_it_brings_the_open_hand_to_its_posture(task, physics):
    """The paper's easy posture, which the straight way misses by 0.86 rad (solved: 0.7)."""
    assert success(task, physics) == 1.0


def test_the_straight_way_ends_elsewhere(monkeypatch):
    monkeypatch.setattr(muscle_control, "APPROACH", 0.0)
    assert success(HANDS[0], "parity") == 0.0


def success(task, physics):
    """Return the share of episodes with more than 5 solved steps."""
    sim = Simulation(TASKS[task], 2, device="cpu", physics=physics, progress=False)
    episodes = Episodes(sim.num_worlds)
    run(sim, acting(find_policy("muscle-control", TASKS[task]), sim), sim.horizon, episodes)
    return float(episodes.arrays()["success"].mean())


ARM = "myoArmReachRandom-v0"


def test_its_way_leads_the_tip_to_its_target_in_mujoco_c():
    """A small part of it brings the tip straight towards the target, by that part of the distance.

    Where no limit is in the way, that is: joints have none here.
    """
    sim = moving(ARM, 5)
    control, model = MuscleControl(sim), full_model(sim.scene.spec)
    control.model = control.model.__copy__()
    control.model.jnt_limited[:] = 0
    data, share = mujoco.MjData(model), 1e-5
    sites = [model.site(name).id for name in sim.scene.spec.tips]
    control(sim.transition.obs.numpy())
    for world, qpos in enumerate(sim.scene.data.qpos.numpy().astype(float)):
        data.qpos[:] = control.data.qpos[:] = qpos
        mujoco.mj_fwdPosition(control.model, control.data)
        leads, slopes, _ = jacobian(control.model, control.ties, qpos)
        mujoco.mj_fwdPosition(model, data)
        before = data.site_xpos[sites].copy()
        mujoco.mj_integratePos(model, data.qpos, slopes @ control.way(world, leads, slopes), share)
        mujoco.mj_fwdPosition(model, data)
        target = np.array(list(sim.shards[0].program.goal_markers(world).values()))
        way, moved = target - before, (data.site_xpos[sites] - before) / share
        np.testing.assert_allclose(moved, way, atol=0.05 * np.linalg.norm(way))


def test_its_way_keeps_within_the_limits_of_joints():
    """What would leave its range goes to its limit."""
    sim = moving(ARM, 5)
    control, limited = MuscleControl(sim), 0
    model, data = control.model, control.data
    for world, qpos in enumerate(sim.scene.data.qpos.numpy().astype(float)):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        leads, slopes, _ = jacobian(model, control.ties, qpos)
        joints = model.dof_jntid[leads]
        low, high = model.jnt_range[joints].T - qpos[model.jnt_qposadr[joints]]
        way = control.way(world, leads, slopes)
        inside = (low <= 0.0) & (high >= 0.0)
        assert ((way >= low - 1e-9) & (way <= high + 1e-9))[inside].all()
        limited += np.count_nonzero((way == low) | (way == high))
    assert limited > 0


def test_it_brings_the_arm_to_its_point():
    assert success("myoArmReachFixed-v0", "parity") == 1.0


def test_weak_muscles_are_asked_for_more():
    """Half the active force and as much passive force: twice the activation for the same torque."""
    whole = moving(ELBOW, 3)
    weak = moving(ELBOW, 3, conditions=(Sarcopenia(0.5),))
    set_state(weak, get_state(whole), conditions=False)
    found = []
    for sim in (whole, weak):
        control = MuscleControl(sim)
        control(sim.transition.obs.numpy())
        found.append(control.problems.x.numpy())
    inside = (found[0] > 0.02) & (found[1] < 0.9)
    assert inside.sum() > 3
    np.testing.assert_allclose((found[1] / found[0])[inside], 2.0, rtol=0.05)


def test_shards_do_not_show():
    actions = []
    for shards in (1, 2):
        sim = moving(FINGER, 3, shards=shards)
        actions.append(MuscleControl(sim)(sim.transition.obs.numpy()))
    np.testing.assert_array_equal(*actions)


FOLLOWING = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="a" type="hinge" axis="0 1 0" range="-1 1" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.5"/>
      <site name="a1" pos="0.05 0 0.03"/><site name="a2" pos="0.05 0 -0.03"/>
      <body pos="0.2 0 0">
        <joint name="b" type="hinge" axis="0 1 0" range="-1 1" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.02" mass="0.2"/>
      </body>
    </body>
    <site name="o1" pos="-0.1 0 0.03"/><site name="o2" pos="-0.1 0 -0.03"/>
  </worldbody>
  <tendon>
    <spatial name="up"><site site="o1"/><site site="a1"/></spatial>
    <spatial name="down"><site site="o2"/><site site="a2"/></spatial>
  </tendon>
  <actuator>
    <muscle name="up" tendon="up" force="300" lengthrange="0.1 0.2"/>
    <muscle name="down" tendon="down" force="300" lengthrange="0.1 0.2"/>
  </actuator>
  <equality><joint joint1="b" joint2="a" polycoef="0 0.5 0 0 0"/></equality>
</mujoco>
"""


def test_joints_that_follow_move_with_those_that_lead(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(FOLLOWING)
    sim = Simulation(pose_task(file), 4, device="cpu", progress=False)
    sim.reset(seeds=np.arange(4))
    control = MuscleControl(sim)
    control.goal = np.tile((0.2, 0.1), (4, 1))
    for _ in range(80):
        sim.action.assign(control(sim.transition.obs.numpy()))
        sim.step()
    np.testing.assert_allclose(sim.scene.data.qpos.numpy(), control.goal, atol=0.02)


@pytest.mark.parametrize(
    ("task", "sentence"),
    [
        ("motorFingerPoseFixed-v0", "policy 'muscle-control' drives muscles; the body of task"),
        ("myoHandKeyTurnFixed-v0", "policy 'muscle-control' follows errors of joints or tips, which task"),
        ("myoLegStandRandom-v0", "policy 'muscle-control' moves limbs of a fixed body, not that of task"),
    ],
)
def test_where_it_cannot_act_it_says_so(task, sentence):
    sim = Simulation(TASKS[task], 1, device="cpu", graph=False, progress=False)
    with pytest.raises(ValueError, match=f"^{sentence}"):
        MuscleControl(sim)


@pytest.mark.parametrize("physics", ["parity", "fast"])
def test_excitations_open_loop_hold_the_fixed_pose(physics):
    """By way of a fist; the straight way from the open hand ends in another equilibrium, at 0.87 rad."""
    task = TASKS["myoHandPoseFixed-v0"]
    sim = Simulation(task, 1, physics=physics, device="cpu", progress=False, autoreset="disabled")
    episodes = Episodes(1)
    run(sim, acting(find_policy(str(EXAMPLE), task), sim), sim.horizon, episodes)
    assert episodes.arrays()["success"].tolist() == [True]
