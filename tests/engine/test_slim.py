"""Slim models against full ones in MuJoCo C, and which geoms can collide against MuJoCo's contacts."""

from functools import lru_cache

import mujoco
import numpy as np
import pytest
from configurations import configurations
from often import of_each, often

import myowarp.tasks  # noqa: F401
from myowarp.definitions.task import TASKS
from myowarp.engine.slim import colliding_geoms, colliding_pairs, slim
from myowarp.sim.build import full_spec, slim_model, stateless_model

NUM_STATES = 200  # in which geoms may touch
NUM_MOVING = 60
NUM_STEPS = 10

ROUNDING = 1e-10
"""Relative to the largest value met. Fused bodies change the order of double-precision sums; measured
3e-14, after ten steps too. Stiff joint limits can magnify a rounding of 1e-16 by several powers."""

TOUCHING, TOUCHING_WORST = 1e-4, 1e-2
"""Of the largest acceleration of a state, for nine states of ten and for the worst. MuJoCo's general collider
stops at 1e-6, which leaves the direction of a contact to rounding; measured 6e-6 and 2e-3. A static body
fused into the world, which makes its contacts harder, changed accelerations by 0.01 and 0.03 to 1."""

BEYOND = 0.05  # of a joint's range, so that limits act

SCENES = {spec.key: spec for spec in {TASKS[key].scene_key: TASKS[key] for key in TASKS}.values()}
ONE_PER_BODY = {spec.body: name for name, spec in reversed(SCENES.items())}.values()
OFTEN = of_each(SCENES, lambda key: (TASKS[key].body,))


@lru_cache
def models(scene):
    """Return the full model of a scene, with the slim one's names of geoms, and the slim one."""
    full = full_spec(SCENES[scene])
    for index, geom in enumerate(full.geoms):
        geom.name = geom.name or f"geom {index}"
    return full.compile(), slim_model(SCENES[scene])


def states(scene, seed, count):
    """Yield pairs of data, full and slim, in the same random states, not yet evaluated."""
    pair = models(scene)
    full = pair[0]
    rng = np.random.default_rng(seed)
    for qpos in configurations(full, SCENES[scene].start(full), count, seed, BEYOND):
        qvel, act, ctrl = (
            rng.normal(size=full.nv),
            rng.uniform(size=full.na),
            rng.uniform(*full.actuator_ctrlrange.T),
        )
        both = [mujoco.MjData(model) for model in pair]
        for data in both:
            data.qpos[:], data.qvel[:], data.act[:], data.ctrl[:] = qpos, qvel, act, ctrl
        yield both


def relative(value, expected):
    """Return the largest error over the largest value."""
    return np.abs(value - expected).max() / max(np.abs(expected).max(), 1e-300)


@pytest.fixture
def untouched(scene):
    """Switch contacts off in the two models of a scene."""
    flags = [model.opt.disableflags for model in models(scene)]
    for model in models(scene):
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    yield
    for model, flag in zip(models(scene), flags, strict=True):
        model.opt.disableflags = flag


@pytest.mark.parametrize("scene", OFTEN)
@pytest.mark.usefixtures("untouched")
def test_slim_moves_like_full(scene):
    """To rounding, but for contacts, which the next test is about."""
    start = {name: ([], []) for name in ("ten_length", "actuator_force", "qacc", "qfrc_passive")}
    end, begin = ([], []), []
    for both in states(scene, 0, NUM_MOVING):
        begin.append(both[0].qpos.copy())
        for side, (model, data) in enumerate(zip(models(scene), both, strict=True)):
            mujoco.mj_forward(model, data)
            for name, values in start.items():
                values[side].append(getattr(data, name).copy())
            mujoco.mj_step(model, data, NUM_STEPS)
            end[side].append(data.qpos.copy())
    for name, (expected, got) in start.items():
        assert relative(np.array(got), np.array(expected)) <= ROUNDING, name
    assert relative(np.array(end[1]), np.array(end[0])) <= ROUNDING
    assert np.abs(np.array(end[0]) - np.array(begin)).max() > 0.01, "nothing moved"


def touches_object(model, data):
    """Whether the body of the last joint, an object, is in contact."""
    last = model.jnt_bodyid[-1]
    return int((model.geom_bodyid[data.contact.geom] == last).any())


COLLIDING = [name for name, spec in SCENES.items() if spec.body == "contact_hand"]


@pytest.mark.parametrize("scene", often(COLLIDING, COLLIDING[:1]))
def test_slim_touches_like_full(scene):
    """The same geoms touch, as deep, and accelerate the bodies alike."""
    met, errors = 0, []
    for both in states(scene, 2, NUM_STATES):
        seen = []
        for model, data in zip(models(scene), both, strict=True):
            mujoco.mj_forward(model, data)
            names = [frozenset(model.geom(geom).name for geom in pair) for pair in data.contact.geom]
            seen.append(sorted(zip(map(sorted, names), data.contact.dist, strict=True)))
        met += touches_object(*next(zip(models(scene), both, strict=True)))
        expected, got = seen
        assert [names for names, _ in got] == [names for names, _ in expected]
        depths = [np.array([depth for _, depth in contacts]) for contacts in seen]
        assert np.allclose(*depths, rtol=0.0, atol=1e-6)
        errors.append(relative(both[1].qacc, both[0].qacc))
    assert np.percentile(errors, 90) <= TOUCHING
    assert max(errors) <= TOUCHING_WORST
    few = 100 if SCENES[scene].family == "diereorient" else 10  # a die on slides of 0.5 m is seldom near
    assert met > NUM_STATES / few, "the object touches nothing"


