"""The end of a step against MuJoCo C, NumPy in float64 and the engine's own launches."""

from types import SimpleNamespace
from unittest import mock

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from configurations import configurations
from mujoco_warp._src import forward
from mujoco_warp._src.types import DisableBit, IntegratorType
from often import often
from stepping import engine_alone, launch_place, step

from myowarp.definitions.task import TASKS
from myowarp.engine.stages import integrate as integrate_file
from myowarp.engine.stages.affine_actuators import AffineActuators
from myowarp.engine.stages.integrate import Integrate, integrate
from myowarp.sim.simulation import Simulation

NUM_WORLDS = 17
ROUNDING = 2e-6  # of the largest acceleration; condition numbers below 200
CLOSE = 1e-5  # of the largest change of velocity in a world; float32 forces against float64
PLACE = 1e-6  # rad, m: float32 of numbers up to 4, and what CLOSE leaves after a step
ENGINE = 2e-5  # of the largest change of velocity; two float32 factorisations of the same matrix
EFFECT = 10.0

LEAF = '<body pos="0 0 0.1"><joint axis="1 0 0"/><joint axis="0 1 0"/><geom size="0.05"/>{inside}</body>'
TREE = LEAF.format(inside=LEAF.format(inside=LEAF.format(inside="") * 2) + LEAF.format(inside=""))
APART = '<mujoco><option><flag contact="disable"/></option>'
TREES = {
    "tree": f"{APART}<worldbody>{TREE}</worldbody></mujoco>",
    "two trees": f"{APART}<worldbody>{TREE}<body pos='1 0 0'><freejoint/><geom size='0.1 0.2 0.3' "
    "type='ellipsoid'/></body></worldbody></mujoco>",
}
MACHINE = """
<mujoco><option timestep="0.01" integrator="{integrator}"><flag contact="disable"/></option><worldbody>
  <site name="wall" pos="0.2 0.1 0.3"/>
  <body><joint name="slide" type="slide" axis="1 0 1" damping="2 0.5 0.3"/><geom size="0.1"/>
    <body pos="0 0 0.3"><joint name="hinge" axis="0 1 0" damping="0.05 0.02 0.01"/><geom size="0.1" mass="1"/>
      <site name="low" pos="0 0.1 0.1"/>
      <body pos="0 0.3 0.1"><joint type="ball" damping="0.05 0.03 0.02"/>
        <geom type="ellipsoid" size="0.1 0.2 0.3" pos="0 0 0.2" mass="2"/><site name="high" pos="0.1 0 0.1"/>
      </body>
      <body pos="0 -0.3 0.1"><joint name="finger" axis="1 1 0"/>
        <geom size="0.1" pos="0 0.1 0.1" mass="1"/>
      </body>
    </body>
  </body>
  {more}
</worldbody>
<tendon>
  <spatial name="short"><site site="wall"/><site site="low"/></spatial>
  <spatial name="long"><site site="wall"/><site site="low"/><site site="high"/></spatial>
</tendon>
<actuator>
  <position joint="slide" kp="50" kv="20"/>
  <velocity joint="finger" kv="3" forcelimited="true" forcerange="-2 2"/>
  <general tendon="short" gainprm="7" biastype="affine" biasprm="0.3 -2 -15"/>
  <general tendon="long" gainprm="7" biastype="affine" biasprm="0.3 -2 -15" {filter}/>
  <general joint="hinge" biastype="none" biasprm="0 0 -5"/>
</actuator></mujoco>"""
BRICKS = """
<body pos="1 0 0"><freejoint/><geom type="box" size="0.1 0.2 0.3" pos="0.1 0.1 0"/></body>
<body pos="2 0 0"><joint type="free" damping="0.1 0.2 0.3"/><geom type="box" size="0.3 0.1 0.05"/></body>"""
FILTER = 'dyntype="filter" dynprm="0.05" actearly="true"'
MACHINES = {"joints": ("", ""), "with free bodies": (BRICKS, ""), "with states": (BRICKS, FILTER)}
INTEGRATORS = ("Euler", "implicitfast")


def machine(name, integrator):
    """Return a model in C."""
    more, dynamics = MACHINES[name]
    return mujoco.MjModel.from_xml_string(MACHINE.format(integrator=integrator, more=more, filter=dynamics))


def scene_of(host, num_worlds=NUM_WORLDS):
    """Return what the stage needs of a scene, on the CPU."""
    model, data = mjw.put_model(host), mjw.make_data(host, nworld=num_worlds, njmax=1)
    model.opt.warn_overflow = 0
    return SimpleNamespace(model=model, data=data, device=wp.get_device("cpu"))


