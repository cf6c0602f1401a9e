"""Policies, value functions and critics: plain networks; the normaliser before them, the noise behind them.

A policy's tensors are `net.<i>.weight`, `net.<i>.bias` and, with one spread for all states, `log_std`;
`myowarp.apps.policies.learned` repeats the forward pass in NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import torch
from torch import nn

from myowarp.apps.rollouts.ranks import ALONE, Ranks
from myowarp.apps.train.settings import Gaussian, Settings

# In place: the slope of a function is then one of its result, without another exponential.
ACTIVATION: dict[str, Callable[[], nn.Module]] = {
    "elu": partial(nn.ELU, inplace=True),
    "tanh": nn.Tanh,
    "relu": partial(nn.ReLU, inplace=True),
}
FIRST_GAIN = 0.01  # of a policy's last layer: the first actions have about the same mean in every state
LOG_STD = (-5.0, 2.0)  # bounds of a spread that depends on the state; as in SAC's reference implementation
GAUSSIAN_LOG_STD = (-20.0, 2.0)  # bounds of a spread that is one for all states
HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
CLIP, EPSILON = 5.0, 1e-8  # of normalised observations; of their standard deviation
EXPANSION = 4  # of a residual block's inner layer
REPEATS = 16  # largest number of control steps for which noise stays


def perceptron(
    inputs: int, hidden: tuple[int, ...], outputs: int, activation: str, first: float | None = None
) -> nn.Sequential:
    """Return a multilayer perceptron; with `first` it returns about that in every state at first."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(inputs, width), ACTIVATION[activation]()]
        inputs = width
    last = nn.Linear(inputs, outputs)
    if first is not None:
        last.weight.data.mul_(FIRST_GAIN)
        last.bias.data.fill_(first)
    return nn.Sequential(*layers, last)


class Normaliser(nn.Module):
    """Mean and variance of all rows that it was shown.

    Merged after Chan, Golub and LeVeque 1983, The American Statistician 37:242; it begins as one sample of
    mean 0 and variance 1, so that a column that never changes keeps a variance.

    Attributes:
        mean, variance: Of every column, shape (size,).
        count: Rows that they are of, shape (size,): columns may be inherited from another run.
    """

    mean: torch.Tensor
    variance: torch.Tensor
    count: torch.Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        self.register_buffer("count", torch.ones(size, dtype=torch.float64))

    def see(self, rows: torch.Tensor, ranks: Ranks = ALONE) -> None:
        """Take rows (number, size) into account, those of all ranks, each with as many."""
        rows = rows.double()
        mean, square = ranks.mean(torch.stack((rows.mean(0), rows.square().mean(0))))
        number = len(rows) * ranks.size
        variance, shift, total = square - mean.square(), mean - self.mean, self.count + number
        squares = self.variance * self.count + variance * number
        self.variance.copy_((squares + shift.square() * self.count * number / total) / total)
        self.mean += shift * number / total
        self.count += number

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return normalised rows, cut at `CLIP` standard deviations."""
        spread = self.variance.float().sqrt() + EPSILON
        return ((rows - self.mean.float()) / spread).clamp(-CLIP, CLIP)

    def inverse(self, rows: torch.Tensor) -> torch.Tensor:
        """Return what normalised rows stand for."""
        return rows * self.variance.float().sqrt() + self.mean.float()


class GaussianPolicy(nn.Module):
    """Actions N(mean(observation), std), std one for all states; the environment clips them.

    A mean beyond -1 or 1 hides its noise behind that clip, and with it the gradient that could bring it back;
    the hyperbolic tangent of it does not.

    Attributes:
        num_inputs: Numbers that the mean is a function of.
    """

    log_std_bounds = GAUSSIAN_LOG_STD

    def __init__(self, num_inputs: int, num_actions: int, settings: Gaussian) -> None:
        super().__init__()
        self.num_inputs = num_inputs
        self.mean_bound, mean = settings.mean_bound, settings.initial_mean
        first = math.atanh(mean) if self.mean_bound == "tanh" else mean
        self.net = perceptron(num_inputs, settings.hidden, num_actions, settings.activation, first)
        self.log_std = nn.Parameter(torch.full((num_actions,), math.log(settings.initial_std)))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return means, float32."""
        return self.bounded(self.net(observations).float())

    def bounded(self, mean: torch.Tensor) -> torch.Tensor:
        """Return what the last layer's output stands for."""
        return mean.tanh() if self.mean_bound == "tanh" else mean

    @property
    def std(self) -> torch.Tensor:
        """Standard deviations of an action's entries."""
        return self.log_std.clamp(*GAUSSIAN_LOG_STD).exp()


