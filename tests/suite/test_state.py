"""State that is taken and given: what follows is what followed, bit for bit, wherever it goes on."""

import copy
import dataclasses
import io
import pickle
import re
import subprocess
import sys
import zipfile

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import warp as wp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from often import of_each
from test_conditions import NAMES, host_of

from myowarp.definitions.condition import CONDITIONS
from myowarp.definitions.task import TASKS
from myowarp.models.conditions import Fatigue3CCR, Sarcopenia, TendonTear, Uniform
from myowarp.process import warn_once
from myowarp.sim.metabolics import Metabolics
from myowarp.sim.signals import UNITS, Signals
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import State, get_state, set_state

ELBOW, HAND = "myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v1"
ID = f"MyoWarp/{ELBOW}"
SCENES = sorted({TASKS[key].scene_key: key for key in sorted(TASKS) if "Fixed" not in key}.values())
NUM_WORLDS = 5
BEFORE, AFTER = 20, 50  # steps
RESULTS = ("obs", "reward", "terms", "solved", "success", "terminated", "truncated", "fault")

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def drawn(name):
    """Return a condition whose parameters are drawn, some for an episode and some for a life."""
    kind = CONDITIONS[name]
    defaults = {field.name: field.default for field in dataclasses.fields(kind)}
    ends = {parameter: sorted((low, defaults[parameter])) for parameter, low in kind.NEUTRAL.items()}
    pers = ("episode", "life")
    return kind(**{name: Uniform(*ends[name], per=pers[i % 2]) for i, name in enumerate(ends)})


def build(key, shards=1, num_worlds=NUM_WORLDS, **options):
    settings = {"device": "cpu", "progress": False, "autoreset": "next_step", "horizon": 33} | options
    return Simulation(TASKS[key], num_worlds, shards=shards, **settings)


def run(sim, first, number):
    """Step with random actions of the steps' own; return what the steps led to."""
    rows = []
    for step in range(first, first + number):
        draws = np.random.default_rng(step).uniform(-1, 1, sim.action.shape)
        sim.action.assign(draws.astype(np.float32))
        sim.step()
        rows.append([getattr(sim.transition, name).numpy().copy() for name in RESULTS])
    return [np.stack(column) for column in zip(*rows, strict=True)]


def assert_goes_on(key, path, shards, **options):
    """Assert that a state goes on in another simulation, over a file, as where it was taken."""
    sim, other = build(key, **options), build(key, shards, **options)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    other.reset(seeds=100 + np.arange(NUM_WORLDS))
    run(sim, 0, BEFORE)
    run(other, 0, 7)
    get_state(sim).save(path)
    assert np.abs(other.transition.obs.numpy() - sim.transition.obs.numpy()).max() > 0.01
    set_state(other, State.load(path))
    np.testing.assert_array_equal(other.transition.obs.numpy(), sim.transition.obs.numpy())
    for expected, got in zip(run(sim, BEFORE, AFTER), run(other, BEFORE, AFTER), strict=True):
        np.testing.assert_array_equal(got, expected)
    ends = get_state(sim), get_state(other)
    assert ends[0].arrays.keys() == ends[1].arrays.keys()
    for name, array in ends[0].arrays.items():
        np.testing.assert_array_equal(ends[1].arrays[name], array, err_msg=name)
    assert ends[0].arrays["keys.episode"].min() > 1  # resets came between


@pytest.mark.parametrize("key", of_each(SCENES))
def test_every_family_goes_on(key, tmp_path):
    assert_goes_on(key, tmp_path / "state.npz", shards=2)


@pytest.mark.parametrize("name", NAMES)
def test_every_condition_goes_on(name, tmp_path):
    key = host_of(name)
    assert_goes_on(key, tmp_path / "state.npz", shards=2, conditions=drawn(name))


@pytest.mark.parametrize("autoreset", ["same_step", "disabled"])
def test_every_autoreset_goes_on(autoreset, tmp_path):
    sim = build(ELBOW, autoreset=autoreset)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    run(sim, 0, BEFORE)
    state = get_state(sim)
    expected = run(sim, BEFORE, 20)
    set_state(sim, state)
    for first, second in zip(expected, run(sim, BEFORE, 20), strict=True):
        np.testing.assert_array_equal(second, first)


