"""Loads: statics in closed form, and MuJoCo C compiled with the weight."""

import copy
from functools import lru_cache

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from configurations import configurations
from often import often
from reference import load as reference
from stepping import engine_alone

from myowarp.definitions.body import BODIES
from myowarp.definitions.condition import resolve
from myowarp.definitions.parameter import Ramp, Uniform
from myowarp.definitions.task import TASKS
from myowarp.engine.slim import slim
from myowarp.models.conditions.load import Load
from myowarp.sim.build import full_spec, oracle_model
from myowarp.sim.simulation import Simulation

NUM_WORLDS = 33
MASSES = np.linspace(0.0, 6.0, NUM_WORLDS)  # kg, one a world
RADIUS = 0.05  # m
COMPILED_MASS = 1.5  # kg, more than some bodies' floors of inertia need
ELBOW = "myoElbowPose1D6MFixed-v0"
HOSTS = {TASKS[key].body: key for key in reversed(list(TASKS)) if BODIES[TASKS[key].body].load is not None}

FIELD = 1e-6
"""Relative; a float32 rounding, or a sum of a few masses."""

TORQUE = 2e-6
"""Of the largest torque of the load; float32 positions of bodies 1.4 m from the origin."""

ACCELERATION = 5e-5
"""Of the largest acceleration; float32 muscle forces and factorization, measured 1.2e-5."""

QPOS = 1e-5
"""rad or m, worst world and joint after one control step; measured 4e-7 (elbow) to 1.2e-6 (hand)."""

EFFECT = 10.0


class States:
    """Random states of a task, one a world, exactly representable in float32."""

    def __init__(self, model, start, seed=0):
        rng = np.random.default_rng(seed)
        self.qpos = np.float32(configurations(model, start, NUM_WORLDS, seed))
        self.qvel = np.float32(0.5 * rng.normal(size=(NUM_WORLDS, model.nv)))
        self.activation = np.float32(rng.uniform(0.0, 0.5, (NUM_WORLDS, model.na)))
        self.ctrl = np.float32(rng.uniform(0.0, 0.5, (NUM_WORLDS, model.nu)))


def loaded(key, mass, **options):
    """Return a simulation with loads, no contacts, and the loads in place."""
    options = {"device": "cpu", "graph": False, "progress": False} | options
    sim = Simulation(TASKS[key], NUM_WORLDS, conditions=Load(mass), **options)
    for model in (sim.scene.oracle, sim.scene.model):
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    sim.shards[0].launch_conditions()
    return sim


def put(sim, states):
    """Write states into a simulation."""
    data = sim.scene.data
    data.qpos.assign(states.qpos)
    data.qvel.assign(states.qvel)
    data.ctrl.assign(states.ctrl)
    sim.scene.muscles.activation.assign(states.activation)


def put_in_c(data, states, world):
    """Write one world's state into MuJoCo C."""
    mujoco.mj_resetData(data.model, data)
    data.qpos[:], data.qvel[:] = states.qpos[world], states.qvel[world]
    data.act[:], data.ctrl[:] = states.activation[world], states.ctrl[world]


@lru_cache
def compiled(key):
    """Return MuJoCo C's slim model of a task, compiled with COMPILED_MASS in the hand."""
    spec = full_spec(TASKS[key])
    place = BODIES[TASKS[key].body].load
    body = spec.body(place.limb).add_body(name="weight", pos=place.pos, ipos=(0.0, 0.0, 0.0), fuse=0)
    body.mass = COMPILED_MASS
    body.inertia, body.explicitinertial = 3 * [reference.sphere_inertia(COMPILED_MASS, RADIUS)], True
    model = slim(spec, TASKS[key].sites).compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model


@lru_cache
def softness(key):
    """Return how soft the stops of the bare limb are."""
    return oracle_model(TASKS[key]).dof_invweight0.copy()


def with_mass(key, mass):
    """Return the compiled model with another mass; stops as soft as without any."""
    model = copy.copy(compiled(key))
    weight = model.body("weight")
    weight.mass[0], weight.inertia[:] = mass, reference.sphere_inertia(mass, RADIUS)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.dof_invweight0[:] = softness(key)
    return model


