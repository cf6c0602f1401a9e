"""Muscle models on every body with muscles, against MuJoCo C and the float64 reference."""

import re
from functools import cache

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from configurations import configurations
from often import covering, often
from reference import mujoco_muscle as reference
from stepping import engine_alone, step

import myowarp.tasks  # noqa: F401
from myowarp.definitions.body import BODIES
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.models.muscles.mujoco import MujocoMuscle, MujocoMuscleParams
from myowarp.models.muscles.mujoco_native import NativeMujocoMuscle
from myowarp.sim.build import compile_scene, stateless_model

NUM_WORLDS = 90  # no multiple of 32

KERNEL_FORCE = 1e-5
"""Of the peak: our kernel given the engine's own length and velocity; float32 roundings of lengths
that are up to 20 times the length over which the force changes, 20 x 2^-24 x 8."""

ENGINE_FORCE = 1e-4
"""Of the peak, MuJoCo C from the same qpos and qvel. The engine's float32 tendon lengths are off by
3e-7 m (points 1.4 m from the origin); a hand muscle with L_0 = 2 cm on the steep part of its curves
turns that into 7e-5 of its own peak. Finger and elbow stay below 1e-5, and every body does relative
to the largest force."""

ACTIVATION = 1e-6
"""An activation of order one, a handful of float32 roundings of 2^-24."""

QVEL = 5e-5
"""Of the largest change of any joint's velocity in one step; float32 factorization of the inertia
matrix, measured 1.2e-5."""
QVEL_OF = {
    "arm": 2e-3,
    "legs": 5e-4,
}  # their joints follow each other by soft equalities, which the solver iterates

EFFECT = 10.0

V_STEP = 1e-6  # m/s, of central differences


FIRST = {TASKS[key].body: TASKS[key] for key in reversed(list(TASKS))}
BODY_TASKS = {body: spec for body, spec in FIRST.items() if BODIES[body].groups}
OFTEN = pytest.mark.parametrize("body", often([*BODY_TASKS], [*BODY_TASKS.keys() - {"contact_hand"}]))
"""The hand that touches things has the muscles of the other one."""
"""The first task of each body that has muscles."""


def muscle_scene(body, num_worlds, physics, muscle):
    """Return a scene in which nothing touches: muscles alone move the joints, in the engine and in C."""
    scene = compile_scene(BODY_TASKS[body], num_worlds, device="cpu", physics=physics, muscle=muscle)
    scene.model.callback.control = scene.muscles.launch
    scene.oracle.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    scene.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return scene


class States:
    """Random states of a scene's oracle, exactly representable in float32; one for each world."""

    def __init__(self, model, num_worlds, seed=0):
        rng = np.random.default_rng(seed)
        shape = (num_worlds, model.nu)
        self.qpos = np.float32(configurations(model, model.qpos0, num_worlds, seed))
        self.qvel = np.float32(rng.normal(size=(num_worlds, model.nv)))
        self.activation = np.float32(rng.uniform(0.0, 1.0, (num_worlds, model.na)))
        self.ctrl = np.float32(rng.uniform(-0.2, 1.2, shape))  # beyond ctrlrange on both sides


def load(scene, states):
    """Write states into a scene and poison what a step has to overwrite."""
    scene.data.qpos.assign(states.qpos)
    scene.data.qvel.assign(states.qvel)
    scene.data.ctrl.assign(states.ctrl)
    scene.muscles.activation.assign(states.activation)
    bias = scene.model.actuator_biasprm.numpy()
    bias[:, scene.muscles.actuator_id] = np.nan
    scene.model.actuator_biasprm.assign(bias)
    scene.data.actuator_force.fill_(np.nan)


