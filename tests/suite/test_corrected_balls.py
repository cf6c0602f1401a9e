"""The corrected balls of baoding: inertia, friction and motion against MuJoCo C and closed forms."""

import copy
from functools import lru_cache

import mujoco
import numpy as np
import pytest
from configurations import configurations
from stepping import forward, repeated_step

from myowarp.definitions.task import TASKS
from myowarp.sim.build import full_spec
from myowarp.sim.simulation import Simulation

KEY = "myoHandBaodingRandom-v1"
NUM_WORLDS = 40
BALLS = ("ball1", "ball2")

SINGLE = 2e-6  # relative, float32
ACCELERATION_TOLERANCE = 1e-4  # relative; float32 of accelerations up to 2000 rad/s^2
STATE_TOLERANCE = 1e-5  # rad, m; engine against MuJoCo C, median, one control step
CONTACT_TOLERANCE = 1e-3  # rad, m; worst: a touch found a substep earlier or later

CONTACT_FIELDS = ("dim", "friction", "solref", "solimp", "includemargin")
SOLIMP = (0.85, 0.875, 0.0055, 0.5, 2.0)  # of ball and hand, as MyoSuite mixes it
HARD_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)  # of MyoSuite's balls among themselves


@lru_cache
def simulation(key=KEY):
    """Return a simulation; every test writes its state."""
    return Simulation(TASKS[key], NUM_WORLDS, device="cpu", graph=False, progress=False)


def freshly_reset(key=KEY):
    """Return the simulation, reset."""
    sim = simulation(key)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    return sim


def compiled(sim, world):
    """Return the model that MuJoCo compiles for the balls of a world."""
    spec, model = full_spec(sim.scene.spec), sim.scene.model
    for name in BALLS:
        ball, body, geom = spec.geom(name), sim.scene.oracle.body(name).id, sim.scene.oracle.geom(name).id
        ball.mass = float(model.body_mass.numpy()[world, body])
        ball.size[0] = model.geom_size.numpy()[world, geom, 0]
        ball.friction = model.geom_friction.numpy()[world, geom].astype(float)
    return spec.compile()


def with_balls(oracle, sim, world):
    """Return a copy of a model with the balls of a world; MuJoCo derives what follows from them."""
    model = copy.copy(oracle)
    for name in set(sim.scene.spec.batched) & {"body_mass", "body_inertia", "geom_size", "geom_friction"}:
        kind = name.split("_")[0]
        rows = [getattr(model, kind)(ball).id for ball in BALLS]
        getattr(model, name)[rows] = getattr(sim.scene.model, name).numpy()[world, rows]
    for ball in BALLS:
        geom = model.geom(ball).id
        model.geom_rbound[geom] = model.geom_aabb[geom, 3:] = model.geom_size[geom, 0]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def test_balls_of_a_world_are_what_mujoco_compiles():
    """Every field that is drawn or follows; everything else stays as it is."""
    sim = freshly_reset()
    oracle, batched = sim.scene.oracle, sim.scene.spec.batched
    assert {"body_inertia", "body_invweight0"} < set(batched)
    for world in (0, NUM_WORLDS - 1):
        expected = compiled(sim, world)
        for name in batched:
            kind, ours = name.split("_")[0], getattr(sim.scene.model, name).numpy()[world]
            rows = [getattr(oracle, kind)(ball).id for ball in BALLS]
            theirs = getattr(expected, name)[[getattr(expected, kind)(ball).id for ball in BALLS]]
            theirs = theirs.reshape(ours[rows].shape)
            if name == "geom_size":  # of a sphere MuJoCo reads the first entry only
                ours, theirs = ours[:, :1], theirs[:, :1]
            np.testing.assert_allclose(ours[rows], theirs, rtol=SINGLE, err_msg=name)
            others = np.delete(np.arange(len(ours)), [0, *rows])  # the world's subtree weighs the balls
            untouched = getattr(oracle, name)[others]
            untouched = untouched[:, :1] if name == "geom_size" else untouched.reshape(ours[others].shape)
            np.testing.assert_allclose(ours[others], untouched, rtol=SINGLE, err_msg=name)
    inertia = sim.scene.model.body_inertia.numpy()[:, oracle.body("ball1").id]
    assert inertia.min() < 1e-5
    assert inertia.max() > 3e-5


