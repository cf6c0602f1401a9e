"""The exoskeleton: torque against MuJoCo C's muscles, mass against solid bodies."""

import gymnasium
import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from elbows import KEY, NUM_WORLDS, States, in_c, worn
from reference import exoskeleton as reference
from reference.load import gravity_torque
from stepping import engine_alone

from myowarp.definitions.body import BODIES
from myowarp.definitions.condition import resolve
from myowarp.definitions.parameter import Ramp, Uniform
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.models.conditions.exoskeleton import CUFF, Exoskeleton
from myowarp.models.conditions.load import Load
from myowarp.sim.build import full_spec

ASSISTANCE = np.linspace(0.0, 1.5, NUM_WORLDS)  # one a world
MAX_TORQUE = 8.5  # N m
BARE = {"forearm_mass": 0.0}  # so that the torque is alone

TORQUE = 1e-5
"""Of the largest torque of the muscles; the engine's float32 forces and moment arms, measured 4e-6."""

QVEL = 5e-5
"""Of the largest change of velocity in a physics step; as in test_muscles."""

FIELD = 1e-6  # relative, float32 roundings of host values
ROUNDING = 1e-6  # of a number of order one, a few float32 operations
EFFECT = 10.0


def muscle_torque(states):
    """Return MuJoCo C's torque of the muscles at the elbow [N m], moment arm by moment arm."""
    model = worn(num_worlds=1).scene.oracle
    rows = in_c(model, states, mujoco.mj_forward)
    moment = np.array([_dense(model, data) for data in rows])
    tension = -np.array([data.actuator_force for data in rows])
    torque = reference.torque(1.0, -moment, tension)
    np.testing.assert_allclose(torque, [data.qfrc_actuator[0] for data in rows], rtol=1e-12)
    return torque


def _dense(model, data):
    """Return the actuators' moments about the only joint."""
    dense = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return dense[:, 0]


def test_torque_is_a_share_of_the_muscles():
    """In 256 states with an assistance each; twice the assistance is twice the torque."""
    states = States()
    expected = ASSISTANCE * muscle_torque(states)
    scale = np.abs(expected).max()
    assert scale > 10.0  # N m
    found = []
    for assistance in (ASSISTANCE, 2.0 * ASSISTANCE):
        sim = worn(Exoskeleton(assistance, **BARE))
        data = states.put(sim)
        data.actuator_force.fill_(np.nan)
        engine_alone(mjw.forward)(sim.scene.model, data)
        found.append(data.actuator_force.numpy()[:, -1].copy())
        assert sim.scene.oracle.actuator(sim.scene.oracle.nu - 1).name == "exoskeleton"
        shown = sim.shards[0].effects[0].info["exo_torque"].numpy()
        np.testing.assert_allclose(shown, found[-1], rtol=0, atol=ROUNDING * scale)
    assert np.abs(found[0] - expected).max() <= TORQUE * scale
    assert np.abs(found[1] - 2.0 * expected).max() <= 2.0 * TORQUE * scale


@pytest.mark.parametrize("physics", PHYSICS)
def test_elbow_moves_as_with_stronger_muscles(physics):
    """Muscles that pull (1 + assistance) times as hard: same acceleration, and, with the derivative by
    velocity that implicit integrators take, same velocity after a step.
    """
    states, sim = States(), worn(Exoskeleton(ASSISTANCE, **BARE), physics=physics)
    if PHYSICS[physics].midstep:  # what C does instead
        sim.scene.muscles.midstep, sim.scene.muscles.implicitness = False, 1.0
    oracle = worn(num_worlds=1, physics=physics).scene.oracle
    expected, alone = (
        in_c(oracle, states, mujoco.mj_step, scale=scale) for scale in (1.0 + ASSISTANCE, np.ones(NUM_WORLDS))
    )
    expected, alone = (np.array([data.qvel for data in rows]) for rows in (expected, alone))
    data = states.put(sim)
    engine_alone(mjw.step)(sim.scene.model, data)
    scale = np.abs(expected - states.qvel).max()
    assert np.abs(data.qvel.numpy() - expected).max() <= QVEL * scale
    assert np.median(np.abs(alone - expected)) > EFFECT * QVEL * scale


def test_acceleration_is_that_of_the_applied_torque():
    """The same torque as MuJoCo's `qfrc_applied` accelerates the forearm alike."""
    states, sim = States(1), worn(Exoskeleton(ASSISTANCE, **BARE))
    torque = ASSISTANCE * muscle_torque(states)
    rows = in_c(worn(num_worlds=1).scene.oracle, states, mujoco.mj_forward, torque=torque)
    expected = np.array([data.qacc for data in rows])
    data = states.put(sim)
    engine_alone(mjw.forward)(sim.scene.model, data)
    assert np.abs(data.qacc.numpy() - expected).max() <= TORQUE * np.abs(expected).max()


