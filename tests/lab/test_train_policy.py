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
from learners import make_learner
from onnx.reference import ReferenceEvaluator

from myowarp.apps.policies.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.train.worlds import Clock
from myowarp.definitions.setup import Setup
from myowarp.disk import plain
from myowarp.extras import to_install

NUM_OBS, NUM_ACTIONS, ROWS = 7, 3, 400
SAME = 1e-6
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
    "ppo, clip": {"algorithm": "ppo", "activation": "elu", "mean_bound": "clip"},
    "trpo": {"algorithm": "trpo", "activation": "tanh"},
    "sac": {"algorithm": "sac", "activation": "relu"},
    "improve": {"algorithm": "improve", "activation": "elu", "copies": 2},
    "dagger": {"algorithm": "dagger", "activation": "relu"},
}


@pytest.fixture(params=KINDS)
def trained(request):
    """Return what `train` does, of each kind."""
    return train(request.param)


def train(kind):
    """Return a learner with weights and a normaliser far from the start, and its checkpoint's content."""
    given = KINDS[kind] | {"num_worlds": 4, "hidden": (9, 8)}
    algorithm = given.pop("algorithm")
    torch.manual_seed(3)
    learner = make_learner(algorithm, NUM_OBS, NUM_ACTIONS, **given)
    with torch.no_grad():
        for parameter in learner.policy.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    learner.normaliser.see(10.0 + 3.0 * torch.randn(500, NUM_OBS))
    setup = Setup(physics="fast", muscle="mujoco", seed=0).plain()
    own = {
        "algorithm": algorithm,
        "settings": dataclasses.asdict(learner.settings) | setup,
        "contract": CONTRACT,
    }
    return learner, REST | own | {"policy": learner.form()}


def arrays_of(learner):
    """Return what a checkpoint has of a policy."""
    learner.follow(0.0)
    return learner.acting()


def observations():
    """Return observations, some beyond where normalised ones are clipped."""
    obs = np.random.default_rng(0).normal(10.0, 3.0, (ROWS, NUM_OBS)).astype(np.float32)
    obs[::10] *= 40.0
    return obs


def torch_means(learner, obs):
    """Return the actions of highest probability, by torch."""
    with torch.no_grad():
        means = learner.policy(learner.normaliser(torch.from_numpy(obs)))
        if isinstance(means, tuple):  # of what is squashed, and logarithms of its spread
            means = means[0].tanh()
        return means.clamp(-1.0, 1.0).numpy()


def torch_draws(learner, obs):
    """Return actions that torch draws."""
    with torch.no_grad():
        seen = learner.normaliser(torch.from_numpy(obs))
        if hasattr(learner.policy, "draw"):
            return learner.policy.draw(seen)[0].numpy()
        mean = learner.policy(seen)
        return (mean + learner.policy.std * torch.randn_like(mean)).clamp(-1.0, 1.0).numpy()


def test_numpy_acts_like_torch(trained, tmp_path):
    learner, manifest = trained
    save_checkpoint(tmp_path, 12, plain(manifest), arrays_of(learner), {})
    act = LearnedPolicy(load_checkpoint(tmp_path))
    obs = observations()
    assert np.abs(act(obs) - torch_means(learner, obs)).max() < SAME
    assert np.abs(act(obs[:1]) - act(obs)[:1]).max() < SAME
    assert np.ptp(act(obs), axis=0).min() > 0.1  # it looks at the observation


def test_a_run_starts_with_the_policy_of_another(trained):
    """The child acts like its parent, apart from a column that never changed while the parent learned."""
    learner, _ = trained
    arrays, samples, fixed = arrays_of(learner), 10**6, 3
    arrays["observation_mean"][fixed], arrays["observation_variance"][fixed] = 0.0, 1.0 / samples
    given = {"num_worlds": 4, "hidden": (9, 8), "activation": learner.settings.activation}
    if "log_std" in arrays:
        given["mean_bound"] = learner.policy.mean_bound
    child = make_learner("ppo" if "log_std" in arrays else "sac", NUM_OBS, NUM_ACTIONS, **given)
    child.inherit(arrays, samples, 96, np.arange(NUM_OBS))
    obs = observations()
    obs[:, fixed] = 0.0
    learner.normaliser.mean[fixed] = 0.0  # a column at its mean says nothing
    assert np.abs(torch_means(child, obs) - torch_means(learner, obs)).max() < SAME
    obs[:, fixed] = 7.0
    assert np.abs(torch_means(learner, obs) - torch_means(child, obs)).max() > 0.1
    child.normaliser.see(torch.from_numpy(obs))
    assert child.normaliser.mean[fixed] > 5.0  # the new task soon says what is usual


