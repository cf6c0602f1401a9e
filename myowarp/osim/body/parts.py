"""Frames in parts: what is solved frame by frame takes bounded memory on the device, and all cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from myowarp.process import num_cores

Found = TypeVar("Found")
GRAIN = 16
"""By default, frames that parts are multiples of."""
COMPILED: set[str] = set()
"""Kinds of parts solved before: kernels are compiled once, not by each thread."""


def in_parts(count: int, most: int, solve: Callable[[slice], Found], grain: int = GRAIN) -> list[Found]:
    """Solve frames in parts, on all cores at a time; return what was found, in order.

    Args:
        count: Number of frames.
        most: Of a part, up to a `grain`.
        solve: Called with the frames of a part.
        grain: What parts are multiples of, so that runs of frames begin at the same ones on any number of
            cores.
    """
    cores = num_cores()
    parts = cores * max(-(-count // (most * cores)), 1)  # as many for each core
    size = -(-count // (parts * grain)) * grain or grain
    slices = [slice(at, min(at + size, count)) for at in range(0, max(count, 1), size)]
    if cores == 1 or len(slices) == 1:
        return [solve(part) for part in slices]
    alone = [] if solve.__qualname__ in COMPILED else [solve(slices[0])]
    COMPILED.add(solve.__qualname__)
    with ThreadPoolExecutor(cores) as pool:
        return [*alone, *pool.map(solve, slices[len(alone) :])]


def joined(found: list[tuple[np.ndarray, ...]]) -> list[np.ndarray]:
    """Return the arrays of parts as those of all frames."""
    return [np.concatenate(arrays) for arrays in zip(*found, strict=True)]
