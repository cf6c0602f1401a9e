"""Wrong input is refused in one sentence and changes nothing; on the device it ends one episode."""

import re
import sys

import gymnasium as gym
import numpy as np
import pytest
import warp as wp
from gymnasium.error import NameNotFound, ResetNeeded

import myowarp
from myowarp.bridge_gym import MyoWarpEnv, MyoWarpVectorEnv
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import LISTED_BY
from myowarp.extras import to_install
from myowarp.kernels.episode import FAULTS
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.snapshot import snapshot

TASK = "myoElbowPose1D6MRandom-v0"
ID = f"MyoWarp/{TASK}"
NUM_ENVS = 3
SHAPE = (NUM_ENVS, 6)
GOOD = np.linspace(-0.9, 0.9, 18, dtype=np.float32).reshape(SHAPE)
ACTION_FAULT = next(bit for bit, text in FAULTS.items() if text == "action not finite")


def make(**options):
    return gym.make_vec(ID, **({"num_envs": NUM_ENVS, "device": "cpu"} | options))


def refused(kind, sentence):
    return pytest.raises(kind, match=f"^{re.escape(sentence)}$")


def state(env):
    """Return everything that an episode is made of."""
    sim = env.unwrapped.sim
    keys, episode = sim.scene.keys, sim.episode
    arrays = (keys.seed, keys.episode, episode.step_count, episode.solved_count, sim.transition.obs)
    seen = [snapshot(sim, world) for world in range(sim.num_worlds)]
    return [array.numpy().copy() for array in arrays] + [
        part for one in seen for part in (one.qpos, one.activation)
    ]


def assert_equal(first, second):
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.fixture(scope="module")
def twins():
    return make(), make()


@pytest.fixture
def unchanged(twins):
    """The environment to mistreat in the middle of an episode; afterwards it goes on like its twin."""
    for env in twins:
        env.reset(seed=3)
        env.step(GOOD)
    env, twin = twins
    before = state(env)
    yield env
    assert_equal(state(env), before)
    stepped, expected = env.step(-GOOD)[:4], twin.step(-GOOD)[:4]
    assert_equal(stepped, expected)
    assert not np.array_equal(stepped[0], before[4])
    assert_equal(env.reset()[0], twin.reset()[0])


def with_entry(value):
    actions = GOOD.copy()
    actions[1, 4] = value
    return actions


FLOATING = f"actions must be floating point of shape {SHAPE}, got "
BAD_ACTIONS = {
    "one world": (GOOD[:1], FLOATING + "float32 of shape (1, 6)"),
    "flat": (GOOD.ravel(), FLOATING + "float32 of shape (18,)"),
    "too narrow": (GOOD[:, :5], FLOATING + "float32 of shape (3, 5)"),
    "transposed": (GOOD.T, FLOATING + "float32 of shape (6, 3)"),
    "integer": (np.ones(SHAPE, dtype=int), FLOATING + "int64 of shape (3, 6)"),
    "bool": (np.ones(SHAPE, dtype=bool), FLOATING + "bool of shape (3, 6)"),
    "complex": (GOOD + 1j, FLOATING + "complex64 of shape (3, 6)"),
    "object": (GOOD.astype(object), FLOATING + "object of shape (3, 6)"),
    "nothing": (None, FLOATING + "object of shape ()"),
    "rows of several lengths": ([*GOOD[:2].tolist(), [0.0]], FLOATING + "list that is no array"),
    "actions and a state": ((GOOD, None), FLOATING + "tuple that is no array"),
    "NaN": (with_entry(np.nan), "actions must be finite, got NaN or infinity for worlds [1]"),
    "infinity": (with_entry(np.inf), "actions must be finite, got NaN or infinity for worlds [1]"),
    "minus infinity": (with_entry(-np.inf), "actions must be finite, got NaN or infinity for worlds [1]"),
}


@pytest.mark.parametrize("case", BAD_ACTIONS)
def test_bad_actions(unchanged, case):
    actions, sentence = BAD_ACTIONS[case]
    with refused(ValueError, sentence):
        unchanged.step(actions)


BAD_WARP_ACTIONS = {
    (2, 6): (float, "actions must be float32 of shape (3, 6), got float32 of shape (2, 6)"),
    (3, 6): (wp.float64, "actions must be float32 of shape (3, 6), got float64 of shape (3, 6)"),
}


