"""Signals of the muscles against MuJoCo C, the states that they are of, and what they leave alone."""

import mujoco
import numpy as np
import pytest
from configurations import configurations
from reference import mujoco_muscle as reference

from myowarp.definitions.body import BODIES
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.models.bodies.arm_muscles import FATIGUE_RATES, GROUPS
from myowarp.models.conditions.sarcopenia import Sarcopenia
from myowarp.models.conditions.tendon_tear import TendonTear
from myowarp.models.conditions.tendon_transfer import ACTUATOR, TendonTransfer
from myowarp.sim.build import oracle_model
from myowarp.sim.signals import UNITS, Signals
from myowarp.sim.simulation import Simulation

ELBOW, HAND, OBJECT = "myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v1", "myoHandObjHoldRandom-v0"
NUM_WORLDS = 9
NUM_STEPS = 6

LENGTH = 1e-6
"""m; the engine's float32 tendon lengths are off by up to 3e-7."""

VELOCITY = 1e-5
"""m/s, at joint velocities up to 20 rad/s; measured 1.6e-6."""

FORCE = 1e-4
"""Of the muscle's peak; the bound of tests/suite/test_muscles.py, measured 2.5e-5."""

POWER = 1e-5
"""Of the sum of the muscles' powers without their signs; measured 3e-6."""

EFFECT = 10.0
EIP_PEAK = 47.3  # N


def simulation(key, num_worlds=NUM_WORLDS, **options):
    settings = {"device": "cpu", "autoreset": "same_step", "progress": False} | options
    return Simulation(TASKS[key], num_worlds, **settings)


def steps(sim, count=NUM_STEPS):
    """Reset and step with random actions, each world's its own; yields after every step."""
    n = sim.num_worlds
    sim.reset(seeds=np.arange(n))
    for step in range(count):
        draws = [
            np.random.default_rng((world, step)).uniform(-1, 1, sim.action.shape[1]) for world in range(n)
        ]
        sim.action.assign(np.array(draws, dtype=np.float32))
        sim.step()
        yield step


def in_c(sim, signals, strength=None):
    """Return length, velocity, force and power of the muscles in MuJoCo C, in the state that signals show."""
    model, data = sim.scene.oracle, mujoco.MjData(sim.scene.oracle)
    healthy, ids = model.actuator_gainprm.copy(), sim.scene.muscles.actuator_id
    peak = reference.peak_force(model.actuator_acc0[ids], healthy[ids])
    rows = []
    for world in range(sim.num_worlds):
        if strength is not None:
            model.actuator_gainprm[ids, 2] = strength[world] * peak
        data.qpos[:], data.qvel[:] = signals.qpos.numpy()[world], signals.qvel.numpy()[world]
        data.act[:] = signals.muscles.activation.numpy()[world]
        mujoco.mj_forward(model, data)
        row = (data.actuator_length[ids], data.actuator_velocity[ids], -data.actuator_force[ids])
        rows.append((*(part.copy() for part in row), data.qfrc_actuator @ data.qvel))
    model.actuator_gainprm[:] = healthy
    return *(np.array(part) for part in zip(*rows, strict=True)), peak


@pytest.mark.parametrize("physics", PHYSICS)
@pytest.mark.parametrize("key", [ELBOW, HAND, OBJECT, "myoFingerPoseRandom-v0"])
def test_length_velocity_and_force_are_of_one_state(key, physics):
    """MuJoCo C's from the same qpos, qvel and activation; what the step leaves in the data is not."""
    sim = simulation(key, physics=physics)
    signals = Signals(sim)
    bare = simulation(key, physics=physics)
    ids = sim.scene.muscles.actuator_id
    for _ in zip(steps(sim), steps(bare), strict=True):
        length, velocity, force, _, peak = in_c(sim, signals)
        np.testing.assert_allclose(signals.muscles.length.numpy(), length, rtol=0, atol=LENGTH)
        np.testing.assert_allclose(signals.muscles.velocity.numpy(), velocity, rtol=0, atol=VELOCITY)
        assert (np.abs(signals.muscles.force.numpy() - force) / peak).max() < FORCE
        stale = -bare.scene.data.actuator_force.numpy()[:, ids]
        assert (np.abs(stale - force) / peak).max() > EFFECT * FORCE
        assert np.abs(bare.scene.data.actuator_length.numpy()[:, ids] - length).max() > EFFECT * LENGTH


