"""Soft actor-critic for many worlds, with critics that learn a distribution and noise that lasts.

Source: Haarnoja et al. 2018, arXiv:1801.01290 and 1812.05905, with FlashSAC's categorical critics, normalised
rewards, repeated noise and rarer updates of the policy, arXiv:2604.04539; layer normalisation takes the place
of its batch normalisation and unit-norm weights, and the policy is a perceptron.

With rewards divided by a scale s, atoms z_k and the critic of the smaller mean, a sample's target is the
distribution of

    r / s + discount * (1 - terminated) * (z_k - temperature * log p(a'))

moved back onto the atoms, and a critic's loss the cross entropy with it.
"""

from __future__ import annotations

import copy
import math

import torch
from torch import nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from myowarp.apps.rollouts.ranks import Ranks
from myowarp.apps.train.learner import Captured, Learner
from myowarp.apps.train.networks import Critics, RepeatedNoise, SquashedPolicy
from myowarp.apps.train.replay import Replay
from myowarp.apps.train.settings import SACSettings
from myowarp.apps.train.worlds import Worlds

BOUND = 5.0  # outermost atom; rewards are scaled so that no discounted sum of them is larger
DECAY = 1e-4  # of the critics' weights, a step, over the learning rate


class SAC(Learner):
    """The policy, two critics with targets that follow them, the temperature and the replay."""

    settings: SACSettings
    policy: SquashedPolicy
    replay: Replay
    atoms: torch.Tensor
    gradient_steps: torch.Tensor

    def __init__(self, settings: SACSettings, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        obs, actions, rate = worlds.num_obs, worlds.num_actions, settings.learning_rate
        self.policy = SquashedPolicy(obs, actions, settings)
        self.critics = Critics(obs + actions, settings.critic_width, settings.critic_blocks, settings.atoms)
        self.targets = copy.deepcopy(self.critics).requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(settings.temperature)))
        self.noise = RepeatedNoise(worlds.num_worlds, actions)
        self.scale = RewardScale(worlds.num_worlds, settings.discount)
        self.register_buffer("atoms", torch.linspace(-BOUND, BOUND, settings.atoms), persistent=False)
        self.register_buffer("gradient_steps", torch.zeros((), dtype=torch.int64))
        self.to(self.device)
        self.optimizers = {
            "policy": self.adam(self.policy.parameters(), rate),
            "critics": self.adam(self.critics.parameters(), rate, DECAY / rate if rate else 0.0),
            "temperature": self.adam([self.log_temperature], rate),
        }
        self.replay = Replay(
            settings.replay, self.device, obs=obs, action=actions, reward=1, next_obs=obs, terminated=1
        )
        self._critics_step = Captured(self, self._update_critics)
        self._policy_step = Captured(self, self._update_policy)
        self._follow = get_ema_multi_avg_fn(1.0 - settings.target_rate)

    def iterate(self, worlds: Worlds) -> None:
        """Alternate between a control step of all worlds and some gradient steps."""
        for _ in range(self.settings.rollout_steps):
            obs, action = worlds.obs.clone(), self._act(worlds)
            step = worlds.step(action)
            self.normaliser.see(obs)
            self.scale.see(step.reward, step.ended)
            self.replay.add(
                obs=obs, action=action, reward=step.reward, next_obs=step.obs, terminated=step.terminated
            )
            if worlds.steps >= self.settings.random_steps and self.replay.filled >= self.settings.batch_size:
                self.update()
        self.note(entropy_weight=self.log_temperature.exp())

    @torch.no_grad()
    def _act(self, worlds: Worlds) -> torch.Tensor:
        """Return actions of all worlds: random ones at first, then the policy's, with noise that stays."""
        if worlds.steps < self.settings.random_steps:
            return 2.0 * torch.rand(worlds.num_worlds, worlds.num_actions, device=self.device) - 1.0
        mean, log_std = self.policy(self.normaliser(worlds.obs))
        return (mean + log_std.exp() * self.noise.next()).tanh()

    def update(self) -> None:
        """Do the gradient steps of one control step."""
        settings = self.settings
        batch = self.replay.draw(settings.gradient_steps, settings.batch_size)
        obs, after = self.normaliser(batch["obs"]), self.normaliser(batch["next_obs"])
        reward = batch["reward"] / self.scale.value()
        keep = settings.discount * (1.0 - batch["terminated"])
        before = int(self.gradient_steps)
        for i in range(settings.gradient_steps):
            self._critics_step(obs[i], batch["action"][i], reward[i], after[i], keep[i])
            if (before + i) % settings.policy_every == 0:
                self._policy_step(obs[i])
            with torch.no_grad():
                self._follow([*self.targets.parameters()], [*self.critics.parameters()], 0)
        self.gradient_steps += settings.gradient_steps

    def _update_critics(
        self,
        obs: torch.Tensor,
        action: torch.Tensor,
        reward: torch.Tensor,
        after: torch.Tensor,
        keep: torch.Tensor,
    ) -> None:
        """Move both critics towards the target distribution."""
        with torch.no_grad(), self.products():
            action_after, log_density = self.policy.draw(after)
            both = self.targets(after, action_after).softmax(dim=-1)
            first = ((both[0] - both[1]) @ self.atoms < 0.0)[:, None]
            value = self.atoms - (self.log_temperature.exp() * log_density)[:, None]
            target = project(reward + keep * value, torch.where(first, both[0], both[1]), self.atoms)
        with self.products():
            logits = self.critics(obs, action)
        loss = -(target * logits.log_softmax(dim=-1)).sum(dim=-1).mean(dim=-1).sum()
        self.descend("critics", loss)
        self.note(critic_loss=loss)

    def _update_policy(self, obs: torch.Tensor) -> None:
        """Move the policy towards higher values, and the temperature towards its entropy."""
        self.critics.requires_grad_(False)
        with self.products():
            action, log_density = self.policy.draw(obs)
            probabilities = self.critics(obs, action).softmax(dim=-1)
        worth = (probabilities @ self.atoms).amin(dim=0)
        loss = (self.log_temperature.exp().detach() * log_density - worth).mean()
        self.descend("policy", loss)
        self.critics.requires_grad_(True)
        entropy = -log_density.detach().mean()
        wanted = self.settings.target_entropy * action.shape[1]
        self.descend("temperature", self.log_temperature * (entropy - wanted))
        self.note(policy_loss=loss, entropy=entropy / action.shape[1])


