"""Proximal policy optimisation, from the first step of the worlds to the last one of the optimisers.

Source: Schulman et al. 2017, arXiv:1707.06347, with generalised advantages, arXiv:1506.02438. Policy and
value function have an optimiser each: a value function whose rate follows the policy's KL divergence starves.
`examples/train_plain.py` is the same in plain torch, without what keeps, shares and captures it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn

from myowarp.apps.rollouts.ranks import Ranks
from myowarp.apps.train.learner import Captured, Learner, set_rate
from myowarp.apps.train.networks import GaussianPolicy, Normaliser, RepeatedNoise, perceptron
from myowarp.apps.train.settings import OnPolicy, PPOSettings
from myowarp.apps.train.worlds import Worlds

RATE_FACTOR = 1.5  # by which a rate with an aim changes at most, an update


def advantages(
    reward: torch.Tensor, ended: torch.Tensor, values: torch.Tensor, discount: float, decay: float
) -> torch.Tensor:
    """Return generalised advantages (steps, worlds); `values` (steps + 1, worlds) goes one step further.

    Rewards have what would have followed a truncation; `ended` is 1 where the step ended an episode.
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
    return -0.5 * ((action - mean).square() @ std.square().reciprocal()) - std.log().sum()


def kl(mean: torch.Tensor, std: torch.Tensor, new_mean: torch.Tensor, new_std: torch.Tensor) -> torch.Tensor:
    """Return the KL divergence from N(mean, std) to N(new_mean, new_std), a mean over rows."""
    weight = 0.5 / new_std.square()
    of_spread = (new_std.log() - std.log() + std.square() * weight - 0.5).sum()
    return of_spread + ((mean - new_mean).square() @ weight).mean()


