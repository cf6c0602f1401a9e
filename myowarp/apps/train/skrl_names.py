"""Private names of skrl that training needs; each is tried where it is used, and missed in one sentence.

skrl is pinned exactly, since a resumed run depends on every number in it.
"""

from __future__ import annotations

import skrl
import torch
from skrl import config
from skrl.agents.torch.sac import SAC
from skrl.resources.preprocessors.torch import RunningStandardScaler

PINNED = "2.1.1"


def _gone(what: str) -> RuntimeError:
    """Return an error that says what skrl no longer lets us do."""
    return RuntimeError(f"skrl {skrl.__version__} has changed, and {what}; run `pip install skrl=={PINNED}`")


class MergedScaler(RunningStandardScaler):
    """Normaliser whose moments are those of the samples of all ranks; skrl's are each rank's own."""

    def _parallel_variance(self, input_mean: torch.Tensor, input_var: torch.Tensor, input_count: int) -> None:
        if config.torch.is_distributed:
            input_mean, input_var, input_count = merged_moments(input_mean, input_var, input_count)
        super()._parallel_variance(input_mean, input_var, input_count)


def average_over_ranks(size: int) -> None:
    """Let skrl average gradients, and `MergedScaler` moments, over ranks that have met.

    Raises:
        RuntimeError: skrl has changed.
    """
    config.torch._is_distributed, config.torch._world_size = True, size
    averages = config.torch.is_distributed and config.torch.world_size == size
    if not averages or not hasattr(RunningStandardScaler, "_parallel_variance"):
        raise _gone("ranks would learn each for itself")


def temperature(agent: SAC) -> torch.Tensor | float:
    """Return the weight of the entropy, as the last update left it."""
    return agent._entropy_coefficient


def set_temperature(agent: SAC, weight: torch.Tensor) -> None:
    """Set the weight of the entropy.

    Raises:
        RuntimeError: skrl has changed.
    """
    if not hasattr(agent, "_entropy_coefficient"):
        raise _gone("SAC keeps the weight of the entropy elsewhere")
    agent._entropy_coefficient = weight


def merged_moments(
    mean: torch.Tensor, variance: torch.Tensor, count: int
) -> tuple[torch.Tensor, torch.Tensor, int]:
    """Return mean, variance and number of the samples of all ranks, each with as many.

    With n samples, mean m and unbiased variance v in each of R ranks:
    v_all = (sum (n - 1) v + sum n (m - m_all)^2) / (R n - 1).
    Source: Chan, Golub and LeVeque 1983, The American Statistician 37:242.
    """
    own = torch.stack((mean, variance)).double()
    size = torch.distributed.get_world_size()
    moments = [torch.empty_like(own) for _ in range(size)]
    torch.distributed.all_gather(moments, own)
    means, variances = torch.stack(moments).unbind(1)
    whole = means.mean(0)
    squares = (count - 1) * variances.sum(0) + count * (means - whole).square().sum(0)
    return whole, squares / (size * count - 1), size * count