def test_implicit_integrator_needs_the_slope():
    """The torque without its derivative moves the velocity after one step by much more than the tolerance."""
    states, sim = States(), worn(Exoskeleton(ASSISTANCE, **BARE), physics="fast")
    launch = sim.scene.model.callback.control

    def without_slope(model, data):
        launch(model, data)
        bias = model.actuator_biasprm.numpy()
        bias[:, -1, 0] += bias[:, -1, 2] * data.actuator_velocity.numpy()[:, -1]
        bias[:, -1, 2] = 0.0

    found = []
    for control in (launch, without_slope):
        sim.scene.model.callback.control = control
        data = states.put(sim)
        engine_alone(mjw.step)(sim.scene.model, data)
        found.append(data.qvel.numpy().copy())
    scale = np.abs(found[0] - states.qvel).max()
    assert np.abs(found[1] - found[0]).max() > EFFECT * QVEL * scale


def test_weak_and_torn_muscles_are_helped_less():
    """The torque follows what other conditions leave of the muscles."""
    states = States()
    weak = states.put(sim := worn((Exoskeleton(0.5, **BARE), "sarcopenia")))
    engine_alone(mjw.forward)(sim.scene.model, weak)
    force = weak.actuator_force.numpy().astype(np.float64)
    moment = np.array([_dense(d.model, d) for d in in_c(sim.scene.oracle, states, mujoco.mj_forward)])
    expected = reference.torque(0.5, -moment[:, :6], -force[:, :6])
    scale = np.abs(expected).max()
    assert np.abs(force[:, 6] - expected).max() <= TORQUE * scale
    assert np.abs(force[:, 6] - 0.5 * muscle_torque(states)).max() > EFFECT * TORQUE * scale


def test_forearm_part_is_that_of_the_solids():
    """Mass, center and inertia of cuff, bar and hinge; each world its own mass."""
    masses = np.array([0.0, 0.111, 0.5])
    sim = worn(Exoskeleton(0.0, forearm_mass=masses), 3)
    body, model = sim.scene.oracle.body(CUFF), sim.scene.model
    for field in (model.body_mass, model.body_inertia):
        poisoned = field.numpy().copy()
        poisoned[:, body.id] = np.nan
        field.assign(wp.array(poisoned, dtype=field.dtype))
    sim.shards[0].launch_conditions()
    mass, center, tensor = reference.forearm_part()
    assert mass == pytest.approx(Exoskeleton().forearm_mass)
    np.testing.assert_allclose(body.ipos, center, atol=1e-12)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    turn = turn.reshape(3, 3)
    np.testing.assert_allclose(model.body_mass.numpy()[:, body.id], masses, rtol=FIELD)
    for world, inertia in enumerate(model.body_inertia.numpy()[:, body.id]):
        expected = tensor * masses[world] / mass
        np.testing.assert_allclose(turn @ np.diag(inertia) @ turn.T, expected, rtol=1e-5, atol=1e-10)


def test_forearm_part_pulls_by_its_weight():
    """Gravity's torque at rest changes by that of 0.111 kg at the center of mass of the solids."""
    states = States()
    states.qvel[:] = 0.0
    held = []
    for mass in (0.111, 0.0):
        sim = worn(Exoskeleton(0.0, forearm_mass=mass))
        data = states.put(sim)
        engine_alone(mjw.forward)(sim.scene.model, data)
        held.append(data.qfrc_bias.numpy()[:, 0].astype(np.float64))
    spec = full_spec(TASKS[KEY])
    spec.body(BODIES["elbow"].exoskeleton.limb).add_site(name="center", pos=reference.forearm_part()[1])
    model, expected = spec.compile(), []
    for data in in_c(model, states, mujoco.mj_forward):
        center, anchor, axis = data.site("center").xpos, data.xanchor[0], data.xaxis[0]
        expected.append(-gravity_torque(0.111, center, anchor, axis))
    assert np.abs(expected).max() > 0.1  # N m
    np.testing.assert_allclose(held[0] - held[1], expected, atol=1e-5 * np.abs(expected).max())


def test_moves_like_mujoco_compiled_with_the_part():
    """One control step from random states; the default mass of the exoskeleton alone moves it visibly."""
    states, sim = States(), worn(Exoskeleton(0.0))
    oracle = worn(num_worlds=1).scene.oracle
    spec = full_spec(TASKS[KEY])
    mass, center, tensor = reference.forearm_part()
    body = spec.body(BODIES["elbow"].exoskeleton.limb).add_body(mass=mass, ipos=center, explicitinertial=True)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    body.fullinertia = (xx, yy, zz, xy, xz, yz)
    spec.compiler.boundinertia = spec.compiler.boundmass = 0.0
    model = spec.compile()
    model.dof_invweight0[:] = oracle.dof_invweight0
    steps = TASKS[KEY].num_substeps
    expected, bare = (
        np.array([data.qpos for data in in_c(m, states, lambda m, d: mujoco.mj_step(m, d, steps))])
        for m in (model, oracle)
    )
    data = states.put(sim)
    for _ in range(steps):
        engine_alone(mjw.step)(sim.scene.model, data)
    assert np.abs(data.qpos.numpy() - expected).max() <= 1e-5  # rad
    assert np.median(np.abs(bare - expected)) > EFFECT * 1e-5


