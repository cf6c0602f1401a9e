"""FlashSAC's parts beside float64 NumPy, and one gradient step of its critics beside their definition."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from myowarp.apps.train import agents
from myowarp.apps.train.flash_sac import BOUND, REPEATS, RepeatedNoise, RewardScale, project
from myowarp.apps.train.settings import choose

ATOMS = torch.linspace(-BOUND, BOUND, 21)
FLOAT32 = 1e-6
OBS, ACTIONS = gym.spaces.Box(-9, 9, (6,), np.float32), gym.spaces.Box(-1, 1, (3,), np.float32)
WORLDS = 8
SMALL = {"num_worlds": WORLDS, "replay": 64, "batch_size": 16, "gradient_steps": 1, "random_steps": 0}
SMALL |= {
    "hidden": (16,),
    "critic_width": 8,
    "critic_blocks": 1,
    "precision": "float32",
    "discount": 0.5,
    "learning_rate": 3e-3,
}


def projected(values, probabilities, atoms):
    """Return the projection of Bellemare et al. 2017 by its definition: triangles around atoms."""
    gap = atoms[1] - atoms[0]
    shares = np.clip(1.0 - np.abs(np.clip(values, atoms[0], atoms[-1])[:, :, None] - atoms) / gap, 0.0, 1.0)
    return (probabilities[:, :, None] * shares).sum(axis=1)


def test_the_projection_is_that_of_the_paper_and_keeps_the_mean():
    rng = np.random.default_rng(0)
    probabilities = rng.dirichlet(np.ones(21), size=50).astype(np.float32)
    values = (0.9 * ATOMS.numpy() + rng.uniform(-2.0, 2.0, (50, 1))).astype(np.float32)
    values[0] = ATOMS.numpy()  # on the atoms, the outermost ones among them
    got = project(torch.from_numpy(values), torch.from_numpy(probabilities), ATOMS).numpy()
    want = projected(values.astype(float), probabilities.astype(float), ATOMS.numpy().astype(float))
    np.testing.assert_allclose(got, want, atol=5 * FLOAT32)
    inside = np.abs(values).max(axis=1) <= BOUND
    assert 5 < inside.sum() < 50
    mean = (probabilities * values).sum(axis=1)
    np.testing.assert_allclose((got @ ATOMS.numpy())[inside], mean[inside], atol=2e-5)
    assert np.abs(got - probabilities)[1:].max() > 0.01


def test_noise_stays_as_long_as_the_law_says_and_is_normal():
    torch.manual_seed(0)
    noise, rows = RepeatedNoise(500, 2), []
    for _ in range(1000):
        rows.append(noise.next().numpy().copy())
    seen = np.array(rows)[:, :, 0]
    changed = np.diff(seen, axis=0) != 0.0
    lengths = np.concatenate([np.diff(np.flatnonzero(world)) for world in changed.T])
    law = 1.0 / np.arange(1, REPEATS + 1) ** 2
    law /= law.sum()
    share = np.bincount(lengths, minlength=REPEATS + 1)[1:] / len(lengths)
    assert lengths.max() == REPEATS
    np.testing.assert_allclose(share, law, atol=0.005)
    fresh = seen[1:][changed]
    assert abs(fresh.mean()) < 0.02
    assert abs(fresh.std() - 1.0) < 0.02


def test_the_scale_follows_discounted_sums_of_episodes():
    rng = np.random.default_rng(1)
    scale, sums, seen = RewardScale(WORLDS, 0.8), np.zeros(WORLDS), []
    for _ in range(300):
        rewards, ended = rng.normal(1.0, 2.0, WORLDS).astype(np.float32), rng.random(WORLDS) < 0.1
        scale.see(torch.from_numpy(rewards)[:, None], torch.from_numpy(ended)[:, None])
        sums = 0.8 * sums + rewards
        seen.append(sums.copy())
        sums[ended] = 0.0
    deviation, most = np.std(seen), np.abs(seen).max()
    assert scale.value() == pytest.approx(max(deviation, most / BOUND), rel=1e-6)
    assert abs(deviation - most / BOUND) > 0.01
    scale.see(torch.full((WORLDS, 1), 1000.0), torch.ones(WORLDS, 1, dtype=torch.bool))
    assert scale.value() == pytest.approx((1000.0 + 0.8 * sums).max() / BOUND, rel=1e-6)


def transitions(agent, terminated):
    """Let an agent record control steps with rewards of one sign and ends as given."""
    torch.manual_seed(5)
    for step in range(8):
        at = {"timestep": step, "timesteps": 0}
        obs = torch.randn(WORLDS, 6)
        with torch.no_grad():
            action, _ = agent.act(obs, None, **at)
        agent.record_transition(
            observations=obs,
            states=None,
            actions=action,
            rewards=1.0 + torch.rand(WORLDS, 1),
            next_observations=torch.randn(WORLDS, 6),
            next_states=None,
            terminated=torch.full((WORLDS, 1), terminated),
            truncated=torch.zeros(WORLDS, 1, dtype=torch.bool),
            infos={},
            **at,
        )


@pytest.mark.parametrize("terminated", [True, False])
def test_critics_learn_what_follows(terminated):
    """After a termination the value is the reward alone, from 1 to 2; else a geometric series follows."""
    torch.manual_seed(2)
    torch.set_num_threads(1)
    settings = choose("none", "flashsac", SMALL | {"temperature": 1e-6, "target_rate": 0.05})
    agent = agents.make_agent(settings, OBS, ACTIONS, "cpu")
    transitions(agent, terminated)
    for step in range(250):
        agent.update(timestep=step, timesteps=0)
    names = ["observations", "actions", "rewards"]
    obs, actions, rewards = agent.memory.sample_all(names=names)[0]
    inputs = {"observations": agent._observation_preprocessor(obs), "taken_actions": actions}
    with torch.no_grad():
        values = [
            agent._logits(inputs, c).softmax(-1)[0] @ agent.atoms for c in (agent.critic_1, agent.critic_2)
        ]
    got = torch.minimum(*values).numpy() * agent.reward_scale.value()
    immediate = rewards.numpy()[:, 0]
    if terminated:
        assert np.abs(got - immediate).mean() < 0.25
    else:
        # Mean reward 1.5, discount 0.5: 3.0 on average, less what the smaller of two critics costs.
        assert 2.7 < got.mean() < 3.1


def test_noise_scale_and_temperature_are_in_a_checkpoint():
    agent = agents.make_agent(choose("none", "flashsac", SMALL), OBS, ACTIONS, "cpu")
    transitions(agent, False)
    arrays = agents.learner_arrays(agent)
    assert {"noise.noise", "noise.left", "reward_scale.sums", "log_entropy_coefficient"} <= arrays.keys()
    assert np.abs(arrays["noise.noise"]).min() > 0.0