OTHER_PROCESS = """
import sys
import gymnasium as gym, numpy as np, myowarp
from myowarp.sim.state import State
env = gym.make_vec(sys.argv[1], num_envs=7, device="cpu", shards=2, progress=False, conditions="fatigue_3ccr")
env.reset(seed=5)
state = State.load(sys.argv[2])
env.set_state(state, [6, 0, 3])
rows = []
for step in range(50):
    actions = np.random.default_rng(step).uniform(-1, 1, (3, env.action_space.shape[1])).astype(np.float32)
    everyone = np.zeros(env.action_space.shape, dtype=np.float32)
    everyone[[6, 0, 3]] = actions
    rows.append(env.step(everyone)[0][[6, 0, 3]])
np.save(sys.argv[3], np.stack(rows))
"""


@pytest.mark.slow
def test_another_process_goes_on(tmp_path):
    """Three worlds of an environment in three places of another one, in a process of its own."""
    env = gym.make_vec(ID, num_envs=4, device="cpu", progress=False, conditions="fatigue_3ccr")
    env.reset(seed=0)
    for _ in range(60):
        env.step(env.action_space.sample())
    env.get_state([3, 1, 2]).save(tmp_path / "state.npz")
    arguments = [ID, str(tmp_path / "state.npz"), str(tmp_path / "obs.npy")]
    subprocess.run([sys.executable, "-W", "ignore", "-c", OTHER_PROCESS, *arguments], check=True)
    other = np.load(tmp_path / "obs.npy")
    for step, expected in enumerate(other):
        actions = np.random.default_rng(step).uniform(-1, 1, (3, 6)).astype(np.float32)
        everyone = np.zeros((4, 6), dtype=np.float32)
        everyone[[3, 1, 2]] = actions
        np.testing.assert_array_equal(env.step(everyone)[0][[3, 1, 2]], expected)


def arrays_of(owner, seen):
    """Yield the names of all arrays that an object holds, in its attributes, and in theirs."""
    other = isinstance(owner, (wp.Kernel, wp.Function, Metabolics))  # the rates follow from the state
    if id(owner) in seen or other or not hasattr(owner, "__dict__"):
        return
    seen.add(id(owner))
    for name, value in vars(owner).items():
        if isinstance(value, wp.array):
            yield f"{type(owner).__name__}.{name}", value
        elif isinstance(value, (list, tuple, dict)):
            for entry in value.values() if isinstance(value, dict) else value:
                inner = entry if isinstance(entry, tuple) else (entry,)
                for thing in inner:
                    yield from [(name, thing)] if isinstance(thing, wp.array) else arrays_of(thing, seen)
        else:
            yield from arrays_of(value, seen)


FOLLOWS = re.compile(r"TendonTransferEffect\.(affected|healthy)|Mujoco\w*Params\.\w+")
"""Arrays with a row for each world that every control step writes anew before it reads them."""


@pytest.mark.parametrize("key", of_each(SCENES))
def test_what_a_task_allocates_is_state(key):
    """An array with a row for each world that is not in the state would be forgotten."""
    n = 31
    sim = build(key, num_worlds=n)
    known = {array.ptr for array in sim.scene.state.values()}
    seen = {id(sim.scene), id(sim.scene.spec), id(sim.scene.worlds)}
    for name, array in arrays_of(sim.shards[0].program, seen):
        assert array.shape[0] != n or array.ptr in known, name


@pytest.mark.parametrize("name", NAMES)
def test_what_a_condition_allocates_is_state(name):
    n = 31
    sim = build(host_of(name), num_worlds=n, conditions=drawn(name))
    known = {array.ptr for array in sim.scene.state.values()}
    scene = sim.scene
    seen = {id(part) for part in (scene, scene.spec, scene.worlds, scene.data, scene.model, scene.muscles)}
    for effect in sim.shards[0].effects:
        for name, array in arrays_of(effect, seen):
            assert array.shape[0] != n or array.ptr in known or FOLLOWS.fullmatch(name), name


