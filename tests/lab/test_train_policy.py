"""A policy played without torch is the one that was trained."""

import dataclasses
import importlib.util
import json
import re
import subprocess
import sys

import numpy as np
import onnx
import pytest
import torch
from full_disk import full_disk
from gymnasium.spaces import Box
from onnx.reference import ReferenceEvaluator

from myowarp.apps.policies.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.train import agents
from myowarp.apps.train.loop import Clock
from myowarp.apps.train.settings import ALGORITHMS, choose
from myowarp.definitions.setup import Setup
from myowarp.disk import plain

NUM_OBS, NUM_ACTIONS, ROWS = 7, 3, 400
SAME = 1e-6
SCALER = "observation_preprocessor"
OBS, ACTIONS = Box(-np.inf, np.inf, (NUM_OBS,), np.float32), Box(-1.0, 1.0, (NUM_ACTIONS,), np.float32)
CONTRACT = {
    "task": "myoTest-v0",
    "family": "test",
    "body": "test",
    "columns": [["qpos", 4, "rad"], ["act", 3, "1"]],
    "actuators": ["a", "b", "c"],
    "action": "",
    "reward": [],
    "control_dt": 0.02,
    "success": "",
}
REST = {
    "task": "myoTest-v0",
    "model": False,
    "reset": "task",
    "conditions": [],
    "versions": {},
    "figures": {},
}
REST |= {"samples": 12, "steps": 3, "updates": 1, "clock": dataclasses.asdict(Clock())}


KINDS = {
    "ppo": {"algorithm": "ppo", "activation": "elu"},
    "ppo, tanh": {"algorithm": "ppo", "activation": "elu", "mean_bound": "tanh"},
    "trpo": {"algorithm": "trpo", "activation": "tanh"},
    "sac": {"algorithm": "sac", "activation": "relu"},
    "flashsac": {"algorithm": "flashsac", "activation": "elu"},
    "dagger": {"algorithm": "dagger", "activation": "relu"},
}


@pytest.fixture(params=KINDS)
def trained(request):
    """Return what `train` does, of each kind."""
    return train(request.param)


def train(kind):
    """Return an agent with weights and a normaliser far from the start, and its checkpoint's content."""
    given = KINDS[kind] | {"num_worlds": 4, "hidden": (9, 8)}
    algorithm = given.pop("algorithm")
    torch.manual_seed(3)
    settings = choose("none", algorithm, given)
    agent = agents.make_agent(settings, OBS, ACTIONS, "cpu")
    with torch.no_grad():
        for parameter in agent.policy.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    agent.checkpoint_modules[SCALER](10.0 + 3.0 * torch.randn(500, NUM_OBS), train=True)
    own = {
        "algorithm": algorithm,
        "settings": dataclasses.asdict(settings) | Setup(physics="fast", muscle="mujoco", seed=0).plain(),
        "contract": CONTRACT,
    }
    return agent, REST | own | {"policy": agents.policy_form(settings)}


def observations():
    """Return observations, some beyond where normalised ones are clipped."""
    obs = np.random.default_rng(0).normal(10.0, 3.0, (ROWS, NUM_OBS)).astype(np.float32)
    obs[::10] *= 40.0
    return obs


def agent_activation(agent):
    """Return the name of the function between an agent's layers."""
    return type(agent.policy.net[1]).__name__.lower()


def torch_means(agent, obs):
    """Return the actions of highest probability, by torch."""
    with torch.no_grad():
        inputs = {"observations": agent.checkpoint_modules[SCALER](torch.from_numpy(obs))}
        return agent.policy.act(inputs, role="policy")[1]["mean_actions"].clamp(-1.0, 1.0).numpy()


def test_numpy_acts_like_torch(trained, tmp_path):
    agent, manifest = trained
    save_checkpoint(tmp_path, 12, plain(manifest), agents.policy_arrays(agent), {})
    act = LearnedPolicy(load_checkpoint(tmp_path))
    obs = observations()
    assert np.abs(act(obs) - torch_means(agent, obs)).max() < SAME
    assert np.abs(act(obs[:1]) - act(obs)[:1]).max() < SAME
    assert np.ptp(act(obs), axis=0).min() > 0.1  # it looks at the observation


def test_a_run_starts_with_the_policy_of_another(trained):
    """The child acts like its parent, apart from a column that never changed while the parent learned."""
    agent, _ = trained
    arrays, samples, fixed = agents.policy_arrays(agent), 10**6, 3
    arrays["observation_mean"][fixed], arrays["observation_variance"][fixed] = 0.0, 1.0 / samples
    given = {"num_worlds": 4, "hidden": (9, 8), "activation": agent_activation(agent)}
    if "log_std" in arrays:
        given["mean_bound"] = agent.policy.bound
    settings = ALGORITHMS["ppo" if "log_std" in arrays else "sac"](**given)
    child = agents.make_agent(settings, OBS, ACTIONS, "cpu")
    agents.inherit(child, arrays, samples, count=96)
    obs = observations()
    obs[:, fixed] = 0.0
    agent.checkpoint_modules[SCALER].running_mean[fixed] = 0.0  # a column at its mean says nothing
    assert np.abs(torch_means(child, obs) - torch_means(agent, obs)).max() < SAME
    obs[:, fixed] = 7.0
    assert np.abs(torch_means(agent, obs) - torch_means(child, obs)).max() > 0.1
    scaler = child.checkpoint_modules[SCALER]
    scaler(torch.from_numpy(obs), train=True)
    assert scaler.running_mean[fixed] > 5.0  # the new task soon says what is usual