@lru_cache
def in_c(key, mass, world):
    """Return acceleration, and configuration after a control step, of a world with a load in MuJoCo C."""
    model = with_mass(key, mass)
    states = States(model, TASKS[key].start(model))
    data = mujoco.MjData(model)
    put_in_c(data, states, world)
    mujoco.mj_forward(model, data)
    acceleration = data.qacc.copy()
    mujoco.mj_step(model, data, TASKS[key].num_substeps)
    return acceleration, data.qpos.copy()


def world_frame(qpos):
    """Return center of the load, anchor and axis of the elbow in the world, each (num_worlds, 3)."""
    spec = full_spec(TASKS[ELBOW])
    place = BODIES["elbow"].load
    spec.body(place.limb).add_site(name="center", pos=place.pos)
    model = spec.compile()
    data, rows = mujoco.MjData(model), []
    for angle in qpos:
        data.qpos[:] = angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        rows.append((data.site("center").xpos.copy(), data.xanchor[0].copy(), data.xaxis[0].copy()))
    return map(np.array, zip(*rows, strict=True))


def test_gravity_torque_is_that_of_statics(record_property):
    """What holds the elbow still changes by m g d sin, and by nothing else."""
    states = States(compiled(ELBOW), compiled(ELBOW).qpos0)
    states.qvel[:] = 0.0
    held = []
    for mass in (MASSES, 0.0):
        sim = loaded(ELBOW, mass)
        put(sim, states)
        engine_alone(mjw.forward)(sim.scene.model, sim.scene.data)
        held.append(sim.scene.data.qfrc_bias.numpy()[:, 0].astype(np.float64))
    center, anchor, axis = world_frame(states.qpos)
    expected = -reference.gravity_torque(MASSES, center, anchor, axis)
    assert np.abs(expected).max() > 10.0  # N m
    error = np.abs(held[0] - held[1] - expected).max() / np.abs(expected).max()
    record_property("torque", float(error))
    assert error <= TORQUE
    # The reference itself, spelt out: weight, distance from the axis, angle; times how level the axis is.
    lever = center - anchor - np.sum((center - anchor) * axis, axis=1)[:, None] * axis
    down = np.array([0.0, 0.0, -1.0]) - axis * -axis[:, 2:]
    distance, level = np.linalg.norm(lever, axis=1), np.linalg.norm(down, axis=1)
    sine = np.sum(np.cross(lever, down) * axis, axis=1) / (distance * level)
    spelt = -MASSES * 9.81 * distance * sine * level
    np.testing.assert_allclose(spelt, expected, atol=1e-12)


@pytest.mark.parametrize("body", often([*HOSTS], ["elbow", "elbow_exo"]))
def test_masses_are_those_of_the_compiler(body):
    """Mass, inertia, their frame, and what hangs on every body."""
    key = HOSTS[body]
    sim = loaded(key, np.where(np.arange(NUM_WORLDS) == 5, COMPILED_MASS, MASSES))
    model, oracle, expected = sim.scene.model, sim.scene.oracle, compiled(key)
    names = [expected.body(i).name for i in range(expected.nbody)]
    ids = [oracle.body("load" if name == "weight" else name).id for name in names]
    assert sorted(ids) == list(range(oracle.nbody))
    for name in ("body_mass", "body_inertia", "body_subtreemass", "body_ipos", "body_iquat", "body_pos"):
        values = getattr(model, name).numpy()
        got = values[5 % len(values)][ids]
        np.testing.assert_allclose(got, getattr(expected, name), rtol=FIELD, atol=FIELD, err_msg=name)