@pytest.mark.parametrize("scene", OFTEN)
def test_slim_is_small_and_keeps_names(scene):
    full, small = models(scene)
    assert small.nsite < full.nsite
    assert small.ngeom <= full.ngeom
    assert small.nbody <= full.nbody
    assert small.nmesh == small.ncam == small.nlight == small.nkey == 0
    assert (small.nq, small.nv, small.nu, small.na) == (full.nq, full.nv, full.nu, full.na)
    for site in SCENES[scene].sites:
        assert small.site(site).id >= 0
    for kind in ("joint", "actuator", "tendon"):
        count = {"joint": full.njnt, "actuator": full.nu, "tendon": full.ntendon}[kind]
        for i in range(count):
            assert getattr(small, kind)(i).name == getattr(full, kind)(i).name


@pytest.mark.parametrize("scene", OFTEN)
def test_kept_sites_are_where_they_were(scene):
    full, small = models(scene)
    sites = SCENES[scene].sites
    data = mujoco.MjData(full), mujoco.MjData(small)
    for qpos in configurations(full, SCENES[scene].start(full), 20, seed=1):
        data[0].qpos[:] = data[1].qpos[:] = qpos
        for model, state in zip((full, small), data, strict=True):
            mujoco.mj_kinematics(model, state)
        for site in sites:
            assert np.abs(data[0].site(site).xpos - data[1].site(site).xpos).max() <= ROUNDING


@pytest.mark.parametrize("scene", ONE_PER_BODY)
def test_stateless_model_differs_in_actuators_only(scene):
    small, stateless = models(scene)[1], stateless_model(SCENES[scene])
    assert stateless.na == 0
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos", "jnt_range", "dof_damping"):
        assert np.array_equal(getattr(stateless, name), getattr(small, name)), name
    for name in ("site_pos", "geom_contype", "wrap_objid", "wrap_prm", "qpos0", "actuator_ctrlrange"):
        assert np.array_equal(getattr(stateless, name), getattr(small, name)), name


def test_slim_leaves_the_full_spec_alone():
    full = full_spec(TASKS["myoFingerReachFixed-v0"])
    before = full.to_xml()
    slim(full, ("IFtip",))
    assert full.to_xml() == before


def test_unknown_site():
    with pytest.raises(ValueError, match=r".") as error:
        slim(full_spec(TASKS["myoFingerReachFixed-v0"]), ("IFtip", "IFtop"))
    assert str(error.value) == ("site 'IFtop' unknown in this body; check the names of the task sites")


def random_tree(rng):
    """Return a random model in which all geoms overlap, so that only filters keep them apart."""
    spec = mujoco.MjSpec()
    bodies, geoms = [spec.worldbody], []
    for index in range(int(rng.integers(4, 10))):
        parent = bodies[rng.integers(len(bodies))]
        body = parent.add_body(name=f"body{index}")
        if rng.random() < 0.6:  # the others are welded to their parent
            body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=rng.normal(size=3))
        bodies.append(body)
    for body in bodies:
        for _ in range(int(rng.integers(0, 3)) or int(body is not spec.worldbody)):
            geom = body.add_geom(name=f"geom{len(geoms)}", size=(1.0, 0.0, 0.0))
            geom.pos = rng.uniform(-0.1, 0.1, 3)
            geom.contype, geom.conaffinity = (int(rng.choice((0, 1, 1, 2, 3))) for _ in range(2))
            geoms.append(geom)
    for _ in range(int(rng.integers(0, 4))):
        first, second = rng.choice(np.arange(1, len(bodies)), 2, replace=False)
        spec.add_exclude(bodyname1=bodies[first].name, bodyname2=bodies[second].name)
    for _ in range(int(rng.integers(0, 4))):
        first, second = rng.choice(len(geoms), 2, replace=False)
        spec.add_pair(geomname1=geoms[first].name, geomname2=geoms[second].name)
    if rng.random() < 0.3:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    return spec


def touching(model):
    """Return the pairs of geoms that MuJoCo reports contacts for in the initial pose."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return {tuple(sorted(map(int, geom))) for geom in data.contact.geom[: data.ncon]}


def named(model, pairs):
    """Return pairs of geoms as sets of names; ids differ between models."""
    return {frozenset(model.geom(geom).name for geom in pair) for pair in pairs}


@pytest.mark.parametrize("seed", range(40))
def test_colliding_pairs_are_those_mujoco_tests(seed):
    model = random_tree(np.random.default_rng(seed)).compile()
    expected = touching(model)
    assert colliding_pairs(model) == expected
    assert colliding_geoms(model) == {geom for pair in expected for geom in pair}


def test_random_trees_meet_every_filter():
    """The models above have pairs that touch, excluded bodies, explicit pairs and welded bodies."""
    compiled = [random_tree(np.random.default_rng(seed)).compile() for seed in range(40)]
    assert sum(len(touching(model)) > 3 for model in compiled) > 10
    assert sum(model.nexclude > 0 for model in compiled) > 10
    assert sum(model.npair > 0 for model in compiled) > 10
    welded = [(model.body_weldid != np.arange(model.nbody)).any() for model in compiled]
    assert sum(welded) > 10


@pytest.mark.parametrize("seed", range(40))
def test_slim_keeps_what_can_touch(seed):
    spec = random_tree(np.random.default_rng(seed))
    full, small = spec.compile(), slim(spec, ()).compile()
    pairs = touching(full)
    assert named(small, touching(small)) == named(full, pairs)
    disabled = small.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    assert bool(disabled) == (not pairs)