def test_power_is_what_the_joints_receive():
    """Tension times shortening, summed over the muscles, is generalized force times velocity in C."""
    sim = simulation(HAND)
    signals = Signals(sim)
    for _ in steps(sim):
        *_, expected, _ = in_c(sim, signals)
        power = signals.muscles.power.numpy()
        scale = np.abs(power).sum(axis=1)
        assert (np.abs(power.sum(axis=1) - expected) < POWER * scale).all()
        assert (np.abs(expected) > EFFECT * POWER * scale).all()
        force, velocity = signals.muscles.force.numpy(), signals.muscles.velocity.numpy()
        np.testing.assert_array_equal(power > 0, (force > 0) & (velocity < 0))


def test_force_has_the_strength_of_the_world():
    strength = np.linspace(0.2, 1.0, NUM_WORLDS)
    sim = simulation(ELBOW, conditions=Sarcopenia(strength))
    signals = Signals(sim)
    for _ in steps(sim):
        _, _, force, _, peak = in_c(sim, signals, strength)
        assert (np.abs(signals.muscles.force.numpy() - force) / peak).max() < FORCE
        healthy = in_c(sim, signals)[2]
        assert (np.abs(healthy - force)[0] / peak).max() > EFFECT * FORCE


def test_a_transferred_muscle_shows_its_new_path():
    """Length and velocity of the new path, force of fibers fitted to it; what is torn pulls nothing."""
    sim = simulation(HAND, num_worlds=2, conditions=(TendonTransfer([0, 1]), TendonTear("FPL")))
    signals = Signals(sim)
    model, data, names = sim.scene.oracle, mujoco.MjData(sim.scene.oracle), list(signals.names)
    eip, epl, fpl = (names.index(name) for name in ("EIP_r", "EPL_r", "FPL_r"))
    effect = next(effect for effect in sim.shards[0].effects if hasattr(effect, "length_range"))
    own, new = sim.scene.muscles.actuator_id[eip], model.actuator(ACTUATOR).id
    paths = ((own, model.actuator_lengthrange[own]), (new, np.array(effect.length_range)))
    for _ in steps(sim):
        shown = {name: getattr(signals.muscles, name).numpy() for name in UNITS}
        for world, (path, lengthrange) in enumerate(paths):
            data.qpos[:], data.qvel[:] = signals.qpos.numpy()[world], signals.qvel.numpy()[world]
            mujoco.mj_forward(model, data)
            length, velocity = data.actuator_length[path], data.actuator_velocity[path]
            fibers = (lengthrange, model.actuator_acc0[own])
            active = reference.gain(length, velocity, *fibers, model.actuator_gainprm[own])
            force = -shown["activation"][world, eip] * active
            force -= reference.bias(length, *fibers, model.actuator_biasprm[own])
            assert shown["length"][world, eip] == pytest.approx(length, abs=LENGTH)
            assert shown["velocity"][world, eip] == pytest.approx(velocity, abs=VELOCITY)
            assert shown["force"][world, eip] == pytest.approx(force, abs=5 * FORCE * EIP_PEAK)
        assert abs(data.actuator_length[own] - data.actuator_length[new]) > EFFECT * LENGTH
        assert (shown["force"][:, fpl] == 0).all()
        assert (shown["activation"][:, fpl] > 0).all()
        assert (shown["force"][:, epl] > 0).tolist() == [True, False]


def test_excitation_is_what_the_policy_commands():
    sim = simulation(ELBOW)
    signals = Signals(sim)
    for _ in steps(sim):
        expected = 1 / (1 + np.exp(-5 * (sim.action.numpy().astype(float) - 0.5)))
        np.testing.assert_allclose(signals.muscles.excitation.numpy(), expected, atol=1e-6)
        np.testing.assert_array_equal(
            signals.muscles.activation.numpy(), sim.scene.muscles.activation.numpy()
        )


@pytest.mark.parametrize("graph", [True, False])
@pytest.mark.parametrize("key", [ELBOW, OBJECT])
def test_the_trajectory_stays_the_same(key, graph):
    """Bit for bit, resets included."""
    trajectories = []
    for with_signals in (False, True):
        sim = simulation(key, horizon=4, graph=graph)
        if with_signals:
            Signals(sim)
        state = sim.scene.data
        parts = (
            sim.transition.obs,
            sim.transition.terms,
            state.qpos,
            state.qvel,
            sim.scene.muscles.activation,
        )
        rows = [np.concatenate([part.numpy() for part in parts], axis=1) for _ in steps(sim, 7)]
        trajectories.append(np.stack(rows))
    np.testing.assert_array_equal(*trajectories)


