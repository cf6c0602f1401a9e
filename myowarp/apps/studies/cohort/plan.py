"""A cohort before it runs: every argument and every entry of the table checked, nothing built."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.policies.find import Act, Policy, find_policy
from myowarp.definitions.registry import check_least
from myowarp.definitions.setup import MOST_SEED, Setup
from myowarp.extras import check_installed
from myowarp.sim.build import MOST_STEPS, resolve_device
from myowarp.sim.patient_table import Population, population_of
from myowarp.tasks.setups import complete, variant_of
from myowarp.tasks.variants import Variant

if TYPE_CHECKING:
    import pandas as pd

MOST_TRIALS = 1_000_000  # of a patient
SAMPLES = 100  # of an episode, unless told otherwise


@dataclass(frozen=True)
class Plan:
    """A cohort that was checked and can be run.

    Attributes:
        setup: What all have in common, with the patients' conditions, one parameter a world.
        population: The patients.
        policy: What acts.
        steps: Control steps.
        trials: Worlds of each patient.
        every: Control steps from one sample to the next.
    """

    setup: Setup
    population: Population
    policy: Policy
    steps: int
    trials: int
    every: int

    @property
    def seeds(self) -> np.ndarray:
        """Seed of every world: trial k of every patient has seed + k."""
        return np.tile((self.setup.seed or 0) + np.arange(self.trials), len(self.population.patients))


def plan_cohort(
    table: str | Path | pd.DataFrame,
    what: Setup | str,
    policy: str | Act = "hold",
    steps: int | None = None,
    *,
    trials: int = 1,
    every: int | None = None,
) -> Plan:
    """Check everything about a cohort; nothing is built. Arguments as in `run_cohort`.

    Raises:
        ValueError: An argument or an entry of the table is wrong.
        ImportError: pandas or pyarrow is not installed.
    """
    for package in ("pandas", "pyarrow"):
        check_installed("a cohort", package, "cohort")
    setup = Setup.of(what)
    if (variant := variant_of(setup)) != Variant(variant.task):
        raise ValueError(
            f"a cohort sets conditions and reset itself; give task {variant.task!r} in place of "
            f"{setup.task!r}"
        )
    setup = complete(setup)
    spec = setup.spec
    steps = spec.horizon if steps is None else steps
    every = max(1, steps // SAMPLES) if every is None else every
    check_least(1, MOST_STEPS, steps=steps, every=every)
    check_least(1, MOST_TRIALS, trials=trials)
    check_least(0, MOST_SEED - MOST_TRIALS, seed=setup.seed or 0)
    resolve_device(setup.device)
    if isinstance(policy, str):
        acts = find_policy(policy, spec)
    else:
        acts = Policy(getattr(policy, "__name__", type(policy).__name__), policy)
    population = population_of(table, spec)
    whole = population.joined(dataclasses.replace(setup, horizon=steps), trials)
    return Plan(whole, population, acts, steps, trials, every)