class RewardScale(nn.Module):
    """The scale of rewards: the deviation of discounted sums, or what keeps the largest within `BOUND`."""

    sums: torch.Tensor
    count: torch.Tensor
    mean: torch.Tensor
    square: torch.Tensor
    most: torch.Tensor

    def __init__(self, num_worlds: int, discount: float) -> None:
        super().__init__()
        self.discount = discount
        for name in ("sums", "count", "mean", "square", "most"):
            shape = (num_worlds,) if name == "sums" else ()
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))

    def see(self, rewards: torch.Tensor, ended: torch.Tensor) -> None:
        """Take the rewards of a control step into account, shape (num_worlds,)."""
        self.sums.mul_(self.discount).add_(rewards)
        self.count += len(rewards)
        weight = len(rewards) / self.count
        self.mean += weight * (self.sums.mean() - self.mean)
        self.square += weight * (self.sums.square().mean() - self.square)
        self.most.copy_(torch.maximum(self.most, self.sums.abs().max()))
        self.sums.masked_fill_(ended, 0.0)

    def value(self) -> float:
        """Return the scale."""
        deviation = (self.square - self.mean.square()).clamp_min(0.0).sqrt()
        return max(float(deviation), float(self.most) / BOUND, 1e-8)


def project(values: torch.Tensor, probabilities: torch.Tensor, atoms: torch.Tensor) -> torch.Tensor:
    """Return a distribution over values as one over equidistant atoms, with the same mean within their range.

    Source: Bellemare et al. 2017, algorithm 1.

    Args:
        values: Shape (rows, num_atoms).
        probabilities: Of them, same shape.
        atoms: Shape (num_atoms,).
    """
    gap = atoms[1] - atoms[0]
    place = (values.clamp(atoms[0], atoms[-1]) - atoms[0]) / gap
    below = place.floor().clamp_max(len(atoms) - 2)
    above = place - below
    index = below.long()
    result = torch.zeros_like(probabilities)
    result.scatter_add_(1, index, probabilities * (1.0 - above))
    return result.scatter_add_(1, index + 1, probabilities * above)
