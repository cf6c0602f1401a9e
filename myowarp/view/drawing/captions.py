"""Text on pictures: time, return and success of worlds in their episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


class Captions:
    """Captions on the pictures of some worlds."""

    def __init__(self, worlds: Sequence[int], control_dt: float, title: str = "") -> None:
        """Start all at time 0.

        Args:
            worlds: Numbers of the worlds.
            control_dt: Time of a control step [s].
            title: First line of every world.
        """
        self._worlds, self._control_dt, self._title = list(worlds), control_dt, title
        self._times, self._returns = np.zeros((2, len(self._worlds)))
        self._success = np.zeros(len(self._worlds), dtype=bool)

    def add(self, reward: np.ndarray, success: np.ndarray | None = None) -> None:
        """Count a step.

        Args:
            reward: Rewards of the step, shape (num_worlds,).
            success: Whether the task counts as solved, shape (num_worlds,).
        """
        self._times += self._control_dt
        self._returns += reward[self._worlds]
        self._success = (
            np.zeros(len(self._worlds), dtype=bool) if success is None else success[self._worlds].astype(bool)
        )

    def begin(self, worlds: np.ndarray) -> None:
        """Start anew in the worlds of a mask (num_worlds,) bool."""
        mask = worlds[self._worlds]
        self._times[mask] = self._returns[mask] = 0.0
        self._success[mask] = False

    def lines(self) -> list[list[str]]:
        """Return the lines of each world."""
        title = [self._title] if self._title else []
        return [[*title, self._line(index)] for index in range(len(self._worlds))]

    def _line(self, index: int) -> str:
        """Return the line of a world; its number where there are several."""
        world = f"world {self._worlds[index]}  " if len(self._worlds) > 1 else ""
        success = "  success" if self._success[index] else ""
        return f"{world}{self._times[index]:.2f} s  return {self._returns[index]:.1f}{success}"
