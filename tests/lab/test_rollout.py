"""Recordings: what a policy does with its arrays, and a disk that fails."""

import numpy as np
import pytest

from myowarp.apps.policies.find import Policy
from myowarp.apps.rollouts.episodes import Trace
from myowarp.apps.rollouts.film import Film
from myowarp.apps.rollouts.rollout import roll_out, save_trace
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.view.drawing.snapshot import snapshot

TASK = "myoElbowPose1D6MRandom-v0"


@pytest.fixture(scope="module")
def sim():
    return Simulation(TASKS[TASK], 2, device="cpu", autoreset="same_step", horizon=4)


def record(sim, act, steps=6, *watchers):
    trace = Trace()
    return roll_out(sim, Policy("mine", act), steps, trace, *watchers), trace


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


def test_policy_may_reuse_its_array(sim):
    _, expected = record(sim, growing(reuse=False))
    _, got = record(sim, growing(reuse=True))
    for name, steps in expected.arrays.items():
        np.testing.assert_array_equal(np.stack(got.arrays[name]), np.stack(steps), err_msg=name)
    assert len(np.unique(np.stack(expected.arrays["action"]))) == 6


def test_policy_may_write_into_its_observations(sim):
    def tidy(obs):
        return np.zeros((2, 6))

    def untidy(obs):
        obs[:] = np.nan
        return np.zeros((2, 6))

    _, expected = record(sim, tidy)
    _, got = record(sim, untidy)
    np.testing.assert_array_equal(np.stack(got.arrays["obs"]), np.stack(expected.arrays["obs"]))


def test_figures_over_several_episodes(sim):
    """Ten steps of episodes of four: two finished ones a world; the third is left out."""
    summary, recording = record(sim, growing(reuse=False), 10)
    reward = np.stack(recording.arrays["reward"]).astype(float)
    returns = np.concatenate([reward[:4].sum(axis=0), reward[4:8].sum(axis=0)])
    assert summary.episodes == 4
    assert summary.return_mean == pytest.approx(returns.mean())
    assert summary.return_std == pytest.approx(returns.std())
    assert summary.return_std > 0
    assert np.flatnonzero(np.stack(recording.arrays["truncated"]).all(axis=1)).tolist() == [3, 7]


def test_filmed_worlds_are_the_leading_ones(sim):
    film = Film(sim, [0])
    summary, recording = record(sim, growing(reuse=False), 3, film)
    assert [len(worlds) for worlds in film.frames] == [1, 1, 1, 1]
    angles = [worlds[0].qpos[0] for worlds in film.frames]
    seen = [obs[0, 0] for obs in recording.arrays["obs"]]
    np.testing.assert_array_equal(angles[:3], seen)
    assert len(set(angles)) == 4
    assert summary.steps == 3


def test_failing_disk_leaves_the_older_file(sim, monkeypatch, tmp_path):
    path = tmp_path / "data.npz"
    path.write_bytes(b"older")
    _, recording = record(sim, growing(reuse=False))

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez_compressed", full)
        with pytest.raises(OSError, match="No space left on device"):
            save_trace(path, sim, recording)
    assert path.read_bytes() == b"older"
    assert list(tmp_path.iterdir()) == [path]
    save_trace(path, sim, recording)
    with np.load(path) as saved:
        assert saved["obs"].shape == (6, 2, 9)
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o444 == 0o444


def test_film_ends_with_the_last_state(tmp_path, monkeypatch):
    """A frame is what the step led to: no start of a next episode in its place, and the same numbers."""
    horizon = TASKS[TASK].horizon
    kept, films = {}, {}
    for mode in ("same_step", "disabled"):
        sim = Simulation(TASKS[TASK], 2, device="cpu", autoreset=mode, seed=4, progress=False)
        films[mode], kept[mode] = Film(sim, range(2)), Trace()
        summary = roll_out(sim, Policy("random"), horizon + 3, films[mode], kept[mode])
        assert summary.episodes == 2
    for name, steps in kept["same_step"].arrays.items():
        np.testing.assert_array_equal(steps, kept["disabled"].arrays[name])
    twin = MyoWarpVectorEnv(TASK, 2, device="cpu", autoreset_mode="disabled", progress=False)
    twin.reset(seed=4)
    for actions in kept["disabled"].arrays["action"][:horizon]:
        twin.step(actions)
    last = films["disabled"].frames[horizon]
    for world in range(2):
        expected = snapshot(twin.sim, world)
        np.testing.assert_array_equal(last[world].qpos, expected.qpos)
        start = films["same_step"].frames[horizon][world].qpos
        assert np.abs(start - expected.qpos).max() > 0.01
