"""All numbers of a run by name, as a checkpoint has them: out of what holds them, and back in place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
import torch

Arrays: TypeAlias = dict[str, np.ndarray]


def taken(own: Mapping[str, torch.Tensor | np.ndarray]) -> Arrays:
    """Return copies on the host."""
    return {
        name: np.array(values.detach().cpu().numpy() if isinstance(values, torch.Tensor) else values)
        for name, values in own.items()
    }


def put(own: Mapping[str, torch.Tensor | np.ndarray], arrays: Mapping[str, np.ndarray]) -> None:
    """Put back what `taken` returned.

    Raises:
        KeyError: An array is missing.
    """
    for name, values in own.items():
        if isinstance(values, torch.Tensor):
            values.copy_(tensor(arrays[name]))
        else:
            values[...] = arrays[name]


def below(arrays: Mapping[str, np.ndarray], prefix: str) -> Arrays:
    """Return the arrays whose names begin with a prefix, without it."""
    return {name[len(prefix) :]: array for name, array in arrays.items() if name.startswith(prefix)}


def tensor(array: np.ndarray) -> torch.Tensor:
    """Return a tensor that owns its memory."""
    return torch.from_numpy(np.array(array))
