"""Reward terms and observations on top of a task, against MuJoCo C and NumPy."""

import dataclasses
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import warp as wp

import myowarp
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation

pytestmark = pytest.mark.usefixtures("registered")

ELBOW = "myoElbowPose1D6MRandom-v0"
REACH = "myoFingerReachRandom-v0"
ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(myowarp.__file__).parents[1]), "CUDA_VISIBLE_DEVICES": ""}
FLOAT32 = 2e-6  # relative
NEWTON = 1e-2  # N of some hundred: velocities are read back from float32
METER = 2e-6  # m
SPEED = 2e-5  # m/s


@wp.func
def effort(excitation: wp.array[float]) -> float:
    """Sum of squared excitations."""
    total = float(0.0)
    for muscle in range(excitation.shape[0]):
        total += excitation[muscle] * excitation[muscle]
    return total


@wp.func
def lean(qpos: wp.array[float], target: wp.array[float], activation: wp.array[float]) -> wp.vec3:
    return wp.vec3(qpos[0], target[0], activation[1])


@wp.func
def height(site_xpos: wp.array[wp.vec3]) -> float:
    return site_xpos[1][2] - site_xpos[0][2]


@wp.func
def pull(tension: wp.array[float]) -> float:
    return wp.max(tension[0], tension[1])


@wp.func
def wrong_type(qpos: wp.array[wp.vec3]) -> float:
    return qpos[0][0]


@wp.func
def wrong_name(qposs: wp.array[float]) -> float:
    return qposs[0]


@wp.func
def of_target(target: wp.array[wp.vec3]) -> float:
    return target[0][0]


@wp.func
def no_result(qpos: wp.array[float]):
    return qpos[0]


@wp.func
def no_type(qpos) -> float:
    return qpos[0]


@wp.func
def a_matrix(qpos: wp.array[float]) -> wp.mat33:
    return wp.identity(3, float)


@wp.func
def undefined_symbol(qpos: wp.array[float]) -> float:
    return something(qpos)  # noqa: F821


@wp.func
def of_undefined(qpos: wp.array[float]) -> float:
    return undefined_symbol(qpos)


@wp.func
def an_int(qpos: wp.array[float]) -> float:
    return 1


@wp.func
def on_one_way(qpos: wp.array[float]) -> float:
    if qpos[0] > 0.0:
        return 1.0


@wp.func
def endless(qpos: wp.array[float]) -> float:
    return endless(qpos)


@wp.func
def a_double(qpos: wp.array[float]) -> wp.vec3d:
    return wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0))


@wp.func
def overwrite(values: wp.array[float]):
    values[0] = 1.0


@wp.func
def meddling(qpos: wp.array[float]) -> float:
    overwrite(qpos)
    return 0.0


@wp.func
def adding(activation: wp.array[float]) -> float:
    wp.atomic_add(activation, 0, 1.0)
    return 0.0


@wp.func
def of_own(qpos: wp.array[float]) -> wp.vec2:
    """Two numbers,
    of which the second is made here.

    This is for those who read the code.
    """
    total = wp.vec2(qpos[0], 0.0)
    total[1] += 2.0
    return total


def rich(base=ELBOW, key="testRich-v0", sites=("wrist", "r_ulna_radius_hand"), **options):
    """A task with one of everything."""
    return myowarp.extend(
        base,
        key,
        rewards={"effort": (-0.1, effort), "height": (0.5, height), "pull": (1e-3, pull), "bonus": 2.0},
        observations={
            "tension": "tension",
            "length": "length",
            "velocity": "velocity",
            "excitation": "excitation",
            "places": "site_xpos",
            "lean": ("rad", lean),
        },
        sites=sites,
        **options,
    )


def sites_of(body):
    spec = myowarp.BODIES[body].build()
    return tuple(site.name for site in spec.sites)[:2]


def rolled(task, num_worlds=6, steps=24, **options):
    """Return the simulation, and what it gave in steps with resets."""
    settings = {"device": "cpu", "progress": False, "autoreset": "same_step", "horizon": 10} | options
    sim = Simulation(task, num_worlds, **settings)
    sim.reset(seeds=np.arange(num_worlds))
    rows = {name: [] for name in ("obs", "reward", "terms", "terminated")}
    first = sim.transition.obs.numpy().copy()
    for step in range(steps):
        draws = [
            np.random.default_rng((step, w)).uniform(-1, 1, sim.action.shape[1]) for w in range(num_worlds)
        ]
        sim.action.assign(np.array(draws, dtype=np.float32))
        sim.step()
        for name, values in rows.items():
            values.append(getattr(sim.transition, name).numpy().copy())
    return sim, first, {name: np.array(values) for name, values in rows.items()}