@pytest.mark.parametrize("shape", BAD_WARP_ACTIONS)
def test_bad_warp_actions(unchanged, shape):
    dtype, sentence = BAD_WARP_ACTIONS[shape]
    actions = wp.ones(shape, dtype=dtype, device="cpu")
    with refused(ValueError, sentence):
        unchanged.step(actions)


def mask_sentence(got):
    return f"reset_mask must be a bool array of shape (3,) with a True entry, got {got} true entries"


SEEDS = "seeds must be integers from 0 to 2**64 - 1 or None, got "
BAD_RESETS = {
    "mask of integers": (
        {"options": {"reset_mask": np.array([1, 0, 1])}},
        mask_sentence("int64 of shape (3,) with 2"),
    ),
    "list of integers": ({"options": {"reset_mask": [1, 0, 0]}}, mask_sentence("int64 of shape (3,) with 1")),
    "mask too long": (
        {"options": {"reset_mask": np.ones(4, dtype=bool)}},
        mask_sentence("bool of shape (4,) with 4"),
    ),
    "mask of two dimensions": (
        {"options": {"reset_mask": np.ones((3, 1), dtype=bool)}},
        mask_sentence("bool of shape (3, 1) with 3"),
    ),
    "mask without True": (
        {"options": {"reset_mask": np.zeros(3, dtype=bool)}},
        mask_sentence("bool of shape (3,) with 0"),
    ),
    "unknown option": (
        {"options": {"goal": 1.0}},
        "reset option 'goal' unknown; available: reset_mask, qpos, qvel, state",
    ),
    "unknown option beside a mask": (
        {"options": {"reset_mask": np.ones(3, dtype=bool), "goal": 1.0}},
        "reset option 'goal' unknown; available: reset_mask, qpos, qvel, state",
    ),
    "too few seeds": ({"seed": [1, 2]}, "seed must have one entry for each of 3 worlds, got 2"),
    "too many seeds": ({"seed": [1, 2, 3, 4]}, "seed must have one entry for each of 3 worlds, got 4"),
    "negative seed": ({"seed": -2}, SEEDS + "-2"),
    "negative in a list": ({"seed": [1, -1, None]}, SEEDS + "[1, -1, None]"),
    "fraction in a list": ({"seed": [1, 2.5, 3]}, SEEDS + "[1, 2.5, 3]"),
    "fraction": ({"seed": 1.5}, SEEDS + "1.5"),
    "array of no dimension": ({"seed": np.array(3)}, SEEDS + "array(3)"),
    "text": ({"seed": "abc"}, SEEDS + "'abc'"),
}


@pytest.mark.parametrize("case", BAD_RESETS)
def test_bad_reset(unchanged, case):
    arguments, sentence = BAD_RESETS[case]
    with refused(ValueError, sentence):
        unchanged.reset(**arguments)


def test_render_without_render_mode(unchanged):
    with refused(ValueError, "render needs a render mode; pass render_mode='rgb_array' to make_vec"):
        unchanged.render()


AVAILABLE = ", ".join(device.alias for device in wp.get_devices())
BAD_OPTIONS = {
    "num_envs 0": ({"num_envs": 0}, "num_envs must be a positive integer, got 0"),
    "num_envs -1": ({"num_envs": -1}, "num_envs must be a positive integer, got -1"),
    "num_envs 2.5": ({"num_envs": 2.5}, "num_envs must be a positive integer, got 2.5"),
    "num_envs True": ({"num_envs": True}, "num_envs must be a positive integer, got True"),
    "no muscle model": ({"muscle": []}, f"muscle model [] unknown; available: {', '.join(MUSCLES)}"),
    "num_envs text": ({"num_envs": "3"}, "num_envs must be a positive integer, got '3'"),
    "no such GPU": ({"device": "cuda:77"}, f"device 'cuda:77' is not available; available: {AVAILABLE}"),
    "no such kind": ({"device": "tpu"}, f"device 'tpu' is not available; available: {AVAILABLE}"),
    "physics": ({"physics": "exact"}, "physics 'exact' unknown; available: parity, fast"),
    "output": ({"output": "jax"}, "output 'jax' unknown; available: numpy, torch, warp"),
    "render_mode": (
        {"render_mode": "ansi"},
        "render_mode 'ansi' unknown; available: None, human, rgb_array",
    ),
    "max_episode_steps 0": (
        {"max_episode_steps": 0},
        "max_episode_steps must be a positive integer, got 0",
    ),
    "max_episode_steps -5": (
        {"max_episode_steps": -5},
        "max_episode_steps must be a positive integer, got -5",
    ),
    "max_episode_steps 2.5": (
        {"max_episode_steps": 2.5},
        "max_episode_steps must be a positive integer, got 2.5",
    ),
}