@pytest.mark.parametrize("body", often([*HOSTS], ["elbow", "elbow_exo"]))
def test_moves_like_mujoco_compiled_with_it(body, record_property):
    """Acceleration and one control step from random states, a mass of its own in every world."""
    key = HOSTS[body]
    sim = loaded(key, MASSES)
    data = sim.scene.data
    put(sim, States(sim.scene.oracle, TASKS[key].start(sim.scene.oracle)))
    engine_alone(mjw.forward)(sim.scene.model, data)
    acceleration = data.qacc.numpy().astype(np.float64)
    put(sim, States(sim.scene.oracle, TASKS[key].start(sim.scene.oracle)))
    data.qacc_warmstart.zero_()
    for _ in range(sim.scene.num_substeps):
        engine_alone(mjw.step)(sim.scene.model, data)
    qpos = data.qpos.numpy()
    expected, unloaded = (
        [np.array(x) for x in zip(*(in_c(key, m, w) for w, m in enumerate(masses)), strict=True)]
        for masses in (MASSES, np.zeros(NUM_WORLDS))
    )
    scale = np.abs(expected[0]).max()
    record_property("acceleration", float(np.abs(acceleration - expected[0]).max() / scale))
    record_property("qpos", float(np.abs(qpos - expected[1]).max()))
    assert np.abs(acceleration - expected[0]).max() <= ACCELERATION * scale
    assert np.abs(qpos - expected[1]).max() <= QPOS
    half = NUM_WORLDS // 2  # heavier than 3 kg
    assert np.all(np.abs(expected[0] - unloaded[0]).max(axis=1)[half:] > EFFECT * ACCELERATION * scale)
    assert np.all(np.abs(expected[1] - unloaded[1]).max(axis=1)[half:] > EFFECT * QPOS)


def test_mass_changes_within_an_episode():
    """1.5 kg are put into the hand from 0.1 s to 0.2 s; until then nothing is felt, bit for bit."""
    ramp = Ramp(0.0, np.where(np.arange(4) == 2, 0.0, 1.5), onset=0.1, duration=0.1)
    sims = [
        Simulation(TASKS[ELBOW], 4, device="cpu", conditions=c, graph=False, progress=False)
        for c in (Load(ramp), ())
    ]
    load = sims[0].scene.oracle.body("load").id
    for sim in sims:
        sim.reset(seeds=np.arange(4))
        sim.action.fill_(0.2)
    for step in range(14):
        for sim in sims:
            sim.step()
        share = np.clip((0.02 * step - 0.1) / 0.1, 0.0, 1.0)
        masses = sims[0].scene.model.body_mass.numpy()[:, load]
        np.testing.assert_allclose(masses, share * np.array([1.5, 1.5, 0.0, 1.5]), rtol=1e-5, atol=1e-7)
        same = np.all(sims[0].transition.obs.numpy() == sims[1].transition.obs.numpy(), axis=1)
        np.testing.assert_array_equal(same, [share == 0.0, share == 0.0, True, share == 0.0])
    difference = np.abs(sims[0].transition.obs.numpy() - sims[1].transition.obs.numpy())
    assert difference[[0, 1, 3], 0].min() > 0.01  # rad


@pytest.mark.parametrize(
    "key",
    ["myoElbowPose1D6MExoRandom-v0", pytest.param("myoHandBaodingRandom-v0", marks=pytest.mark.slow)],
)
def test_what_was_hung_before_leaves_no_trace(key):
    """Masses, and those of subtrees, follow from seed and episode alone, bit for bit; the task's own too."""
    sim = Simulation(
        TASKS[key], 5, device="cpu", conditions=Load(Uniform(0.0, 3.0)), graph=False, progress=False
    )

    def hung():
        sim.shards[0].launch_conditions()
        fields = (sim.scene.model.body_mass, sim.scene.model.body_subtreemass)
        return np.concatenate([field.numpy() for field in fields], axis=1)

    sim.reset(seeds=np.arange(5))
    first = hung().copy()
    for _ in range(3):
        sim.reset()
        assert not np.array_equal(hung(), first)
    sim.reset(seeds=np.arange(5))
    np.testing.assert_array_equal(hung(), first)
    oracle, (mass, subtree) = sim.scene.oracle, np.split(first, 2, axis=1)
    for body in range(oracle.nbody):
        if body and oracle.body_weldid[body] == oracle.body("load").weldid[0]:
            below = [i for i in range(oracle.nbody) if body in lineage(oracle, i)]
            np.testing.assert_allclose(subtree[:, body], mass[:, below].sum(axis=1), rtol=FIELD)