def test_one_world_for_all():
    """A planner's candidates: all start where one world is, and go on as it does under its actions."""
    env = gym.make_vec(ID, num_envs=6, device="cpu", progress=False)
    env.reset(seed=0)
    for _ in range(9):
        obs = env.step(env.action_space.sample())[0]
    np.testing.assert_array_equal(env.set_state(env.get_state(4)), np.tile(obs[4], (6, 1)))
    for _ in range(9):
        obs = env.step(np.tile(env.single_action_space.sample(), (6, 1)))[0]
        np.testing.assert_array_equal(obs, np.tile(obs[:1], (6, 1)))


def test_other_worlds_stay_as_they_are():
    env, twin = (gym.make_vec(ID, num_envs=6, device="cpu", progress=False) for _ in range(2))
    for one in (env, twin):
        one.reset(seed=0)
        one.action_space.seed(0)
    for _ in range(9):
        env.step(env.action_space.sample())
        twin.step(twin.action_space.sample())
    env.set_state(env.get_state(0), [2, 4])
    for _ in range(9):
        ours, theirs = env.step(env.action_space.sample())[0], twin.step(twin.action_space.sample())[0]
        np.testing.assert_array_equal(ours[[0, 1, 3, 5]], theirs[[0, 1, 3, 5]])
        assert (ours[[2, 4]] != theirs[[2, 4]]).any()


def test_the_same_movement_in_another_patient():
    """Without the conditions' state the worlds keep their own; the body's state is the one given."""
    healthy, sick = build(ELBOW), build(ELBOW, conditions=(Sarcopenia(0.5), "exoskeleton"))
    for sim in (healthy, sick):
        sim.reset(seeds=np.arange(NUM_WORLDS))
        run(sim, 0, 10)
    state = get_state(healthy)
    with pytest.raises(ValueError, match=r"^state and environment must have the same conditions, .*strength"):
        set_state(sick, state)
    set_state(sick, state, conditions=False)
    for name in ("data.qpos", "data.qvel", "muscles.activation", "task.target"):
        np.testing.assert_array_equal(get_state(sick).arrays[name], state.arrays[name])
    here, there = run(healthy, 10, 10), run(sick, 10, 10)
    assert np.abs(here[0] - there[0][..., : here[0].shape[2]]).max() > 0.01


def test_signals_are_right_after_a_reset_and_after_a_state_was_set():
    """Against MuJoCo C: passive forces at rest where no tendon is torn; then those of any state."""
    torn = np.arange(NUM_WORLDS) % 2 == 0
    tear = TendonTear("BIClong", time=0.0, transmission=1.0 - torn)
    sim = build(ELBOW, 2, conditions=tear)
    signals, model = Signals(sim), sim.scene.oracle
    sim.reset(seeds=np.arange(NUM_WORLDS))

    def assert_right(strength=1.0):
        data, muscles = mujoco.MjData(model), sim.scene.muscles
        for world in range(NUM_WORLDS):
            data.qpos[:], data.qvel[:] = (
                sim.scene.data.qpos.numpy()[world],
                sim.scene.data.qvel.numpy()[world],
            )
            data.act[:] = muscles.activation.numpy()[world]
            mujoco.mj_forward(model, data)
            force = -data.actuator_force[muscles.actuator_id]
            force[list(muscles.names).index("BIClong")] *= not torn[world]
            got = {name: getattr(signals.muscles, name).numpy()[world] for name in UNITS}
            np.testing.assert_allclose(got["force"], force, atol=0.1)
            np.testing.assert_allclose(got["length"], data.actuator_length[muscles.actuator_id], atol=1e-6)
            np.testing.assert_array_equal(got["activation"], data.act.astype(np.float32))
        assert signals.valid.numpy().all()

    assert_right()
    run(sim, 0, 20)
    state = get_state(sim)
    before = signals.muscles.force.numpy().copy()
    assert before.max() > 100
    sim.reset(np.arange(NUM_WORLDS) == 1, np.arange(NUM_WORLDS))
    np.testing.assert_array_equal(signals.muscles.force.numpy()[[0, 2, 3, 4]], before[[0, 2, 3, 4]])
    assert_right()
    run(sim, 20, 5)
    set_state(sim, state)
    np.testing.assert_array_equal(signals.muscles.force.numpy(), before)