@pytest.mark.parametrize("task", [0, None, [], {}, 1.5, b"myoElbowPose1D6MFixed-v0"])
def test_what_is_no_id_is_no_task(task):
    with refused(ValueError, f"task must be an id, got {task!r}; {LISTED_BY}"):
        myowarp.make_vec(task)


@pytest.mark.parametrize("given", [{"num_worlds": 0}, {"horizon": 0}])
def test_a_simulation_speaks_of_its_own_arguments(given):
    setup = Setup(task="myoElbowPose1D6MFixed-v0", device="cpu", horizon=given.get("horizon"))
    with refused(ValueError, f"{next(iter(given))} must be a positive integer, got 0"):
        Simulation(setup, given.get("num_worlds", 1))


def test_tensors_without_values_are_refused(unchanged):
    torch = pytest.importorskip("torch")
    shape = unchanged.action_space.shape
    for tensor in (torch.empty(shape, device="meta"), torch.zeros(shape).to_sparse()):
        said = f"actions must be a dense tensor with values, got {tensor.layout} on {tensor.device}"
        with refused(ValueError, said):
            unchanged.step(tensor)


def test_a_single_environment_takes_what_many_take():
    """A tensor whose gradient is wanted, too."""
    torch = pytest.importorskip("torch")
    env = myowarp.make("myoElbowPose1D6MFixed-v0", device="cpu")
    action = np.linspace(-0.5, 0.5, 6, dtype=np.float32)
    seen = []
    for given in (action, torch.from_numpy(action), torch.from_numpy(action).requires_grad_()):
        env.reset(seed=0)
        seen.append(env.step(given)[0])
    assert np.ptp(seen, axis=0).max() == 0.0
    with refused(ValueError, "actions must be a dense tensor with values, got torch.strided on meta"):
        env.step(torch.empty(6, device="meta"))


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_bad_option(case):
    options, sentence = BAD_OPTIONS[case]
    with refused(ValueError, sentence):
        make(**options)


@pytest.mark.parametrize("option", ["muscle", "autoreset_mode"])
def test_bad_option_with_open_choices(option):
    """The list of choices may grow; it names at least the default."""
    name = {"muscle": "muscle model", "autoreset_mode": "autoreset_mode"}[option]
    default = {"muscle": "mujoco", "autoreset_mode": "next_step"}[option]
    with pytest.raises(ValueError, match=rf"^{name} 'hill' unknown; available: .*\b{default}\b"):
        make(**{option: "hill"})


@pytest.mark.parametrize("maker", [gym.make, gym.make_vec])
def test_option_that_does_not_exist(maker):
    with pytest.raises(TypeError, match=r"got an unexpected keyword argument 'gravity'"):
        maker(ID, device="cpu", gravity=1.0)


@pytest.mark.parametrize("option", ["num_envs", "autoreset_mode", "output", "copy"])
def test_option_of_many_worlds_for_one(option):
    with refused(ValueError, f"option '{option}' is for make_vec; a single environment has none"):
        gym.make(ID, device="cpu", **{option: 1})


@pytest.mark.parametrize("maker", [MyoWarpEnv, MyoWarpVectorEnv])
def test_unknown_task(maker):
    sentence = "task 'myoElbowPose1D6MRandm-v0' unknown; did you mean myoElbowPose1D6MRandom-v0, "
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}"):
        maker("myoElbowPose1D6MRandm-v0", device="cpu")


@pytest.mark.parametrize("maker", [gym.make, gym.make_vec])
def test_unknown_id(maker):
    with pytest.raises(NameNotFound, match=r"Did you mean: `myoElbowPose1D6MRandom`\?"):
        maker("MyoWarp/myoElbowPose1D6MRandm-v0")


