"""The same worlds beside themselves: another body, policy, other conditions, always from the same states."""

from __future__ import annotations

import numpy as np

from myowarp.apps.rollouts.run import Act, Step, Watcher, seeds_of, stepped
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state, set_state


class Beside(Watcher):
    """Steps a second simulation together with the one that is run.

    A world that ends in one starts its next episode in both, again from the same state.
    """

    def __init__(
        self, first: Simulation, sim: Simulation, act: Act, *watchers: Watcher, patients: bool = False
    ) -> None:
        """Prepare.

        Args:
            first: The simulation that is run, without autoreset.
            sim: Another one of its task, without autoreset.
            act: Who acts there.
            watchers: Who looks there.
            patients: Whether it has the first one's patients, too, whose conditions are the same.
        """
        self._first, self._sim, self._watchers, self._patients = first, sim, watchers, patients
        self._steps = stepped(sim, act)

    def start(self, mask: np.ndarray) -> None:
        """Take over the states in which the worlds of the mask start, the conditions if so asked."""
        self._sim.reset(mask, seeds_of(self._sim) if mask.all() else None)
        set_state(self._sim, get_state(self._first, mask), mask, conditions=self._patients)
        for watcher in self._watchers:
            watcher.start(mask)

    def see(self, step: Step) -> np.ndarray:
        """Make a step, too; returns which worlds have ended there."""
        own = next(self._steps)
        for watcher in self._watchers:
            watcher.see(own)
        return own.ended
