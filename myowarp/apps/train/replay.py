"""A memory of samples, the newest in place of the oldest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from myowarp.apps.train.settings import DAggerSettings, Replaying, Settings

PREFIX = "replay."


def replay_bytes(settings: Settings, num_obs: int, num_actions: int) -> int:
    """Return what the replay of a run takes, in memory and in a checkpoint [B]; 0 without one."""
    if not isinstance(settings, Replaying):
        return 0
    once = num_obs + num_actions
    return 4 * settings.replay * (once if isinstance(settings, DAggerSettings) else once + num_obs + 2)


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

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the samples, and where the next ones go."""
        rows = {PREFIX + name: tensor[: self.filled].cpu().numpy() for name, tensor in self._rows.items()}
        return rows | {f"{PREFIX}next": np.array([self._next])}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put all samples back.

        Raises:
            KeyError: An array is missing.
        """
        self._next = int(arrays[f"{PREFIX}next"][0])
        for name, rows in self._rows.items():
            kept = arrays[PREFIX + name]
            rows[: len(kept)] = torch.from_numpy(np.array(kept))
            self.filled = len(kept)