def step_in_c(model, states):
    """Return force, activation and qvel of one `mj_step` from each state, built-in muscles."""
    data = mujoco.MjData(model)
    force, activation, qvel = [], [], []
    for i in range(len(states.qpos)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = states.qpos[i], states.qvel[i]
        data.act[:], data.ctrl[:] = states.activation[i], states.ctrl[i]
        mujoco.mj_step(model, data)
        force.append(data.actuator_force.copy())
        activation.append(data.act.copy())
        qvel.append(data.qvel.copy())
    return np.array(force), np.array(activation), np.array(qvel)


def activation_in_step(model, states, fraction):
    """Return the reference's activation after a fraction of a physics step, shape (num_states, na)."""
    ids = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE
    bounds = np.where(model.actuator_ctrllimited[ids, None], model.actuator_ctrlrange[ids], (0.0, 1.0))
    return reference.activation_after(
        fraction * model.opt.timestep,
        np.clip(states.ctrl[:, ids].astype(np.float64), *bounds.T),
        states.activation,
        *model.actuator_dynprm[ids, :2].T,
    )


def step_midstep_in_c(body, oracle, states, implicitness):
    """Return what `step_in_c` does with muscles of the reference: midstep activation, a share of dF/dv."""
    model = stateless_model(BODY_TASKS[body])
    for option in ("integrator", "timestep", "disableflags"):
        setattr(model.opt, option, getattr(oracle.opt, option))
    ids = np.flatnonzero(oracle.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE)
    gainprm, biasprm = oracle.actuator_gainprm[ids], oracle.actuator_biasprm[ids]
    lengthrange, acc0 = oracle.actuator_lengthrange[ids], oracle.actuator_acc0[ids]
    middle, end = (activation_in_step(oracle, states, fraction) for fraction in (0.5, 1.0))
    data = mujoco.MjData(model)
    force, qvel = [], []
    for i, activation in enumerate(middle):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = states.qpos[i], states.qvel[i], states.ctrl[i]
        mujoco.mj_step1(model, data)
        length, velocity = data.actuator_length[ids], data.actuator_velocity[ids]

        def active(v, length=length, activation=activation):
            return activation * reference.gain(length, v, lengthrange, acc0, gainprm)

        pull = active(velocity) + reference.bias(length, lengthrange, acc0, biasprm)
        slope = (active(velocity + V_STEP) - active(velocity - V_STEP)) / (2.0 * V_STEP)
        model.actuator_biasprm[ids, 0] = pull - implicitness * slope * velocity
        model.actuator_biasprm[ids, 2] = implicitness * slope
        mujoco.mj_step2(model, data)
        force.append(data.actuator_force.copy())
        qvel.append(data.qvel.copy())
    return np.array(force), end, np.array(qvel)


def peaks(model):
    """Return the peak force of every muscle [N]."""
    ids = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE
    return reference.peak_force(model.actuator_acc0[ids], model.actuator_gainprm[ids])


def force_from_path(scene, activation, gainprm, biasprm):
    """Return the reference force at the engine's own lengths and velocities."""
    model, ids = scene.oracle, scene.muscles.actuator_id
    length = scene.data.actuator_length.numpy().astype(np.float64)[:, ids]
    velocity = scene.data.actuator_velocity.numpy().astype(np.float64)[:, ids]
    lengthrange, acc0 = model.actuator_lengthrange[ids], model.actuator_acc0[ids]
    active = activation * reference.gain(length, velocity, lengthrange, acc0, gainprm)
    return active + reference.bias(length, lengthrange, acc0, biasprm)


def expected_step(body, scene, states):
    """Return force, activation and qvel of one step in MuJoCo C under the scene's preset."""
    if scene.muscles.midstep:
        return step_midstep_in_c(body, scene.oracle, states, scene.muscles.implicitness)
    return step_in_c(scene.oracle, states)


@cache
def stepped(body, physics):
    """Return scene, states, and what one step in MuJoCo C gives; the scene is stepped once."""
    scene = muscle_scene(body, NUM_WORLDS, physics, "mujoco")
    states = States(scene.oracle, NUM_WORLDS)
    load(scene, states)
    step(scene)
    return scene, states, expected_step(body, scene, states)


@pytest.mark.parametrize("physics", PHYSICS)
@OFTEN
def test_one_step_equals_mujoco(body, physics):
    scene, states, (force, activation, qvel) = stepped(body, physics)
    ids = scene.muscles.actuator_id
    difference = np.abs(scene.data.actuator_force.numpy() - force)[:, ids]
    assert difference.max() <= KERNEL_FORCE * np.abs(force).max()
    assert (difference / peaks(scene.oracle)).max() <= ENGINE_FORCE
    assert np.abs(force[:, ids] / peaks(scene.oracle)).max() > EFFECT * ENGINE_FORCE

    assert np.abs(scene.muscles.activation.numpy() - activation).max() <= ACTIVATION
    assert np.abs(states.activation - activation).max() > EFFECT * ACTIVATION

    scale = np.abs(qvel - states.qvel).max()
    assert np.abs(scene.data.qvel.numpy() - qvel).max() <= QVEL_OF.get(body, QVEL) * scale


@pytest.mark.parametrize("physics", PHYSICS)
@OFTEN
def test_kernel_equals_reference(body, physics):
    scene, states, _ = stepped(body, physics)
    model, ids = scene.oracle, scene.muscles.actuator_id
    midstep = scene.muscles.midstep
    activation = activation_in_step(model, states, 0.5) if midstep else states.activation
    expected = force_from_path(scene, activation, model.actuator_gainprm[ids], model.actuator_biasprm[ids])
    error = np.abs(scene.data.actuator_force.numpy()[:, ids] - expected) / peaks(model)
    assert error.max() <= KERNEL_FORCE


@OFTEN
def test_force_comes_from_the_callback(body):
    scene = muscle_scene(body, 33, "parity", "mujoco")
    states = States(scene.oracle, 33)
    force, _, _ = step_in_c(scene.oracle, states)
    load(scene, states)
    scene.model.actuator_biasprm.zero_()
    scene.model.callback.control = None
    engine_alone(mjw.forward)(scene.model, scene.data)
    difference = np.abs(scene.data.actuator_force.numpy() - force)[:, scene.muscles.actuator_id]
    assert np.all(difference.max(axis=0) > EFFECT * ENGINE_FORCE * peaks(scene.oracle))


@OFTEN
def test_implicit_integrator_needs_the_force_slope(body):
    """The same force without kv moves the velocity after one step by much more than the tolerance."""
    scene = muscle_scene(body, 33, "fast", "mujoco")
    states = States(scene.oracle, 33)
    _, _, qvel = expected_step(body, scene, states)

    def without_slope(model, data):
        scene.muscles.launch(model, data)
        bias = model.actuator_biasprm.numpy()
        bias[..., 0] += bias[..., 2] * data.actuator_velocity.numpy()
        bias[..., 2] = 0.0
        model.actuator_biasprm.assign(bias)

    load(scene, states)
    scene.model.callback.control = without_slope
    engine_alone(mjw.step)(scene.model, scene.data)
    scale = np.abs(qvel - states.qvel).max()
    assert np.abs(scene.data.qvel.numpy() - qvel).max() > EFFECT * QVEL * scale


GAIN_COLUMN = {"max_isometric_force": 2, "max_contraction_velocity": 6}
BIAS_COLUMN = {"passive_peak_force": 2, "passive_multiplier": 7}
VARIED = {**GAIN_COLUMN, **BIAS_COLUMN}


@pytest.mark.parametrize("widened", [*VARIED, "all"])
def test_parameters_of_each_world(widened):
    """Any array may be (num_worlds, num_muscles) while others are (1, num_muscles)."""
    num_worlds = 3
    scene = muscle_scene("elbow", num_worlds, "parity", "mujoco")
    model, ids, params = scene.oracle, scene.muscles.actuator_id, scene.muscles.params
    states = States(model, num_worlds)
    for values in vars(states).values():
        values[:] = values[0]  # only the parameters differ
    factor = np.array([1.0, 0.5, 0.8])[:, None]
    gain = np.tile(model.actuator_gainprm[ids], (num_worlds, 1, 1))
    bias = np.tile(model.actuator_biasprm[ids], (num_worlds, 1, 1))
    if widened == "all":
        for name in MujocoMuscleParams.vars:
            array = getattr(params, name)
            if array.ndim == 2:
                wide = np.repeat(array.numpy(), num_worlds, axis=0)
                setattr(params, name, wp.array(wide, dtype=array.dtype, device="cpu"))
    for name in VARIED if widened == "all" else [widened]:
        prm = gain if name in GAIN_COLUMN else bias
        prm[..., VARIED[name]] *= factor
        values = wp.array(prm[..., VARIED[name]], dtype=float, device="cpu")
        setattr(params, name, values)
    load(scene, states)
    engine_alone(mjw.forward)(scene.model, scene.data)
    force = scene.data.actuator_force.numpy()[:, ids]
    expected = force_from_path(scene, states.activation, gain, bias)
    assert np.abs((force - expected) / peaks(model)).max() <= KERNEL_FORCE
    difference = np.abs(expected[1:] - expected[0]) / peaks(model)
    assert np.all(difference.max(axis=1) > EFFECT * KERNEL_FORCE)


TINY = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="hinge" axis="0 1 0" range="-1 1" limited="true"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
    </body>
  </worldbody>
  <actuator>
    <muscle joint="hinge" lengthrange="-0.5 0.5"/>
    <muscle joint="hinge" lengthrange="-1 1" ctrllimited="true" ctrlrange="0.2 0.7" force="50"/>
    <muscle joint="hinge" lengthrange="-0.7 1.2" tausmooth="0.4" timeconst="0.02 0.06"
            range="0.6 1.2" lmin="0.4" lmax="1.5" vmax="3" fpmax="0.9" fvmax="1.5"/>
  </actuator>
</mujoco>
"""


def test_options_of_a_muscle():
    """Force from scale and acc0, no or a narrow ctrlrange, smooth switch: as MuJoCo C."""
    model = mujoco.MjModel.from_xml_string(TINY)
    num_worlds = 101
    states = States(model, num_worlds)
    states.ctrl = np.float32(np.random.default_rng(1).uniform(-0.5, 1.5, states.ctrl.shape))
    expected_force, expected_activation, _ = step_in_c(model, states)
    with wp.ScopedDevice("cpu"):
        muscles = MujocoMuscle(model, num_worlds)
        engine = mjw.put_model(model, batch_sizes={"actuator_biasprm": num_worlds})
        data = mjw.make_data(model, nworld=num_worlds)
        muscles.activation.assign(states.activation)
        data.ctrl.assign(states.ctrl)
        data.actuator_length.assign(np.repeat(states.qpos, 3, axis=1))
        data.actuator_velocity.assign(np.repeat(states.qvel, 3, axis=1))
        muscles.launch(engine, data)
    bias = engine.actuator_biasprm.numpy()
    force = bias[..., 0] + bias[..., 2] * data.actuator_velocity.numpy()
    assert np.abs((force - expected_force) / peaks(model)).max() <= KERNEL_FORCE
    assert np.abs(muscles.activation.numpy() - expected_activation).max() <= ACTIVATION


TWIN = 2e-6
"""Two ways to round the same law; of the peak, or an activation of order one."""

PUBLISHED = ("activation", "workload", "tension", "length", "velocity", "damping")


def random_muscles(num_worlds, num_muscles):
    """Return an `MjModel` of muscles, and random parameters of every muscle in every world."""
    muscle = '<muscle joint="hinge" lengthrange="-0.5 0.5"/>'
    model = mujoco.MjModel.from_xml_string(
        re.sub("<muscle[^>]*>", "", TINY).replace("</actuator>", num_muscles * muscle + "</actuator>")
    )
    rng = np.random.default_rng(3)
    shape = (num_worlds, num_muscles)
    ranges = {
        "activation_time_constant": (0.005, 0.03),
        "deactivation_time_constant": (0.02, 0.08),
        "max_isometric_force": (50.0, 900.0),
        "optimal_fiber_length": (0.3, 0.9),
        "tendon_slack_length": (-0.9, -0.4),
        "min_norm_length": (0.1, 0.7),
        "max_norm_length": (1.3, 1.9),
        "max_contraction_velocity": (1.0, 9.0),
        "eccentric_multiplier": (1.05, 1.8),
        "passive_peak_force": (50.0, 900.0),
        "passive_optimal_length": (0.3, 0.9),
        "passive_slack_length": (-0.9, -0.4),
        "passive_max_norm_length": (1.3, 1.9),
        "passive_multiplier": (0.2, 2.0),
    }
    values = {name: rng.uniform(*bounds, shape) for name, bounds in ranges.items()}
    values["smoothing_width"] = np.where(rng.random(shape) < 0.7, 0.0, rng.uniform(0.1, 1.0, shape))
    low = rng.uniform(0.0, 0.3, shape)
    values["excitation_range"] = np.stack([low, low + rng.uniform(0.2, 0.7, shape)], axis=-1)
    return model, values


@pytest.mark.parametrize("implicitness", [0.0, 0.5])
@pytest.mark.parametrize("midstep", [False, True])
def test_native_twin_equals_the_readable_law(midstep, implicitness):
    num_worlds, num_muscles = 11, 3  # a full SIMD register and a part of one
    model, values = random_muscles(num_worlds, num_muscles)
    results = []
    for muscle in (MujocoMuscle, NativeMujocoMuscle):
        rng = np.random.default_rng(4)
        shape = (num_worlds, num_muscles)
        with wp.ScopedDevice("cpu"):
            muscles = muscle(model, num_worlds)
            muscles.midstep, muscles.implicitness = midstep, implicitness
            muscles.individualize()
            muscles.record_workload()
            engine = mjw.put_model(model, batch_sizes={"actuator_biasprm": num_worlds})
            data = mjw.make_data(model, nworld=num_worlds)
            for name, array in values.items():
                dtype = getattr(muscles.params, name).dtype
                setattr(muscles.params, name, wp.array(array, dtype=dtype))
        assert set(values) == set(MujocoMuscleParams.vars) - {"actuator_id"}
        muscles.anatomy.path.assign(np.array([rng.permutation(num_muscles) for _ in range(num_worlds)]))
        muscles.anatomy.strength.assign(rng.uniform(0.2, 1.0, shape))
        muscles.anatomy.transmission.assign(rng.uniform(0.2, 1.0, shape))
        for name in ("tension", "length", "velocity", "damping"):
            getattr(muscles, name).fill_(np.nan)
        engine.actuator_biasprm.fill_(np.nan)
        muscles.workload.assign(rng.uniform(size=shape))
        muscles.activation.assign(rng.uniform(size=shape))
        data.ctrl.assign(rng.uniform(-0.2, 1.2, shape))
        data.actuator_length.assign(rng.uniform(-0.5, 0.5, shape))
        data.actuator_velocity.assign(rng.normal(size=shape))
        muscles.launch(engine, data)
        bias = engine.actuator_biasprm.numpy()
        results.append({name: getattr(muscles, name).numpy().copy() for name in PUBLISHED} | {"bias": bias})
        path = muscles.anatomy.path.numpy()
        pulled = np.take_along_axis(bias, path[..., None], axis=1)
        assert np.array_equal(
            muscles.length.numpy(), np.take_along_axis(data.actuator_length.numpy(), path, 1)
        )
        force = pulled[..., 0] + pulled[..., 2] * muscles.velocity.numpy()
        assert np.abs(muscles.tension.numpy() + force).max() <= TWIN * 900.0
        assert muscles.tension.numpy().min() >= 0.0
    readable, native = results
    for name in readable:
        scale = 1.0 if name in ("activation", "workload", "length", "velocity") else 900.0
        assert np.abs(readable[name] - native[name]).max() <= TWIN * scale, name
        worlds = np.abs(readable[name][0] - readable[name][1])
        assert (name == "damping" and not implicitness) or worlds.max() > EFFECT * TWIN * scale, name


PAIRS = [
    (body, muscle) for body in sorted(BODY_TASKS, key=lambda body: BODIES[body].large) for muscle in MUSCLES
]


@pytest.mark.parametrize("pair", often(PAIRS, covering(PAIRS, tuple)), ids="-".join)
def test_every_model_pulls_and_resets_by_mask(pair):
    num_worlds, (body, muscle) = 33, pair
    scene = muscle_scene(body, num_worlds, "parity", muscle)
    states = States(scene.oracle, num_worlds)
    for name in ("qpos", "qvel", "activation", "ctrl"):
        getattr(states, name)[-1] = getattr(states, name)[0]
    load(scene, states)
    engine_alone(mjw.forward)(scene.model, scene.data)
    force = scene.data.actuator_force.numpy()[:, scene.muscles.actuator_id]
    assert np.isfinite(scene.model.actuator_biasprm.numpy()).all()
    assert np.all(force <= KERNEL_FORCE * peaks(scene.oracle))
    assert np.all(force[0] == force[-1]), "the force depends on which world it is"

    before = scene.muscles.activation.numpy().copy()  # numpy() is a view on the CPU
    mask = np.arange(num_worlds) % 2 == 0
    scene.muscles.reset(wp.array(mask, dtype=bool, device="cpu"))
    after = scene.muscles.activation.numpy()
    assert np.all(after[~mask] == before[~mask])
    assert np.all(after[mask] == 0.0)
    assert np.abs(before[mask]).max() > 0.1
