"""The policy of a run that goes on: its best one so far acts, or its last one before the first selection.

A run writes a checkpoint under another name, and renames it when it is whole. One that is damaged all the
same is passed over, with one line; the one before acts on.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from myowarp.apps.policies.checkpoint import FOLDER, CheckpointError, find_folder, load_checkpoint
from myowarp.apps.policies.learned import Bound
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation

LOOK = 1.0
"""s between two looks at the run's folder."""


def is_run(name: str) -> bool:
    """Say whether a name is that of a run's folder, rather than of one checkpoint."""
    return (Path(name) / FOLDER).is_dir()


class Following:
    """Observations (num_worlds, obs_size) to actions (num_worlds, num_actions) in [-1, 1].

    Attributes:
        checkpoint: The checkpoint that acts.
    """

    def __init__(self, run: Path, sim: Simulation) -> None:
        """Begin with the checkpoint that `find_folder` finds.

        Raises:
            CheckpointError: There is none, it is damaged, or it does not fit.
        """
        self._run, self._sim = run, sim
        self.checkpoint = load_checkpoint(run)
        self._act = Bound(self.checkpoint, sim)
        self._looked = time.monotonic()
        self._bad: Path | None = None

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return actions of the checkpoint that `find_folder` found last."""
        if time.monotonic() - self._looked > LOOK:
            self._looked = time.monotonic()
            self._renew()
        return self._act(obs)

    def copy(self, source: int, target: int) -> None:
        """Let a world remember what another one does."""
        self._act.copy(source, target)

    def _renew(self) -> None:
        """Let the checkpoint that `find_folder` finds act, if it is another one, whole and fitting."""
        try:
            newest = find_folder(self._run)
            if newest in (self.checkpoint.folder, self._bad):
                return
            self._bad = newest
            checkpoint = load_checkpoint(self._run)
            self._act, self.checkpoint, self._bad = Bound(checkpoint, self._sim), checkpoint, None
        except (CheckpointError, OSError) as error:
            warn_once(f"{error}; checkpoint {self.checkpoint.folder.name} acts on")
