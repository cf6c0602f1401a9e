"""Proximal policy optimisation, from the first step of the worlds to the last one of the optimisers.

Source: Schulman et al. 2017, arXiv:1707.06347, with generalised advantages, arXiv:1506.02438. Policy and
value function have an optimiser each: a value function whose rate follows the policy's KL divergence starves.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch
from torch import nn

from myowarp.apps.train.learner import Learner
from myowarp.apps.train.networks import GaussianPolicy, Normaliser, perceptron
from myowarp.apps.train.noise import RepeatedNoise
from myowarp.apps.train.ranks import Ranks
from myowarp.apps.train.settings import OnPolicy, PPOSettings
from myowarp.apps.train.worlds import Worlds

RATE_FACTOR = 1.5  # by which a rate with an aim changes at most, an update


@dataclass
class Rollout:
    """Samples of an iteration, one row a sample.

    Attributes:
        obs: Normalised observations, shape (rows, obs_size).
        action: Actions, before they are clipped, shape (rows, num_actions).
        mean: The policy's means, same shape.
        advantage: Advantages with mean 0 and deviation 1, shape (rows,).
        returns: What the value function is to say, normalised, shape (rows,).
        std: The policy's standard deviations, shape (num_actions,).
    """

    obs: torch.Tensor
    action: torch.Tensor
    mean: torch.Tensor
    advantage: torch.Tensor
    returns: torch.Tensor
    std: torch.Tensor

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.obs)

    def __getitem__(self, rows: torch.Tensor) -> Rollout:
        """Return some samples."""
        advantage, returns = self.advantage[rows], self.returns[rows]
        return Rollout(self.obs[rows], self.action[rows], self.mean[rows], advantage, returns, self.std)


class OnPolicyLearner(Learner):
    """What PPO and TRPO share: policy, value function, samples and their advantages."""

    settings: OnPolicy
    policy: GaussianPolicy
    iterations: torch.Tensor

    def __init__(self, settings: OnPolicy, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        self.policy = GaussianPolicy(worlds.num_obs, worlds.num_actions, settings)
        self.value = perceptron(worlds.num_obs, settings.hidden, 1, settings.activation)
        self.returns = Normaliser(1)
        self.noise = RepeatedNoise(worlds.num_worlds, worlds.num_actions)
        self.register_buffer("iterations", torch.zeros((), dtype=torch.int64))
        self.to(self.device)
        self.optimizers = {"value": self.adam(self.value.parameters(), settings.value_rate)}

    def iterate(self, worlds: Worlds) -> dict[str, float]:
        """Act for some control steps, and learn from them."""
        self.set_rates()
        rollout = self.collect(worlds)
        begin = time.perf_counter()
        self.update(rollout)
        self.iterations += 1
        worlds.clock.learner += time.perf_counter() - begin
        self.note("action_std", self.policy.std.mean())
        return self.figures()

    def update(self, rollout: Rollout) -> None:
        """Change policy and value function."""
        raise NotImplementedError

    @property
    def value_alone(self) -> bool:
        """Whether the policy stays: behind a value function that knows nothing it forgets what it could."""
        return bool(self.iterations < self.settings.value_first)

    @torch.no_grad()
    def worth(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the values of normalised observations, in units of the reward."""
        with self.products():
            return self.returns.inverse(self.value(obs).float())[..., 0]

    @torch.no_grad()
    def collect(self, worlds: Worlds) -> Rollout:
        """Act in all worlds; returns the samples with their advantages."""
        steps, shape = self.settings.rollout_steps, (worlds.num_worlds, worlds.num_actions)
        obs = torch.empty(steps, worlds.num_worlds, worlds.num_obs, device=self.device)
        seen, (action, mean) = torch.empty_like(obs), torch.empty(2, steps, *shape, device=self.device)
        reward, ended = torch.empty(2, steps, worlds.num_worlds, device=self.device)
        std, repeated = self.policy.std.clone(), getattr(self.settings, "noise", "white") == "repeated"
        for t in range(steps):
            begin = time.perf_counter()
            seen[t], obs[t] = worlds.obs, self.normaliser(worlds.obs)
            with self.products():
                mean[t] = self.policy(obs[t])
            noise = self.noise.next() if repeated else torch.randn_like(mean[t])
            action[t] = mean[t] + std * noise
            worlds.clock.learner += time.perf_counter() - begin
            step = worlds.step(action[t])
            begin = time.perf_counter()
            if step.truncated.any():  # the time is over, not the task: what would have followed counts
                further = self.worth(self.normaliser(step.obs[step.truncated]))
                step.reward[step.truncated] += self.settings.discount * further
            reward[t], ended[t] = step.reward, step.ended.float()
            worlds.clock.learner += time.perf_counter() - begin
        begin = time.perf_counter()
        values = self.worth(torch.cat((obs, self.normaliser(worlds.obs)[None])))
        advantage = advantages(reward, ended, values, self.settings.discount, self.settings.trace_decay)
        returns = (advantage + values[:-1]).flatten()[:, None]
        self.returns.see(returns, self.ranks)
        self.normaliser.see(seen.flatten(0, 1), self.ranks)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        obs, action, mean = obs.flatten(0, 1), action.flatten(0, 1), mean.flatten(0, 1)
        worlds.clock.learner += time.perf_counter() - begin
        return Rollout(obs, action, mean, advantage.flatten(), self.returns(returns)[:, 0], std)

    def update_value(self, part: Rollout) -> None:
        """Move the value function towards the returns of some samples."""
        with self.products():
            value = self.value(part.obs)
        loss = nn.functional.mse_loss(value.float()[:, 0], part.returns)
        self.descend("value", loss, self.value.parameters(), self.settings.gradient_norm)
        self.note("value_loss", loss)


