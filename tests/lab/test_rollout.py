"""Recordings: what a policy does with its arrays, and a disk that fails."""

import numpy as np
import pytest

from myowarp.apps.rollouts import rollout
from myowarp.apps.rollouts.film import Film
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import TASKS
from myowarp.view.drawing.snapshot import snapshot

TASK = "myoElbowPose1D6MRandom-v0"


@pytest.fixture(scope="module")
def env():
    return MyoWarpVectorEnv(TASK, 2, device="cpu", autoreset_mode="same_step", max_episode_steps=4)


def record(env, act, steps=6, **options):
    return rollout.run(env, rollout.Policy("mine", act), steps, 0, record=True, **options)


def growing(reuse):
    """Policy whose action grows from step to step, in new arrays or in one that it overwrites."""
    buffer, step = np.zeros((2, 6), dtype=np.float32), 0

    def act(obs):
        nonlocal step, buffer
        step += 1
        buffer = buffer if reuse else buffer.copy()
        buffer[:] = 0.1 * step
        return buffer

    return act


def test_policy_may_reuse_its_array(env):
    _, expected = record(env, growing(reuse=False))
    _, got = record(env, growing(reuse=True))
    for name, steps in expected.arrays.items():
        np.testing.assert_array_equal(np.stack(got.arrays[name]), np.stack(steps), err_msg=name)
    assert len(np.unique(np.stack(expected.arrays["action"]))) == 6


def test_policy_may_write_into_its_observations(env):
    def tidy(obs):
        return np.zeros((2, 6))

    def untidy(obs):
        obs[:] = np.nan
        return np.zeros((2, 6))

    _, expected = record(env, tidy)
    _, got = record(env, untidy)
    np.testing.assert_array_equal(np.stack(got.arrays["obs"]), np.stack(expected.arrays["obs"]))


def test_figures_over_several_episodes(env):
    """Ten steps of episodes of four: two finished ones a world; the third is left out."""
    summary, recording = record(env, growing(reuse=False), steps=10)
    reward = np.stack(recording.arrays["reward"]).astype(float)
    returns = np.concatenate([reward[:4].sum(axis=0), reward[4:8].sum(axis=0)])
    assert summary.episodes == 4
    assert summary.return_mean == pytest.approx(returns.mean())
    assert summary.return_std == pytest.approx(returns.std())
    assert summary.return_std > 0
    assert np.flatnonzero(np.stack(recording.arrays["truncated"]).all(axis=1)).tolist() == [3, 7]


def test_filmed_worlds_are_the_leading_ones(env):
    film = Film(env.sim, [0])
    summary, recording = record(env, growing(reuse=False), steps=3, film=film)
    assert [len(worlds) for worlds in film.frames] == [1, 1, 1]
    angles = [worlds[0].qpos[0] for worlds in film.frames]
    seen = [obs[0, 0] for obs in recording.arrays["obs"]]
    np.testing.assert_array_equal(angles[:2], seen[1:])
    assert len(set(angles)) == 3
    assert summary.steps == 3


def test_failing_disk_leaves_the_older_file(env, monkeypatch, tmp_path):
    path = tmp_path / "data.npz"
    path.write_bytes(b"older")
    _, recording = record(env, growing(reuse=False))

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez_compressed", full)
        with pytest.raises(OSError, match="No space left on device"):
            rollout.save_recording(path, env, recording)
    assert path.read_bytes() == b"older"
    assert list(tmp_path.iterdir()) == [path]
    rollout.save_recording(path, env, recording)
    with np.load(path) as saved:
        assert saved["obs"].shape == (6, 2, 9)
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o444 == 0o444


def test_film_ends_with_the_last_state(tmp_path, monkeypatch):
    """A frame is what the step led to: no start of a next episode in its place, and the same numbers."""
    horizon = TASKS[TASK].horizon
    kept, films = {}, {}
    for mode in ("same_step", "disabled"):
        env = MyoWarpVectorEnv(TASK, 2, device="cpu", autoreset_mode=mode, progress=False)
        policy = rollout.Policy("random")
        films[mode] = Film(env.sim, range(2))
        options = {"seed": 4, "record": True, "film": films[mode]}
        summary, kept[mode] = rollout.run(env, policy, horizon + 3, **options)
        assert summary.episodes == 2
    for name, steps in kept["same_step"].arrays.items():
        np.testing.assert_array_equal(steps, kept["disabled"].arrays[name])
    twin = MyoWarpVectorEnv(TASK, 2, device="cpu", autoreset_mode="disabled", progress=False)
    twin.reset(seed=4)
    for actions in kept["disabled"].arrays["action"][:horizon]:
        twin.step(actions)
    last = films["disabled"].frames[horizon - 1]
    for world in range(2):
        expected = snapshot(twin.sim, world)
        np.testing.assert_array_equal(last[world].qpos, expected.qpos)
        start = films["same_step"].frames[horizon - 1][world].qpos
        assert np.abs(start - expected.qpos).max() > 0.01