def random_states(host):
    """Return float32 states of all worlds, by their names in both engines; some turn fast."""
    rng = np.random.default_rng(0)
    states = {
        "qpos": configurations(host, host.qpos0, NUM_WORLDS, seed=1),
        "qvel": rng.normal(size=(NUM_WORLDS, host.nv)) * np.geomspace(0.1, 5.0, NUM_WORLDS)[:, None],
        "ctrl": rng.normal(size=(NUM_WORLDS, host.nu)),
        "act": rng.normal(size=(NUM_WORLDS, host.na)),
        "time": rng.uniform(size=NUM_WORLDS),
    }
    return {name: values.astype(np.float32) for name, values in states.items()}


def random_parameters(host):
    """Return other parameters for each world, by their names in both engines."""
    factors = np.random.default_rng(2).uniform(0.5, 2.0, (NUM_WORLDS, 1))
    slopes = np.tile(host.actuator_biasprm, (NUM_WORLDS, 1, 1))
    slopes[:, :, 2] *= factors
    return {
        "dof_damping": host.dof_damping * factors,
        "dof_dampingpoly": host.dof_dampingpoly * factors[:, :, None],
        "actuator_biasprm": slopes,
        "actuator_forcerange": host.actuator_forcerange * factors[:, :, None],
    }


def stepped_by_c(host, states, parameters, timesteps):
    """Return states after a step of MuJoCo C, and explicit changes of velocity."""
    data, ends, explicit = mujoco.MjData(host), {name: [] for name in states}, []
    for world in range(NUM_WORLDS):
        mujoco.mj_resetData(host, data)
        host.opt.timestep = timesteps[world]
        for name, values in parameters.items():
            getattr(host, name)[:] = values[world]
        for name, values in states.items():
            setattr(data, name, values[world])
        mujoco.mj_step(host, data)
        explicit.append(host.opt.timestep * data.qacc)
        for name, values in ends.items():
            values.append(np.copy(getattr(data, name)))
    return {name: np.array(values) for name, values in ends.items()}, np.array(explicit)


def relative(ours, theirs):
    """Return the error of every world as a share of its largest entry."""
    return np.abs(ours - theirs).max(axis=1) / np.abs(theirs).max(axis=1)


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_step_is_that_of_mujoco_c(name, integrator):
    """Every kind of joint, polynomial damping and actuators, in worlds with different parameters."""
    host = machine(name, integrator)
    states, parameters = random_states(host), random_parameters(host)
    timesteps = np.linspace(0.005, 0.02, NUM_WORLDS)
    with wp.ScopedDevice("cpu"):
        scene = scene_of(host)
        assert Integrate.obstacle(scene) is None
        for field, values in parameters.items():
            setattr(scene.model, field, wp.array(values, dtype=getattr(scene.model, field).dtype))
        scene.model.opt.timestep = wp.array(timesteps, dtype=float)
        for field, values in states.items():
            getattr(scene.data, field).assign(values)
        step(scene, [Integrate(scene)])
    ours = {field: getattr(scene.data, field).numpy().astype(float) for field in states}
    theirs, explicit = stepped_by_c(host, states, parameters, timesteps)
    change = theirs["qvel"] - states["qvel"]
    assert relative(ours["qvel"] - states["qvel"], change).max() < CLOSE
    assert relative(explicit, change).min() > EFFECT * CLOSE
    for field in ("qpos", "act", "time"):
        np.testing.assert_allclose(ours[field], theirs[field], rtol=0, atol=PLACE)
    assert np.all(np.abs(theirs["qpos"] - states["qpos"]).max(axis=1) > EFFECT * PLACE)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_bits_of_a_world_depend_on_no_other(integrator):
    """Worlds with parameters of their own: the same bits in a block, in another order, and alone."""
    host = machine("joints", integrator)
    states, parameters = random_states(host), random_parameters(host)
    fields = ("qpos", "qvel", "time", "qacc_warmstart", "actuator_force", "qfrc_actuator")

    def stepped(worlds):
        with wp.ScopedDevice("cpu"):
            scene = scene_of(host, len(worlds))
            for field, values in parameters.items():
                dtype = getattr(scene.model, field).dtype
                setattr(scene.model, field, wp.array(values[worlds], dtype=dtype))
            for field, values in states.items():
                getattr(scene.data, field).assign(values[worlds])
            step(scene, [AffineActuators(scene), Integrate(scene)])
            return {field: getattr(scene.data, field).numpy() for field in fields}

    order = np.random.default_rng(5).permutation(NUM_WORLDS)
    together, shuffled = stepped(np.arange(NUM_WORLDS)), stepped(order)
    alone = [stepped(np.array([world])) for world in range(NUM_WORLDS)]
    for field in fields:
        assert np.ptp(together[field], axis=0).max() > EFFECT * CLOSE, field
        np.testing.assert_array_equal(shuffled[field], together[field][order], err_msg=field)
        apart = np.concatenate([one[field] for one in alone])
        np.testing.assert_array_equal(apart, together[field], err_msg=field)


