"""A policy played without torch is the one that was trained."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from myowarp.apps.learned import LearnedPolicy
from myowarp.apps.train import agents
from myowarp.apps.train.checkpoint import Checkpoint, load_checkpoint, plain, save_checkpoint
from myowarp.apps.train.settings import choose

NUM_OBS, NUM_ACTIONS, ROWS = 7, 3, 400
SAME = 1e-6
OBS, ACTIONS = Box(-np.inf, np.inf, (NUM_OBS,), np.float32), Box(-1.0, 1.0, (NUM_ACTIONS,), np.float32)
CONTRACT = {
    "task": "myoTest-v0",
    "family": "test",
    "body": "test",
    "columns": [["qpos", 4, "rad"], ["act", 3, "1"]],
    "actuators": ["a", "b", "c"],
    "action": "",
}


@pytest.fixture(params=[("ppo", "elu"), ("trpo", "tanh"), ("sac", "relu")])
def trained(request):
    """Return an agent with weights and a normaliser far from the start, and its checkpoint's content."""
    algorithm, activation = request.param
    torch.manual_seed(3)
    given = {"num_worlds": 4, "hidden": (9, 8), "activation": activation}
    settings = choose("none", algorithm, given)
    agent = agents.make_agent(settings, OBS, ACTIONS, "cpu")
    with torch.no_grad():
        for parameter in agent.policy.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    agent._observation_preprocessor(10.0 + 3.0 * torch.randn(500, NUM_OBS), train=True)
    return agent, {"policy": agents.policy_form(settings), "contract": CONTRACT}


def observations():
    """Return observations, some beyond where normalised ones are clipped."""
    obs = np.random.default_rng(0).normal(10.0, 3.0, (ROWS, NUM_OBS)).astype(np.float32)
    obs[::10] *= 40.0
    return obs


def torch_means(agent, obs):
    """Return the actions of highest probability, by torch."""
    with torch.no_grad():
        inputs = {"observations": agent._observation_preprocessor(torch.from_numpy(obs))}
        return agent.policy.act(inputs, role="policy")[1]["mean_actions"].clamp(-1.0, 1.0).numpy()


def test_numpy_acts_like_torch(trained, tmp_path):
    agent, manifest = trained
    save_checkpoint(tmp_path, 12, plain(manifest), agents.policy_arrays(agent), {})
    act = LearnedPolicy(load_checkpoint(tmp_path))
    obs = observations()
    assert np.abs(act(obs) - torch_means(agent, obs)).max() < SAME
    assert np.abs(act(obs[:1]) - act(obs)[:1]).max() < SAME
    assert np.ptp(act(obs), axis=0).min() > 0.1  # it looks at the observation


def test_drawn_actions_have_the_spread_of_torch(trained, tmp_path):
    agent, manifest = trained
    checkpoint = Checkpoint(tmp_path, manifest, agents.policy_arrays(agent))
    obs = np.repeat(observations()[1:2], 40_000, axis=0)
    with torch.no_grad():
        torch.manual_seed(0)
        inputs = {"observations": agent._observation_preprocessor(torch.from_numpy(obs))}
        expected = agent.policy.act(inputs, role="policy")[0].clamp(-1.0, 1.0).numpy()
    got = LearnedPolicy(checkpoint, sampled=True, seed=1)(obs)
    assert expected.std(axis=0).min() > 0.05
    np.testing.assert_allclose(got.mean(axis=0), expected.mean(axis=0), atol=0.02)  # 5 standard errors
    np.testing.assert_allclose(got.std(axis=0), expected.std(axis=0), atol=0.02)
    again = LearnedPolicy(checkpoint, sampled=True, seed=1)(obs)
    np.testing.assert_array_equal(got, again)


def test_playing_imports_no_torch(trained, tmp_path):
    agent, manifest = trained
    save_checkpoint(tmp_path, 12, plain(manifest), agents.policy_arrays(agent), {})
    code = f"""
import sys
sys.modules["torch"] = sys.modules["skrl"] = None
from pathlib import Path
import numpy as np
import myowarp.apps.train.evaluate
from myowarp.apps.learned import LearnedPolicy
from myowarp.apps.train.checkpoint import load_checkpoint
print(LearnedPolicy(load_checkpoint(Path({str(tmp_path)!r})))(np.ones((2, 7))).shape)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip().endswith("(2, 3)"), done.stderr
