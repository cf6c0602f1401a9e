"""DAgger beside its definition: who acts, what is kept, what is fitted; and that an expert is learned."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from elbows import learner_env
from learners import make_learner

from myowarp.apps.policies.checkpoint import load_checkpoint
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.train.dagger import NOISE_LEVELS
from myowarp.apps.train.loop import Run
from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import start, train
from myowarp.apps.train.settings import choose

ELBOW = "myoElbowPose1D6MRandom-v0"
WORLDS, EXPERT_STEPS, HORIZON = 6, 4, 7
SMALL = {
    "num_worlds": WORLDS,
    "rollout_steps": 10,
    "hidden": (16,),
    "expert": "hold",
    "expert_steps": EXPERT_STEPS,
    "replay": 600,
    "batch_size": 24,
    "gradient_steps": 2,
}


def make_run(**settings):
    """Return a run of a few elbows with short episodes, and what its expert was asked and said."""
    env = learner_env(WORLDS, HORIZON)
    run, said = Run(env, choose("none", "dagger", SMALL | settings)), []
    expert = run.learner.expert

    def noted(obs):
        said.append((obs.copy(), expert(obs)))
        return said[-1][1]

    run.learner.expert = noted
    return run, said


def acted(run):
    """Let a run note its actions."""
    actions, step = [], run.env.step

    def noted(action):
        actions.append(action.numpy().copy())
        return step(action)

    run.env.step = noted
    return actions


def test_the_expert_acts_first_and_then_the_policy_with_noise_of_three_sizes():
    run, said = make_run(initial_std=0.2, gradient_steps=1)
    actions, quiet = acted(run), np.arange(WORLDS) % NOISE_LEVELS == 0
    run.iterate()
    spread = np.exp(run.learner.acting()["log_std"])
    for number, (action, (_, label)) in enumerate(zip(actions, said, strict=True)):
        if number < EXPERT_STEPS:
            np.testing.assert_array_equal(action[quiet], label[quiet])
            assert np.abs(action - label)[~quiet].max() > 0.01
        else:
            assert np.abs(action - label).max() > 0.1  # a policy that has learned next to nothing
    assert spread == pytest.approx(0.2)
    spread = [np.std([(a - e)[w] for a, (_, e) in zip(actions[:4], said, strict=False)]) for w in (1, 2)]
    assert 0.02 < spread[0] < spread[1] < 0.4


def test_everything_that_was_said_is_kept_also_where_an_episode_begins():
    run, said = make_run()
    run.iterate()
    for name, index in (("obs", 0), ("action", 1)):
        kept = run.learner.replay.arrays()[f"replay.{name}"]
        rows = np.concatenate([pair[index] for pair in said]).astype(np.float32)
        np.testing.assert_array_equal(kept, rows)


def test_a_gradient_step_is_one_of_the_squared_error():
    """Adam's first step is learning rate times the sign of the gradient of mean |mean(o) - a|^2."""
    rows = {"rollout_steps": EXPERT_STEPS, "last_rate": 1.0}  # the last one alone is followed by a step
    run, _ = make_run(gradient_steps=1, learning_rate=1e-3, precision="float32", **rows)
    learner = run.learner
    before = {k: v.clone() for k, v in learner.policy.state_dict().items()}
    draw, seen = learner.replay.draw, {}

    def noted(*shape):
        seen["batch"] = draw(*shape)
        return seen["batch"]

    learner.replay.draw = noted
    run.iterate()
    obs, label = seen["batch"]["obs"][0], seen["batch"]["action"][0]
    last = before["net.2.weight"].clone().requires_grad_()
    scaled = learner.normaliser(obs)
    hidden = torch.nn.functional.elu(scaled @ before["net.0.weight"].T + before["net.0.bias"])
    loss = (torch.tanh(hidden @ last.T + before["net.2.bias"]) - label).square().mean()
    loss.backward()
    moved = learner.policy.state_dict()["net.2.weight"] - before["net.2.weight"]
    clear = last.grad.abs() > 1e-4
    assert clear.sum() > 20
    np.testing.assert_allclose(moved[clear].numpy(), -1e-3 * np.sign(last.grad[clear].numpy()), rtol=1e-3)


@pytest.mark.slow
def test_it_learns_what_its_expert_does(tmp_path):
    job = plan(
        ELBOW, algorithm="dagger", output=tmp_path, device="cpu", samples=19_200, stop_success=2.0,
        num_worlds=64, rollout_steps=20, hidden=(64, 64), expert="hold", expert_steps=40, replay=19_200,
        selections=0,
    )  # fmt: skip
    train(job)
    policy, (run, said) = LearnedPolicy(load_checkpoint(tmp_path)), make_run()
    for _ in range(3):
        run.iterate()
    seen = np.concatenate([obs for obs, _ in said])
    expert = np.concatenate([label for _, label in said])
    assert np.abs(policy(seen) - expert).mean() < 0.1
    assert np.abs(expert.mean(axis=0) - expert).mean() > 0.4  # what a constant would miss it by


@pytest.mark.parametrize(
    ("task", "settings", "sentence"),
    [
        ("myoHandReachFixed-v0", {"expert": "hold"}, "policy 'hold' follows joint errors, which task"),
        (
            ELBOW,
            {"expert": "nobody"},
            "policy 'nobody' unknown; available: random, zero, hold, muscle-control",
        ),
        (ELBOW, {"expert_steps": 0}, "--expert-steps must be at least 1, got 0"),
        (ELBOW, {"replay": 100}, "--replay must be a multiple of the 64 worlds, got 100"),
    ],
)
def test_what_cannot_be_imitated_is_refused_before_anything_is_built(task, settings, sentence, tmp_path):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        plan(task, algorithm="dagger", output=tmp_path / "run", **settings)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("algorithm", ["dagger", "sac"])
def test_a_replay_that_does_not_fit_is_refused_before_the_first_step(algorithm, tmp_path, monkeypatch):
    small = {"samples": 640, "num_worlds": 8, "replay": 6400}
    job = plan(ELBOW, algorithm=algorithm, output=tmp_path / "run", device="cpu", **small)
    replay = make_learner(algorithm, 9, 6, num_worlds=8, replay=6400).replay
    for _ in range(800):
        replay.add(**{name: torch.zeros(8, width) for name, width in replay.widths.items()})
    held = sum(array.nbytes for array in replay.arrays().values())
    assert held == replay.size + 8
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1e5))
    with pytest.raises(ValueError, match=r"--replay needs 0\.0 GB of disk .* has 0\.0 GB; choose a smaller"):
        start(job)
    assert not (tmp_path / "run").exists()