def test_copies_go_on():
    """`pickle` and `copy.deepcopy` of a vector environment and of a wrapped single one."""
    options = {"device": "cpu", "progress": False, "conditions": Fatigue3CCR(initial=Uniform(0.0, 0.5))}
    env, single = gym.make_vec(ID, num_envs=3, **options), gym.make(ID, **options)
    env.reset(seed=0)
    single.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(11):
        env.step(rng.uniform(-1, 1, (3, 6)))
        single.step(rng.uniform(-1, 1, 6))
    copies, singles = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))], [copy.deepcopy(single)]
    for _ in range(11):
        actions = rng.uniform(-1, 1, (3, 6))
        expected, alone = env.step(actions), single.step(actions[0])
        for one in copies:
            for ours, theirs in zip(one.step(actions)[:4], expected[:4], strict=True):
                np.testing.assert_array_equal(ours, theirs)
        for one in singles:
            np.testing.assert_array_equal(one.step(actions[0])[0], alone[0])


def test_a_world_may_be_copied_to_others():
    """`state[rows]` names rows as often as wished; what is set is named once."""
    env = hold()
    state = env.get_state()
    copies = state[[1, 1]]
    assert (len(copies), copies.task, copies.physics) == (2, state.task, state.physics)
    for name, array in copies.arrays.items():
        np.testing.assert_array_equal(array, state.arrays[name][[1, 1]], err_msg=name)
        assert not np.shares_memory(array, state.arrays[name])
    env.set_state(State(state.task, {n: a for n, a in copies.arrays.items() if not n.startswith("keys.")}))
    alike = [env.step(np.zeros(env.action_space.shape))[:2] for _ in range(5)]
    for obs, reward in alike:
        np.testing.assert_array_equal(obs[0], obs[1])
        assert reward[0] == reward[1]
    env.set_state(state)
    assert len(state[[0, 1, 0]]) == 3
    for rows in ([0, 2], [-1], [], [0.5]):
        with pytest.raises(ValueError, match=r"^worlds must be numbers from 0 to 1, or a bool mask of shape"):
            state[rows]
    with pytest.raises(ValueError, match=r"^worlds must be different numbers from 0 to 1, or a bool mask"):
        env.set_state(copies, [1, 1])


def test_start_from_a_configuration():
    """Against MuJoCo C: the first step from a given state; worlds that are not reset stay."""
    env = gym.make_vec(ID, num_envs=3, device="cpu", progress=False)
    env.reset(seed=0)
    for _ in range(5):
        kept, *_ = env.step(env.action_space.sample())
    qpos, qvel = np.array([[0.3], [0.9], [1.5]]), np.array([2.0])
    mask = np.array([True, False, True])
    obs, _ = env.reset(options={"qpos": qpos, "qvel": qvel, "reset_mask": mask})
    np.testing.assert_allclose(obs[mask, 0], qpos[mask, 0], rtol=1e-6)
    np.testing.assert_allclose(obs[mask, 1], 2.0 * env.sim.scene.control_dt, rtol=1e-6)
    np.testing.assert_array_equal(obs[1], kept[1])
    actions = np.full((3, 6), 0.3)
    got, *_ = env.step(actions)
    model = env.sim.scene.oracle
    for world in (0, 2):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = qpos[world], qvel
        data.ctrl[:] = 1 / (1 + np.exp(-5 * (actions[world] - 0.5)))
        mujoco.mj_step(model, data, env.sim.scene.num_substeps)
        np.testing.assert_allclose(got[world, 0], data.qpos[0], atol=1e-5)


FREE = "myoHandObjHoldRandom-v0"


