"""A cohort before it runs: every argument and every entry of the table checked, nothing built."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.rollouts.rollout import Act, Policy, find_policy
from myowarp.definitions.condition import Condition
from myowarp.definitions.registry import check_choice
from myowarp.definitions.task import PHYSICS, RESETS, TASKS, TaskSpec
from myowarp.sim.build import MOST_STEPS, resolve_device
from myowarp.sim.patient_columns import conditions_of
from myowarp.sim.patient_table import Population, population_of
from myowarp.tasks.outside import find_task
from myowarp.tasks.variants import Variant

if TYPE_CHECKING:
    import pandas as pd

MOST_TRIALS = 1_000_000  # of a patient
SAMPLES = 100  # of an episode, unless told otherwise


@dataclass(frozen=True)
class Plan:
    """A cohort that was checked and can be run.

    Attributes:
        spec: The task.
        population: The patients.
        conditions: Their conditions, one parameter a world.
        policy: What acts.
        steps: Control steps.
        trials: Worlds of each patient.
        seed: Seed of the first trial.
        every: Control steps from one sample to the next.
        reset: What episodes start from, one of `RESETS`.
        physics: Name in `PHYSICS`.
        device: Warp device.
    """

    spec: TaskSpec
    population: Population
    conditions: tuple[Condition, ...]
    policy: Policy
    steps: int
    trials: int
    seed: int
    every: int
    reset: str
    physics: str
    device: str | None

    @property
    def seeds(self) -> np.ndarray:
        """Seed of every world: trial k of every patient has seed + k."""
        return np.tile(self.seed + np.arange(self.trials), len(self.population.patients))


def plan_cohort(
    table: str | Path | pd.DataFrame,
    task: str,
    policy: str | Act = "hold",
    steps: int | None = None,
    seed: int = 0,
    *,
    trials: int = 1,
    every: int | None = None,
    reset: str = "task",
    physics: str = "parity",
    device: str | None = None,
) -> Plan:
    """Check everything about a cohort; nothing is built. Arguments as in `run_cohort`.

    Raises:
        ValueError: An argument or an entry of the table is wrong.
        ImportError: pandas or pyarrow is not installed.
    """
    for package in ("pandas", "pyarrow"):
        if importlib.util.find_spec(package) is None:
            raise ImportError(
                f'a cohort needs {package}, which is not installed; run `pip install "myowarp[cohort]"`'
            )
    variant = find_task(task)
    if variant != Variant(variant.task):
        raise ValueError(
            f"a cohort sets conditions and reset itself; give task {variant.task!r} in place of {task!r}"
        )
    spec = TASKS[variant.task]
    steps = spec.horizon if steps is None else steps
    every = max(1, steps // SAMPLES) if every is None else every
    for name, number, least, most in (
        ("steps", steps, 1, MOST_STEPS),
        ("trials", trials, 1, MOST_TRIALS),
        ("every", every, 1, MOST_STEPS),
        ("seed", seed, 0, 2**63 - 1 - MOST_TRIALS),
    ):
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or number < least:
            raise ValueError(f"{name} must be an integer >= {least}, got {number!r}")
        if number > most:
            raise ValueError(f"{name} must be at most {most}, got {number}")
    check_choice("reset", reset, RESETS)
    check_choice("physics", physics, PHYSICS)
    resolve_device(device)
    if isinstance(policy, str):
        acts = find_policy(policy, spec)
    else:
        acts = Policy(getattr(policy, "__name__", type(policy).__name__), policy)
    population = population_of(table, spec)
    conditions = conditions_of(population.entries, spec, trials)
    return Plan(spec, population, conditions, acts, steps, trials, seed, every, reset, physics, device)
