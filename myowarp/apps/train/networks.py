"""Policies and value functions: plain multilayer perceptrons in the form that skrl's agents ask for.

A policy's tensors are `net.<i>.weight`, `net.<i>.bias` and, with one spread for all states, `log_std`;
`myowarp.apps.policies.learned` repeats the forward pass in NumPy.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from torch import nn

ACTIVATION = {"elu": nn.ELU, "tanh": nn.Tanh, "relu": nn.ReLU}
FIRST_GAIN = 0.01  # of a policy's last layer: the first actions have about the same mean in every state
LOG_STD = (-5.0, 2.0)  # bounds of a spread that depends on the state; as in SAC's reference implementation
GAUSSIAN_LOG_STD = (-20.0, 2.0)  # bounds of a spread that is one for all states; skrl's
HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


def perceptron(inputs: int, hidden: tuple[int, ...], outputs: int, activation: str) -> nn.Sequential:
    """Return a multilayer perceptron."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(inputs, width), ACTIVATION[activation]()]
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))


def _soften(net: nn.Sequential, bias: float = 0.0) -> None:
    """Make the last layer of a policy small, so that it returns about the bias in every state."""
    last = net[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.weight.mul_(FIRST_GAIN)
        last.bias.fill_(bias)


class GaussianPolicy(GaussianMixin, Model):
    """Actions N(mean(observation), std), std one for all states; the environment clips them.

    A mean beyond -1 or 1 hides its noise behind that clip, and with it the gradient that could bring it back;
    the hyperbolic tangent of it does not.
    """

    def __init__(
        self,
        spaces: dict[str, Any],
        device: str,
        hidden: tuple[int, ...],
        activation: str,
        std: float,
        mean: float,
        bound: str,
    ) -> None:
        Model.__init__(self, **spaces, device=device)
        GaussianMixin.__init__(self, min_log_std=GAUSSIAN_LOG_STD[0], max_log_std=GAUSSIAN_LOG_STD[1])
        self.net = perceptron(self.num_observations, hidden, self.num_actions, activation)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), math.log(std)))
        self.bound = bound
        _soften(self.net, math.atanh(mean) if bound == "tanh" else mean)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Return means and, as extra, the logarithm of the standard deviation."""
        mean = self.net(inputs["observations"])
        return mean.tanh() if self.bound == "tanh" else mean, {"log_std": self.log_std}


class SquashedPolicy(Model):
    """Actions tanh(u), u ~ N(mean, std) of the observation. Source: Haarnoja et al. 2018, appendix C."""

    def __init__(self, spaces: dict[str, Any], device: str, hidden: tuple[int, ...], activation: str) -> None:
        super().__init__(**spaces, device=device)
        self.net = perceptron(self.num_observations, hidden, 2 * self.num_actions, activation)
        _soften(self.net)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Return the means of u and, as extra, the logarithm of their standard deviations."""
        mean, log_std = self.net(inputs["observations"]).chunk(2, dim=-1)
        return mean, {"log_std": log_std.clamp(*LOG_STD)}

    def act(self, inputs: dict[str, Any], *, role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Sample; log p(a) = log p(u) - sum log(1 - tanh(u)^2)."""
        mean, outputs = self.compute(inputs, role)
        noise = torch.randn_like(mean)
        u = mean + outputs["log_std"].exp() * noise
        log_slope = 2.0 * (math.log(2.0) - u - nn.functional.softplus(-2.0 * u))
        log_prob = -0.5 * noise.square() - outputs["log_std"] - HALF_LOG_2PI - log_slope
        outputs |= {"log_prob": log_prob.sum(dim=-1, keepdim=True), "mean_actions": mean.tanh()}
        return u.tanh(), outputs

    def random_act(self, inputs: dict[str, Any], *, role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Return uniform actions, from torch's generator, which a checkpoint holds."""
        rows = len(inputs["observations"])
        return 2.0 * torch.rand(rows, self.num_actions, device=self.device) - 1.0, {}


class Value(DeterministicMixin, Model):
    """Value of an observation, or, with actions, of both."""

    def __init__(
        self,
        spaces: dict[str, Any],
        device: str,
        hidden: tuple[int, ...],
        activation: str,
        *,
        of_actions: bool = False,
    ) -> None:
        Model.__init__(self, **spaces, device=device)
        DeterministicMixin.__init__(self)
        self.of_actions = of_actions
        inputs = self.num_observations + (self.num_actions if of_actions else 0)
        self.net = perceptron(inputs, hidden, 1, activation)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        """Return values, shape (rows, 1)."""
        seen = inputs["observations"]
        if self.of_actions:
            seen = torch.cat((seen, inputs["taken_actions"]), dim=-1)
        return self.net(seen), {}