class SquashedPolicy(nn.Module):
    """Actions tanh(u), u ~ N(mean, std) of the observation. Source: Haarnoja et al. 2018, appendix C."""

    log_std_bounds = LOG_STD
    mean_bound = "tanh"

    def __init__(self, num_obs: int, num_actions: int, settings: Settings) -> None:
        super().__init__()
        self.net = perceptron(num_obs, settings.hidden, 2 * num_actions, settings.activation, 0.0)

    def forward(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return means of u and the logarithms of their standard deviations, float32."""
        mean, log_std = self.net(observations).float().chunk(2, dim=-1)
        return mean, log_std.clamp(*LOG_STD)

    def draw(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return actions and the logarithms of their densities.

        log p(a) = log p(u) - sum log(1 - tanh(u)^2)
        """
        mean, log_std = self(observations)
        noise = torch.randn_like(mean)
        u = mean + log_std.exp() * noise
        log_slope = 2.0 * (math.log(2.0) - u - nn.functional.softplus(-2.0 * u))
        log_density = -0.5 * noise.square() - log_std - HALF_LOG_2PI - log_slope
        return u.tanh(), log_density.sum(dim=-1)


class Critics(nn.Module):
    """Two critics of observation and action side by side, each product of matrices one for both.

    Each has residual blocks x + W2 relu(W1 normalise(x)) and returns logits of the atoms of a value.
    Source: FlashSAC, arXiv:2604.04539; layer normalisation in place of its batch normalisation.
    """

    def __init__(self, inputs: int, width: int, blocks: int, atoms: int) -> None:
        super().__init__()
        inner = EXPANSION * width
        self.first = Pair(inputs, width)
        self.blocks = nn.ModuleList(
            nn.Sequential(PairNorm(width), Pair(width, inner), nn.ReLU(), Pair(inner, width))
            for _ in range(blocks)
        )
        self.last = nn.Sequential(PairNorm(width), Pair(width, atoms))

    def forward(self, observations: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Return logits, shape (2, rows, atoms), float32."""
        x = self.first(torch.cat((observations, actions), dim=-1))
        for block in self.blocks:
            x = x + block(x)
        return self.last(x).float()


class Pair(nn.Module):
    """Two linear layers: (rows, inputs) or (2, rows, inputs) to (2, rows, outputs)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        bound = inputs**-0.5  # as of nn.Linear
        self.weight = nn.Parameter(torch.empty(2, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(2, 1, outputs).uniform_(-bound, bound))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return W x + b of both."""
        return torch.baddbmm(self.bias, x.expand(2, -1, -1), self.weight)


class PairNorm(nn.Module):
    """Two layer normalisations: (2, rows, width) to the same shape."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(2, 1, width))
        self.bias = nn.Parameter(torch.zeros(2, 1, width))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return rows of mean 0 and variance 1, scaled and shifted by each one's own."""
        return torch.addcmul(self.bias, nn.functional.layer_norm(x, x.shape[-1:]), self.weight)


class RepeatedNoise(nn.Module):
    """Normal noise for each world, drawn anew after n control steps, P(n) proportional to 1 / n^2.

    It moves a limb where white noise only shakes it. Source: FlashSAC, arXiv:2604.04539.
    """

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
