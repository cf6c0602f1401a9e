"""FlashSAC: soft actor-critic for many worlds, with critics that learn a distribution and noise that lasts.

Source: FlashSAC, arXiv:2604.04539. This agent has the categorical critics, residual blocks, normalised
rewards, repeated noise and rarer updates of the actor of its recipe; layer normalisation takes the place of
its batch normalisation and unit-norm weights, and the actor is SAC's.

With rewards divided by a scale s, atoms z_k and the critic of the smaller mean, a sample's target is the
distribution of

    r / s + discount * (1 - terminated) * (z_k - temperature * log p(a'))

moved back onto the atoms, and a critic's loss the cross entropy with it.
"""

from __future__ import annotations

from typing import Any

import torch
from skrl.agents.torch.sac import SAC
from skrl.models.torch import DeterministicMixin, Model
from torch import nn

from myowarp.apps.train.skrl_names import set_temperature, temperature

BOUND = 5.0  # outermost atom; rewards are scaled so that no discounted sum of them is larger
EXPANSION = 4  # of a residual block's inner layer
REPEATS = 16  # largest number of control steps for which noise stays
DECAY = 1e-4  # of the critics' weights, a step, over the learning rate
SAMPLED = ("observations", "actions", "rewards", "next_observations", "terminated")
"""What an update needs of skrl's memory."""


class Residual(nn.Module):
    """x + W2 relu(W1 normalise(x))."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.net = nn.Sequential(
            nn.LayerNorm(width),
            nn.Linear(width, EXPANSION * width),
            nn.ReLU(),
            nn.Linear(EXPANSION * width, width),
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the sum."""
        return x + self.net(x)


