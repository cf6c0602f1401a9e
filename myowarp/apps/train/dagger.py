"""DAgger: a policy learns what an expert would do in the states that the policy itself leads to.

The expert says in every state what it would do, and acts itself at first. Then the policy acts, with noise,
so that states near its way are seen too. The network is fitted to all that was said so far; its loss is
|mean(observation) - expert|^2, a mean over actions.

Source: Ross, Gordon, Bagnell (2011), *A reduction of imitation learning and structured prediction to
no-regret online learning*, arXiv:1011.0686: the expert acts for `expert_steps`, the policy from then on.
Noise while samples are taken: Laskey et al. (2017), *DART*, arXiv:1703.09327; here of fixed size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from skrl.agents.torch import Agent, AgentCfg

from myowarp.apps.train.settings import DAggerSettings


@dataclass(kw_only=True)
class DAGGER_CFG(AgentCfg):  # noqa: N801 (as skrl's are called)
    """What skrl's agents share of their configuration, as far as it is used here."""

    discount_factor: float
    learning_rate: float
    observation_preprocessor: type
    observation_preprocessor_kwargs: dict[str, Any]


NOISE_LEVELS = 3  # of worlds in turn: none, half of the noise, all of it
KEPT = ("observations", "actions")
"""What the memory holds: what was seen, and what the expert would have done."""


class DAgger(Agent):
    """An agent in skrl's form that imitates an expert.

    Attributes:
        expert: Observations (num_worlds, obs_size), on the host, to actions (num_worlds, num_actions) in
            [-1, 1]; called once in every control step, before it.
    """

    expert: Callable[[np.ndarray], np.ndarray]

    def __init__(self, *, settings: DAggerSettings, **skrl: Any) -> None:
        """Make the optimiser; see skrl's `Agent`."""
        super().__init__(**skrl)
        self.settings = settings
        self.policy = self.models["policy"]
        cfg = self.cfg
        self.normalise = cfg.observation_preprocessor(**cfg.observation_preprocessor_kwargs)
        self.optimizer = torch.optim.Adam(self.policy.parameters(), lr=settings.learning_rate)
        self.checkpoint_modules |= {
            "policy": self.policy,
            "optimizer": self.optimizer,
            "observation_preprocessor": self.normalise,
        }
        levels = torch.arange(settings.num_worlds, device=self.device) % NOISE_LEVELS
        self.noise = settings.initial_std * levels[:, None] / (NOISE_LEVELS - 1)
        self.said = torch.empty(0)

    def init(self, *, trainer_cfg: Any = None) -> None:
        """Allocate the memory."""
        super().init(trainer_cfg=trainer_cfg)
        for name, space in zip(KEPT, (self.observation_space, self.action_space), strict=True):
            self.memory.create_tensor(name, size=space, dtype=torch.float32)

    def act(self, observations: torch.Tensor, states: Any, *, timestep: int, timesteps: int) -> Any:
        """Return the actions of the policy, at first those of the expert, with noise."""
        said = np.clip(self.expert(observations.cpu().numpy().copy()), -1.0, 1.0)
        self.said = torch.from_numpy(np.asarray(said, dtype=np.float32)).to(observations.device)
        if timestep < self.settings.expert_steps:
            mean = self.said
        else:
            mean = self.policy.compute({"observations": self.normalise(observations)})[0]
        return (mean + self.noise * torch.randn_like(mean)).clamp(-1.0, 1.0), {}

    def pre_interaction(self, *, timestep: int, timesteps: int) -> None:
        """Do nothing."""

    def record_transition(self, *, observations: torch.Tensor, **others: Any) -> None:
        """Keep what was seen and said."""
        self.memory.add_samples(observations=observations, actions=self.said)

    def post_interaction(self, *, timestep: int, timesteps: int) -> None:
        """Fit the networks once the expert has shown enough."""
        if timestep + 1 >= self.settings.expert_steps:
            self.update(timestep=timestep, timesteps=timesteps)

    def update(self, *, timestep: int, timesteps: int) -> None:
        """Do the gradient steps of one control step."""
        losses = []
        for number in range(self.settings.gradient_steps):
            seen, said = self.memory.sample(names=KEPT, batch_size=self.settings.batch_size)[0]
            seen = self.normalise(seen, train=number == 0)
            loss = (self.policy.compute({"observations": seen})[0] - said).square().mean()
            self.optimizer.zero_grad()
            loss.backward()
            self.optimizer.step()
            losses.append(loss.detach())
        self.track_data("Loss / Policy loss", float(torch.stack(losses).mean()))