@pytest.mark.parametrize(("angle", "said"), [(1.5, False), (90.0, True), (-3.0, True)])
def test_angles_in_degrees_are_said(caplog, angle, said):
    env = gym.make_vec("MyoWarp/myoElbowPose1D6MRandom-v0", num_envs=2, device="cpu", progress=False)
    warn_once.cache_clear()
    obs, _ = env.reset(options={"qpos": [angle]})
    assert obs[:, 0].tolist() == [angle, angle]
    sentence = (
        f"reset option 'qpos' has joint 'r_elbow_flex' at {angle:.4g} rad, far out of its range, 0 to "
        "2.27 rad; is it in degrees?"
    )
    assert caplog.messages == [sentence] * said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([1], r"reset options must be a dictionary, got \[1\]"),
        ({"qpso": 1}, r"reset option 'qpso' unknown; available: reset_mask, qpos, qvel, state"),
        (
            {"qpos": [1.0, 2.0]},
            r"reset option 'qpos' must be finite numbers of shape \(30,\) or \(2, 30\), got",
        ),
        ({"qpos": "here"}, r"reset option 'qpos' must be finite numbers of shape \(30,\) or \(2, 30\), got"),
        ({"qvel": np.full(29, np.nan)}, r"reset option 'qvel' must be finite numbers of shape \(29,\) or"),
        ({"qpos": np.zeros(30)}, r"reset option 'qpos' must have a unit quaternion in entries 26 to 29"),
        ({"state": 3}, r"state must be a State, as get_state\(\) returns it, got int"),
    ],
)
def test_bad_options(options, message):
    env = hold()
    before = env.get_state()
    with pytest.raises(ValueError, match=f"^{message}"):
        env.reset(options=options)
    after = env.get_state()
    for name, array in before.arrays.items():
        np.testing.assert_array_equal(after.arrays[name], array)


def hold(cache={}):  # noqa: B006 (one environment for all)
    if not cache:
        cache["env"] = gym.make_vec(f"MyoWarp/{FREE}", num_envs=2, device="cpu", progress=False)
        cache["env"].reset(seed=0)
    return cache["env"]


def test_bad_states(tmp_path):
    env, state = hold(), hold().get_state()
    with pytest.raises(ValueError, match=r"^worlds must be different numbers from 0 to 1, or a bool mask"):
        env.get_state([0, 0])
    with pytest.raises(ValueError, match=r"^worlds must be different numbers from 0 to 1, or a bool mask"):
        env.set_state(state, 2)
    with pytest.raises(ValueError, match=r"^state must have 1 or 1 worlds, as many as are set, got 2$"):
        env.set_state(state, 1)
    with pytest.raises(ValueError, match=r"^state is one of task 'reach-v0'; this one is 'myoHandObjHold"):
        env.set_state(State("reach-v0", state.arrays))
    for wrong, reason in (
        (np.full((2, 30), np.nan), "must be finite in float32, got NaN, infinity or too large a number"),
        (np.full((2, 30), 1e300), "must be finite in float32, got NaN, infinity or too large a number"),
        (np.zeros((2, 3)), r"must have shape \(2, 30\), got \(2, 3\)"),
        (np.array([["a"] * 30] * 2), "must be of type float32, got <U1"),
    ):
        with pytest.raises(ValueError, match=f"^state 'data.qpos' {reason}$"):
            env.set_state(State(state.task, state.arrays | {"data.qpos": wrong}))
    for count in (-1, 2**31 - 1, 2**40):
        with pytest.raises(
            ValueError, match=r"^state 'episode.step_count' must be from 0 to 2147483646, got"
        ):
            env.set_state(State(state.task, state.arrays | {"episode.step_count": np.full(2, count)}))
    for arrays in (
        {},
        None,
        {"data.qpos": [0.0]},
        {"data.qpos": np.float32(1)},
        {"a": np.ones(2), "b": np.ones(3)},
    ):
        with pytest.raises(
            ValueError, match=r"^arrays of a State must be NumPy arrays by name, each with a row"
        ):
            State(state.task, arrays)
    for wrong, name in (
        ({name: array for name, array in state.arrays.items() if name != "data.ctrl"}, "data.ctrl"),
        (state.arrays | {"more": np.zeros(2)}, "more"),
    ):
        for conditions in (True, False):
            with pytest.raises(
                ValueError, match=f"^state must have the arrays .* they differ in {name}; take"
            ):
                env.set_state(State(state.task, wrong), conditions=conditions)
    fresh = gym.make_vec(ID, num_envs=1, device="cpu", progress=False)
    with pytest.raises(gym.error.ResetNeeded, match=r"^get_state needs an environment that was reset"):
        fresh.get_state()
    with pytest.raises(ValueError, match=r"^reset option 'state' is all that a world is; leave out seed"):
        env.reset(seed=1, options={"state": state})