class CategoricalCritic(DeterministicMixin, Model):
    """Logarithms, not normalised, of the probabilities of the atoms of a value."""

    def __init__(self, spaces: dict[str, Any], device: str, width: int, blocks: int, atoms: int) -> None:
        Model.__init__(self, **spaces, device=device)
        DeterministicMixin.__init__(self)
        layers: list[nn.Module] = [nn.Linear(self.num_observations + self.num_actions, width)]
        layers += [Residual(width) for _ in range(blocks)]
        self.net = nn.Sequential(*layers, nn.LayerNorm(width), nn.Linear(width, atoms))

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Return them, shape (rows, atoms)."""
        return self.net(torch.cat((inputs["observations"], inputs["taken_actions"]), dim=-1)), {}


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
        for name, shape in (
            ("sums", (num_worlds, 1)),
            ("count", ()),
            ("mean", ()),
            ("square", ()),
            ("most", ()),
        ):
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))

    def see(self, rewards: torch.Tensor, ended: torch.Tensor) -> None:
        """Take the rewards of a control step into account."""
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


class RepeatedNoise(nn.Module):
    """Normal noise for each world, drawn anew after n control steps, P(n) proportional to 1 / n^2."""

    noise: torch.Tensor
    left: torch.Tensor

    def __init__(self, num_worlds: int, num_actions: int) -> None:
        super().__init__()
        self.register_buffer("noise", torch.zeros(num_worlds, num_actions))
        self.register_buffer("left", torch.zeros(num_worlds, 1, dtype=torch.int64))
        self.weights = 1.0 / torch.arange(1, REPEATS + 1, dtype=torch.float32).square()

    def next(self) -> torch.Tensor:
        """Return the noise of the next control step, shape (num_worlds, num_actions)."""
        due = self.left == 0
        steps = 1 + torch.multinomial(self.weights, len(due), replacement=True).to(due.device)[:, None]
        self.left.copy_(torch.where(due, steps, self.left) - 1)
        self.noise.copy_(torch.where(due, torch.randn_like(self.noise), self.noise))
        return self.noise


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


class FlashSAC(SAC):
    """skrl's SAC with another critic, another noise and rewards on a scale of their own."""

    def __init__(self, *, num_worlds: int, policy_every: int, precision: str, **kwargs: Any) -> None:
        """Make the optimisers and what a checkpoint holds besides.

        Args:
            num_worlds: Worlds.
            policy_every: Updates of the critics for one of the policy.
            precision: Of the critics' products of matrices, bfloat16 or float32.
            kwargs: What skrl's SAC takes.
        """
        super().__init__(**kwargs)
        self.normalise = self.checkpoint_modules["observation_preprocessor"]
        self.policy_every, self.bfloat16 = policy_every, precision == "bfloat16"
        self.noise = RepeatedNoise(num_worlds, self.policy.num_actions).to(self.device)
        self.reward_scale = RewardScale(num_worlds, self.cfg.discount_factor).to(self.device)
        critics = [*self.critic_1.parameters(), *self.critic_2.parameters()]
        atoms = self.critic_1.net[-1].out_features
        self.atoms = torch.linspace(-BOUND, BOUND, atoms, device=self.device)
        rate = self.cfg.learning_rate
        self.critic_optimizer = torch.optim.AdamW(
            critics, lr=rate[1], weight_decay=DECAY / rate[1], fused=True
        )
        self.checkpoint_modules["critic_optimizer"] = self.critic_optimizer
        self.checkpoint_modules["noise"] = self.noise
        self.checkpoint_modules["reward_scale"] = self.reward_scale

    def act(
        self, observations: torch.Tensor, states: torch.Tensor | None, *, timestep: int, timesteps: int
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        """Return actions of all worlds, with noise that stays for a while."""
        inputs = {"observations": self.normalise(observations)}
        if timestep < self.cfg.random_timesteps:
            return self.policy.random_act(inputs, role="policy")
        mean, outputs = self.policy.compute(inputs, role="policy")
        return (mean + outputs["log_std"].exp() * self.noise.next()).tanh(), outputs

    def record_transition(self, **kwargs: Any) -> None:
        """Record a control step; rewards as they are, since their scale changes."""
        self.normalise(kwargs["observations"], train=True)
        self.reward_scale.see(kwargs["rewards"], kwargs["terminated"] | kwargs["truncated"])
        super().record_transition(**kwargs)

    def update(self, *, timestep: int, timesteps: int) -> None:
        """Do the gradient steps of one control step."""
        scale = self.reward_scale.value()
        first = timestep * self.cfg.gradient_steps
        for step in range(first, first + self.cfg.gradient_steps):
            batch = self.memory.sample(SAMPLED, batch_size=self.cfg.batch_size)[0]
            observations, actions, rewards, after, terminated = batch
            inputs = {"observations": self.normalise(observations)}
            after = {"observations": self.normalise(after)}
            self._update_critics({**inputs, "taken_actions": actions}, rewards / scale, after, terminated)
            if step % self.policy_every == 0:
                self._update_policy(inputs)
            self.target_critic_1.update_parameters(self.critic_1, polyak=self.cfg.polyak)
            self.target_critic_2.update_parameters(self.critic_2, polyak=self.cfg.polyak)

    def _logits(self, inputs: dict[str, Any], *critics: Model) -> torch.Tensor:
        """Return the logits of two critics, shape (2, rows, atoms)."""
        with torch.autocast(torch.device(self.device).type, torch.bfloat16, enabled=self.bfloat16):
            return torch.stack([critic.compute(inputs)[0] for critic in critics]).float()

    def _update_critics(
        self, inputs: dict[str, Any], rewards: torch.Tensor, after: dict[str, Any], terminated: torch.Tensor
    ) -> None:
        """Move both critics towards the target distribution."""
        with torch.no_grad():
            actions, outputs = self.policy.act(after, role="policy")
            logits = self._logits(
                {**after, "taken_actions": actions}, self.target_critic_1, self.target_critic_2
            )
            both = logits.softmax(dim=-1)
            first = ((both[0] - both[1]) @ self.atoms < 0.0)[:, None]
            value = self.atoms - temperature(self) * outputs["log_prob"]
            value = rewards + self.cfg.discount_factor * terminated.logical_not() * value
            target = project(value, torch.where(first, both[0], both[1]), self.atoms)
        logits = self._logits(inputs, self.critic_1, self.critic_2)
        loss = -(target * logits.log_softmax(dim=-1)).sum(dim=-1).mean(dim=-1).sum()
        self.critic_optimizer.zero_grad()
        loss.backward()
        self.critic_optimizer.step()
        self.track_data("Loss / Critic loss", loss.item())

    def _update_policy(self, inputs: dict[str, Any]) -> None:
        """Move the policy towards higher values, and the temperature towards its entropy."""
        critics = self.critic_1, self.critic_2
        for critic in critics:
            critic.requires_grad_(False)
        actions, outputs = self.policy.act(inputs, role="policy")
        probabilities = self._logits({**inputs, "taken_actions": actions}, *critics).softmax(dim=-1)
        worth = (probabilities @ self.atoms).amin(dim=0)[:, None]
        loss = (temperature(self) * outputs["log_prob"] - worth).mean()
        self.policy_optimizer.zero_grad()
        loss.backward()
        self.policy_optimizer.step()
        for critic in critics:
            critic.requires_grad_(True)
        lack = (outputs["log_prob"].detach() + self.cfg.target_entropy).mean()
        self.entropy_optimizer.zero_grad()
        (-self.log_entropy_coefficient * lack).backward()
        self.entropy_optimizer.step()
        weight = self.log_entropy_coefficient.detach().exp()
        set_temperature(self, weight)
        self.track_data("Loss / Policy loss", loss.item())
        self.track_data("Coefficient / Entropy coefficient", weight.item())
