"""Search by particles around a policy, and imitation of the episodes that succeeded.

Every start is given to some worlds, its copies. They act as the policy does, with noise that lasts; every
few control steps the best copies of a start are copied over the others, states, goals and all. A copy that
ends with a success is an episode that succeeds, from the start to the end. The network is fitted to the
actions of such episodes, and the next search is around it; what fails teaches nothing. A search of this kind
finds what a policy nearly does.

Source: sequential Monte Carlo (Doucet, de Freitas, Gordon 2001) weighed by the return so far; imitation of
the best episodes as in Oh et al. 2018, arXiv:1806.05635.
"""

from __future__ import annotations

import torch

from myowarp.apps.rollouts.ranks import Ranks
from myowarp.apps.train.dagger import Imitation
from myowarp.apps.train.networks import RepeatedNoise
from myowarp.apps.train.replay import Replay
from myowarp.apps.train.settings import ImproveSettings
from myowarp.apps.train.worlds import Worlds

MOST = 0.99  # size of an expert's action that is the hyperbolic tangent of an output


class Improve(Imitation):
    """A policy that imitates the best of what it, or an expert, nearly does."""

    settings: ImproveSettings

    def __init__(self, settings: ImproveSettings, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        self.noise = RepeatedNoise(worlds.num_worlds, worlds.num_actions).to(self.device)
        horizon = worlds.env.sim.horizon
        rows = settings.replay // horizon * horizon  # whole episodes
        if not rows:
            raise ValueError(
                f"--replay must hold an episode of {horizon} control steps, got {settings.replay}"
            )
        self.replay = Replay(rows, self.device, obs=worlds.num_obs, output=worlds.num_actions)

    def iterate(self, worlds: Worlds) -> None:
        """Search for one episode of every start, keep what succeeded, and fit the network to all that did."""
        obs, output, success = self.search(worlds)
        self.note(solved_starts=success.any(dim=1).float().mean())
        first = torch.arange(len(success), device=self.device) * success.shape[1]
        best = first + success.float().argmax(dim=1)
        for world in best[success.any(dim=1)].tolist():
            self.replay.add(obs=obs[:, world], output=output[:, world])
        for _ in range(self.settings.gradient_steps if self.replay.filled else 0):
            batch = self.replay.draw(self.settings.batch_size)
            if self.expert is not None:  # else the parent's normaliser stays, and with it the policy
                self.normaliser.see(batch["obs"])
            self.fit(self.policy.net, self.normaliser(batch["obs"]), batch["output"])

    @torch.no_grad()
    def search(self, worlds: Worlds) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return observations and outputs of the network on the way of every world, and who succeeded.

        Noise is added before the hyperbolic tangent: an action at a bound is not stuck there, and a network
        that is fitted to outputs is not drawn from the bounds by it.

        Shapes are (steps, worlds, size) and (starts, copies). The way of a copy begins as the way of the
        world that it was copied from.
        """
        settings, steps, number = self.settings, worlds.env.sim.horizon, worlds.num_worlds
        copies = settings.copies
        worlds.restart()
        worlds.copy(torch.arange(number, device=self.device) // copies * copies)
        obs = torch.empty(steps, number, worlds.num_obs, device=self.device)
        output = torch.empty(steps, number, worlds.num_actions, device=self.device)
        score = torch.zeros(number, device=self.device)
        alive, success = torch.ones_like(score, dtype=torch.bool), torch.zeros_like(score, dtype=torch.bool)
        for t in range(steps):
            obs[t] = worlds.obs
            noise = settings.initial_std * self.noise.next()
            noise[::copies] = 0.0  # a copy of every start acts without
            output[t] = self._proposal(worlds.obs) + noise
            step = worlds.step(self.policy.bounded(output[t]))
            score += torch.where(alive, step.reward, 0.0)
            alive &= ~step.terminated
            success |= alive & step.success
            if (t + 1) % settings.every == 0 and t + 1 < steps:
                rows = survivors(torch.where(alive, score, -torch.inf).view(-1, copies), settings.keep)
                worlds.copy(rows)
                score, alive, success = score[rows], alive[rows], success[rows]
                obs[: t + 1], output[: t + 1] = obs[: t + 1, rows], output[: t + 1, rows]
        return obs, output, (success & alive).view(-1, copies)

    def _proposal(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the outputs that noise is added to."""
        if self.expert is None:
            with self.products():
                return self.policy.net(self.normaliser(obs)).float()
        action = self.advice(obs, MOST)
        return action.atanh() if self.policy.mean_bound == "tanh" else action


def survivors(score: torch.Tensor, keep: int) -> torch.Tensor:
    """Return which world each world becomes: the best `keep` of its start in turn, shape (worlds,).

    Args:
        score: Shape (starts, copies); minus infinity for those that have failed.
        keep: Copies that are kept.
    """
    starts, copies = score.shape
    order = score.argsort(dim=1, descending=True)[:, :keep]
    best = order[:, torch.arange(copies, device=score.device) % keep]
    return (torch.arange(starts, device=score.device)[:, None] * copies + best).flatten()