class PPO(OnPolicyLearner):
    """PPO with a clipped ratio."""

    settings: PPOSettings
    rate: torch.Tensor

    def __init__(self, settings: PPOSettings, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        self.optimizers["policy"] = self.adam(self.policy.net.parameters(), settings.learning_rate)
        self.optimizers["spread"] = self.adam([self.policy.log_std], settings.spread_rate)
        self.register_buffer("rate", torch.tensor(settings.learning_rate, dtype=torch.float64))

    def update(self, rollout: Rollout) -> None:
        """Pass over the samples some times, in parts drawn anew for every pass."""
        size = len(rollout) // self.settings.minibatches
        for _ in range(self.settings.epochs):
            for rows in torch.randperm(len(rollout), device=self.device).split(size):
                self.update_value(rollout[rows])
                if not self.value_alone:
                    self._update_policy(rollout[rows])

    def _update_policy(self, part: Rollout) -> None:
        """Make actions of positive advantage more likely, within the clip."""
        with self.products():
            mean = self.policy(part.obs)
        std, clip = self.policy.std, self.settings.clip
        before = log_density(part.action, part.mean, part.std)
        ratio = (log_density(part.action, mean, std) - before).exp()
        gain = torch.min(ratio * part.advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * part.advantage)
        loss = -gain.mean() - self.settings.entropy * std.log().sum()
        divergence = kl(part.mean, part.std, mean, std).detach()
        if self.settings.kl:
            self._aim(float(self.ranks.mean(divergence)) / part.action.shape[1])
        self.optimizers["spread"].zero_grad()
        self.descend("policy", loss, self.policy.parameters(), self.settings.gradient_norm)
        self.optimizers["spread"].step()
        self.note("policy_loss", loss)
        self.note("kl", divergence)

    def _aim(self, divergence: float) -> None:
        """Let the policy's rate follow the KL divergence an entry of the action."""
        aim, settings = self.settings.kl, self.settings
        factor = (
            1.0 / RATE_FACTOR if divergence > 2.0 * aim else RATE_FACTOR if divergence < 0.5 * aim else 1.0
        )
        self.rate.copy_((self.rate * factor).clamp(settings.least_rate, settings.largest_rate))
        self.optimizers["policy"].param_groups[0]["lr"] = float(self.rate)


def advantages(
    reward: torch.Tensor, ended: torch.Tensor, values: torch.Tensor, discount: float, decay: float
) -> torch.Tensor:
    """Return generalised advantages, shape (steps, worlds).

    Args:
        reward: Rewards, what would have followed a truncation included, shape (steps, worlds).
        ended: 1 where the step ended an episode, same shape.
        values: Values before each step and after the last one, shape (steps + 1, worlds).
        discount: Of rewards.
        decay: Lambda.
    """
    found, carried = torch.zeros_like(reward), torch.zeros_like(reward[0])
    for t in reversed(range(len(reward))):
        goes_on = 1.0 - ended[t]
        error = reward[t] + discount * goes_on * values[t + 1] - values[t]
        carried = error + discount * decay * goes_on * carried
        found[t] = carried
    return found


def log_density(action: torch.Tensor, mean: torch.Tensor, std: torch.Tensor) -> torch.Tensor:
    """Return log N(action; mean, std) up to a constant, summed over the action's entries."""
    return (-0.5 * ((action - mean) / std).square() - std.log()).sum(dim=-1)


def kl(mean: torch.Tensor, std: torch.Tensor, new_mean: torch.Tensor, new_std: torch.Tensor) -> torch.Tensor:
    """Return the KL divergence from N(mean, std) to N(new_mean, new_std), a mean over rows."""
    squares = std.square() + (mean - new_mean).square()
    return (new_std.log() - std.log() + squares / (2.0 * new_std.square()) - 0.5).sum(dim=-1).mean()