@pytest.mark.parametrize("bound", ["clip", "tanh"])
def test_a_policy_starts_at_its_first_mean(bound):
    settings = choose("none", "ppo", {"initial_mean": -0.7, "mean_bound": bound, "num_worlds": 4})
    agent = agents.make_agent(settings, OBS, ACTIONS, "cpu")
    means = torch_means(agent, observations())
    assert np.abs(means + 0.7).max() < 0.05
    assert np.ptp(means, axis=0).min() > 1e-4


def test_only_the_tangent_has_a_gradient_beyond_the_bounds():
    """d min(max(m, -1), 1) / dm is 0 there; that of tanh is 1 - tanh(m)^2."""
    given = {"mean_bound": "tanh", "num_worlds": 4}
    agent = agents.make_agent(choose("none", "ppo", given), OBS, ACTIONS, "cpu")
    last = agent.policy.net[-1]
    with torch.no_grad():
        last.weight.zero_()
        last.bias.fill_(-3.0)
    seen = {"observations": torch.from_numpy(observations())}
    agent.policy.compute(seen)[0].sum().backward()
    expected = ROWS * (1.0 - np.tanh(-3.0) ** 2)
    np.testing.assert_allclose(last.bias.grad.numpy(), expected, rtol=1e-5)
    assert torch_means(agent, observations()).min() > -1.0


def test_drawn_actions_have_the_spread_of_torch(trained, tmp_path):
    agent, manifest = trained
    checkpoint = Checkpoint(tmp_path, manifest, agents.policy_arrays(agent))
    obs = np.repeat(observations()[1:2], 40_000, axis=0)
    with torch.no_grad():
        torch.manual_seed(0)
        inputs = {"observations": agent.checkpoint_modules[SCALER](torch.from_numpy(obs))}
        expected = agent.policy.act(inputs, role="policy")[0].clamp(-1.0, 1.0).numpy()
    got = LearnedPolicy(checkpoint, Setup(seed=1))(obs)
    assert expected.std(axis=0).min() > 0.05
    np.testing.assert_allclose(got.mean(axis=0), expected.mean(axis=0), atol=0.02)  # 5 standard errors
    np.testing.assert_allclose(got.std(axis=0), expected.std(axis=0), atol=0.02)
    again = LearnedPolicy(checkpoint, Setup(seed=1))(obs)
    np.testing.assert_array_equal(got, again)


def test_exported_policies_act_like_the_original(trained, tmp_path, run):
    """ONNX by the reference evaluator of its own package, TorchScript as another program loads it."""
    agent, manifest = trained
    save_checkpoint(tmp_path / "run", 12, plain(manifest), agents.policy_arrays(agent), {})
    for name in ("policy.onnx", "policy.pt"):
        status, _, err = run("export", tmp_path / "run", tmp_path / name)
        assert status == 0, err
    obs = observations()
    model = onnx.load(tmp_path / "policy.onnx")
    (got,) = ReferenceEvaluator(model).run(None, {"obs": obs})
    expected = torch_means(agent, obs)
    assert np.abs(got - expected).max() < SAME
    (contract,) = [entry.value for entry in model.metadata_props if entry.key == "contract"]
    assert json.loads(contract) == CONTRACT
    files = {"contract": ""}
    script = torch.jit.load(str(tmp_path / "policy.pt"), _extra_files=files)
    assert np.abs(script(torch.from_numpy(obs)).numpy() - expected).max() < SAME
    assert script(torch.from_numpy(obs[:1])).shape == (1, NUM_ACTIONS)
    assert json.loads(files["contract"]) == CONTRACT


@pytest.mark.parametrize("name", ["policy.onnx", "policy.pt"])
def test_a_full_disk_ends_an_export_with_a_sentence(trained, tmp_path, run, name):
    """Torch itself ends the process where it writes the file."""
    agent, manifest = trained
    save_checkpoint(tmp_path / "run", 12, plain(manifest), agents.policy_arrays(agent), {})
    with full_disk(500):
        status, _, err = run("export", tmp_path / "run", tmp_path / name)
    assert status == 2
    assert re.match(rf"myowarp: output '.*{name}' cannot be written \(File too large\); make room there", err)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("output", "missing", "sentence"),
    [
        ("policy.h5", None, "must end in .onnx or .pt"),
        (
            "policy.onnx",
            "onnx",
            "need onnx, which is not installed; run `pip install onnx`; a .pt file needs torch alone",
        ),
        (
            "policy.pt",
            "torch",
            'need torch, which is not installed; run `pip install "myowarp[torch]"`',
        ),
        ("nowhere/policy.pt", None, "its folder must exist and be writable"),
        ("there.onnx", None, "exists; choose another name, or replace it with --overwrite"),
        ("new.onnx", None, "holds no checkpoint"),
    ],
)
def test_what_cannot_be_exported_is_said(output, missing, sentence, run, tmp_path, monkeypatch):
    (tmp_path / "there.onnx").touch()
    if missing:
        find = importlib.util.find_spec
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else find(name))
    status, _, err = run("export", tmp_path / "empty", tmp_path / output)
    assert status == 2
    assert sentence in err
    assert [file.name for file in tmp_path.iterdir()] == ["there.onnx"]


def test_playing_imports_no_torch(tmp_path):
    for kind in KINDS:
        agent, manifest = train(kind)
        save_checkpoint(tmp_path / kind, 12, plain(manifest), agents.policy_arrays(agent), {})
    code = f"""
import sys
sys.modules["torch"] = sys.modules["skrl"] = None
from pathlib import Path
import numpy as np
import myowarp.apps.train.evaluate
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.policies.checkpoint import load_checkpoint
for run in Path({str(tmp_path)!r}).iterdir():
    print(LearnedPolicy(load_checkpoint(run))(np.ones((2, 7))).shape)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.split("\n").count("(2, 3)") == len(KINDS), done.stderr
