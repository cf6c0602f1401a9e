"""Trust region policy optimisation: a natural gradient with a line search, as the paper's NPG has it.

Source: Schulman et al. 2015, arXiv:1502.05477; conjugate gradients on products with the Fisher matrix, which
are second derivatives of the KL divergence.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn

from myowarp.apps.train.ppo import OnPolicyLearner, Rollout, kl, log_density
from myowarp.apps.train.settings import TRPOSettings

HALVINGS = 10  # of a step that misses
LEAST_GAIN = 0.1  # share of the gain that the gradient promises


class TRPO(OnPolicyLearner):
    """TRPO; its value function is that of PPO."""

    settings: TRPOSettings

    def update(self, rollout: Rollout) -> None:
        """Step the policy once, and pass over the samples for the value function."""
        if not self.value_alone:
            self.step_policy(rollout)
        for part in rollout.parts(self.settings.minibatches) * self.settings.epochs:
            self.update_value(part)

    def step_policy(self, rollout: Rollout) -> None:
        """Go as far along the natural gradient as the divergence allows."""
        parameters = [*self.policy.parameters()]
        before = nn.utils.parameters_to_vector(parameters).detach()

        def flat(tensors: tuple[torch.Tensor, ...]) -> torch.Tensor:
            return torch.cat([tensor.reshape(-1) for tensor in tensors])

        def gain() -> torch.Tensor:
            now = log_density(rollout.action, self.policy(rollout.obs), self.policy.std)
            return ((now - rollout.density).exp() * rollout.advantage).mean()

        def divergence() -> torch.Tensor:
            return kl(rollout.mean, rollout.std, self.policy(rollout.obs), self.policy.std)

        def curvature(vector: torch.Tensor) -> torch.Tensor:
            slope = flat(torch.autograd.grad(divergence(), parameters, create_graph=True))
            product = flat(torch.autograd.grad(slope @ vector, parameters))
            return product + self.settings.damping * vector

        begin = gain()
        slope = flat(torch.autograd.grad(begin, parameters))
        direction = conjugate_gradient(curvature, slope, self.settings.conjugate_steps)
        length = (2.0 * self.settings.max_kl / (direction @ curvature(direction) + 1e-8)).sqrt()
        promised = slope @ (length * direction)
        with torch.no_grad():
            for halving in range(HALVINGS):
                share = 0.5**halving
                nn.utils.vector_to_parameters(before + share * length * direction, parameters)
                gained, moved = gain() - begin, divergence()
                if moved <= self.settings.max_kl and gained >= LEAST_GAIN * share * promised:
                    break
            else:
                nn.utils.vector_to_parameters(before, parameters)
        self.note(policy_loss=-begin, kl=divergence())


def conjugate_gradient(
    product: Callable[[torch.Tensor], torch.Tensor], right: torch.Tensor, steps: int
) -> torch.Tensor:
    """Return about x with product(x) = right."""
    x, residual = torch.zeros_like(right), right.clone()
    direction, square = residual.clone(), residual @ residual
    for _ in range(steps):
        along = product(direction)
        length = square / (direction @ along + 1e-12)
        x, residual = x + length * direction, residual - length * along
        before, square = square, residual @ residual
        if square < 1e-10:
            break
        direction = residual + square / before * direction
    return x
