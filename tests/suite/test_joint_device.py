"""Devices at joints: torque against MuJoCo C and NumPy, delay, order of actuators, errors."""

import gymnasium
import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
from configurations import configurations
from elbows import KEY, NUM_WORLDS, States, in_c, worn
from stepping import engine_alone

from myowarp.definitions.condition import resolve
from myowarp.definitions.task import TASKS
from myowarp.models.conditions.exoskeleton import Exoskeleton
from myowarp.models.conditions.joint_device import JointDevice
from myowarp.sim.patient import Patient, every_condition
from myowarp.sim.simulation import Simulation

HAND = "myoHandPoseRandom-v1"
WRIST = "flexion_r"
JOINT = "r_elbow_flex"

TORQUE = 2e-5
"""Of the largest torque; the engine's float32 forces and moment arms, measured 5e-6."""

ROUNDING = 1e-6  # of a number of order one, a few float32 operations


def test_a_spring_with_a_limit_is_that_of_mujoco_c():
    """Each world its own stiffness; a third of the torques are clipped."""
    stiffness, rest, limit = np.linspace(0.0, 20.0, NUM_WORLDS), 1.0, 8.0
    states = States()
    wanted = -stiffness * (states.qpos[:, 0] - rest)
    torque = np.clip(wanted, -limit, limit)
    assert 0.1 < (torque != wanted).mean() < 0.9
    rows = in_c(worn(num_worlds=1).scene.oracle, states, mujoco.mj_forward, torque=torque)
    expected = np.array([data.qacc for data in rows])
    sim = worn(JointDevice(JOINT, stiffness, rest=rest, limit=limit))
    data = states.put(sim)
    engine_alone(mjw.forward)(sim.scene.model, data)
    assert np.abs(data.qacc.numpy() - expected).max() <= TORQUE * np.abs(expected).max()
    shown = sim.shards[0].effects[0].torque.numpy()
    np.testing.assert_allclose(shown, torque, rtol=0, atol=ROUNDING * limit)


@pytest.mark.parametrize(
    ("key", "joint"),
    [
        (HAND, WRIST),
        ("myoArmReachFixed-v0", "elbow_flexion_r"),
        ("myoLegWalk-v0", "knee_angle_l"),
        ("myoLegWalk-v0", "ankle_angle_r"),
        ("myoTorsoPoseFixed-v0", "flex_extension"),
    ],
)
def test_assistance_at_one_of_many_joints(key, joint):
    """A share of MuJoCo C's torque of all muscles at that joint, and none at others."""
    n, share = 16, 0.4
    options = {"device": "cpu", "graph": False, "progress": False}
    device = JointDevice(joint, 0.0, assistance=share, limit=1000.0)  # N m
    sim = Simulation(TASKS[key], n, conditions=device, **options)
    scene = Simulation(TASKS[key], 1, **options).scene
    model = scene.oracle
    qpos = np.float32(configurations(model, scene.qpos_start.numpy(), n, seed=0))
    act = np.float32(np.random.default_rng(0).uniform(size=(n, model.na)))
    dof = int(model.joint(joint).dofadr[0])
    expected = np.zeros((n, model.nv))
    for world in range(n):
        data = mujoco.MjData(model)
        data.qpos[:], data.act[:] = qpos[world], act[world]
        mujoco.mj_forward(model, data)
        expected[world] = data.qfrc_actuator
    expected[:, dof] *= 1.0 + share
    sim.shards[0].launch_conditions()
    sim.scene.data.qpos.assign(qpos)
    sim.scene.data.qvel.zero_()  # legs start to walk
    sim.scene.muscles.activation.assign(act)
    engine_alone(mjw.forward)(sim.scene.model, sim.scene.data)
    found = sim.scene.data.qfrc_actuator.numpy()
    scale = np.abs(expected[:, dof]).max()
    assert scale > 1.0  # N m
    np.testing.assert_allclose(found[:, dof], expected[:, dof], rtol=0, atol=10 * TORQUE * scale)
    rest = np.arange(model.nv) != dof
    np.testing.assert_allclose(found[:, rest], expected[:, rest], rtol=0, atol=10 * TORQUE * scale)


def torques_of(device, steps, num_worlds=2, action=None):
    """Return the torques that an environment shows after each step, shape (steps, num_worlds)."""
    env = gymnasium.make_vec(
        f"MyoWarp/{KEY}", num_envs=num_worlds, device="cpu", conditions=device, progress=False
    )
    env.reset(seed=0)
    rows = []
    for step in range(steps):
        actions = np.full((num_worlds, env.single_action_space.shape[0]), -1.0, dtype=np.float32)
        if action is not None:
            actions[:, -1] = action[step]
        name = "brace_device_torque" if not device.joint else f"{device.joint}_device_torque"
        rows.append(env.step(actions)[-1][name].copy())
    dt = env.unwrapped.sim.scene.control_dt
    env.close()
    return np.array(rows), dt


@pytest.mark.parametrize("delay_steps", [0, 3])
def test_profile_over_time(delay_steps):
    """Straight lines, again after each period; with a delay the same later, and nothing before."""
    dt = torques_of(JointDevice(), 1)[1]
    profile, period = ((0.0, 0.0), (2.5 * dt, 1.0), (6 * dt, -0.5)), 8 * dt
    peaks = np.array([1.0, -3.0])
    device = JointDevice(
        JOINT,
        0.0,
        peak=peaks,
        profile=profile,
        period=period,
        delay=(delay_steps - 0.5 * (delay_steps > 0)) * dt,
    )
    found = torques_of(device, 30)[0]
    time = dt * (np.arange(30) - delay_steps)
    shares = np.interp(time % period, *zip(*profile, strict=True)) * (time > -0.5 * dt)
    edge = np.isclose(time % period, 0.0, atol=1e-6) | np.isclose(time % period, period, atol=1e-6)
    np.testing.assert_allclose(found[~edge], (shares[:, None] * peaks)[~edge], atol=1e-4)
    assert np.abs(shares[~edge]).max() > 0.7
    assert edge.sum() < 6