def lineage(model, body):
    """Return a body and all that it hangs on."""
    return {0} if body == 0 else {body} | lineage(model, model.body_parentid[body])


@pytest.mark.parametrize("body", sorted({TASKS[key].body for key in TASKS}))
def test_every_body_holds_a_load_or_says_that_it_cannot(body):
    spec = next(TASKS[key] for key in TASKS if TASKS[key].body == body)
    if (place := BODIES[body].load) is not None:
        model = full_spec(spec, resolve("load", spec)).compile()
        assert model.body("load").mass == 0
        limb = model.body(model.body("load").parentid[0]).name
        assert (limb, tuple(model.body("load").pos)) == (place.limb, place.pos)
        return
    with pytest.raises(ValueError, match=r".") as error:
        resolve("load", spec)
    known = "hand, contact_hand, elbow, elbow_exo"
    assert str(error.value) == f"body {body!r} cannot hold a load; bodies that can: {known}"


def test_palm_is_the_site_of_the_model():
    """The hands' load is where myo-sim has its site of grasping."""
    for body in ("hand", "contact_hand"):
        site, place = BODIES[body].build().site("S_grasp_r"), BODIES[body].load
        assert (site.parent.name, tuple(site.pos)) == (place.limb, place.pos)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mass": -1.0}, r"^load mass must be in 0\.\.100, got -1$"),
        ({"mass": [1.0, 2.0]}, r"^load mass must be one number or of shape \(33,\), got shape \(2,\)$"),
        ({"mass": {"BRA": 1.0}}, r"^load mass must be numbers, got \{'BRA': 1\.0\}$"),
        ({"mass": np.nan}, r"^load mass must be in 0\.\.100, got nan$"),
        ({"mass": 500.0}, r"^load mass must be in 0\.\.100, got 500$"),
    ],
)
def test_bad_mass(options, message):
    with pytest.raises(ValueError, match=message):
        loaded(ELBOW, **options)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.inf, 1e39, "big"])
def test_bad_radius(radius):
    with pytest.raises(ValueError, match=r".") as error:
        Load(radius=radius)
    assert str(error.value) == f"load radius must be a finite length > 0 m, got {radius!r}"


def test_one_hand_holds_one_load():
    with pytest.raises(
        ValueError, match=r"^conditions 'load' and 'load' both set the weight in the hand; leave one out$"
    ):
        resolve((Load(), Load(2.0)), TASKS[ELBOW])


def test_neutral_is_the_identity():
    """Weight 0 leaves the acceleration of every world as it is, bit for bit; 1 g does not."""
    found = []
    for conditions in ((), Load(0.0), Load(0.001)):
        sim = Simulation(
            TASKS[ELBOW], NUM_WORLDS, device="cpu", conditions=conditions, graph=False, progress=False
        )
        sim.shards[0].launch_conditions()
        put(sim, States(sim.scene.oracle, sim.scene.oracle.qpos0))
        engine_alone(mjw.forward)(sim.scene.model, sim.scene.data)
        found.append(sim.scene.data.qacc.numpy().copy())
    np.testing.assert_array_equal(found[1], found[0])
    assert np.abs(found[2] - found[0]).min() > 0


def test_radius_is_that_of_the_inertia():
    """Two fifths m r^2 for any radius, written over poison."""
    sim = Simulation(
        TASKS[ELBOW], 3, device="cpu", conditions=Load([1, 2, 3], radius=0.2), graph=False, progress=False
    )
    load = sim.scene.oracle.body("load").id
    for field in (sim.scene.model.body_inertia, sim.scene.model.body_mass):
        poisoned = field.numpy().copy()
        poisoned[:, load] = np.nan
        field.assign(wp.array(poisoned, dtype=field.dtype))
    sim.shards[0].launch_conditions()
    inertia = sim.scene.model.body_inertia.numpy()[:, load]
    expected = np.repeat(reference.sphere_inertia(np.array([[1.0], [2.0], [3.0]]), 0.2), 3, axis=1)
    np.testing.assert_allclose(inertia, expected, rtol=FIELD)
