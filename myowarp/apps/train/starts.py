"""Starts of episodes: resets, states of a file, or states on the way of episodes that succeeded.

The third kind is backplay (Resnick et al. 2018, arXiv:1807.06919) without a demonstration: every ten control
steps the worlds' states are noted, and those of an episode that succeeds later are kept, from before its
success. A share of the episodes then starts there. A goal is part of a state, so that what was solved once is
practised from every point of its way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.sim.state import KEYS, State

EVERY = 10  # control steps from one note to the next
KEPT = 4096  # states to start from, the newest in place of the oldest
PREFIX, NOTES = "starts.", "notes."
COUNTS = "starts.counts"


class Backplay:
    """States on the way of successes.

    Attributes:
        filled: States that are kept.
    """

    def __init__(self, env: MyoWarpVectorEnv, share: float) -> None:
        """Begin without a state.

        Args:
            env: The worlds, after a reset.
            share: Of the episodes that start in a kept state, as soon as there is one.
        """
        self._share = share
        self._noted: dict[str, np.ndarray] = {}
        self._kept: dict[str, np.ndarray] = {}
        longest = env.sim.horizon // EVERY + 1
        for name, rows in without_keys(env.get_state()).items():
            self._noted[name] = np.zeros((len(rows), longest, *rows.shape[1:]), rows.dtype)
            self._kept[name] = np.zeros((KEPT, *rows.shape[1:]), rows.dtype)
        self._task = env.sim.scene.spec.key
        self._length = np.zeros(env.num_envs, dtype=np.int64)  # control steps of the episode
        self._notes = np.zeros(env.num_envs, dtype=np.int64)
        self._next = self.filled = 0

    def see(self, env: MyoWarpVectorEnv, success: np.ndarray, ended: np.ndarray) -> None:
        """Take a control step into account, before what ended is reset; both (num_worlds,) bool."""
        self._length += 1
        for world in np.flatnonzero(ended & success).tolist():
            self._keep(world)
        due = (self._length % EVERY == 0) & ~success & ~ended
        if due.any():
            worlds, notes = np.flatnonzero(due), self._notes[due]
            for name, rows in without_keys(env.get_state()).items():
                self._noted[name][worlds, notes] = rows[worlds]
            self._notes[due] += 1
        self._length[ended] = self._notes[ended] = 0

    def place(self, env: MyoWarpVectorEnv, ended: np.ndarray) -> Any:
        """Set some of the worlds that were reset to kept states; returns all observations, None: none was."""
        worlds = np.flatnonzero(ended)
        drawn = torch.rand(len(worlds)).numpy() < self._share
        rows = torch.randint(max(self.filled, 1), (len(worlds),)).numpy()
        if not self.filled or not drawn.any():
            return None
        state = State(self._task, {name: kept[rows[drawn]] for name, kept in self._kept.items()})
        return env.set_state(state, worlds[drawn], conditions=False)

    def forget(self) -> None:
        """Begin anew in every world, with what is kept."""
        self._length[:] = self._notes[:] = 0

    def copy(self, rows: np.ndarray) -> None:
        """Give every world the way of another one, whose state it takes."""
        for noted in self._noted.values():
            noted[:] = noted[rows]
        self._length[:], self._notes[:] = self._length[rows], self._notes[rows]

    def _keep(self, world: int) -> None:
        """Keep what was noted on the way of an episode."""
        for note in range(self._notes[world]):
            for name, rows in self._kept.items():
                rows[self._next] = self._noted[name][world, note]
            self._next = (self._next + 1) % KEPT
            self.filled = min(self.filled + 1, KEPT)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the states that are kept."""
        kept = {PREFIX + name: rows[: self.filled].copy() for name, rows in self._kept.items()}
        return kept | {COUNTS: np.array([self._next, self.filled])}

    def rows(self) -> dict[str, np.ndarray]:
        """Return what is noted, one row a world."""
        notes = {NOTES + name: rows.copy() for name, rows in self._noted.items()}
        return notes | {f"{NOTES}length": self._length.copy(), f"{NOTES}number": self._notes.copy()}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put all states back.

        Raises:
            KeyError: An array is missing.
        """
        self._next, self.filled = (int(number) for number in arrays[COUNTS])
        for name, rows in self._kept.items():
            rows[: self.filled] = arrays[PREFIX + name]
        for name, rows in self._noted.items():
            rows[:] = arrays[NOTES + name]
        self._length[:], self._notes[:] = arrays[f"{NOTES}length"], arrays[f"{NOTES}number"]


def without_keys(state: State) -> dict[str, np.ndarray]:
    """Return the arrays of a state but for random numbers to come: each episode has its own."""
    return {name: array for name, array in state.arrays.items() if not name.startswith(KEYS)}
