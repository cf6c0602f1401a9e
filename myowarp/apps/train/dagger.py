"""DAgger: a policy learns what an expert would do in the states that the policy itself leads to.

The expert says in every state what it would do, and acts itself at first. Then the policy acts, with noise,
so that states near its way are seen too. The network is fitted to all that was said so far; its loss is
|mean(observation) - expert|^2, a mean over actions.

Source: Ross, Gordon, Bagnell (2011), *A reduction of imitation learning and structured prediction to
no-regret online learning*, arXiv:1011.0686: the expert acts for `expert_steps`, the policy from then on.
Noise while samples are taken: Laskey et al. (2017), *DART*, arXiv:1703.09327; here of fixed size.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from myowarp.apps.policies.learned import Act
from myowarp.apps.rollouts.ranks import Ranks
from myowarp.apps.train.learner import Learner
from myowarp.apps.train.networks import GaussianPolicy
from myowarp.apps.train.replay import Replay
from myowarp.apps.train.settings import DAggerSettings, ImproveSettings
from myowarp.apps.train.worlds import Worlds

NOISE_LEVELS = 3  # of worlds in turn: none, half of the noise, all of it


class Imitation(Learner):
    """A policy that is fitted to actions: the base of DAgger and of `myowarp improve`.

    Attributes:
        expert: What is imitated, or searched around; called once in every control step, before it. None: the
            policy itself.
    """

    settings: DAggerSettings | ImproveSettings
    policy: GaussianPolicy
    replay: Replay
    expert: Act | None = None

    def __init__(self, settings: DAggerSettings | ImproveSettings, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        self.policy = GaussianPolicy(worlds.num_obs, worlds.num_actions, settings).to(self.device)
        self.optimizers = {"policy": self.adam(self.policy.net.parameters(), settings.learning_rate)}

    def advice(self, obs: torch.Tensor, most: float = 1.0) -> torch.Tensor:
        """Return what the expert would do, cut to a size."""
        assert self.expert is not None
        actions = np.clip(self.expert(obs.cpu().numpy().copy()), -most, most)
        return torch.from_numpy(np.asarray(actions, dtype=np.float32)).to(obs.device)

    def fit(self, network: nn.Module, obs: torch.Tensor, wanted: torch.Tensor) -> None:
        """Do a gradient step of the policy, or its network alone, towards what is wanted."""
        with self.products():
            output = network(obs).float()
        loss = (output - wanted).square().mean()
        self.descend("policy", loss)
        self.note(policy_loss=loss)


class DAgger(Imitation):
    """A policy that imitates an expert."""

    settings: DAggerSettings

    def __init__(self, settings: DAggerSettings, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        self.replay = Replay(settings.replay, self.device, obs=worlds.num_obs, action=worlds.num_actions)
        levels = torch.arange(settings.num_worlds, device=self.device) % NOISE_LEVELS
        self._noise = settings.initial_std * levels[:, None] / (NOISE_LEVELS - 1)

    def iterate(self, worlds: Worlds) -> None:
        """Alternate between a control step of all worlds and some gradient steps."""
        settings = self.settings
        for _ in range(settings.rollout_steps):
            obs = worlds.obs.clone()
            advice = self.advice(obs)
            with torch.no_grad(), self.products():
                expert_acts = worlds.steps < settings.expert_steps
                mean = advice if expert_acts else self.policy(self.normaliser(obs))
            worlds.step((mean + self._noise * torch.randn_like(mean)).clamp(-1.0, 1.0))
            self.replay.add(obs=obs, action=advice)
            if worlds.steps >= settings.expert_steps:
                batch = self.replay.draw(settings.gradient_steps, settings.batch_size)
                self.normaliser.see(batch["obs"][0])
                for part, wanted in zip(self.normaliser(batch["obs"]), batch["action"], strict=True):
                    self.fit(self.policy, part, wanted)
