"""Watchers of a run: episodes that have ended, and everything step by step."""

from __future__ import annotations

import numpy as np

from myowarp.apps.rollouts.run import Step, Watcher
from myowarp.definitions.setup import Setup
from myowarp.kernels.episode import MYOSUITE, SUCCESS_STEPS


class Episodes(Watcher):
    """Episodes that have ended: their returns, lengths, successes and faults.

    Attributes:
        ended_once: Worlds in which an episode has ended, (num_worlds,) bool.
    """

    def __init__(self, num_worlds: int) -> None:
        self.ended_once = np.zeros(num_worlds, dtype=bool)
        self._begin, self._total = np.zeros(num_worlds, dtype=int), np.zeros(num_worlds)
        self._solved = np.zeros(num_worlds, dtype=int)
        self._rows: list[dict[str, np.ndarray]] = []
        self._step = 0

    def start(self, mask: np.ndarray) -> None:
        """Count anew where an episode starts."""
        self._begin[mask], self._total[mask], self._solved[mask] = self._step, 0.0, 0

    def see(self, step: Step) -> None:
        """Count a step."""
        self._step = step.number
        self._total += step.reward
        self._solved += step.solved
        world = np.flatnonzero(step.ended)
        if not world.size:
            return
        self._rows.append(
            {
                "world": world,
                "begin": self._begin[world],
                "length": step.number - self._begin[world],
                "return": self._total[world],
                "success": step.success[world],
                "success_last": step.solved[world],
                "success_any": self._solved[world] > 0,
                MYOSUITE: self._solved[world] > int(SUCCESS_STEPS),
                "failed": step.terminated[world] & (step.fault[world] == 0),
                "fault": step.fault[world],
            }
        )
        self.ended_once[world] = True

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what is known of the episodes that have ended, in the order of their ends, (episodes,) each.

        Returns:
            `world`; `begin`, steps of the run before its first; `length` [control steps]; `return`;
            `success` (`SUCCESS_RULE`), `success_last` (solved in the last step), `success_any` (in any
            step), `success_myosuite` (in more than 5 steps, failed or not: MyoSuite's rule); `failed`:
            whether the task ended it; `fault`: bits, 0 for none.
        """
        if not self._rows:
            return {name: np.zeros(0, dtype=kind) for name, kind in KINDS.items()}
        return {name: np.concatenate([rows[name] for rows in self._rows]) for name in KINDS}

    def first(self, after: int = 0) -> dict[str, np.ndarray]:
        """Return the same of the first episode of every world, in the order of the worlds that had one.

        Args:
            after: Episodes of a world before it; 1: the second of every world.
        """
        arrays = self.arrays()
        order = np.argsort(arrays["world"], kind="stable")
        _, begin = np.unique(arrays["world"][order], return_index=True)
        number = np.arange(len(order)) - np.repeat(begin, np.diff(np.append(begin, len(order))))
        return {name: array[order][number == after] for name, array in arrays.items()}


SAME_EPISODES = 1e-3
"""Spread of the returns of one episode that many worlds run: rounding, in units of their mean or of 1."""


def are_one(setup: Setup, lengths: np.ndarray, returns: np.ndarray) -> bool:
    """Return whether episodes are all the same one: nothing is drawn at their start, and they end alike."""
    postures = setup.reset == "task"
    drawn = any(draw.varies and (draw.when != "posture" or postures) for draw in setup.spec.draws)
    if drawn or setup.reset == "random" or len(returns) < 2 or np.ptp(lengths):
        return False
    return bool(returns.std() < SAME_EPISODES * max(1.0, abs(returns.mean())))


KINDS: dict[str, type] = {
    **dict.fromkeys(("world", "begin", "length"), int),
    "return": float,
    **dict.fromkeys(("success", "success_last", "success_any", MYOSUITE, "failed"), bool),
    "fault": int,
}
"""Fields of an episode, and their types."""


class Trace(Watcher):
    """Everything that passes between a policy and the worlds; T steps, N worlds.

    Attributes:
        arrays: `obs`, `action`, `reward`, `terminated` and `truncated`, each T arrays (N, ...).
    """

    def __init__(self) -> None:
        self.arrays: dict[str, list[np.ndarray]] = {}

    def see(self, step: Step) -> None:
        """Keep a step."""
        for name in ("obs", "action", "reward", "terminated", "truncated"):
            self.arrays.setdefault(name, []).append(np.array(getattr(step, name)))