@pytest.mark.parametrize(
    "flags", ["-march=native -DMYOWARP_LANES=1", pytest.param("-DMYOWARP_LANES=4", marks=pytest.mark.slow)]
)
def test_narrow_registers_leave_the_same_bits(flags, monkeypatch):
    """As where a compiler or a machine has none; other flags are another key of the cache."""
    host = machine("joints", "Euler")
    states, ends = random_states(host), []
    narrow = wp.kernel(integrate.func, module="unique", module_options={"cpu_compiler_flags": flags})
    assert narrow.module.get_module_hash() != integrate.module.get_module_hash()
    for kernel in (integrate, narrow):
        monkeypatch.setattr(integrate_file, "integrate", kernel)
        with wp.ScopedDevice("cpu"):
            scene = scene_of(host)
            for field, values in states.items():
                getattr(scene.data, field).assign(values)
            step(scene, [Integrate(scene)])
            ends.append(np.concatenate([scene.data.qpos.numpy(), scene.data.qvel.numpy()], axis=1))
    np.testing.assert_array_equal(ends[1], ends[0])


@pytest.mark.parametrize(
    ("name", "implicit_actuators"), [("tree", False), ("tree", True), ("two trees", False)]
)
def test_solution_is_that_of_the_dense_system(name, implicit_actuators):
    """The matrix is M, with h times the damping on its diagonal; there are no actuators."""
    host = mujoco.MjModel.from_xml_string(TREES[name])
    rng = np.random.default_rng(0)
    with wp.ScopedDevice("cpu"):
        scene = scene_of(host)
        model, data = scene.model, scene.data
        data.qpos.assign(data.qpos.numpy() + rng.normal(size=(NUM_WORLDS, host.nq)))
        engine_alone(mjw.fwd_position)(model, data)
        damping = rng.uniform(0.0, 1.0, (NUM_WORLDS, host.nv))
        model.dof_damping = wp.array(damping, dtype=float)
        data.efc.Ma.assign(rng.normal(size=(NUM_WORLDS, host.nv)))
        stage = Integrate(scene)
        stage.acceleration.fill_(np.nan)
        stage.advance(model, data, implicit_actuators, advance=False)
    expected, oracle, M = [], mujoco.MjData(host), np.zeros((host.nv, host.nv))
    for world in range(NUM_WORLDS):
        oracle.M[:] = data.M.numpy()[world]
        mujoco.mj_fullM(host, oracle, M)
        system = M + host.opt.timestep * np.diag(damping[world])
        expected.append(np.linalg.solve(system, data.efc.Ma.numpy()[world].astype(float)))
        without = np.linalg.solve(M, data.efc.Ma.numpy()[world].astype(float))
        assert np.abs(without - expected[-1]).max() > EFFECT * ROUNDING * np.abs(expected[-1]).max()
    assert np.abs(expected).max() > 10
    assert np.abs(stage.acceleration.numpy() - expected).max() <= ROUNDING * np.abs(expected).max()