@pytest.mark.parametrize(
    "key", ["myoHandBaodingFixed-v1", "myoHandBaodingSwap-v0", "myoChallengeBaodingP1-v2"]
)
def test_nominal_balls_are_solid_spheres(key):
    model = full_spec(TASKS[key]).compile()
    for name in BALLS:
        ball = model.body(name)
        inertia = 0.4 * 0.043 * 0.022**2
        np.testing.assert_allclose(ball.mass, 0.043)
        np.testing.assert_allclose(ball.inertia, inertia)
        np.testing.assert_allclose(model.body_invweight0[ball.id], [1 / 0.043, 1 / inertia])


def test_second_names_are_the_same_tasks():
    for challenge, hand in (("P1-v2", "Fixed-v1"), ("P2-v2", "Random-v1")):
        first, second = vars(TASKS[f"myoChallengeBaoding{challenge}"]), vars(TASKS[f"myoHandBaoding{hand}"])
        assert {name for name, value in first.items() if value != second[name]} == {"name", "version"}


@pytest.mark.parametrize(("version", "true_inertia"), [(0, False), (1, True)])
def test_pushed_ball(version, true_inertia):
    """A force F at the top of a ball in the air: a = F/m, alpha = F r / (2/5 m r^2); the floor slows it."""
    sim, force = freshly_reset(f"myoHandBaodingRandom-v{version}"), 0.01  # N
    data, model, oracle = sim.scene.data, sim.scene.model, sim.scene.oracle
    data.qpos.numpy()[:, 32] += 0.5  # m, nothing is up there
    mass = model.body_mass.numpy()[:, oracle.body("ball2").id].astype(float)
    radius = model.geom_size.numpy()[:, oracle.geom("ball2").id, 0].astype(float)
    push = np.zeros((NUM_WORLDS, oracle.nv))
    push[:, 29], push[:, 33] = force, force * radius  # along x, about y
    data.qfrc_applied.assign(push)
    forward(sim.scene, sim.shards[0].stages)
    data.qfrc_applied.zero_()
    linear, angular = data.qacc.numpy()[:, 29], data.qacc.numpy()[:, 33]
    np.testing.assert_allclose(linear, force / mass, rtol=ACCELERATION_TOLERANCE)
    true, floored = force * radius / (0.4 * mass * radius**2), force * radius / 1e-4
    expected = true if true_inertia else floored
    np.testing.assert_allclose(angular, expected, rtol=ACCELERATION_TOLERANCE)
    assert (true > 1.4 * floored).all()


