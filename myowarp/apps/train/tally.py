"""Returns and successes of episodes while they run, on the device of the environment."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from myowarp.apps.reports.evaluation import SUCCESSES
from myowarp.apps.train.arrays import Arrays

WINDOW = 256  # episodes that figures cover
COLUMNS = ("return", "length", *SUCCESSES)  # of an episode


class Tally:
    """Running returns, and the last episodes that ended.

    Attributes:
        worlds: Of the episodes that run, each (num_worlds,): `tally.return`, `tally.length` and `tally.any`,
            whether a step was solved.
        episodes: Episodes that ended so far.
    """

    def __init__(self, num_worlds: int, device: torch.device | str) -> None:
        kinds = {"return": torch.float64, "length": torch.float64, "any": torch.bool}
        self.worlds = {f"tally.{n}": torch.zeros(num_worlds, dtype=kinds[n], device=device) for n in kinds}
        self._new: list[np.ndarray] = []
        self._last: deque[np.ndarray] = deque(maxlen=WINDOW)
        self.episodes = 0

    def add(self, reward: torch.Tensor, ended: torch.Tensor, any_ended: bool, info: dict[str, Any]) -> None:
        """Count one control step of all worlds."""
        total, length, solved = self.worlds.values()
        total += reward
        length += 1.0
        solved |= info["solved"]
        if any_ended:
            columns = (total, length, info["success"], info["solved"], solved)
            rows = [column[ended].double() for column in columns]
            self._new.append(torch.stack(rows, dim=1).cpu().numpy())
            self.forget(ended)

    def forget(self, mask: torch.Tensor) -> None:
        """Begin anew in the worlds of a mask."""
        for column in self.worlds.values():
            column[mask] = 0

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

    def arrays(self) -> Arrays:
        """Return the numbers of the episodes that ended."""
        last = np.array(self._last, dtype=np.float64).reshape(-1, len(COLUMNS))
        return {"tally.last": last, "tally.episodes": np.array([self.episodes])}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put them back."""
        self._last = deque(arrays["tally.last"], maxlen=WINDOW)
        self.episodes = int(arrays["tally.episodes"][0])