def blocks(sim):
    ends = np.cumsum([column.size for column in sim.columns])
    return {c.name: slice(end - c.size, end) for c, end in zip(sim.columns, ends, strict=True)}


def check_state(sim, row, dt):
    """Compare the extension's columns of an observation with MuJoCo C in the same state."""
    where, model = blocks(sim), sim.full_model
    data = mujoco.MjData(model)
    data.qpos[:] = row[where["qpos"]]
    data.qvel[:] = row[where["qvel"]] / dt
    data.act[:] = row[where["act"]]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(row[where["length"]], data.actuator_length, atol=METER)
    np.testing.assert_allclose(row[where["velocity"]], data.actuator_velocity, atol=SPEED)
    np.testing.assert_allclose(row[where["tension"]], -data.actuator_force, atol=NEWTON)
    places = [data.site(name).xpos for name in sim.scene.spec.extension.sites]
    np.testing.assert_allclose(row[where["places"]], np.ravel(places), atol=METER)
    return -data.actuator_force, np.array(places)


def test_quantities_are_those_of_the_state_in_mujoco():
    """In every observation, the first of an episode included."""
    task = rich(sites=sites_of("elbow"))
    sim, first, rows = rolled(task)
    for row in (*first, *rows["obs"][[0, 5, 9, 10, 19, 23]].reshape(-1, first.shape[1])):
        tension, _ = check_state(sim, row, task.control_dt)
    assert tension.max() > 10 * NEWTON
    where = blocks(sim)
    assert np.ptp(rows["obs"][..., where["length"]]) > 10 * METER
    lean_, target = (
        rows["obs"][..., where["lean"]],
        rows["obs"][..., where["qpos"]] + rows["obs"][..., where["pose_err"]],
    )
    np.testing.assert_allclose(lean_[..., 0], rows["obs"][..., where["qpos"]][..., 0])
    np.testing.assert_allclose(lean_[..., 1], target[..., 0], atol=FLOAT32)
    np.testing.assert_allclose(lean_[..., 2], rows["obs"][..., where["act"]][..., 1])


def test_reward_is_the_weighted_sum():
    task = rich(sites=sites_of("elbow"))
    sim, _, rows = rolled(task, autoreset="disabled", horizon=100)
    where, obs = blocks(sim), rows["obs"].astype(np.float64)
    names = [term.name for term in sim.terms]
    assert names[-3:] == ["effort", "height", "pull"]
    terms = dict(zip(names, np.moveaxis(rows["terms"], 2, 0), strict=True))
    places = obs[..., where["places"]]
    np.testing.assert_allclose(terms["effort"], (obs[..., where["excitation"]] ** 2).sum(axis=2), rtol=1e-5)
    np.testing.assert_allclose(terms["height"], places[..., 5] - places[..., 2], atol=METER)
    np.testing.assert_allclose(terms["pull"], obs[..., where["tension"]][..., :2].max(axis=2))
    base, _, plain = rolled(myowarp.TASKS[ELBOW], autoreset="disabled", horizon=100)
    width = plain["obs"].shape[2]
    np.testing.assert_array_equal(rows["obs"][..., :width], plain["obs"])
    np.testing.assert_array_equal(rows["terms"][..., :5], plain["terms"])
    weights = {term.name: term.weight for term in base.terms} | {"bonus": 2.0, "effort": -0.1}
    weights |= {"height": 0.5, "pull": 1e-3}
    expected = sum(weights[name] * terms[name].astype(np.float64) for name in names)
    np.testing.assert_allclose(rows["reward"], expected, rtol=1e-4, atol=1e-4)
    assert np.abs(0.1 * terms["effort"]).max() > 1e-2