KEPT = ("time", "overflow", "qacc_warmstart")


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(("contacts", "found"), [(0, 0), (5, 9), (4, 5), (5, 4)])
def test_bookkeeping_is_that_of_the_engine(integrator, contacts, found):
    """Time, warm start and what was too small: bit for bit, flags of earlier steps included."""
    host = machine("with free bodies", integrator)
    states, ends = random_states(host), []
    with wp.ScopedDevice("cpu"):
        for ours in (False, True):
            scene = scene_of(host)
            data = scene.data
            for field, values in states.items():
                getattr(data, field).assign(values)
            engine_alone(mjw.forward)(scene.model, data)
            data.naconmax = 4
            data.nacon.fill_(contacts), data.ncollision.fill_(found)
            data.nefc.assign(np.arange(NUM_WORLDS) % 3)
            data.overflow.assign(np.arange(NUM_WORLDS) % 2 * 64)
            launch_place(scene, "integrate", [Integrate(scene)] if ours else [])
            ends.append([getattr(data, field).numpy().copy() for field in KEPT])
    for theirs, mine in zip(*ends, strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert len(np.unique(theirs)) > 3


def test_free_bodies_fall_back_on_their_plain_inertia():
    """So does the engine where its own system of a free body is singular; here it leaves all of them out."""
    host = machine("with free bodies", "implicitfast")
    states, ends = random_states(host), []
    free = slice(host.nv - 12, None)
    with (
        wp.ScopedDevice("cpu"),
        mock.patch.object(forward, "implicit_free_body"),
        mock.patch("myowarp.engine.stages.integrate.implicit_free_body"),
    ):
        scene = scene_of(host)
        for stages in ((), (Integrate(scene),)):
            for field, values in states.items():
                getattr(scene.data, field).assign(values)
            step(scene, stages)
            ends.append(scene.data.qvel.numpy()[:, free] - states["qvel"][:, free])
    assert relative(ends[1], ends[0]).max() < CLOSE
    damped, _ = stepped_by_c(host, states, {}, np.full(NUM_WORLDS, host.opt.timestep))
    assert relative(damped["qvel"][:, free] - states["qvel"][:, free], ends[0]).min() > EFFECT * CLOSE


TASK_STEPS = {
    "myoHandPoseRandom-v0": "fast",
    "myoFingerReachRandom-v0": "fast",
    "myoHandObjHoldRandom-v0": "fast",
    "myoChallengeBaodingP1-v1": "parity",
}


@pytest.mark.parametrize("key", often([*TASK_STEPS], ["myoHandPoseRandom-v0"]))
def test_tasks_end_their_steps_as_the_engine_does(key):
    """From states of motion, with the slopes of our muscles; and from the second step on."""
    sim = Simulation(
        TASKS[key], 4, device="cpu", physics=TASK_STEPS[key], graph=False, progress=False, stages=()
    )
    rng, data = np.random.default_rng(0), sim.scene.data
    sim.reset(seeds=np.arange(4))
    for _ in range(3):
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape))
        sim.step()
    fields = ("qpos", "qvel", "qacc_warmstart", "time")
    start = [getattr(data, field).numpy().copy() for field in fields]
    activation = sim.scene.muscles.activation.numpy().copy()
    ends = []
    for stages in ((), (Integrate(sim.scene),)):
        for field, values in zip(fields, start, strict=True):
            getattr(data, field).assign(values)
        sim.scene.muscles.activation.assign(activation)
        with wp.ScopedDevice("cpu"):
            step(sim.scene, stages)
        ends.append([getattr(data, field).numpy().copy() for field in fields])
    changes = [end[1] - start[1] for end in ends]
    assert relative(changes[1], changes[0]).max() < ENGINE
    assert np.abs(changes[0]).max() > EFFECT * ENGINE
    np.testing.assert_allclose(ends[1][0], ends[0][0], rtol=0, atol=PLACE)
    for ours, theirs in zip(ends[1][2:], ends[0][2:], strict=True):
        np.testing.assert_array_equal(ours, theirs)


OBSTACLES = {
    "the device is not the CPU": lambda s: setattr(s, "device", SimpleNamespace(is_cpu=False)),
    "the integrator is neither Euler nor implicitfast": lambda s: setattr(
        s.model.opt, "integrator", IntegratorType.RK4
    ),
    "nothing moves": lambda s: setattr(s.model, "nv", 0),
    "a row of the inertia matrix does not begin with the rows above it": lambda s: s.model.M_colind.fill_(1),
    "forces are integrated explicitly": lambda s: setattr(
        s.model.opt, "disableflags", int(DisableBit.DAMPER)
    ),
    "actuators damp joints or tendons": lambda s: s.model.actuator_damping.fill_(1.0),
    "there are plastic springs": lambda s: setattr(s.model, "nplastic", 1),
    "overflows are to be printed": lambda s: setattr(s.model.opt, "warn_overflow", 1),
}
SLOPES = {
    "a gain may depend on velocity": lambda s: s.model.actuator_gaintype.fill_(int(mjw.GainType.AFFINE)),
    "there are DC motors": lambda s: s.model.actuator_biastype.fill_(int(mjw.BiasType.DCMOTOR)),
    "forces are limited at tendons or joints": lambda s: s.model.jnt_actfrclimited.fill_(True),
    "tendons are damped": lambda s: s.model.tendon_damping.fill_(1.0),
    "a fluid resists": lambda s: setattr(s.model, "has_fluid", True),
}
"""These hinder implicitfast only."""


@pytest.mark.parametrize("reason", OBSTACLES | SLOPES)
def test_obstacles(reason):
    with wp.ScopedDevice("cpu"):
        for integrator in INTEGRATORS:
            scene = scene_of(machine("joints", integrator))
            assert Integrate.obstacle(scene) is None
            (OBSTACLES | SLOPES)[reason](scene)
            hinders = integrator == "implicitfast" or reason in OBSTACLES
            assert Integrate.obstacle(scene) == (reason if hinders else None)