def test_a_commanded_motor_comes_before_devices_that_are_not():
    """The last action commands it, a step later, limited; beside an exoskeleton that follows muscles."""
    motor = JointDevice(JOINT, 0.0, motor=True, limit=4.0, delay=1e-3)
    action = np.array([0.5, -1.0, 2.0, 0.0], dtype=np.float32)
    found = torques_of(motor, 4, action=action)[0]
    expected = 4.0 * np.clip([0.0, *action[:-1]], -1.0, 1.0)
    np.testing.assert_allclose(found[:, 0], expected, atol=4.0 * ROUNDING)
    sim = worn((Exoskeleton(), motor), 2)
    names = [sim.scene.oracle.actuator(i).name for i in range(sim.scene.oracle.nu)]
    assert names[-2:] == [f"device_{JOINT}", "exoskeleton"]
    assert sim.action.shape[1] == 7


def test_two_devices_at_two_joints_weigh_their_own():
    options = {"device": "cpu", "graph": False, "progress": False}
    worn_twice = (JointDevice(WRIST, 1.0, mass=0.2), JointDevice("pro_sup_r", 1.0, mass=0.3))
    sim = Simulation(TASKS[HAND], 2, conditions=worn_twice, adjustable=True, **options)
    knobs, patient = Patient(sim).knobs, Patient(sim)
    springs = [knobs[f"joint_device stiffness of {name}"] for name in (WRIST, "pro_sup_r")]
    patient.set(springs[0], 7.0, [0])
    assert [patient.value(spring, world) for spring in springs for world in (0, 1)] == [7.0, 1.0, 1.0, 1.0]
    sim.shards[0].launch_conditions()
    masses = sim.scene.model.body_mass.numpy()
    for name, mass in ((WRIST, 0.2), ("pro_sup_r", 0.3)):
        body = sim.scene.oracle.body(f"device_{name}").id
        np.testing.assert_allclose(masses[:, body], mass, rtol=ROUNDING)
        limb = sim.scene.oracle.joint(name).bodyid[0]
        assert sim.scene.oracle.body_parentid[body] == limb
    both = "conditions 'joint_device' and 'joint_device' both set the torque of a device at flexion_r"
    with pytest.raises(ValueError, match=f"^{both}; leave one out$"):
        resolve((JointDevice(WRIST), JointDevice(WRIST, 2.0)), TASKS[HAND])


def test_legs_can_wear_devices_at_hips_knees_and_ankles():
    """A page offers them; each is at the joint of its side, and nothing is worn twice."""
    worn = [kind for kind in every_condition(TASKS["myoLegWalk-v0"]) if isinstance(kind, JointDevice)]
    joints = [kind.joint for kind in worn]
    both = [f"{j}_{side}" for j in ("ankle_angle", "hip_flexion", "knee_angle") for side in "lr"]
    assert sorted(joints) == both
    assert all(kind.stiffness == kind.assistance == kind.peak == kind.mass == 0.0 for kind in worn)
    chosen = JointDevice("ankle_angle_r", 30.0)
    given = every_condition(TASKS["myoLegWalk-v0"], [chosen])
    assert [kind for kind in given if isinstance(kind, JointDevice)] == [chosen]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"joint": "ankle"}, "body 'elbow': joint_device joint 'ankle' unknown; available: r_elbow_flex"),
        ({"joint": 3}, "joint_device joint must be the name of a joint, got 3"),
        ({"stiffness": -1.0}, "joint_device stiffness must be >= 0, got -1"),
        ({"assistance": np.ones(3)}, "joint_device assistance must be one number or of shape .*"),
        ({"rest": np.nan}, "joint_device rest must be a finite number, got nan"),
        (
            {"assistance": 40},
            "joint_device assistance must be at most 4 times the muscles' torque, got 40; for 40 % write 0.4",
        ),
        (
            {"rest": 90},
            f"joint_device rest must be near the range of {JOINT}, 0 to 2.27 rad, got 90; "
            "for 90 degrees write 1.57",
        ),
        ({"delay": -0.1}, "joint_device delay must be a finite number >= 0, got -0.1"),
        ({"delay": 60}, "joint_device delay must be at most 10 s, got 60"),
        ({"limit": 0.0}, "joint_device limit must be above 0, got 0; leave a device out that does nothing"),
        ({"profile": 1.0}, r"joint_device profile must be pairs \(time, share of the peak\), got 1.0"),
        (
            {"profile": ((0.1, 1.0), (0.1, 2.0))},
            r"joint_device profile needs rising times >= 0 s, got \[0.1, 0.1\]",
        ),
        (
            {"profile": ((0.0, 1.0), (2.0, 1.0)), "period": 1.0},
            "joint_device period must be 0 or at least the last time of the profile, 2 s, got 1.0",
        ),
        ({"place": (0.0, 1.0)}, r"joint_device place must be three finite numbers, got \(0.0, 1.0\)"),
        ({"mass": -1.0}, "joint_device mass must be in 0..100, got -1"),
    ],
)
def test_bad_input(options, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        worn(JointDevice(**options), 2)


def test_a_body_without_a_brace_needs_a_joint():
    message = "^body 'hand' cannot have a joint_device without a joint named; bodies that can: elbow$"
    with pytest.raises(ValueError, match=message):
        resolve("joint_device", TASKS[HAND])
