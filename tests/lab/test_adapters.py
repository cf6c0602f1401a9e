"""Adapters for other trainers: what they hand over is what the Gymnasium environment returns."""

import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

torch = pytest.importorskip("torch")

ID = "MyoWarp/myoElbowPose1D6MRandom-v0"
FALLING = "MyoWarp/myoHandObjHoldRandom-v1"  # terminates as well
OPTIONS = {"device": "cpu", "progress": False}
NUM_WORLDS = 5


def sb3_env(env):
    """Return an environment as Stable-Baselines3 wants it; imported here, as that takes seconds."""
    pytest.importorskip("stable_baselines3")
    from myowarp.apps.adapters.stable_baselines3 import Sb3VecEnv

    return Sb3VecEnv(env)


def rsl_rl_env(env, **options):
    """Return an environment as RSL-RL wants it."""
    pytest.importorskip("rsl_rl")
    from myowarp.apps.adapters.rsl_rl import RslRlVecEnv

    return RslRlVecEnv(env, **options)


def actions(step):
    return np.random.default_rng(step).uniform(-1, 1, (NUM_WORLDS, 6)).astype(np.float32)


def bare(env_id=ID, **options):
    return gym.make_vec(env_id, NUM_WORLDS, autoreset_mode=AutoresetMode.SAME_STEP, **OPTIONS, **options)


@pytest.mark.parametrize("env_id", [ID, FALLING])
def test_stable_baselines3_sees_what_gymnasium_sees(env_id):
    """Terminal observations, and which endings were time limits; the next episode's start in their place."""
    ours, theirs = sb3_env(bare(env_id)), bare(env_id)
    ours.seed(3)
    np.testing.assert_array_equal(ours.reset(), theirs.reset(seed=3)[0])
    limits, failures = 0, 0
    for step in range(120):
        draws = np.random.default_rng(step).uniform(-1, 1, theirs.action_space.shape).astype(np.float32)
        obs, reward, done, infos = ours.step(draws)
        expected = theirs.step(draws)
        np.testing.assert_array_equal(obs, expected[0])
        np.testing.assert_array_equal(reward, expected[1])
        np.testing.assert_array_equal(done, expected[2] | expected[3])
        for world, info in enumerate(infos):
            assert bool(info) == done[world]
            if info:
                np.testing.assert_array_equal(info["terminal_observation"], expected[4]["final_obs"][world])
                assert (info["terminal_observation"] != obs[world]).any()
                assert info["TimeLimit.truncated"] == (expected[3][world] and not expected[2][world])
                assert info["is_success"] == expected[4]["final_info"]["success"][world]
                limits += info["TimeLimit.truncated"]
                failures += not info["TimeLimit.truncated"]
    assert limits + failures >= NUM_WORLDS
    assert failures > 0 or env_id == ID


def test_stable_baselines3_counts_episodes():
    monitors = pytest.importorskip("stable_baselines3.common.vec_env")
    env = monitors.VecMonitor(sb3_env(bare()))
    env.reset()
    rewards = []
    for step in range(100):
        _, reward, _, infos = env.step(actions(step))
        rewards.append(reward)
    np.testing.assert_allclose([info["episode"]["r"] for info in infos], np.sum(rewards, axis=0), rtol=1e-4)
    assert [info["episode"]["l"] for info in infos] == [100] * NUM_WORLDS


def test_rsl_rl_sees_what_gymnasium_sees():
    ours, theirs = rsl_rl_env(bare(output="torch"), seed=4), bare()
    obs, _ = theirs.reset(seed=4)
    np.testing.assert_array_equal(ours.get_observations()["policy"].numpy(), obs)
    ended = 0
    for step in range(120):
        shown, reward, done, extras = ours.step(torch.from_numpy(actions(step)))
        expected = theirs.step(actions(step))
        np.testing.assert_array_equal(shown["policy"].numpy(), expected[0])
        np.testing.assert_array_equal(reward.numpy(), expected[1])
        np.testing.assert_array_equal(done.numpy(), expected[2] | expected[3])
        np.testing.assert_array_equal(extras["time_outs"].numpy(), expected[3] & ~expected[2])
        if done.any():
            success = expected[4]["final_info"]["success"][done.numpy()]
            assert extras["log"]["/episode/success"].item() == pytest.approx(success.mean())
        ended += done.sum().item()
    assert ended == NUM_WORLDS


def test_rsl_rl_may_start_within_episodes():
    """What it writes into `episode_length_buf` ends episodes earlier, each world its own."""
    env = rsl_rl_env(bare(output="torch"))
    env.episode_length_buf = torch.tensor([0, 95, 98, 50, 99])
    ends = np.stack([env.step(torch.zeros(NUM_WORLDS, 6))[2].numpy() for _ in range(5)])
    np.testing.assert_array_equal(ends.argmax(axis=0)[[1, 2, 4]], [4, 1, 0])
    assert not ends[:, [0, 3]].any()


@pytest.mark.parametrize(
    ("file", "budget"),
    [
        pytest.param("train_sb3.py", 160_000, marks=pytest.mark.slow),
        pytest.param("train_rsl_rl.py", 60, marks=pytest.mark.slow),
        pytest.param("train_skrl.py", 1500, marks=pytest.mark.slow),
    ],
)
def test_examples_learn(file, budget):
    """The elbow is reached by at least 90 % of the episodes."""
    path = Path(__file__).parents[2] / "examples" / file
    assert len(path.read_text().splitlines()) <= 40
    one_thread = os.environ | {"OMP_NUM_THREADS": "1"}  # torch's would wait for busy cores
    command = [sys.executable, path, str(budget)]
    run = subprocess.run(command, env=one_thread, capture_output=True, text=True, check=True)
    assert int(re.search(r"success (\d+)%", run.stdout)[1]) >= 90, run.stdout


def test_stable_baselines3_refuses_views_that_the_next_step_overwrites():
    with pytest.raises(
        ValueError, match=r"^the environment must be made without copy=False: Stable-Baselines3"
    ):
        sb3_env(bare(copy=False))


@pytest.mark.parametrize("adapter", [sb3_env, rsl_rl_env])
def test_what_does_not_fit_is_refused(adapter):
    env = gym.make_vec(ID, 1, **OPTIONS)
    with pytest.raises(
        ValueError, match=r"^the environment must be made with autoreset_mode='SameStep' and "
    ):
        adapter(env)
    with pytest.raises(ValueError, match=r"^the environment must be a vector environment, of gymnasium"):
        adapter(gym.make(ID))
