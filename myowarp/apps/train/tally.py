"""Returns and successes of episodes while they run, on the device of the environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from myowarp.apps.reports.evaluation import SUCCESSES

LAST, NUMBER = "tally.last", "tally.episodes"
WINDOW = 256  # episodes that figures cover
COLUMNS = ("return", "length", *SUCCESSES)  # of an episode


class Tally:
    """Running returns, and the last episodes that ended.

    Attributes:
        worlds: Of the episodes that run, each (num_worlds,): `tally.return`, `tally.length` and `tally.any`,
            whether a step was solved.
        ended: Of the episodes that ended, `tally.last`: the last ones, shape (episodes, columns), and
            `tally.episodes`: how many there were, shape (1,).
    """

    def __init__(self, num_worlds: int, device: torch.device | str) -> None:
        kinds = {"return": torch.float64, "length": torch.float64, "any": torch.bool}
        self.worlds = {f"tally.{n}": torch.zeros(num_worlds, dtype=kinds[n], device=device) for n in kinds}
        self._new: list[np.ndarray] = []
        self.ended = {LAST: np.empty((0, len(COLUMNS))), NUMBER: np.zeros(1, dtype=np.int64)}

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
        self.ended[LAST] = np.concatenate((self.ended[LAST], rows))[-WINDOW:]
        self.ended[NUMBER] += len(rows)

    def figures(self) -> dict[str, float]:
        """Return means over the last episodes, NaN before the first one ended."""
        last = self.ended[LAST]
        means = last.mean(axis=0) if len(last) else np.full(len(COLUMNS), np.nan)
        return dict(zip(COLUMNS, means.tolist(), strict=True)) | {"episodes": int(self.ended[NUMBER][0])}

    def reached(self, share: float, rule: str) -> bool:
        """Return whether this share of a full window succeeded, by one of the rules `SUCCESSES`."""
        return len(self.ended[LAST]) == WINDOW and self.figures()[rule] >= share