def test_assistance_changes_within_an_episode():
    """From nothing to all of the muscles' torque, between 0.04 s and 0.1 s."""
    sim = worn(Exoskeleton(Ramp(0.0, [1.0, 0.0], onset=0.04, duration=0.06), **BARE), 2)
    sim.reset(seeds=np.arange(2))
    sim.action.fill_(0.3)
    for step in range(8):
        sim.step()
        force = sim.scene.data.actuator_force.numpy().astype(np.float64)
        moment = sim.scene.data.actuator_moment.numpy()
        share = np.clip((0.02 * step - 0.04) / 0.06, 0.0, 1.0)
        expected = share * np.sum(moment[0, :6] * force[0, :6])
        assert force[0, 6] == pytest.approx(expected, abs=1e-4)
        assert force[1, 6] == 0
    assert abs(force[0, 6]) > 0.1


def test_reset_shows_no_torque():
    sim = worn("exoskeleton", 3)
    sim.reset(seeds=np.arange(3))
    sim.action.fill_(0.5)
    sim.step()
    torque = sim.shards[0].effects[0].info["exo_torque"]
    before = torque.numpy().copy()
    assert np.abs(before).min() > 0
    sim.reset(np.array([True, False, True]))
    np.testing.assert_array_equal(torque.numpy(), [0.0, before[1], 0.0])


def test_drawn_parameters():
    """Assistance and mass are drawn independently of each other and of the load's mass."""
    sim = worn((Exoskeleton(Uniform(0, 1), forearm_mass=Uniform(0, 1)), Load(Uniform(0, 1))), 64)
    sim.reset(seeds=np.arange(64))
    sim.shards[0].launch_conditions()
    exo, _ = sim.shards[0].effects
    masses = sim.scene.model.body_mass.numpy()
    ids = [sim.scene.oracle.body(name).id for name in (CUFF, "load")]
    drawn = np.column_stack([exo.assistance.curve.start.numpy(), masses[:, ids]])
    assert drawn.min() >= 0
    assert drawn.max() <= 1
    correlation = np.corrcoef(drawn.T) - np.eye(3)
    assert np.abs(correlation).max() < 0.4
    subtree = sim.scene.model.body_subtreemass.numpy()[:, 1]
    np.testing.assert_allclose(subtree, masses[:, 1:].sum(axis=1), rtol=FIELD)


def test_grid_uses_the_defaults():
    env = gymnasium.make_vec("MyoWarp/paperElbowPoseHardRExo-v0", num_envs=2, device="cpu")
    (condition,) = env.unwrapped.sim.conditions
    assert (condition.assistance, condition.motor, condition.forearm_mass) == (0.5, False, 0.111)
    env.close()


@pytest.mark.parametrize("body", sorted({TASKS[key].body for key in TASKS} - {"elbow"}))
def test_other_bodies_cannot_wear_it(body):
    spec = next(TASKS[key] for key in TASKS if TASKS[key].body == body)
    with pytest.raises(ValueError, match=r".") as error:
        resolve("exoskeleton", spec)
    assert str(error.value) == f"body {body!r} cannot wear an exoskeleton; bodies that can: elbow"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"assistance": -0.1}, r"^exoskeleton assistance must be >= 0, got -0\.1$"),
        (
            {"assistance": Uniform(0.0, 40.0)},
            r"^exoskeleton assistance must be at most 4 times the muscles' torque, got 40; "
            r"for 40 % write 0\.4$",
        ),
        ({"forearm_mass": -1}, r"^exoskeleton forearm_mass must be in 0\.\.100, got -1$"),
        (
            {"assistance": np.ones(3)},
            r"^exoskeleton assistance must be one number or of shape \(2,\), got shape \(3,\)$",
        ),
        (
            {"motor": True, "max_torque": np.nan},
            r"^exoskeleton max_torque must be a finite number >= 0, got nan$",
        ),
        (
            {"motor": True, "max_torque": 1e39},
            r"^exoskeleton max_torque must be a finite number >= 0, got 1e\+39$",
        ),
        (
            {"motor": True, "effort_weight": "high"},
            r"^exoskeleton effort_weight must be a finite number >= 0, got 'high'$",
        ),
        (
            {"effort_weight": 1.0},
            r"^exoskeleton effort_weight is for a motor; give motor=True or leave it out$",
        ),
    ],
)
def test_bad_input(options, message):
    with pytest.raises(ValueError, match=message):
        worn(Exoskeleton(**options), 2)


def test_two_are_refused():
    both = "conditions 'exoskeleton' and 'exoskeleton' both set the torque of the exoskeleton; leave one out"
    with pytest.raises(ValueError, match=f"^{both}$"):
        resolve(("exoskeleton", Exoskeleton(motor=True)), TASKS[KEY])