def test_a_state_of_other_physics_is_said(tmp_path, caplog):
    env = gym.make_vec(ID, num_envs=2, device="cpu", progress=False)
    env.reset(seed=0)
    path = tmp_path / "state.npz"
    env.get_state().save(path)
    state = State.load(path)
    assert state.physics == state[0].physics == "parity"
    env.set_state(state)
    env.set_state(State(state.task, state.arrays))  # not known
    assert not caplog.messages
    fast = gym.make_vec(ID, num_envs=2, device="cpu", progress=False, physics="fast")
    fast.set_state(state)
    (message,) = caplog.messages
    assert message.startswith("a state of physics 'parity' goes on under 'fast': what follows is not")


def test_files_of_the_version_before_are_read(tmp_path):
    """They do not say under which physics."""
    state = hold().get_state()
    np.savez(tmp_path / "old.npz", task=np.array(state.task), **state.arrays)
    old = State.load(tmp_path / "old.npz")
    assert (old.task, old.physics) == (state.task, "")
    for name, array in state.arrays.items():
        np.testing.assert_array_equal(old.arrays[name], array)


def test_bad_files(tmp_path):
    path = tmp_path / "state.npz"
    hold().get_state().save(path)
    whole = path.read_bytes()
    with pytest.raises(FileNotFoundError):
        State.load(tmp_path / "none.npz")
    with pytest.raises(ValueError, match=r"must end in \.npz"):
        hold().get_state().save(tmp_path / "state.txt")
    np.savez(path, qpos=np.zeros(3))
    with pytest.raises(ValueError, match=r"must be an \.npz file of State\.save\(\), undamaged"):
        State.load(path)
    np.savez(path, task=np.array("x"), harm=np.array([print], dtype=object))
    with pytest.raises(ValueError, match=r"must be an \.npz file of State\.save\(\), undamaged"):
        State.load(path)
    damaged = [whole[:size] for size in (0, 10, len(whole) // 2, len(whole) - 1)]
    central = whole.find(b"PK\1\2")
    for method in (1, 8, 14, 99):
        damaged.append(with_bytes(whole, {8: method, central + 10: method}))
    damaged.append(with_bytes(whole, {6: 1, central + 8: 1}))  # encrypted
    for rows in (10**15, 2**70, -5):
        damaged.append(with_head(whole, rows))
    np.savez_compressed(path, task=np.array("x"), qpos=np.zeros((4, 2**20)))
    damaged.append(path.read_bytes())
    for content in damaged:
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"must be an \.npz file of State\.save\(\), undamaged \(.+\)$"):
            State.load(path)
    with pytest.raises(
        ValueError, match=r"must be an \.npz file of State\.save\(\), undamaged \(.*[Dd]irectory"
    ):
        State.load(tmp_path)


def with_bytes(content, changes):
    """Content with other values at some places."""
    changed = bytearray(content)
    for place, value in changes.items():
        changed[place] = value
    return bytes(changed)


def with_head(content, rows):
    """A state whose array says that it has so many rows; the file's sums are right."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f4", "fortran_order": False, "shape": (rows, 30)})
    changed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(changed, "w") as new:
        for entry in old.infolist():
            is_qpos = entry.filename == "data.qpos.npy"
            new.writestr(entry.filename, head.getvalue() + bytes(240) if is_qpos else old.read(entry))
    return changed.getvalue()


@given(
    places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 7)), min_size=1, max_size=3)
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_files_with_flipped_bits(tmp_path, places):
    """They are refused, or hold what they held."""
    path, state = tmp_path / "state.npz", hold().get_state()
    state.save(path)
    content = bytearray(path.read_bytes())
    for place, bit in places:
        content[int(place * len(content))] ^= 1 << bit
    path.write_bytes(content)
    try:
        read = State.load(path)
    except ValueError as error:
        assert "must be an .npz file of State.save(), undamaged" in str(error)  # noqa: PT017 (or it is read)
        return
    for name, array in read.arrays.items():
        np.testing.assert_array_equal(array, state.arrays[name])