def contacts(model, qpos):
    """Return the contacts of the balls in MuJoCo C, by the names of their geoms."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    names = [frozenset(model.geom(geom).name for geom in pair) for pair in data.contact.geom]
    return {
        name: {field: np.copy(getattr(data.contact, field)[row]) for field in CONTACT_FIELDS}
        for row, name in enumerate(names)
        if name & set(BALLS)
    }


def touching(sim):
    """Put the balls near the palm and each other, the hand near its start; returns qpos."""
    model, rng = sim.scene.oracle, np.random.default_rng(4)
    start = sim.scene.spec.start(model)
    share = rng.uniform(0, 0.3, (NUM_WORLDS, 1))
    qpos = (1 - share) * start + share * configurations(model, start, NUM_WORLDS, 5)
    qpos[:, 23:26] = start[23:26] + rng.uniform(-0.02, 0.02, (NUM_WORLDS, 3))
    side = rng.normal(size=(NUM_WORLDS, 3)) * (1, 1, 0.2)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    qpos[:, 30:33] = qpos[:, 23:26] + rng.uniform(0.034, 0.044, (NUM_WORLDS, 1)) * side
    qpos[:, 26:30] = qpos[:, 33:37] = (1, 0, 0, 0)
    sim.scene.data.qpos.assign(qpos)
    sim.scene.data.qvel.zero_()
    return qpos


def test_friction_of_the_ball_decides():
    """MuJoCo C: on the hand friction is the ball's, above and below the hand's; all else as in MyoSuite."""
    sim, uncorrected = freshly_reset(), simulation("myoHandBaodingRandom-v0").scene.oracle
    qpos, slides, num_between = touching(sim), [], 0
    for world in range(NUM_WORLDS):
        new = with_balls(sim.scene.oracle, sim, world)
        before = contacts(with_balls(uncorrected, sim, world), qpos[world])
        after = contacts(new, qpos[world])
        assert set(before) == set(after)
        for geoms, contact in after.items():
            slide, spin, roll = np.max([new.geom(ball).friction for ball in geoms & set(BALLS)], axis=0)
            own = np.array([slide, slide, spin, roll, roll])
            between = geoms == set(BALLS)
            mixed = own if between else np.maximum(own, (1, 1, 0.005, 0.0001, 0.0001))
            np.testing.assert_array_equal(contact["friction"], own)
            np.testing.assert_array_equal(before[geoms]["friction"], mixed)
            for field in set(CONTACT_FIELDS) - {"friction", "solimp"}:
                np.testing.assert_array_equal(contact[field], before[geoms][field])
            np.testing.assert_allclose(contact["solimp"], SOLIMP)
            np.testing.assert_allclose(before[geoms]["solimp"], HARD_SOLIMP if between else SOLIMP)
            num_between += between
            slides += [] if between else [slide]
    assert min(slides) < 0.9
    assert max(slides) > 1.1
    assert num_between > 10


def test_contacts_of_the_engine_are_those_of_mujoco():
    """Friction, impedance and dimension of every contact of a ball that both see."""
    sim = freshly_reset()
    qpos, data, oracle = touching(sim), sim.scene.data, sim.scene.oracle
    forward(sim.scene, sim.shards[0].stages)
    count = data.nacon.numpy()[0]
    fields = {field: getattr(data.contact, field).numpy()[:count] for field in CONTACT_FIELDS}
    pairs, worlds = data.contact.geom.numpy()[:count], data.contact.worldid.numpy()[:count]
    expected = [contacts(with_balls(oracle, sim, world), qpos[world]) for world in range(NUM_WORLDS)]
    seen = {False: 0, True: 0}  # between the balls or not
    for i, (pair, world) in enumerate(zip(pairs, worlds, strict=True)):
        geoms = frozenset(oracle.geom(int(geom)).name for geom in pair)
        if geoms not in expected[world]:
            continue
        seen[geoms == set(BALLS)] += 1
        for field, values in fields.items():
            theirs = expected[world][geoms][field]
            np.testing.assert_allclose(values[i], theirs, rtol=SINGLE, atol=1e-9, err_msg=field)
    assert sum(seen.values()) >= 0.98 * sum(map(len, expected))
    assert min(seen.values()) > 10


def test_light_balls_are_stable():
    """Random and extreme actions: no fault, no spin beyond that of rolling at the speeds that occur."""
    sim = freshly_reset()
    rng, fastest = np.random.default_rng(6), np.zeros(2)
    for _ in range(20):
        action = rng.uniform(-1, 1, sim.action.shape)
        action[::2] = np.sign(action[::2])
        sim.action.assign(action.astype(np.float32))
        sim.step()
        assert not sim.transition.fault.numpy().any()
        speed = np.abs(sim.scene.data.qvel.numpy()[:, -12:]).reshape(NUM_WORLDS, 2, 2, 3)
        fastest = np.maximum(fastest, speed.max(axis=(0, 1, 3)))
    assert 1.0 < fastest[0] < 10.0  # m/s
    assert 10.0 < fastest[1] < 10.0 / 0.018  # rad/s


def test_control_step_of_light_balls(record_property):
    """A control step from states of rollouts, with the balls of each world: engine against MuJoCo C."""
    sim = freshly_reset()
    rng, data = np.random.default_rng(7), sim.scene.data
    for _ in range(6):
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
    data.qacc_warmstart.zero_()
    before = {name: getattr(data, name).numpy().astype(float) for name in ("qpos", "qvel", "ctrl")}
    before["act"] = sim.scene.muscles.activation.numpy().astype(float)
    after, touched = [], 0
    for world in range(NUM_WORLDS):
        model = with_balls(sim.scene.oracle, sim, world)
        state = mujoco.MjData(model)
        for name, values in before.items():
            getattr(state, name)[:] = values[world]
        mujoco.mj_step(model, state, sim.scene.num_substeps)
        touched += np.isin(state.contact.geom, [model.geom(ball).id for ball in BALLS]).any()
        after.append(state.qpos.copy())
    step = repeated_step(sim.scene, sim.shards[0].stages)
    for _ in range(sim.scene.num_substeps):
        step()
    error = np.abs(data.qpos.numpy() - np.array(after)).max(axis=1)
    record_property("qpos median", float(np.median(error)))
    record_property("qpos worst", float(error.max()))
    assert touched > NUM_WORLDS / 4
    assert np.median(error) < STATE_TOLERANCE
    assert error.max() < CONTACT_TOLERANCE
    assert np.median(np.abs(after - before["qpos"]).max(axis=1)) > 10 * CONTACT_TOLERANCE
