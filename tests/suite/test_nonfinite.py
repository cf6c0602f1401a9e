"""A reward or an observation that is not finite: a fault of its world, which the others do not feel."""

import gymnasium as gym
import numpy as np
import pytest
import warp as wp

import myowarp

pytestmark = pytest.mark.usefixtures("registered")

ELBOW = "myoElbowPose1D6MRandom-v0"
STEPS = 6
BROKEN = 1  # the world whose first muscle is excited
OBSERVATION, REWARD = (
    next(bit for bit, text in myowarp.FAULTS.items() if text == f"{what} not finite")
    for what in ("observation", "reward")
)


@wp.func
def root(activation: wp.array[float]) -> float:
    """NaN where the first muscle is almost wholly active."""
    return wp.sqrt(0.9 - activation[0])


@wp.func
def pole(activation: wp.array[float]) -> float:
    """Infinite where the first muscle is almost wholly active."""
    return 1.0 / wp.max(0.9 - activation[0], 0.0)


@wp.func
def never(qpos: wp.array[float]) -> float:
    """NaN in every state."""
    return wp.sqrt(-1.0 - qpos[0] * qpos[0])


@wp.func
def safe(activation: wp.array[float]) -> float:
    """As `root`, where that is finite."""
    return wp.sqrt(wp.max(0.9 - activation[0], 0.0))


def make(key, mode="next_step", output="numpy", **blocks):
    task = myowarp.extend(ELBOW, key, **blocks)
    return myowarp.make_vec(
        task, 3, device="cpu", progress=False, autoreset_mode=mode, output=output, copy=True
    )


def stepped(env, seed=0):
    """Return what steps gave, as lists; the first muscle of one world becomes active."""
    env.reset(seed=seed)
    rng, seen = np.random.default_rng(0), []
    for _ in range(STEPS):
        action = rng.uniform(-1, -0.5, (3, 6)).astype(np.float32)
        action[BROKEN, 0] = 1.0
        seen.append(env.step(action))
        ended = seen[-1][2] | seen[-1][3]
        if ended.any() and env.metadata["autoreset_mode"] == gym.vector.AutoresetMode.DISABLED:
            env.reset(options={"reset_mask": ended})
    env.close()
    return seen


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
@pytest.mark.parametrize(
    ("what", "bit", "broken", "whole"),
    [
        ("root", REWARD, {"rewards": {"x": (1.0, root)}}, {"rewards": {"x": (1.0, safe)}}),
        ("pole", REWARD, {"rewards": {"x": (0.0, pole)}}, {"rewards": {"x": (0.0, safe)}}),
        ("obs", OBSERVATION, {"observations": {"x": ("1", root)}}, {"observations": {"x": ("1", safe)}}),
    ],
    ids=["reward", "reward without weight", "observation"],
)
def test_a_world_ends_with_a_fault_and_the_others_go_on(mode, what, bit, broken, whole):
    with pytest.warns(UserWarning, match="world 1 was reset after a fault .*'x'"):
        got = stepped(make(f"testBroken{what}-v0", mode, **broken))
    expected = stepped(make(f"testWhole{what}-v0", mode, **whole))
    faults = np.array([info["fault"] for *_, info in got])
    first = int(np.flatnonzero(faults[:, BROKEN])[0])
    assert first > 0
    assert faults[first].tolist() == [0, bit, 0]
    obs, reward, terminated, truncated, info = got[first]
    assert terminated.tolist() == [False, True, False]
    assert reward[BROKEN] == 0.0
    assert not truncated.any()
    last = info["final_obs"] if mode == "same_step" else obs
    healthy = got[first - 1][0] if what == "obs" else expected[first][0]
    np.testing.assert_array_equal(last[BROKEN][:-1], healthy[BROKEN][:-1])
    for step, (one, other) in enumerate(zip(got, expected, strict=True)):
        for values, others in zip(one[:4], other[:4], strict=True):
            assert np.isfinite(values).all()
            if what != "pole" or step < first:  # their term differs, with no weight
                np.testing.assert_array_equal(values[[0, 2]], others[[0, 2]])
        for name, values in one[4].items():
            assert name.startswith("_") or name.startswith("final") or np.isfinite(values).all(), name


def test_an_observation_that_is_never_finite_faults_in_every_episode():
    """From the reset on, rows stay what they were: nothing."""
    env = make("testNeverObserved-v0", observations={"x": ("1", never)})
    obs, _ = env.reset(seed=0)
    assert not obs.any()
    with pytest.warns(UserWarning, match=r"observation not finite: column 9, of 'x'"):
        seen = [env.step(np.zeros((3, 6), dtype=np.float32)) for _ in range(4)]
    assert all(np.isfinite(obs).all() and not reward.any() for obs, reward, *_ in seen)
    assert all((info["fault"] == OBSERVATION).all() for *_, info in seen)
    assert [step[2].all() for step in seen] == [True, False, True, False]
    env.close()


def test_the_term_is_named():
    env = make("testNeverRewarded-v0", rewards={"fine": (1.0, safe), "broken": (1.0, never)})
    env.reset(seed=0)
    with pytest.warns(UserWarning, match=r"reward not finite: term 'broken'"):
        env.step(np.zeros((3, 6), dtype=np.float32))
    assert env.sim.describe_fault(2) == "reward not finite: term 'broken'"
    env.close()
