"""A memory of samples, the newest in place of the oldest."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
import torch

from myowarp.apps.train.arrays import Arrays, put

NEXT = "replay.next"
COPIES = 2  # at once, in memory and on disk, while it is saved: the last checkpoint stays meanwhile


class Replay:
    """Rows by name, each (number, width) float32.

    Attributes:
        size: What it takes, in memory and in a checkpoint [B].
        filled: Rows that hold a sample.
        widths: Entries of a row, by name.
    """

    def __init__(self, rows: int, device: torch.device, **widths: int) -> None:
        """Allocate it, or raise ValueError where this machine has not the memory.

        Args:
            rows: Samples, a multiple of the number that `add` gets.
            device: Where it is.
            **widths: Entries of a row, by name.
        """
        self.size, self.widths = 4 * rows * sum(widths.values()), widths
        check_room(self.size, "memory", os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        self._rows = {name: torch.empty(rows, width, device=device) for name, width in widths.items()}
        self._number, self._next, self.filled = rows, 0, 0

    def add(self, **rows: torch.Tensor) -> None:
        """Keep samples, each (number, width) or (number,)."""
        number = len(next(iter(rows.values())))
        for name, kept in self._rows.items():
            kept[self._next : self._next + number] = rows[name].reshape(number, -1)
        self._next = (self._next + number) % self._number
        self.filled = min(self.filled + number, self._number)

    def draw(self, *shape: int) -> dict[str, torch.Tensor]:
        """Return samples drawn with replacement, (*shape, width) by name."""
        any_of = next(iter(self._rows.values()))
        index = torch.randint(self.filled, shape, device=any_of.device)
        return {name: rows[index] for name, rows in self._rows.items()}

    def arrays(self) -> Arrays:
        """Return the samples, and where the next ones go."""
        rows = {name: rows.cpu().numpy() for name, rows in self._kept().items()}  # views: they are large
        return rows | {NEXT: np.array([self._next])}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put all samples back."""
        self._next = int(arrays[NEXT][0])
        self.filled = len(next(arrays[name] for name in self._kept()))
        put(self._kept(), arrays)

    def _kept(self) -> dict[str, torch.Tensor]:
        """Return the rows that hold a sample, as a checkpoint names them."""
        return {f"replay.{name}": rows[: self.filled] for name, rows in self._rows.items()}


def check_room(size: int, where: str, there: int) -> None:
    """Raise ValueError now if a replay of a size [B] cannot be kept and saved, which takes it once more."""
    if (needed := COPIES * size) > there:
        raise ValueError(
            f"--replay needs {needed / 1e9:.1f} GB of {where} to be kept and saved, this machine has "
            f"{there / 1e9:.1f} GB; choose a smaller --replay"
        )
