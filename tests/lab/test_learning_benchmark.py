"""`benchmarks.learning`: what passes the pipe to a rival's process, and what the summary says."""

import json
import os
import sys

import numpy as np
import pytest
import torch

from benchmarks.learner import ServedEnv
from benchmarks.learning import draw, print_table, summary
from myowarp.apps.train.loop import Run
from myowarp.apps.train.settings import choose

FAKE = '''
import numpy as np
from types import SimpleNamespace

class Env:
    """Observation: world, steps since its reset, last action; solved in even worlds, over after 8 steps."""

    action_space = SimpleNamespace(shape=(3, 2))

    def reset(self, ids=(0, 1, 2)):
        if len(ids) == 3:
            self.count, self.action = np.zeros(3), np.zeros(3)
        self.count[list(ids)] = 0
        return self.obs()[list(ids)], {}

    def obs(self):
        return np.stack([np.arange(3.0), self.count, self.action], axis=1)

    def step(self, actions):
        print("noise of a rival")
        self.count += 1
        self.action = actions[:, 1].astype(float)
        over = self.count == 8
        failed, solved = over & (np.arange(3) == 1), np.arange(3) % 2 == 0
        return self.obs(), 2.0 * self.count, failed, over, {"solved": solved}

def make_gymnasium(task, num_envs, num_threads, seed):
    assert task == "MyoSuite/x"
    return Env()
'''


@pytest.fixture
def served(tmp_path, monkeypatch):
    (tmp_path / "envpool.py").write_text(FAKE)
    monkeypatch.setitem(os.environ, "PYTHONPATH", str(tmp_path))
    env = ServedEnv(sys.executable, 3, kind="envpool", task="x", cores=1)
    yield env
    env.close()


def test_a_rival_is_stepped_through_a_pipe(served):
    assert served.single_observation_space.shape == (3,)
    assert served.single_action_space.shape == (2,)
    obs, _ = served.reset(seed=0)
    np.testing.assert_array_equal(obs, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    for step in range(1, 9):
        obs, reward, terminated, truncated, info = served.step(torch.tensor([[9.0, 0.5]] * 3))
        np.testing.assert_array_equal(obs, [[0, step, 0.5], [1, step, 0.5], [2, step, 0.5]])
        assert reward.tolist() == [2.0 * step] * 3
        assert info["success"].tolist() == [step > 5, False, step > 5]  # more than 5 solved steps
        assert info["solved"].tolist() == [True, False, True]
    assert (terminated.tolist(), truncated.tolist()) == ([False, True, False], [True] * 3)
    obs, _ = served.reset(options={"reset_mask": np.array([True, False, False])})
    np.testing.assert_array_equal(obs[:, 1], [0, 8, 8])
    *_, info = served.step(torch.full((3, 2), 7.0))
    assert info["success"].tolist() == [False, False, True]  # counted anew in the world that was reset
    obs, *_ = served.step(torch.full((3, 2), -7.0))
    assert obs[:, 2].tolist() == [-1.0] * 3  # clipped


def test_a_rival_is_learned_in_with_the_learner_of_ours(served):
    """Bootstraps, restarts by mask and figures of episodes, of which two a world end in as many steps."""
    run = Run(served, choose("none", "ppo", {"num_worlds": 3, "rollout_steps": 17, "minibatches": 1}))
    run.iterate()
    assert run.samples == 3 * 17
    figures = run.worlds.tally.figures()
    assert figures["episodes"] == 6
    assert figures["return"] == 2.0 * sum(range(1, 9))
    assert figures["success"] == pytest.approx(2 / 3)
    assert np.isfinite(run.losses["value_loss"])
    np.testing.assert_array_equal(run.worlds.obs[:, 1], [1.0, 1.0, 1.0])


def test_the_summary_counts_a_rival_that_did_not_succeed(tmp_path, capsys):
    def training(seconds, reached):
        row = {
            "seconds": seconds,
            "start": 1.5,
            "cpu": 2 * seconds,
            "samples": 100,
            "success": 0.96,
            "simulation": 0.5,
        }
        return {"reached": reached, "curve": [row | {"success": float("nan")}, row], "others": 0.0}

    rows = {
        "myowarp": [training(s, True) for s in (3.0, 2.0, 9.0)],
        "myowarp_sac": [training(1.0, True)],  # no rival
        "envpool": [training(30.0, False)],
        "myosuite_async": [training(24.0, True)],
    }
    found = summary(rows)
    assert found["times_better_seconds"] == found["times_better_cpu"] == 8.0
    report = {"tasks": {"elbow pose": {"summary": found, "trainings": rows}}}
    draw(report, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000
    print_table(json.loads(json.dumps(report)))
    out = capsys.readouterr().out
    assert "> 30.0" in out
    assert "start [s]" in out
