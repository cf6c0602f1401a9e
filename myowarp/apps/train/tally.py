"""Returns and successes of episodes while they run, on the device of the environment."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from myowarp.apps.train.settings import SUCCESSES

WINDOW = 256  # episodes that figures cover
COLUMNS = ("return", "length", *SUCCESSES)  # of an episode


class Tally:
    """Running returns, and the last episodes that ended.

    Attributes:
        episodes: Episodes that ended so far.
    """

    def __init__(self, num_worlds: int, device: str) -> None:
        self._return = torch.zeros(num_worlds, dtype=torch.float64, device=device)
        self._length = torch.zeros(num_worlds, dtype=torch.float64, device=device)
        self._any = torch.zeros(num_worlds, dtype=torch.bool, device=device)
        self._new: list[np.ndarray] = []
        self._last: deque[np.ndarray] = deque(maxlen=WINDOW)
        self.episodes = 0

    def add(self, reward: torch.Tensor, ended: torch.Tensor, any_ended: bool, info: dict[str, Any]) -> None:
        """Count one control step of all worlds."""
        self._return += reward
        self._length += 1.0
        self._any |= info["solved"]
        if not any_ended:
            return
        columns = (self._return, self._length, info["success"], info["solved"], self._any)
        self._new.append(torch.stack([column[ended].double() for column in columns], dim=1).cpu().numpy())
        self._return[ended] = 0.0
        self._length[ended] = 0.0
        self._any[ended] = False

    def forget(self, worlds: np.ndarray) -> None:
        """Begin anew in the worlds of a mask."""
        mask = torch.from_numpy(worlds).to(self._return.device)
        for column in (self._return, self._length, self._any):
            column[mask] = 0

    def copy(self, rows: torch.Tensor) -> None:
        """Give every world the numbers of another one."""
        self._return, self._length, self._any = (c[rows] for c in (self._return, self._length, self._any))

    def take(self) -> np.ndarray:
        """Return the episodes that ended since the last call, shape (episodes, columns)."""
        rows = np.concatenate([np.empty((0, len(COLUMNS))), *self._new])
        self._new.clear()
        return rows

    def keep(self, rows: np.ndarray) -> None:
        """Count episodes, those of other ranks too, shape (episodes, columns)."""
        self._last.extend(rows)
        self.episodes += len(rows)

    def figures(self) -> dict[str, float]:
        """Return means over the last episodes, NaN before the first one ended."""
        means = np.mean(self._last, axis=0) if self._last else np.full(len(COLUMNS), np.nan)
        return dict(zip(COLUMNS, means.tolist(), strict=True)) | {"episodes": self.episodes}

    def reached(self, share: float, rule: str) -> bool:
        """Return whether this share of a full window succeeded, by one of the rules `SUCCESSES`."""
        return len(self._last) == WINDOW and self.figures()[rule] >= share

    def rows(self) -> dict[str, np.ndarray]:
        """Return the numbers of the worlds."""
        return {
            "tally.return": self._return.cpu().numpy().copy(),
            "tally.length": self._length.cpu().numpy().copy(),
            "tally.any": self._any.cpu().numpy().copy(),
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the numbers of the episodes that ended."""
        return {
            "tally.last": np.array(self._last, dtype=np.float64).reshape(-1, len(COLUMNS)),
            "tally.episodes": np.array([self.episodes]),
        }

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put all numbers back."""
        device = self._return.device
        self._return = torch.from_numpy(arrays["tally.return"].copy()).to(device)
        self._length = torch.from_numpy(arrays["tally.length"].copy()).to(device)
        self._any = torch.from_numpy(arrays["tally.any"].copy()).to(device)
        self._last = deque(arrays["tally.last"], maxlen=WINDOW)
        self.episodes = int(arrays["tally.episodes"][0])