def test_a_search_starts_from_the_means_of_any_policy(trained):
    """Also of one whose spread depends on the state, which is the second half of its last layer."""
    learner, _ = trained
    given = {"hidden": (9, 8), "activation": learner.settings.activation, "num_worlds": 4, "copies": 2}
    child = make_learner("improve", NUM_OBS, NUM_ACTIONS, mean_bound=learner.policy.mean_bound, **given)
    child.inherit(arrays_of(learner), 500, 96, np.arange(NUM_OBS))
    obs = observations()
    assert np.abs(torch_means(child, obs) - torch_means(learner, obs)).max() < SAME


@pytest.mark.parametrize("bound", ["clip", "tanh"])
def test_a_policy_starts_at_its_first_mean(bound):
    given = {"initial_mean": -0.7, "mean_bound": bound, "num_worlds": 4}
    means = torch_means(make_learner("ppo", NUM_OBS, NUM_ACTIONS, **given), observations())
    assert np.abs(means + 0.7).max() < 0.05
    assert np.ptp(means, axis=0).min() > 1e-4


def test_only_the_tangent_has_a_gradient_beyond_the_bounds():
    """d min(max(m, -1), 1) / dm is 0 there; that of tanh is 1 - tanh(m)^2."""
    learner = make_learner("ppo", NUM_OBS, NUM_ACTIONS, mean_bound="tanh", num_worlds=4)
    last = learner.policy.net[-1]
    with torch.no_grad():
        last.weight.zero_()
        last.bias.fill_(-3.0)
    learner.policy(torch.from_numpy(observations())).sum().backward()
    expected = ROWS * (1.0 - np.tanh(-3.0) ** 2)
    np.testing.assert_allclose(last.bias.grad.numpy(), expected, rtol=1e-5)
    assert torch_means(learner, observations()).min() > -1.0


def test_drawn_actions_have_the_spread_of_torch(trained, tmp_path):
    learner, manifest = trained
    checkpoint = Checkpoint(tmp_path, manifest, arrays_of(learner))
    obs = np.repeat(observations()[1:2], 40_000, axis=0)
    torch.manual_seed(0)
    expected = torch_draws(learner, obs)
    got = LearnedPolicy(checkpoint, Setup(seed=1))(obs)
    assert expected.std(axis=0).min() > 0.05
    np.testing.assert_allclose(got.mean(axis=0), expected.mean(axis=0), atol=0.02)  # 5 standard errors
    np.testing.assert_allclose(got.std(axis=0), expected.std(axis=0), atol=0.02)
    again = LearnedPolicy(checkpoint, Setup(seed=1))(obs)
    np.testing.assert_array_equal(got, again)


def test_exported_policies_act_like_the_original(trained, tmp_path, run):
    """ONNX by the reference evaluator of its own package, TorchScript as another program loads it."""
    learner, manifest = trained
    save_checkpoint(tmp_path / "run", 12, plain(manifest), arrays_of(learner), {})
    for name in ("policy.onnx", "policy.pt"):
        status, _, err = run("export", tmp_path / "run", tmp_path / name)
        assert status == 0, err
    obs = observations()
    model = onnx.load(tmp_path / "policy.onnx")
    (got,) = ReferenceEvaluator(model).run(None, {"obs": obs})
    expected = torch_means(learner, obs)
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
    save_checkpoint(tmp_path / "run", 12, plain(manifest), arrays_of(agent), {})
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
            f"need torch, which is not installed; run {to_install('torch')}",
        ),
        ("there.onnx/policy.pt", None, "it must be a folder, or a new one, and writable"),
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


@pytest.mark.slow
def test_playing_imports_no_torch(tmp_path):
    for kind in KINDS:
        learner, manifest = train(kind)
        save_checkpoint(tmp_path / kind, 12, plain(manifest), arrays_of(learner), {})
    code = f"""
import sys
sys.modules["torch"] = None
from pathlib import Path
import numpy as np
import myowarp.apps.reports.evaluation
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.policies.checkpoint import load_checkpoint
for run in Path({str(tmp_path)!r}).iterdir():
    print(LearnedPolicy(load_checkpoint(run))(np.ones((2, 7))).shape)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.split("\n").count("(2, 3)") == len(KINDS), done.stderr
