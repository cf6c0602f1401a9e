"""The learner beside our own arithmetic: bootstrap at truncation, finite weights, arrays there and back."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from elbows import learner_env

from myowarp.apps.train import agents, skrl_names
from myowarp.apps.train.loop import INHERITED_STEPS, DivergedError, Run
from myowarp.apps.train.settings import ALGORITHMS, Replaying, choose

ELBOW = "myoElbowPose1D6MRandom-v0"
HORIZON = 5  # steps: two truncations and a piece in a rollout of 12
STEPS, WORLDS = 12, 3
SMALL = {"num_worlds": WORLDS, "rollout_steps": STEPS, "hidden": (16,), "discount": 0.9}
FLOAT32 = 2e-5  # of advantages of order 1, sums of a dozen float32


def make_run(algorithm, seed=0, parent=None, **settings):
    """Return a run of a few elbows with short episodes."""
    env = learner_env(WORLDS, HORIZON, seed)
    return Run(env, choose("none", algorithm, SMALL | settings), parent)


@pytest.mark.parametrize(
    ("task", "settings", "count"),
    [
        (ELBOW, {}, 7777),
        ("myoElbowPose1D6MFixed-v0", {}, WORLDS * INHERITED_STEPS),
        (ELBOW, {"parent_samples": 55}, 55),
    ],
)
def test_an_inherited_normaliser_counts_what_it_has_seen_in_the_same_task(task, settings, count):
    """Else a rollout from the begin of all episodes would move it, and with it a policy that was good."""
    arrays = agents.policy_arrays(make_run("ppo", minibatches=2).agent)
    arrays["observation_mean"] = arrays["observation_mean"] + 3.0
    parent = SimpleNamespace(task=task, policy=arrays, manifest={"samples": 7777})
    run = make_run("ppo", parent=parent, minibatches=2, **settings)
    scaler = run.agent.checkpoint_modules["observation_preprocessor"]
    assert scaler.current_count == count
    np.testing.assert_allclose(scaler.running_mean, arrays["observation_mean"])


def record(run):
    """Let a run note every transition as the environment gave it, before anything is reset."""
    rows, step = [], run.env.step

    def noted(action):
        before = run.env._obs()["obs"].clone()
        obs, reward, terminated, truncated, info = step(action)
        rows.append([x.clone().double().numpy() for x in (before, obs, reward, terminated, truncated)])
        return obs, reward, terminated, truncated, info

    run.env.step = noted
    return rows


def hand_computed(rows, value, discount, decay, *, bootstrap=True):
    """Return advantages (steps, worlds) by their definition, world by world, in float64.

    A_t = sum_k (discount decay)^k delta_{t+k} within the episode, delta = r + discount V(s') - V(s), with
    V(s') = 0 after a termination, and V of the observation that the episode ended with after a truncation.
    """
    advantages = np.zeros((len(rows), WORLDS))
    for world in range(WORLDS):
        for first in range(len(rows)):
            weight = 1.0
            for before, after, reward, terminated, truncated in rows[first:]:
                following = 0.0 if terminated[world] else value(after[world])
                if truncated[world] and not bootstrap:
                    following = 0.0
                delta = reward[world] + discount * following - value(before[world])
                advantages[first, world] += weight * delta
                if terminated[world] or truncated[world]:
                    break
                weight *= discount * decay
    return advantages


def replays(algorithm):
    """Return whether an algorithm has a memory of samples."""
    return issubclass(ALGORITHMS[algorithm], Replaying)


def standardized(x):
    return (x - x.mean()) / x.std(ddof=1)


@pytest.mark.parametrize("algorithm", ["ppo", "trpo"])
def test_truncated_episodes_bootstrap_from_the_observation_they_ended_with(algorithm):
    run = make_run(algorithm, minibatches=1, epochs=1, trace_decay=0.8)
    run.iterate()  # a normaliser and a value function that are not those of the start
    rows, seen = record(run), {}
    update = run.agent.update

    def noted(**at):
        scaler, returns = run.agent._observation_preprocessor, run.agent._value_preprocessor

        def value(obs):
            with torch.no_grad():
                x = scaler(torch.tensor(obs, dtype=torch.float32)[None])
                return returns(run.agent.value.act({"observations": x}, role="value")[0], inverse=True).item()

        for name, bootstrap in (("right", True), ("without", False)):
            seen[name] = standardized(hand_computed(rows, value, 0.9, 0.8, bootstrap=bootstrap))
        update(**at)

    run.agent.update = noted
    run.iterate()
    got = run.agent.memory.get_tensor_by_name("advantages")[..., 0].numpy()
    assert sum(row[4].sum() for row in rows) >= 2 * WORLDS
    assert np.abs(got - seen["right"]).max() < FLOAT32
    assert np.abs(seen["without"] - seen["right"]).max() > 10 * FLOAT32


@pytest.mark.parametrize("algorithm", ["sac", "flashsac"])
def test_sac_keeps_the_observation_that_an_episode_ended_with(algorithm):
    run = make_run(algorithm, replay=60, batch_size=30, gradient_steps=1, random_steps=0)
    rows = record(run)
    run.iterate()
    kept = run.agent.memory.get_tensor_by_name("next_observations")[:STEPS].numpy()
    firsts = run.agent.memory.get_tensor_by_name("observations")[:STEPS].numpy()
    np.testing.assert_array_equal(kept, np.stack([row[1] for row in rows]).astype(np.float32))
    np.testing.assert_array_equal(firsts, np.stack([row[0] for row in rows]).astype(np.float32))
    ended = np.flatnonzero(rows[HORIZON - 1][4])
    assert ended.size
    assert np.abs(kept[HORIZON - 1, ended] - firsts[HORIZON, ended]).max() > 1e-3  # not the next episode's


def test_a_loss_that_is_not_finite_stops_the_run():
    run = make_run("ppo", minibatches=1)
    run.iterate()
    with torch.no_grad():
        next(run.agent.value.parameters())[0, 0] = float("nan")
    with pytest.raises(DivergedError, match="policy loss was not finite in update 2"):
        run.iterate()


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_an_agent_made_anew_from_arrays_is_the_same(algorithm):
    small = {"replay": 60, "batch_size": 30} if replays(algorithm) else {"minibatches": 2}
    run = make_run(algorithm, **small)
    run.iterate()
    policy, learner = agents.policy_arrays(run.agent), agents.learner_arrays(run.agent)
    other = make_run(algorithm, **small, seed=5)
    assert not np.array_equal(agents.policy_arrays(other.agent)["net.0.weight"], policy["net.0.weight"])
    agents.restore_agent(other.agent, policy, learner)
    for before, after in (
        (policy, agents.policy_arrays(other.agent)),
        (learner, agents.learner_arrays(other.agent)),
    ):
        assert before.keys() == after.keys()
        for name, array in before.items():
            np.testing.assert_array_equal(array, after[name], err_msg=name)


def test_what_skrl_no_longer_has_is_one_sentence(monkeypatch):
    torch_config, scaler = skrl_names.config.torch, skrl_names.RunningStandardScaler
    for name in ("_is_distributed", "_world_size"):
        monkeypatch.setattr(torch_config, name, getattr(torch_config, name))
    skrl_names.average_over_ranks(3)
    assert torch_config.is_distributed
    assert torch_config.world_size == 3
    monkeypatch.delattr(scaler, "_parallel_variance")
    ending = rf"; run `pip install skrl=={skrl_names.PINNED}`$"
    with pytest.raises(
        RuntimeError, match=r"^skrl .* has changed, and ranks would learn each for itself" + ending
    ):
        skrl_names.average_over_ranks(2)
    with pytest.raises(
        RuntimeError, match=r"^skrl .* has changed, and SAC keeps the weight of the.*" + ending
    ):
        skrl_names.set_temperature(SimpleNamespace(), torch.ones(1))
    requirements = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert f'"skrl=={skrl_names.PINNED}"' in requirements
