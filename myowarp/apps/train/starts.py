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

from myowarp.apps.train.arrays import Arrays, put, taken
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.sim.state import State, without_keys

EVERY = 10  # control steps from one note to the next
KEPT = 4096  # states to start from, the newest in place of the oldest
KEEPS, NOTES = "starts.", "notes."
COUNTS, LENGTH, NUMBER = "starts.counts", "notes.length", "notes.number"


class Backplay:
    """States on the way of successes.

    Attributes:
        notes: By name, a row a world: the states that were noted in its episode, (num_worlds, notes, ...);
            how many they are, and the control steps so far, (num_worlds,).
        kept: States to start from, (`KEPT`, ...) by name.
        filled: How many there are.
    """

    def __init__(self, env: MyoWarpVectorEnv, share: float) -> None:
        """Begin without a state.

        Args:
            env: The worlds, after a reset.
            share: Of the episodes that start in a kept state, as soon as there is one.
        """
        self._share, self._task, self._next, self.filled = share, env.sim.scene.spec.key, 0, 0
        now, longest = without_keys(env.get_state()).arrays, env.sim.horizon // EVERY + 1
        self.kept = {name: np.zeros((KEPT, *rows.shape[1:]), rows.dtype) for name, rows in now.items()}
        self.notes = {
            NOTES + name: np.zeros((len(rows), longest, *rows.shape[1:]), rows.dtype)
            for name, rows in now.items()
        } | {name: np.zeros(env.num_envs, np.int64) for name in (LENGTH, NUMBER)}

    def see(self, env: MyoWarpVectorEnv, success: np.ndarray, ended: np.ndarray) -> None:
        """Take a control step into account, before what ended is reset; both (num_worlds,) bool."""
        length, number = self.notes[LENGTH], self.notes[NUMBER]
        length += 1
        for world in np.flatnonzero(ended & success).tolist():
            self.keep(world)
        due = (length % EVERY == 0) & ~success & ~ended
        if due.any():
            for name, rows in without_keys(env.get_state()).arrays.items():
                self.notes[NOTES + name][np.flatnonzero(due), number[due]] = rows[due]
            number[due] += 1
        length[ended] = number[ended] = 0

    def keep(self, world: int) -> None:
        """Keep what was noted on the way of an episode."""
        for note in range(self.notes[NUMBER][world]):
            for name, rows in self.kept.items():
                rows[self._next] = self.notes[NOTES + name][world, note]
            self._next = (self._next + 1) % KEPT
            self.filled = min(self.filled + 1, KEPT)

    def place(self, env: MyoWarpVectorEnv, ended: np.ndarray) -> Any:
        """Set some of the worlds that were reset to kept states; returns all observations, None: none was."""
        worlds = np.flatnonzero(ended)
        drawn = torch.rand(len(worlds)).numpy() < self._share
        rows = torch.randint(max(self.filled, 1), (len(worlds),)).numpy()
        if not self.filled or not drawn.any():
            return None
        state = State(self._task, {name: kept[rows[drawn]] for name, kept in self.kept.items()})
        return env.set_state(state, worlds[drawn], conditions=False)

    def forget(self) -> None:
        """Begin anew in every world, with what is kept."""
        self.notes[LENGTH][:] = self.notes[NUMBER][:] = 0

    def arrays(self) -> Arrays:
        """Return the states that are kept."""
        return taken(self._filled()) | {COUNTS: np.array([self._next, self.filled])}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Put them back."""
        self._next, self.filled = (int(number) for number in arrays[COUNTS])
        put(self._filled(), arrays)

    def _filled(self) -> Arrays:
        """Return the rows that hold a state, as a checkpoint names them."""
        return {KEEPS + name: rows[: self.filled] for name, rows in self.kept.items()}