@pytest.mark.parametrize("options", [{"graph": False}, {"conditions": ("sarcopenia", "fatigue_3ccr")}])
def test_contract(options):
    """A world's numbers are the same in any batch and without a graph, resets included; the graph is ours."""
    task = rich(sites=sites_of("elbow"))
    shared = {name: value for name, value in options.items() if name != "graph"}
    sim, first, rows = rolled(task, **shared)
    assert all(graph.replay for graph in (sim.shards[0].step_graph, sim.shards[0].reset_graph))
    _, other_first, others = rolled(task, num_worlds=13, **options)
    np.testing.assert_array_equal(first, other_first[:6])
    for name, values in rows.items():
        np.testing.assert_array_equal(values, others[name][:, :6], err_msg=name)
    sim.reset(seeds=np.arange(6))
    np.testing.assert_array_equal(sim.transition.obs.numpy(), first)
    assert np.isfinite(rows["obs"]).all()


def test_in_gymnasium():
    task = rich(sites=sites_of("elbow"), horizon=7, doc="Save strength.")
    assert (task.horizon, task.doc, task.family, isinstance(task, myowarp.PoseTask)) == (
        7,
        "Save strength.",
        "pose",
        True,
    )
    env = gym.make_vec(
        task.env_id, num_envs=8, device="cpu", progress=False, shards=2, conditions="motor_noise"
    )
    obs, _ = env.reset(seed=0)
    env.action_space.seed(0)  # of all draws, one in eight excites no muscle of a world
    assert obs.shape == env.observation_space.shape
    *_, info = env.step(env.action_space.sample())
    assert {"terms/effort", "terms/height", "terms/pull", "terms/pose"} <= info.keys()
    assert (info["terms/effort"] > 0.0).all()
    env.close()
    env = gym.make(task.env_id, device="cpu", progress=False, reset="random")
    env.reset(seed=0)
    env.close()


def test_on_other_families():
    """Sites that the family knows are shared; an extension can be extended."""
    task = myowarp.extend(
        REACH, "testFinger-v0", observations={"tip": "site_xpos", "length": "length"}, sites="IFtip"
    )
    task = myowarp.extend(task, "testFinger-v1", rewards={"effort": (-1.0, effort)})
    task = myowarp.extend(task, "testFinger-v2", rewards={"effort": -3.0, "act_reg": 1.0}, near_per_tip=0.02)
    assert task.scene_key == myowarp.TASKS[REACH].scene_key
    assert {term.name: term.weight for term in task.reward_terms()} == {
        "reach": 1.0, "bonus": 4.0, "penalty": 50.0, "act_reg": 1.0, "sparse": 0.0, "effort": -3.0
    }  # fmt: skip
    sim, _, rows = rolled(task)
    where = blocks(sim)
    np.testing.assert_array_equal(rows["obs"][..., where["tip"]], rows["obs"][..., where["tip_pos"]])
    assert task.near == 0.02
    key = myowarp.extend(
        "myoHandObjHoldRandom-v1", "testHold-v0", observations={"where": "site_xpos"}, sites="object"
    )
    assert "object" in key.sites