def test_torch_without_torch(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    sentence = f'output="torch" needs torch, which is not installed; run {to_install("torch")}'
    with refused(ImportError, sentence):
        make(output="torch")


def test_step_before_reset():
    """Nor does a reset of some worlds suffice."""
    env, sentence = make(), "step needs an environment that was reset; call reset() first"
    before = state(env)
    with refused(ResetNeeded, sentence):
        env.step(GOOD)
    assert_equal(state(env), before)
    env.reset(options={"reset_mask": np.array([True, False, False])})
    with refused(ResetNeeded, sentence):
        env.step(GOOD)
    env.reset(seed=3)
    assert not np.array_equal(env.step(GOOD)[0], env.step(GOOD)[0])


def test_step_of_ended_worlds():
    """Without autoreset they have to be reset, all of them."""
    env, twin = (make(autoreset_mode="disabled", max_episode_steps=3) for _ in range(2))
    first, second = np.array([True, False, False]), np.array([False, True, True])
    for each in (env, twin):
        each.reset(seed=3)
        each.step(GOOD)
        each.reset(options={"reset_mask": first})
        each.step(GOOD)
        each.step(GOOD)
    before = state(env)
    sentence = "worlds {} have ended; reset them with reset(options={{'reset_mask': mask}}) first"
    with refused(ResetNeeded, sentence.format([1, 2])):
        env.step(GOOD)
    assert_equal(state(env), before)
    env.reset(options={"reset_mask": np.array([False, True, False])})
    with refused(ResetNeeded, sentence.format([2])):
        env.step(GOOD)
    env.reset(options={"reset_mask": np.array([False, False, True])})
    twin.reset(options={"reset_mask": second})
    assert_equal(env.step(GOOD)[:4], twin.step(GOOD)[:4])
    with refused(ResetNeeded, sentence.format([0])):
        env.step(GOOD)


@pytest.fixture(scope="module")
def single():
    return gym.make(ID, device="cpu")


BAD_SINGLE_ACTIONS = {
    "batch": (GOOD, "action must be floating point of shape (6,), got shape (3, 6)"),
    "short": (GOOD[0, :5], "action must be floating point of shape (6,), got shape (5,)"),
    "integer": (
        np.ones(6, dtype=int),
        "actions must be floating point of shape (1, 6), got int64 of shape (1, 6)",
    ),
    "NaN": (with_entry(np.nan)[1], "actions must be finite, got NaN or infinity for worlds [0]"),
}


@pytest.mark.parametrize("case", BAD_SINGLE_ACTIONS)
def test_bad_action_of_one_world(single, case):
    action, sentence = BAD_SINGLE_ACTIONS[case]
    single.reset(seed=3)
    single.step(GOOD[0])
    undisturbed = single.step(GOOD[1])[:4]
    single.reset(seed=3)
    single.step(GOOD[0])
    before = state(single)
    with refused(ValueError, sentence):
        single.unwrapped.step(action)
    assert_equal(state(single), before)
    assert_equal(single.step(GOOD[1])[:4], undisturbed)


@pytest.mark.parametrize("maker", [gym.make, lambda id, **options: gym.make(id, **options).unwrapped])
def test_step_of_one_world_before_reset(maker):
    with pytest.raises(ResetNeeded):
        maker(ID, device="cpu").step(GOOD[0])


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_bad_action_on_the_device_costs_its_world_alone(mode, value):
    """Without a look at the array the host cannot refuse it; the world ends with a fault."""
    env, twin = (make(output="warp", copy=True, autoreset_mode=mode) for _ in range(2))
    for each in (env, twin):
        each.reset(seed=3)
        obs = each.step(wp.array(GOOD, device="cpu"))[0].numpy()
    bad = wp.array(with_entry(value), dtype=float, device="cpu")
    with pytest.warns(UserWarning, match=r"world 1 was reset after a fault \(action not finite\)"):
        broken = env.step(bad)
    whole = twin.step(wp.array(GOOD, device="cpu"))
    others = [0, 2]
    for got, expected in zip(broken[:4], whole[:4], strict=True):
        np.testing.assert_array_equal(got.numpy()[others], expected.numpy()[others])
    assert broken[4]["fault"].numpy().tolist() == [0, ACTION_FAULT, 0]
    assert broken[2].numpy().tolist() == [False, True, False]
    assert not broken[3].numpy().any()
    assert broken[1].numpy()[1] == 0.0
    assert not broken[4]["solved"].numpy()[1]
    last = broken[4]["final_obs"] if mode == "same_step" else broken[0]
    np.testing.assert_array_equal(last.numpy()[1], obs[1])
    if mode == "disabled":
        env.reset(options={"reset_mask": np.array([False, True, False])})
    for _ in range(2):
        after, expected = (each.step(wp.array(-GOOD, device="cpu")) for each in (env, twin))
        np.testing.assert_array_equal(after[0].numpy()[others], expected[0].numpy()[others])
        assert not after[4]["fault"].numpy().any()
    assert np.isfinite(after[0].numpy()).all()
    assert not np.array_equal(after[0].numpy()[1], expected[0].numpy()[1])
