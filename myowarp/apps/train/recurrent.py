"""PPO of a policy that remembers its episode: a gated recurrent unit beside the observation.

    h' = GRU(x, h)    mean = net(x, h')    value = net(x, h)

x is a normalised observation; h, the memory, is 0 where an episode begins. Gradients go back through some
control steps (`PPOSettings.unrolled`), to a memory that the policy acted with. The value function sees such
memories too, and sends no gradient into them.

Source: Cho et al. 2014, arXiv:1406.1078, in torch's form; of such policies where a parameter of the world is
hidden, Ni, Eysenbach, Salakhutdinov 2022, arXiv:2110.05038.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from myowarp.apps.rollouts.ranks import Ranks
from myowarp.apps.train.networks import GaussianPolicy
from myowarp.apps.train.ppo import PPO
from myowarp.apps.train.settings import PPOSettings
from myowarp.apps.train.worlds import Worlds


class Unrolled(torch.autograd.Function):
    """A gated recurrent unit over steps that follow each other, with its gradient written out.

        r, z = sigmoid(W x + V h + b)    n = tanh(W x + b + r (V h + c))    h' = n + z (h - n)

    Torch's own unit takes two to three times as long for some dozen worlds: a node of the graph for each
    operation of each step.
    """

    @staticmethod
    def forward(ctx: Any, *given: torch.Tensor) -> torch.Tensor:
        """Return the memories after the steps, shape (steps, rows, size).

        Args:
            ctx: What the gradient needs.
            given: W x + b of r, z and n, shape (steps, rows, 3 x size); V, b of it; the memory before,
                (rows, size); and 0 where a step begins an episode, else 1, (steps, rows, 1).
        """
        gates, weight, bias, memory, same = given
        size = memory.shape[-1]
        recalled, opened = torch.empty_like(gates), torch.empty_like(gates[..., : 2 * size])
        before, new, after = gates.new_empty(3, *gates.shape[:2], size)
        for t in range(len(gates)):
            torch.mul(memory, same[t], out=before[t])
            torch.addmm(bias, before[t], weight.T, out=recalled[t])
            torch.add(gates[t, :, : 2 * size], recalled[t, :, : 2 * size], out=opened[t]).sigmoid_()
            by_reset = opened[t, :, :size], recalled[t, :, 2 * size :]
            torch.addcmul(gates[t, :, 2 * size :], *by_reset, out=new[t]).tanh_()
            memory = torch.lerp(new[t], before[t], opened[t, :, size:], out=after[t])
        ctx.save_for_backward(weight, same, before, recalled[..., 2 * size :], *opened.chunk(2, dim=-1), new)
        return after

    @staticmethod
    def backward(ctx: Any, *slopes: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """Return the gradients of the first four arguments."""
        weight, same, before, recalled, reset, update, new = ctx.saved_tensors
        size, to_new = new.shape[-1], (1.0 - update) * (1.0 - new * new)
        to_reset, to_update = recalled * reset * (1.0 - reset), (before - new) * update * (1.0 - update)
        # Slopes of n, r, z and V h + c of n, over that of h'; the last three stand as rows of V do.
        over = torch.stack((to_new, to_new * to_reset, to_update, to_new * reset), dim=-2)
        found, back = torch.empty_like(over), torch.zeros_like(new[0])
        of_recalled = found.flatten(-2)[..., size:]
        for t in reversed(range(len(new))):
            slope = slopes[0][t] + back
            torch.mul(over[t], slope[:, None], out=found[t])
            back = torch.addmm(slope * update[t], of_recalled[t], weight) * same[t]
        gates = torch.cat((found[..., 1, :], found[..., 2, :], found[..., 0, :]), dim=-1)
        rows = of_recalled.flatten(0, 1)
        return gates, rows.T @ before.flatten(0, 1), rows.sum(dim=0), back, None


class RecurrentPolicy(GaussianPolicy):
    """Actions N(mean(observation, memory), std).

    Attributes:
        memory: The unit's weights; `myowarp.apps.policies.learned` repeats it in NumPy.
        sizes: Numbers that are observed and that are remembered, the two parts of an input.
    """

    def __init__(self, num_obs: int, num_actions: int, settings: PPOSettings) -> None:
        self.sizes = [num_obs, settings.memory]
        super().__init__(sum(self.sizes), num_actions, settings)
        self.memory = nn.GRUCell(num_obs, settings.memory)

    def recall(self, inputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return means and memories after steps that follow each other.

        A memory of zeros is one before an episode: nothing goes through it.

        Args:
            inputs: Observations with the memories before them, shape (steps, rows, num_inputs).
        """
        x, before = inputs.split(self.sizes, dim=-1)
        unit, same = self.memory, (before != 0.0).any(dim=-1, keepdim=True).float()
        gates = nn.functional.linear(x, unit.weight_ih, unit.bias_ih).float()
        with torch.autocast(x.device.type, enabled=False):
            memory = Unrolled.apply(gates, unit.weight_hh, unit.bias_hh, before[0].float(), same)
        return super().forward(torch.cat((x, memory.to(x.dtype)), dim=-1)), memory

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return means of steps that follow each other, flattened, with gradients through the memories."""
        return self.recall(inputs)[0].flatten(0, 1)


class RecurrentPPO(PPO):
    """PPO with a memory; samples are steps of a world that follow each other.

    Attributes:
        remembered: The memory of every world, shape (num_worlds, size).
    """

    policy: RecurrentPolicy
    remembered: torch.Tensor

    def __init__(self, settings: PPOSettings, worlds: Worlds, ranks: Ranks) -> None:
        super().__init__(settings, worlds, ranks)
        self.together = settings.unrolled
        memory = torch.zeros(worlds.num_worlds, settings.memory, device=self.device)
        self.register_buffer("remembered", memory)

    def make_policy(self, worlds: Worlds) -> RecurrentPolicy:
        """Return the policy as it starts, with nothing learned of what is remembered."""
        return RecurrentPolicy(worlds.num_obs, worlds.num_actions, self.settings)

    def inputs(self, obs: torch.Tensor) -> torch.Tensor:
        """Return normalised observations with what is remembered."""
        return torch.cat((self.normaliser(obs), self.remembered), dim=-1)

    def act(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return means, and remember the step."""
        mean, memory = self.policy.recall(inputs[None])
        self.remembered.copy_(memory[0])
        return mean[0]

    def forget(self, ended: torch.Tensor) -> None:
        """Let nothing be remembered in the worlds of a mask."""
        self.remembered[ended] = 0.0

    def means(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the means of sequences, flattened as they came."""
        return self.policy(inputs.view(self.together, -1, inputs.shape[-1]))