class Rollout(NamedTuple):
    """Samples of an iteration, one row a sample.

    Attributes:
        obs: Inputs of policy and value function: normalised observations, and what is remembered if anything
            is, shape (rows, num_inputs).
        action: Actions, before they are clipped, shape (rows, num_actions).
        mean, std: The policy's means, same shape, and standard deviations, shape (num_actions,).
        advantage: Advantages with mean 0 and deviation 1, shape (rows,).
        returns: What the value function is to say, normalised, shape (rows,).
        density: Logarithms of the actions' densities, as of `log_density`, shape (rows,).
    """

    obs: torch.Tensor
    action: torch.Tensor
    mean: torch.Tensor
    advantage: torch.Tensor
    returns: torch.Tensor
    std: torch.Tensor
    density: torch.Tensor

    def parts(self, number: int, together: int = 1, worlds: int = 1) -> list[Rollout]:
        """Return the samples in so many parts of one size, drawn.

        Args:
            number: Of parts.
            together: Steps that follow each other in a world and stay together; a part has all first ones,
                then all second ones.
            worlds: Of which a step of each follows that of the one before.
        """
        device = self.obs.device
        drawn = torch.randperm(len(self.obs) // together, device=device)
        first = drawn // worlds * worlds * together + drawn % worlds
        steps = worlds * torch.arange(together, device=device)[:, None]
        rows = [(steps + own).flatten() for own in first.chunk(number)]
        return [Rollout(*(v[own] if len(v) == len(self.obs) else v for v in self)) for own in rows]


class OnPolicyLearner(Learner):
    """The base of PPO and TRPO: policy, value function, samples and their advantages.

    Attributes:
        together: Steps of a world that stay together in an update.
    """

    settings: OnPolicy
    policy: GaussianPolicy
    iterations: torch.Tensor
    together = 1

    def __init__(self, settings: OnPolicy, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        self.policy = self.make_policy(worlds)
        self.value = perceptron(self.policy.num_inputs, settings.hidden, 1, settings.activation)
        self.returns = Normaliser(1)
        self.noise = RepeatedNoise(worlds.num_worlds, worlds.num_actions)
        self.register_buffer("iterations", torch.zeros((), dtype=torch.int64))
        self.to(self.device)
        self.optimizers = {"value": self.adam(self.value.parameters(), settings.value_rate)}

    def make_policy(self, worlds: Worlds) -> GaussianPolicy:
        """Return the policy as it starts."""
        return GaussianPolicy(worlds.num_obs, worlds.num_actions, self.settings)

    def inputs(self, obs: torch.Tensor) -> torch.Tensor:
        """Return what policy and value function are given where all worlds observe this."""
        return self.normaliser(obs)

    def act(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the means of the actions of all worlds."""
        return self.policy(inputs)

    def forget(self, ended: torch.Tensor) -> None:
        """Begin anew in the worlds of a mask, whose episodes are over."""

    def iterate(self, worlds: Worlds) -> None:
        """Act for some control steps, and learn from them."""
        self.update(self.collect(worlds))
        self.iterations += 1
        self.note(action_std=self.policy.std.mean())

    def update(self, rollout: Rollout) -> None:
        """Change policy and value function."""
        raise NotImplementedError

    @property
    def value_alone(self) -> bool:
        """Whether the policy stays: behind a value function that knows nothing it forgets what it could."""
        return bool(self.iterations < self.settings.value_first)

    @torch.no_grad()
    def worth(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return values, in units of the reward."""
        with self.products():
            return self.returns.inverse(self.value(inputs).float())[..., 0]

    @torch.no_grad()
    def collect(self, worlds: Worlds) -> Rollout:
        """Act in all worlds; returns the samples with their advantages."""
        steps, shape = self.settings.rollout_steps, (worlds.num_worlds, worlds.num_actions)
        obs = torch.empty(steps, worlds.num_worlds, self.policy.num_inputs, device=self.device)
        seen = torch.empty(steps, *worlds.obs.shape, device=self.device)
        action, mean = torch.empty(2, steps, *shape, device=self.device)
        reward, ended = torch.empty(2, steps, worlds.num_worlds, device=self.device)
        std, repeated = self.policy.std.clone(), self.settings.noise == "repeated"
        for t in range(steps):
            seen[t], obs[t] = worlds.obs, self.inputs(worlds.obs)
            with self.products():
                mean[t] = self.act(obs[t])
            action[t] = mean[t] + std * (self.noise.next() if repeated else torch.randn_like(mean[t]))
            step = worlds.step(action[t])
            reward[t], ended[t] = step.reward, step.ended.float()
            if step.truncated.any():  # the time is over, not the task: what would have followed counts
                further = self.worth(self.inputs(step.obs)[step.truncated])
                reward[t, step.truncated] += self.settings.discount * further
            self.forget(step.ended)
        values = self.worth(torch.cat((obs, self.inputs(worlds.obs)[None])))
        advantage = advantages(reward, ended, values, self.settings.discount, self.settings.trace_decay)
        returns = (advantage + values[:-1]).flatten()[:, None]
        self.returns.see(returns, self.ranks)
        self.normaliser.see(seen.flatten(0, 1), self.ranks)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        obs, action, mean = (each.flatten(0, 1) for each in (obs, action, mean))
        density = log_density(action, mean, std)
        return Rollout(obs, action, mean, advantage.flatten(), self.returns(returns)[:, 0], std, density)

    def update_value(self, part: Rollout) -> None:
        """Move the value function towards the returns of some samples."""
        with self.products():
            value = self.value(part.obs)
        loss = nn.functional.mse_loss(value.float()[:, 0], part.returns)
        self.descend("value", loss, self.value.parameters(), self.settings.gradient_norm)
        self.note(value_loss=loss)


class PPO(OnPolicyLearner):
    """PPO with a clipped ratio."""

    settings: PPOSettings
    rate: torch.Tensor

    def __init__(self, settings: PPOSettings, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        learned = (value for name, value in self.policy.named_parameters() if name != "log_std")
        self.optimizers["policy"] = self.adam(learned, settings.learning_rate)
        self.optimizers["spread"] = self.adam([self.policy.log_std], settings.spread_rate)
        self.register_buffer("rate", torch.tensor(settings.learning_rate, dtype=torch.float64))
        self._step = Captured(self, self._descend)

    def update(self, rollout: Rollout) -> None:
        """Pass over the samples some times, in parts that are drawn once, as rsl_rl does."""
        parts = self.settings.minibatches, self.together, self.settings.num_worlds
        if self.settings.precision == "bfloat16":
            rollout = rollout._replace(obs=rollout.obs.bfloat16())  # once, and not in every product
        # A rate with an aim is the host's, and so are messages to other ranks.
        alike = not (self.value_alone or self.settings.kl or self.ranks.size > 1)
        for part in rollout.parts(*parts) * self.settings.epochs:
            self._step(*part, alike=alike)

    def means(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the means of samples, from inputs of as many steps of each world as stay together."""
        return self.policy(inputs)

    def _descend(self, *samples: torch.Tensor) -> None:
        """Do a gradient step of value function and policy on samples, the fields of a `Rollout`."""
        self.update_value(part := Rollout(*samples))
        if not self.value_alone:
            self.update_policy(part)

    def update_policy(self, part: Rollout) -> None:
        """Make actions of positive advantage more likely, within the clip."""
        with self.products():
            mean = self.means(part.obs)
        std, clip = self.policy.std, self.settings.clip
        ratio = (log_density(part.action, mean, std) - part.density).exp()
        gain = torch.min(ratio * part.advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * part.advantage)
        loss = -gain.mean() - self.settings.entropy * std.log().sum()
        divergence = kl(part.mean, part.std, mean.detach(), std.detach())
        if self.settings.kl:  # the rate follows the divergence an entry of the action
            aims = float(self.ranks.mean(divergence)) / part.action.shape[1] / self.settings.kl
            rate = self.rate * RATE_FACTOR ** (-1 if aims > 2.0 else 1 if aims < 0.5 else 0)
            self.rate.copy_(rate.clamp(self.settings.least_rate, self.settings.largest_rate))
            set_rate(self.optimizers["policy"], float(self.rate))
        self.optimizers["spread"].zero_grad()
        self.descend("policy", loss, self.policy.parameters(), self.settings.gradient_norm)
        self.optimizers["spread"].step()
        self.note(policy_loss=loss, kl=divergence)
