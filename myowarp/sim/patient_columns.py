"""The columns of a patient table: which condition and which of its parameters each one sets.

A new condition is one line of `COLUMNS`. A condition takes part if the table has one of its columns. Its
other parameters keep their defaults, save for patients whose entries are all neutral: they do not have it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from myowarp.definitions.condition import CONDITIONS, Condition, resolve
from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.registry import Registry
from myowarp.definitions.task import TaskSpec
from myowarp.disk import number_in

T = TypeVar("T")

INF = math.inf


@dataclass(frozen=True)
class CohortColumn:
    """A column of numbers.

    Attributes:
        condition: Name in `CONDITIONS`.
        parameter: Field of the condition that it sets.
        label: What it is, for axes.
        unit: Unit, "" for none.
        low: Least entry.
        high: Greatest entry.
        otherwise: The parameter's value where the condition takes part without this column; None: as the
            condition has it.
    """

    condition: str
    parameter: str
    label: str
    unit: str = ""
    low: float = 0.0
    high: float = INF
    otherwise: float | None = None

    def expected(self) -> str:
        """Return what an entry has to be."""
        span = f">= {self.low:g}" if self.high == INF else f"in {self.low:g}..{self.high:g}"
        return f"a number {span}" + (f" {self.unit}" if self.unit else "")

    def parse(self, entry: Any, names: Sequence[str]) -> float:
        """Return an entry as a number; `names` are those of the muscles.

        Raises:
            ValueError: It is none, or out of range.
        """
        if isinstance(entry, (bool, np.bool_)):
            raise ValueError
        number = number_in(entry) if isinstance(entry, str) else float(entry)
        if not (math.isfinite(number) and self.low <= number <= self.high):
            raise ValueError
        return number


@dataclass(frozen=True)
class Switch(CohortColumn):
    """A column of 0 and 1."""

    def expected(self) -> str:
        """Return what an entry has to be."""
        return "0 or 1"

    def parse(self, entry: Any, names: Sequence[str]) -> float:
        """Return 0 or 1.

        Raises:
            ValueError: It is neither.
        """
        known = {"0": 0.0, "1": 1.0, "0.0": 0.0, "1.0": 1.0, "false": 0.0, "true": 1.0}
        if str(entry).strip().lower() not in known:
            raise ValueError
        return known[str(entry).strip().lower()]


@dataclass(frozen=True)
class TornMuscles(CohortColumn):
    """A column of muscle names, several joined by "+"; an empty entry is none."""

    def expected(self) -> str:
        """Return what an entry has to be."""
        return "the name of a muscle, several joined by +, or nothing"

    def parse(self, entry: Any, names: Sequence[str]) -> tuple[str, ...]:  # type: ignore[override]
        """Return the muscles' full names, sorted.

        Raises:
            ValueError: There is no such muscle; the message lists the close names.
        """
        muscles = [muscle.strip() for muscle in str(entry).split("+")] if str(entry).strip() else []
        return tuple(sorted({names[muscle_index(muscle, names)] for muscle in muscles}))


def _columns() -> Registry[CohortColumn]:
    """Return all columns by name."""
    columns: Registry[CohortColumn] = Registry("cohort column")
    for name, column in {
        "strength": CohortColumn("sarcopenia", "strength", "Muscle strength (healthy: 1)"),
        "fatigue_rate": CohortColumn("fatigue_3ccr", "fatigue_rate", "Fatigue rate", "1/s", high=10.0),
        "recovery_rate": CohortColumn("fatigue_3ccr", "recovery_rate", "Recovery rate", "1/s", high=10.0),
        "rest_recovery_factor": CohortColumn(
            "fatigue_3ccr", "rest_recovery_factor", "Recovery at rest, factor"
        ),
        "initial_fatigue": CohortColumn("fatigue_3ccr", "initial", "Fatigue at the start", high=1.0),
        "force_loss_rate": CohortColumn("fatigue_ma2009", "rate", "Force loss rate", "1/min"),
        "initial_force_loss": CohortColumn("fatigue_ma2009", "initial", "Force lost at the start", high=0.99),
        "tendon_transfer": Switch("tendon_transfer", "affected", "Tendon transfer"),
        "reafferentation": Switch("reafferentation", "affected", "Reafferentation"),
        "tendon_tear": TornMuscles("tendon_tear", "muscles", "Torn tendon"),
        "tear_time": CohortColumn("tendon_tear", "time", "Time of the tear", "s"),
        "exo_assistance": CohortColumn("exoskeleton", "assistance", "Exoskeleton, share of muscle torque"),
        "exo_mass": CohortColumn("exoskeleton", "forearm_mass", "Exoskeleton on the forearm", "kg"),
        "load_mass": CohortColumn("load", "mass", "Load in the hand", "kg"),
        "noise_signal": CohortColumn("motor_noise", "signal", "Motor noise per excitation", otherwise=0.0),
        "noise_constant": CohortColumn("motor_noise", "constant", "Motor noise at rest", otherwise=0.0),
    }.items():
        columns.add(name, column)
    return columns


COLUMNS = _columns()
"""All columns that set something, by name; `patient` names the rows."""

EXCLUSIVE = (("tendon_transfer", "reafferentation"),)
"""Pairs of switches of which a patient can have one only."""


Entries = Mapping[str, Sequence[Any]]
"""Checked entries of all patients by column name."""


def conditions_of(entries: Entries, spec: TaskSpec, repeats: int = 1) -> tuple[Condition, ...]:
    """Return the conditions of a population, with one parameter a world.

    Args:
        entries: The population.
        spec: The task.
        repeats: Consecutive worlds of each patient.

    Raises:
        ValueError: The body cannot have a condition, or two exclude each other; the columns are named.
    """
    columns: dict[str, list[str]] = {}
    for name in entries:
        columns.setdefault(COLUMNS[name].condition, []).append(name)
    found = []
    for condition, names in columns.items():
        values = {COLUMNS[name].parameter: entries[name] for name in names}
        parameters = _tear(values) if condition == "tendon_tear" else _completed(condition, values)
        if parameters:
            arrays = {
                k: np.repeat(v, repeats, axis=0) if k != "muscles" else v for k, v in parameters.items()
            }
            found.append(CONDITIONS[condition](**arrays))
            _blaming(names, found[-1].check, spec)
    return _blaming(list(entries), resolve, found, spec)


def _blaming(columns: Sequence[str], function: Callable[..., T], *arguments: Any) -> T:
    """Return what a function returns; its errors begin with the columns that are to blame."""
    try:
        return function(*arguments)
    except ValueError as error:
        plural = "columns" if len(columns) > 1 else "column"
        raise ValueError(f"cohort {plural} {', '.join(columns)}: {error}") from None


def _tear(values: Entries) -> dict[str, Any]:
    """Return the parameters of a tendon tear: all muscles that anybody tore, and who tore which."""
    if "muscles" not in values:
        raise ValueError("cohort column tear_time: it needs column tendon_tear, which says what tears")
    torn = sorted({muscle for muscles in values["muscles"] for muscle in muscles})
    whole = [[float(muscle not in muscles) for muscle in torn] for muscles in values["muscles"]]
    times = {name: np.array(entries) for name, entries in values.items() if name != "muscles"}
    return {"muscles": torn, "transmission": np.array(whole)} | times if torn else {}


def _completed(condition: str, values: Entries) -> dict[str, Any]:
    """Return the parameters of a condition: given ones, and what patients without it differ in."""
    kind = CONDITIONS[condition]
    parameters: dict[str, Any] = {name: np.array(entries) for name, entries in values.items()}
    given = [parameters[name] != neutral for name, neutral in kind.NEUTRAL.items() if name in parameters]
    if not given:
        return parameters
    usual: dict[str, Any] = {f.name: f.default for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for column in map(COLUMNS.__getitem__, COLUMNS):
        if column.condition == condition and column.otherwise is not None:
            usual[column.parameter] = column.otherwise
    for name, neutral in kind.NEUTRAL.items():
        if name not in parameters:
            parameters[name] = np.where(np.any(given, axis=0), usual[name], neutral)
    return parameters
