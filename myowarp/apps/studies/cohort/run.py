"""Runs a policy on all patients at once and gathers what came of it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from myowarp.apps.policies.find import Act, acting
from myowarp.apps.rollouts.episodes import Episodes
from myowarp.apps.rollouts.run import Step, Watcher, progress, run
from myowarp.apps.studies.cohort.plan import Plan, plan_cohort
from myowarp.definitions.registry import check_choice
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import Column
from myowarp.disk import in_place, make_folder, version
from myowarp.kernels.episode import describe_fault
from myowarp.sim.economy import Economy
from myowarp.sim.metabolics import WHOLE_BODY_UNITS
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation

if TYPE_CHECKING:
    import pandas as pd

SETTLED = 0.75  # of an episode; `final_error` is the mean from there on
FORMATS = (".parquet", ".csv")
FORMULA = re.compile(r"^'*[=+\-@]")  # how a formula of a spreadsheet begins, or one that was made harmless

UNITS = {"time": "s", "total_force": "N", "time_to_solve": "s", "duration": "s"} | WHOLE_BODY_UNITS
"""Units of results, but for the tracking error and what conditions show; all others are pure numbers."""


def tracking_blocks(columns: Iterable[Column]) -> tuple[list[slice], str]:
    """Return the part of the observation whose norm is the tracking error, and its unit.

    It is the first block called an error (`..._err...`), with those after it that have the same unit: joint
    errors in pose tasks, the way from the fingertips to their targets in reach tasks, from an object to its
    goal. A task that observes no error has none: an empty list.
    """
    blocks: list[slice] = []
    unit, start = "", 0
    for column in columns:
        if "err" in column.name.split("_") and unit in ("", column.unit):
            blocks.append(slice(start, start + column.size))
            unit = column.unit
        start += column.size
    return blocks, unit


@dataclass(frozen=True)
class CohortResult:
    """Results of a cohort.

    Attributes:
        samples: One row per patient, trial and sampled time: `tracking_error` where the task has one,
            `mean_activation`, `total_force`, metabolic rates of the whole body, `reward`, `solved`, and what
            conditions show, as means over the muscles.
        summary: One row per patient and trial: the patient's entries, `success` (more than 5 steps
            solved, and no failure), `success_last` (solved on the last step), `failed` (the episode ended
            by the task's failure), `return`, `time_to_solve` (NaN: never), `solved_share` of the steps,
            `mean_error`, `final_error` (mean over the last quarter; of one who failed before, the last),
            means of activation, force and metabolic rates, of a free root `speed` and cost of transport
            (these and the rates are missing where it failed), last values and means of what conditions
            show, `duration`, `fault` (missing: none).
        settings: Task, policy, seed and so on, and the units of the results.
    """

    samples: pd.DataFrame
    summary: pd.DataFrame
    settings: dict[str, Any]

    def save(self, folder: Path, suffix: str = ".parquet") -> list[Path]:
        """Write results, summary.csv and settings.json into a folder, each in place in one move.

        In .csv a name that a spreadsheet would take for a formula gets a single quote in front.

        Args:
            folder: Folder; it is made if it does not exist.
            suffix: Format of the samples: .parquet or .csv.

        Returns:
            The files.

        Raises:
            ValueError: No such format.
            OSError: They cannot be written.
        """
        check_choice("cohort format", suffix, FORMATS)
        make_folder(folder)
        paths = [folder / name for name in result_files(suffix)]
        with in_place(paths[0]) as scratch:
            if suffix == ".csv":
                _for_spreadsheets(self.samples).to_csv(scratch, index=False)
            else:
                self.samples.to_parquet(scratch, index=False)
        with in_place(paths[1]) as scratch:
            _for_spreadsheets(self.summary).to_csv(scratch, index=False)
        with in_place(paths[2]) as scratch:
            scratch.write_text(json.dumps(self.settings, indent=1) + "\n")
        return paths


def _for_spreadsheets(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with patients' names that no spreadsheet takes for formulas; different ones stay so."""
    names = table["patient"].cat.rename_categories(lambda name: FORMULA.sub(r"'\g<0>", name))
    return table.assign(patient=names)


def result_files(suffix: str) -> tuple[str, ...]:
    """Return the names of the files that `CohortResult.save` writes."""
    return f"results{suffix}", "summary.csv", "settings.json"


def run_cohort(
    table: str | Path | pd.DataFrame,
    what: Setup | str,
    policy: str | Act = "hold",
    steps: int | None = None,
    *,
    console: Console | None = None,
    trials: int = 1,
    every: int | None = None,
    **fields: Any,
) -> CohortResult:
    """Run one episode of every patient, all at once.

    Every patient meets the same trials: trial k starts, for all, with seed + k, so that patients differ in
    their bodies alone. A patient's rows are the same, bit for bit, in a cohort of one.

    Args:
        table: Patient table: a .csv or .parquet file or a DataFrame, see `myowarp.sim.patient_columns`.
        what: What all have in common: a setup, or a task id alone, with or without "MyoWarp/".
        policy: A function of the observations (num_worlds, obs_size) that returns actions (num_worlds,
            num_actions) in [-1, 1], its name as in `myowarp.apps.policies.find.find_policy`, or "hold".
        steps: Control steps; None: the task's horizon.
        console: Where to draw the progress bar.
        trials: Worlds of each patient.
        every: Control steps from one sample to the next; None: steps / 100.
        **fields: Fields of `Setup`, in place of those of `what`.

    Raises:
        ValueError: An argument or an entry of the table is wrong; nothing was built.
        ImportError: pandas or pyarrow is not installed.
    """
    plan = plan_cohort(table, Setup.of(what, **fields), policy, steps, trials=trials, every=every)
    return run_plan(plan, console)


def run_plan(plan: Plan, console: Console | None = None) -> CohortResult:
    """Run a checked cohort; see `run_cohort`."""
    sim = Simulation(plan.setup, len(plan.seeds), autoreset="disabled")
    tally = _Tally(plan, sim)
    unit = f"steps of {len(plan.population.patients):,} patients"
    with progress("Simulating", unit, plan.steps, console) as bar:
        run(sim, _policy(plan, sim), plan.steps, tally, bar, seeds=plan.seeds, again=False)
    return CohortResult(tally.samples(), tally.summary(), tally.settings())


def _policy(plan: Plan, sim: Simulation) -> Act:
    """Return the function that acts; random actions are a trial's, the same for every patient."""
    if plan.policy.act is not None or plan.policy.name != "random":
        return acting(plan.policy, sim)
    draws = [np.random.default_rng((plan.setup.seed or 0) + trial) for trial in range(plan.trials)]
    patients, num_actions = len(plan.population.patients), sim.scene.num_actions

    def act(obs: np.ndarray) -> np.ndarray:
        one = [rng.uniform(-1.0, 1.0, num_actions) for rng in draws]
        return np.tile(np.array(one, dtype=np.float32), (patients, 1))

    return act


class _Tally(Watcher):
    """Gathers results step by step, each patient's up to the end of the episode."""

    def __init__(self, plan: Plan, sim: Simulation) -> None:
        self._plan, self._sim, self._signals = plan, sim, Signals(sim)
        self._episodes, self._economy = Episodes(sim.num_worlds), Economy(sim, self._signals)
        self._blocks, self._unit = tracking_blocks(sim.columns)
        n = sim.num_worlds
        self._alive = np.ones(n, dtype=bool)
        self._steps = np.zeros(n, dtype=int)
        self._late_steps = np.zeros(n, dtype=int)
        self._late_error = np.zeros(n)
        self._solved_at = np.full(n, np.nan)
        self._sums: dict[str, np.ndarray] = {}
        self._last: dict[str, np.ndarray] = {}
        self._rows: list[dict[str, np.ndarray]] = []

    def _values(self) -> dict[str, np.ndarray]:
        """Return the measured quantities of the present state, each (num_worlds,)."""
        transition, signals = self._sim.transition, self._signals
        values: dict[str, np.ndarray] = {}
        if self._blocks:
            obs = transition.obs.numpy()
            errors = np.concatenate([obs[:, block] for block in self._blocks], axis=1)
            values["tracking_error"] = np.linalg.norm(errors, axis=1)
        values["mean_activation"] = signals.muscles.activation.numpy().mean(axis=1)
        values["total_force"] = signals.muscles.force.numpy().sum(axis=1)
        values |= {name: array.numpy().copy() for name, array in signals.whole_body.items()}
        values["reward"] = transition.reward.numpy().copy()
        values["solved"] = transition.solved.numpy().copy()
        for name, array in signals.info.items():
            shown = array.numpy()
            values[name] = shown.mean(axis=1) if shown.ndim == 2 else shown.copy()
        return values

    def start(self, mask: np.ndarray) -> None:
        """Count from the start of the episodes."""
        self._episodes.start(mask)
        self._economy.start(mask)

    def see(self, step: Step) -> None:
        """Count a step of all worlds."""
        self._episodes.see(step)
        values, control_dt = self._values(), self._sim.scene.control_dt
        valid = self._alive & (step.fault == 0)
        self._economy.see(valid)
        self._steps += valid
        for name, value in values.items():
            total = self._sums.setdefault(name, np.zeros(len(valid)))
            total[valid] += value[valid]
            self._last.setdefault(name, np.full(len(valid), np.nan))[valid] = value[valid]
        late = valid & (step.number > SETTLED * self._plan.steps)
        self._late_steps += late
        if self._blocks:
            self._late_error[late] += values["tracking_error"][late]
        first = valid & values["solved"] & np.isnan(self._solved_at)
        self._solved_at[first] = step.number * control_dt
        self._alive &= ~step.ended
        if step.number % self._plan.every == 0:
            world = np.flatnonzero(valid)
            time = np.full(len(world), step.number * control_dt)
            self._rows.append({"world": world, "time": time} | {k: v[valid] for k, v in values.items()})

    def _keys(self, world: np.ndarray) -> dict[str, Any]:
        """Return the columns that say which patient and trial a world is."""
        import pandas as pd

        patients, trials = self._plan.population.patients, self._plan.trials
        return {
            "patient": pd.Categorical.from_codes(world // trials, list(patients)),
            "trial": world % trials,
        }

    def samples(self) -> pd.DataFrame:
        """Return what was sampled, in the order of patients, trials and times."""
        import pandas as pd

        columns = {name: np.concatenate([row[name] for row in self._rows]) for name in self._rows[0]}
        order = np.lexsort((columns["time"], columns["world"]))
        sorted_ = {name: column[order] for name, column in columns.items()}
        return pd.DataFrame(self._keys(sorted_.pop("world")) | sorted_)

    def summary(self) -> pd.DataFrame:
        """Return one row per patient and trial."""
        import pandas as pd

        plan, steps, episode = self._plan, np.maximum(self._steps, 1), self._episodes.first()
        world = np.arange(len(steps))
        table: dict[str, Any] = self._keys(world)
        for name, entries in plan.population.entries.items():
            written = ["+".join(entry) if isinstance(entry, tuple) else entry for entry in entries]
            table[name] = np.repeat(np.array(written), plan.trials)
        table |= {name: episode[name] for name in ("success", "success_last", "failed", "return")}
        table |= {"time_to_solve": self._solved_at, "solved_share": self._sums["solved"] / steps}
        if self._blocks:
            late = np.divide(
                self._late_error, self._late_steps, where=self._late_steps > 0, out=np.zeros(len(steps))
            )
            table["mean_error"] = self._sums["tracking_error"] / steps
            table["final_error"] = np.where(self._late_steps > 0, late, self._last["tracking_error"])
        for name in ("mean_activation", "total_force"):
            table[name] = self._sums[name] / steps
        table |= self._economy.means(episode["failed"])
        for name in self._signals.info:
            table |= {name: self._last[name], f"mean_{name}": self._sums[name] / steps}
        table["duration"] = self._steps * self._sim.scene.control_dt
        table["fault"] = [describe_fault(bits) or None for bits in episode["fault"]]
        return pd.DataFrame(table)

    def settings(self) -> dict[str, Any]:
        """Return what the results depend on, and their units."""
        plan, scene = self._plan, self._sim.scene
        error = (
            dict.fromkeys(("tracking_error", "mean_error", "final_error"), self._unit) if self._blocks else {}
        )
        shown = {
            column: unit for name, unit in self._sim.info_units.items() for column in (name, f"mean_{name}")
        }
        return {
            "myowarp": version("myowarp"),
            "task": scene.spec.env_id,
            "policy": plan.policy.name,
            "patients": len(plan.population.patients),
            "trials": plan.trials,
            "seed": plan.setup.seed,
            "steps": plan.steps,
            "control_dt": scene.control_dt,
            "reset": plan.setup.reset,
            "physics": plan.setup.physics,
            "muscle": plan.setup.muscles.model,
            "device": str(scene.device),
            "body_mass": self._signals.body_mass,
            "conditions": [condition.name for condition in self._sim.conditions],
            "columns": list(plan.population.entries),
            "units": UNITS | self._economy.units | shown | error,
        }
