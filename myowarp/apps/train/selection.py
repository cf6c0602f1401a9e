"""Selection of a run's policy: the best of the averages that were evaluated on the way.

Mean actions, `parity` physics, one episode in each of 128 worlds, whose seeds are neither those of the
training nor those of `myowarp eval`. Patients have as many worlds here as in the training.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console

from myowarp.apps.policies.checkpoint import BEST, MANIFEST, Checkpoint
from myowarp.apps.policies.learned import Bound
from myowarp.apps.reports.evaluation import evaluate
from myowarp.apps.train.plan import Job
from myowarp.definitions.condition import Condition
from myowarp.definitions.option import flag, options_of, shown
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation

EPISODES = 128
SEED = 2_000_000


@dataclass(frozen=True)
class Score:
    """The result of an evaluation.

    Attributes:
        samples: Samples of the run before it.
        success: Share of its episodes that succeeded, by the rule that the run stops by.
        returns: Mean return.
    """

    samples: int
    success: float
    returns: float


class Selection:
    """The evaluations of a run.

    Attributes:
        best: The best one; None: there was none.
        last: The last one.
        risen: The last one that had a greater share of successes than all before it.
    """

    def __init__(self, job: Job) -> None:
        """Go on with what a resumed run has found."""
        manifest: dict[str, Any] = {"samples": 0, "selection": {}}
        manifest |= job.checkpoint.manifest if job.checkpoint else {}
        found = {name: Score(**score) for name, score in manifest["selection"].items() if score}
        self.best, self.last, self.risen = (found.get(name) for name in ("best", "last", "risen"))
        if self.best and not any((job.folder / BEST).glob(f"*/{MANIFEST}")):
            warn_once(
                f"the best policy of {str(job.folder)!r}, after {self.best.samples} samples, is gone; the "
                "next evaluation is the first that counts"
            )
            self.best = self.risen = None
        self._job, self._taken = job, manifest["samples"]
        self._sim: Simulation | None = None

    def is_due(self, samples: int) -> bool:
        """Whether an evaluation falls between the samples of the last call and these."""
        settings, before = self._job.settings, self._taken
        self._taken = samples
        first, last = (number * settings.selections // settings.samples for number in (before, samples))
        return first < last

    def evaluate(self, samples: int, manifest: Mapping[str, Any], policy: Mapping[str, np.ndarray]) -> bool:
        """Evaluate a policy; returns whether it is the best one so far."""
        job, quiet = self._job, Console(quiet=True)
        if self._sim is None:
            self._sim = evaluated_worlds(job)
        act = Bound(Checkpoint(job.folder, dict(manifest), dict(policy)), self._sim)
        figures = dataclasses.asdict(evaluate(self._sim, act, console=quiet, ranks=job.ranks))
        self.last = Score(samples, figures[job.settings.stop_rule], figures["return_mean"])
        if self.risen is None or self.last.success > self.risen.success:
            self.risen = self.last
        if self.best and (self.best.success, self.best.returns) >= (self.last.success, self.last.returns):
            return False
        self.best = self.last
        return True

    def stall(self, before: Score | None) -> str:
        """Return a sentence if for half of the budget now, but not `before`, no more succeeded; else ""."""
        settings, risen, last = self._job.settings, self.risen, self.last
        if not (risen and last and before) or risen.success == 1.0:
            return ""
        if not before.samples - risen.samples < settings.samples / 2 <= last.samples - risen.samples:
            return ""
        own = options_of(settings)
        changed = {name: value for name, value in vars(settings).items() if value != own[name].default}
        tried = " ".join(f"{flag(name)} {shown(value)}" for name, value in changed.items())
        return (
            f"for half of the budget nothing was better than {100.0 * risen.success:.1f} % after "
            f"{risen.samples:,} samples; tried was {settings.algorithm} {tried}; change one, add --bonus or "
            f"--start-share, or search around the best with `myowarp improve {self._job.folder}`"
        )

    def figures(self) -> dict[str, float]:
        """Return columns of `progress.csv`: the last evaluation, NaN before the first one."""
        score = self.last or Score(0, math.nan, math.nan)
        return {"selection_success": score.success, "selection_return": score.returns}

    def manifest(self) -> dict[str, Any]:
        """Return what a checkpoint says of the evaluations."""
        scores = {"best": self.best, "last": self.last, "risen": self.risen}
        return {name: score and dataclasses.asdict(score) for name, score in scores.items()}

    def close(self) -> None:
        """End the worlds."""
        if self._sim is not None:
            self._sim.close()


def evaluated_worlds(job: Job) -> Simulation:
    """Return the worlds of this rank in which a run's policies are evaluated."""
    ranks = job.ranks
    patients = any(isinstance(condition, Condition) for condition in job.setup.conditions or ())
    episodes = job.settings.num_worlds if patients else EPISODES
    setup = dataclasses.replace(
        job.setup, physics="parity", device=ranks.device(job.setup.device), rank=ranks.part, seed=SEED
    )
    return Simulation(setup, -(-episodes // ranks.size), autoreset="same_step")
