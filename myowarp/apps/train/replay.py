"""A memory of samples, the newest in place of the oldest."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from myowarp.apps.train.arrays import Arrays, put
from myowarp.apps.train.settings import DAggerSettings, Replaying, Settings
from myowarp.disk import existing

NEXT = "replay.next"
COPIES = 2  # at once, in memory and on disk, while it is saved


class Replay:
    """Rows by name, each (size, width) float32.

    Attributes:
        filled: Rows that hold a sample.
    """

    def __init__(self, size: int, device: torch.device, **widths: int) -> None:
        """Allocate it.

        Args:
            size: Samples, a multiple of the number that `add` gets.
            device: Where it is.
            **widths: Entries of a row, by name.
        """
        self._rows = {name: torch.empty(size, width, device=device) for name, width in widths.items()}
        self._size, self._next, self.filled = size, 0, 0

    def add(self, **rows: torch.Tensor) -> None:
        """Keep samples, each (number, width) or (number,)."""
        number = len(next(iter(rows.values())))
        for name, kept in self._rows.items():
            kept[self._next : self._next + number] = rows[name].reshape(number, -1)
        self._next = (self._next + number) % self._size
        self.filled = min(self.filled + number, self._size)

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
        return {f"replay.{name}": rows[: self.filled] for name, rows in self._rows.items()}


def replay_bytes(settings: Settings, num_obs: int, num_actions: int) -> int:
    """Return what the replay of a run takes, in memory and in a checkpoint [B]; 0 without one."""
    if not isinstance(settings, Replaying):
        return 0
    once = num_obs + num_actions
    return 4 * settings.replay * (once if isinstance(settings, DAggerSettings) else once + num_obs + 2)


def check_replay(size: int, folder: Path) -> None:
    """Raise ValueError now if this machine cannot hold and save a replay of a size [B].

    A save copies it once more, and the last checkpoint stays in its folder until the new one is whole.
    """
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for what, there in (("memory", memory), ("disk", shutil.disk_usage(existing(folder)).free)):
        if (needed := COPIES * size) > there:
            raise ValueError(
                f"--replay needs {needed / 1e9:.1f} GB of {what} to be kept and saved, this machine has "
                f"{there / 1e9:.1f} GB; choose a smaller --replay"
            )