def test_signals_are_of_the_state_before_a_reset():
    """In the step that ends an episode both modes show its last state; only one has been reset by then."""
    same, late = simulation(ELBOW, horizon=3), simulation(ELBOW, horizon=3, autoreset="next_step")
    shown, kept = Signals(same), Signals(late)
    for step in zip(steps(same, 3), steps(late, 3), strict=True):
        for array in ("qpos", "qvel", "valid", "step_count", "episode"):
            np.testing.assert_array_equal(getattr(shown, array).numpy(), getattr(kept, array).numpy())
        for name in UNITS:
            np.testing.assert_array_equal(
                getattr(shown.muscles, name).numpy(), getattr(kept.muscles, name).numpy()
            )
        assert (shown.step_count.numpy() == step[0] + 1).all()
        assert (shown.episode.numpy() == 1).all()
    np.testing.assert_array_equal(kept.qpos.numpy(), late.scene.data.qpos.numpy())
    assert np.abs(shown.qpos.numpy() - same.scene.data.qpos.numpy()).max() > 0.1
    assert kept.valid.numpy().all()
    late.step()
    assert not kept.valid.numpy().any()


def test_a_broken_world_is_not_valid():
    sim = simulation(ELBOW, num_worlds=3, graph=False)
    signals = Signals(sim)
    sim.reset(seeds=np.arange(3))
    sim.scene.data.qvel.numpy()[1] = np.nan
    sim.step()
    assert signals.valid.numpy().tolist() == [True, False, True]


def test_joints_are_hinges_and_slides():
    """The held object floats freely: no joint angle."""
    signals = Signals(simulation(OBJECT, num_worlds=2))
    assert len(signals.joint_names) == 23
    assert signals.qpos.shape[1] > 23
    assert signals.joint_angles.shape == signals.joint_velocities.shape == (2, 23)
    model = signals.sim.scene.oracle
    for column, name in enumerate(signals.joint_names):
        np.testing.assert_array_equal(
            signals.joint_angles[:, column], signals.qpos.numpy()[:, model.joint(name).qposadr[0]]
        )


def test_no_muscles_no_signals():
    sim = simulation("motorFingerPoseFixed-v0", num_worlds=1)
    with pytest.raises(
        ValueError,
        match=r"^signals are those of muscles; the body of task 'motorFingerPoseFixed-v0' has none$",
    ):
        Signals(sim)


# Joint about which a group's muscles turn; {} is the finger that the muscle's name ends in.
TURNS = {
    "elbow flexors": ("r_elbow_flex", 1),
    "elbow extensors": ("r_elbow_flex", -1),
    "forearm pronators": ("pro_sup_r", 1),
    "wrist flexors": ("flexion_r", 1),
    "wrist extensors": ("flexion_r", -1),
    "finger flexors": ("pm{}_flexion_r", 1),
    "finger extensors": ("pm{}_flexion_r", -1),
    "thumb flexors": ("ip_flexion_r", 1),
    "thumb extensors": ("mp_flexion_r", -1),
}
FINGER_OF = {"EIP": "2", "EDM": "5"}


@pytest.mark.parametrize("key", [ELBOW, HAND])
def test_groups_do_what_their_names_say(key):
    """Median moment arm over random postures, about the joint that the group's name means."""
    model = oracle_model(TASKS[key])
    data, arms = mujoco.MjData(model), np.zeros((64, model.nu, model.nv))
    for i, qpos in enumerate(configurations(model, model.qpos0, 64, seed=0)):
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        moment = np.zeros((model.nu, model.nv))
        mujoco.mju_sparse2dense(
            moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        arms[i] = -moment
    checked, group_of = 0, BODIES[TASKS[key].body].group_of
    for actuator in range(model.nu):
        name = model.actuator(actuator).name.removesuffix("_r")
        assert group_of(name) == group_of(f"{name}_r") != ""
        if group_of(name) in TURNS:
            joint, sign = TURNS[group_of(name)]
            dof = model.joint(joint.format(FINGER_OF.get(name, name[-1]))).dofadr[0]
            thumb = -1 if "thumb" in group_of(name) else 1  # its axes point the other way
            assert thumb * sign * np.median(arms[:, actuator, dof]) > 1e-3, name
            checked += 1
    assert checked == (6 if key == ELBOW else 25)


def test_every_muscle_of_the_table_has_a_group_and_rates():
    assert set(GROUPS) == set(FATIGUE_RATES)
    assert len(GROUPS) == 6 + 39 + 18  # elbow, hand, shoulder
    assert BODIES["hand"].group_of("unheard_of") == ""