def test_again():
    """The same extension is the same task; another under its id is refused, or replaces it."""
    options = {"rewards": {"effort": (-0.1, effort)}}
    first = myowarp.extend(ELBOW, "testAgain-v0", **options)
    assert myowarp.extend(ELBOW, "testAgain-v0", **options) is not None
    assert myowarp.TASKS["testAgain-v0"] is first
    with pytest.raises(ValueError, match="already registered"):
        myowarp.extend(ELBOW, "testAgain-v0", rewards={"effort": (-0.2, effort)})
    myowarp.extend(ELBOW, "testAgain-v0", rewards={"effort": (-0.2, effort)}, replace=True)
    assert myowarp.TASKS["testAgain-v0"].reward_terms()[-1].weight == -0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "myoElbow-v0"}, "task 'myoElbow-v0' unknown; "),
        ({"key": "testBad"}, "task id 'testBad' must be a name and a version"),
        ({"key": ELBOW}, f"task '{ELBOW}' belongs to myowarp; choose another name"),
        ({"horizont": 3}, f"task '{ELBOW}' has no 'horizont'; it has name, version, "),
        (
            {"rewards": {"effort": 1.0}},
            "reward 'effort' must be a weight and a function, got 1.0; terms of which",
        ),
        (
            {"rewards": {"effort": (1.0, effort, 2)}},
            "reward 'effort' must be a weight and a function, got (1.0,",
        ),
        (
            {"rewards": {"effort": ("a", effort)}},
            "weight of reward 'effort' must be a finite number, got 'a'",
        ),
        ({"rewards": {"pose": np.nan}}, "weight of reward 'pose' must be a finite number, got nan"),
        (
            {"rewards": {"pose": (1.0, effort)}},
            "reward 'pose' is a term of 'myoElbowPose1D6MRandom-v0'; give its",
        ),
        (
            {"rewards": {"effort": (1.0, max)}},
            "'effort' must be a function under @wp.func, got builtin_function",
        ),
        ({"rewards": {"effort": (1.0, wp.sin)}}, "'effort' must be a function under @wp.func, got Function"),
        ({"rewards": {"lean": (1.0, lean)}}, "reward 'lean' must return a float, got 3 numbers"),
        (
            {"rewards": {"a": (1.0, wrong_type)}},
            "parameter 'qpos' of 'a' must be of type wp.array[float], got ",
        ),
        (
            {"rewards": {"a": (1.0, no_result)}},
            "'a' must say what it returns, -> float, wp.vec3 or wp.quat; got None",
        ),
        (
            {"rewards": {"a": (1.0, a_matrix)}},
            "'a' must say what it returns, -> float, wp.vec3 or wp.quat; got mat33",
        ),
        (
            {"rewards": {"a": (1.0, no_type)}},
            "'a' must have parameters with types, such as qpos: wp.array[float]",
        ),
        (
            {"observations": {"qpos": "qpos"}},
            "observation 'qpos' is a block of 'myoElbowPose1D6MRandom-v0'; choose",
        ),
        (
            {"observations": {"a": "forces"}},
            "quantity of observation 'a' 'forces' unknown; available: qpos, qvel",
        ),
        ({"observations": {"a": 3}}, "'a' must be a function under @wp.func, got int"),
        ({"rewards": {"a": (1.0, height)}}, "task 'testBad-v0' reads site_xpos; name the sites"),
        ({"rewards": {"pose": 10**400}}, "weight of reward 'pose' must be a finite number, got 1000"),
        ({"rewards": {"pose": 1e39}}, "weight of reward 'pose' must be a finite number, got 1e+39"),
        ({"sites": 5}, "sites must be names of sites, got 5"),
        ({"observations": {5: "qpos"}}, "observations must be a mapping from names, got {5: 'qpos'}"),
        ({"near": np.nan}, "near must hold numbers, got nan"),
        ({"target_low": (np.nan,)}, "target_low must hold numbers, got (nan,)"),
        (
            {"target_low": (2.0,), "target_high": (1.0,)},
            "target_low must not be above its upper bound, got 2 > 1 at 0",
        ),
        (
            {"start_pose": (np.inf,)},
            "physics_dt must be positive, and start_pose finite, got 0.002 and (inf,)",
        ),
        ({"physics_dt": 0.0}, "physics_dt must be positive, and start_pose finite, got 0.0 and ()"),
        ({"num_substeps": 0}, "num_substeps must be an integer from 1 to 10000, got 0"),
        ({"num_substeps": 1.5}, "num_substeps must be an integer from 1 to 10000, got 1.5"),
    ],
)
def test_wrong(options, message):
    given = {"task": ELBOW, "key": "testBad-v0"} | options
    before = list(myowarp.TASKS)
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        myowarp.extend(**given)
    assert list(myowarp.TASKS) == before


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        (undefined_symbol, "Referencing undefined symbol: something"),
        (of_undefined, "Referencing undefined symbol: something"),
        (
            an_int,
            "The function `an_int` has its return type annotated as `float` but the code returns a value",
        ),
        (on_one_way, "on_one_way must return a value on every way through it"),
        (endless, "endless calls itself, which Warp does not translate"),
        (
            a_double,
            "Warp does not translate a_double: array_store() value argument type (float64) must be of",
        ),
        (meddling, "meddling writes to 'qpos', which it may only read"),
        (adding, "adding writes to 'activation', which it may only read"),
    ],
)
def test_a_function_that_cannot_be_computed(function, reason):
    """It is said in a line where it is named, with the place; nothing is compiled for that."""
    before = list(myowarp.TASKS)
    with pytest.raises(ValueError, match=r"^'a' cannot be computed: ") as raised:
        myowarp.extend(ELBOW, "testBad-v0", observations={"a": function})
    said = str(raised.value)
    assert reason in said
    assert "\n" not in said
    if reason.startswith(("Ref", "The")):
        name = "an_int" if function is an_int else "undefined_symbol"
        line = inspect.getsourcelines(globals()[name].func)[1] + 2
        assert f"Warp does not translate line {line} of test_extend.py, {name}: " in said
    assert list(myowarp.TASKS) == before


def test_without_private_names_of_warp(monkeypatch, caplog):
    """A function is then checked when it is compiled; one line says so."""
    monkeypatch.delattr("warp._src.context.ModuleBuilder")
    warn_once.cache_clear()
    for version in range(2):
        myowarp.extend(ELBOW, f"testUnchecked-v{version}", rewards={"a": (1.0, meddling)})
    (said,) = caplog.messages
    assert said.startswith("Warp has changed, functions of tasks are checked only when they are compiled: ")


FAR_OFF = """
import warp as wp
from myowarp.kernels.world_function import world_kernels
@wp.func
def far_off(qpos: wp.array[float]) -> float:
    return qpos[50]
wp.config.mode = "debug"
mask, qpos, out = wp.ones(1, dtype=bool), wp.zeros((1, 3), dtype=float), wp.zeros((1, 1), dtype=float)
first, count = wp.zeros(1, dtype=int), wp.ones(1, dtype=int)
observe, _ = world_kernels("far", (far_off,), (), (), frozenset({"qpos"}))
wp.launch(observe, dim=1, inputs=[qpos, mask, first, count, out])
print("went on")
"""


@pytest.mark.slow
def test_indices_are_checked_in_debug_mode(tmp_path):
    """As the documentation says: Warp ends the process at an index out of range."""
    (tmp_path / "far_off.py").write_text(FAR_OFF)
    command = [sys.executable, tmp_path / "far_off.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=ENVIRONMENT)
    assert done.returncode != 0
    assert "Assertion failed" in done.stdout + done.stderr
    assert "went on" not in done.stdout


def test_units_and_meanings():
    """The family's stay; a function's docstring says what it returns, a quantity has its own."""
    task = myowarp.extend(
        ELBOW,
        "testSaid-v0",
        rewards={"effort": (-0.1, effort, "1"), "bonus": 2.0},
        observations={"own": ("rad", of_own), "tension": "tension"},
    )
    base = {term.name: term for term in myowarp.TASKS[ELBOW].reward_terms()}
    terms = {term.name: term for term in task.reward_terms()}
    assert base["bonus"].unit
    assert base["bonus"].doc
    assert terms["bonus"] == dataclasses.replace(base["bonus"], weight=2.0)
    assert terms["pose"] == base["pose"]
    assert (terms["effort"].unit, terms["effort"].doc) == ("1", "Sum of squared excitations.")
    columns = {column.name: column for column in task.columns(1, 1, 6)}
    assert (columns["own"].unit, columns["own"].doc) == (
        "rad",
        "Two numbers, of which the second is made here.",
    )
    assert (columns["tension"].unit, columns["tension"].doc[:5]) == ("N", "force")


def test_joints_that_are_not_there():
    task = myowarp.extend(ELBOW, "testBad-v0", joints=(99,))
    message = r"^joints of task 'testBad-v0' must be ids of hinges and slides, of \[0\], got \(99,\)$"
    with pytest.raises(ValueError, match=message):
        Simulation(task, 1, device="cpu", progress=False)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (wrong_name, "'a' reads 'qposs', which task 'testBad-v0' has not; available: qpos, qvel, "),
        (of_target, "parameter 'target' of 'a' must be of type wp.array[float], got "),
    ],
)
def test_wrong_in_a_scene(function, message):
    """What depends on the program is said before anything is compiled."""
    task = myowarp.extend(ELBOW, "testBad-v0", rewards={"a": (1.0, function)})
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        Simulation(task, 1, device="cpu", progress=False)


def test_a_site_that_is_not_there():
    task = myowarp.extend(ELBOW, "testBad-v0", observations={"a": "site_xpos"}, sites="nose")
    with pytest.raises(ValueError, match=r"^site 'nose' unknown in this body"):
        Simulation(task, 1, device="cpu", progress=False)
