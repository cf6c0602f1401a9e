"""The columns of a patient table: which condition and which of its parameters each one sets.

A new condition is one line of `COLUMNS`. A condition takes part if the table has one of its columns. Its
other parameters keep their defaults, save for patients whose entries are all neutral: they do not have it.

An entry is a number, or says how a patient changes:

    0.3..0.7                  drawn anew in every episode
    1 -> 0.3                  FROM -> TO, from the first control step on
    1 -> 0.3..0.7 @ 1..2.5    FROM -> TO @ SECONDS of the episode, each a number or drawn
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
from myowarp.definitions.parameter import MOST, Ramp, Uniform, Value
from myowarp.definitions.registry import Registry
from myowarp.definitions.task import TaskSpec
from myowarp.disk import number_in
from myowarp.models.conditions.added_mass import HEAVIEST

T = TypeVar("T")

INF = math.inf


Span = tuple[float, float]
"""Bounds of what is drawn; twice a number that is not."""


class Course(str):
    """An entry that is drawn or changes, as it was written.

    Attributes:
        start: Before the change.
        end: After the change.
        onset: When it changes [s].
    """

    start: Span
    end: Span
    onset: Span


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
        changes: Whether it may change within an episode.
        draws: Whether it may be drawn.
        of: Column that says what happens where this one says when [s]: if that one is empty, this one may be.
    """

    condition: str
    parameter: str
    label: str
    unit: str = ""
    low: float = 0.0
    high: float = INF
    otherwise: float | None = None
    changes: bool = True
    draws: bool = True
    of: str = ""

    def expected(self) -> str:
        """Return what an entry has to be."""
        span = f">= {self.low:g}" if self.high == INF else f"from {self.low:g} to {self.high:g}"
        return f"a number {span}" + (f" {self.unit}" if self.unit else "")

    def course_expected(self) -> str:
        """Return what an entry that is drawn or changes has to be."""
        forms = ["LOW..HIGH"] * self.draws + ["FROM -> TO @ SECONDS"] * self.changes
        return f"{' or '.join(forms)}, of which each is {self.expected()}" if forms else self.expected()

    def parse(self, entry: Any, names: Sequence[str]) -> float | Course:
        """Return an entry as a number, or as what it says of changes; `names` are those of the muscles.

        Raises:
            ValueError: It is none, or out of range.
        """
        if not is_course(entry):
            return self.number(entry)
        before, arrow, after = str(entry).partition("->")
        after, at, time = after.partition("@")
        if (arrow and not self.changes) or (at and not time.strip()):
            raise ValueError
        course = Course(" ".join(str(entry).split()))
        course.start = self._bounds(before)
        course.end = self._bounds(after) if arrow else course.start
        course.onset = _span(time, number_in) if at else (0.0, 0.0)
        if not 0.0 <= course.onset[0] <= course.onset[1] < INF:
            raise ValueError
        return course

    def _bounds(self, text: str) -> Span:
        low, high = _span(text, self.number)
        if low > high or (low < high and not self.draws):
            raise ValueError
        return low, high

    def number(self, entry: Any) -> float:
        """Return a number.

        Raises:
            ValueError: It is none, or out of range.
        """
        if isinstance(entry, (bool, np.bool_)):
            raise ValueError
        number = number_in(entry) if isinstance(entry, str) else float(entry)
        if not (math.isfinite(number) and self.low <= number <= self.high):
            raise ValueError
        return number


def is_course(entry: Any) -> bool:
    """Whether an entry is one that is drawn or changes, right or wrong."""
    return isinstance(entry, str) and any(mark in entry for mark in ("..", "->", "@"))


def _span(text: str, number: Callable[[str], float]) -> Span:
    """Return the bounds that a text names."""
    low, between, high = text.partition("..")
    return number(low), number(high if between else low)


@dataclass(frozen=True)
class Share(CohortColumn):
    """A column of shares of a whole, which may be a few times as much."""

    high: float = MOST

    def expected(self) -> str:
        """Return what an entry has to be."""
        return f"a share from {self.low:g} to {self.high:g}, such as 0.3 for 30 %"


@dataclass(frozen=True)
class Switch(CohortColumn):
    """A column of 0 and 1."""

    draws: bool = False

    def expected(self) -> str:
        """Return what an entry has to be."""
        return "0 or 1"

    def number(self, entry: Any) -> float:
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

    changes: bool = False
    draws: bool = False

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
        "strength": Share("sarcopenia", "strength", "Muscle strength (healthy: 1)"),
        "fatigue_rate": CohortColumn("fatigue_3ccr", "fatigue_rate", "Fatigue rate", "1/s", high=10.0),
        "recovery_rate": CohortColumn("fatigue_3ccr", "recovery_rate", "Recovery rate", "1/s", high=10.0),
        "rest_recovery_factor": CohortColumn(
            "fatigue_3ccr", "rest_recovery_factor", "Recovery at rest, factor"
        ),
        "initial_fatigue": CohortColumn(
            "fatigue_3ccr", "initial", "Fatigue at the start", high=1.0, changes=False
        ),
        "force_loss_rate": CohortColumn("fatigue_ma2009", "rate", "Force loss rate", "1/min"),
        "initial_force_loss": CohortColumn(
            "fatigue_ma2009", "initial", "Force lost at the start", high=0.99, changes=False
        ),
        "tendon_transfer": Switch("tendon_transfer", "affected", "Tendon transfer"),
        "reafferentation": Switch("reafferentation", "affected", "Reafferentation"),
        "nerve_crossing": Switch("nerve_crossing", "affected", "Nerve crossing"),
        "tendon_tear": TornMuscles("tendon_tear", "muscles", "Torn tendon"),
        "tear_time": CohortColumn(
            "tendon_tear", "time", "Time of the tear", "s", changes=False, of="tendon_tear"
        ),
        "exo_assistance": Share(
            "exoskeleton", "assistance", "Exoskeleton, share of muscle torque", otherwise=0.0
        ),
        "exo_mass": CohortColumn(
            "exoskeleton", "forearm_mass", "Exoskeleton on the forearm", "kg", high=HEAVIEST
        ),
        "load_mass": CohortColumn("load", "mass", "Load in the hand", "kg", high=HEAVIEST),
        "noise_signal": Share("motor_noise", "signal", "Motor noise per excitation", otherwise=0.0),
        "noise_constant": Share("motor_noise", "constant", "Motor noise at rest", otherwise=0.0),
    }.items():
        columns.add(name, column)
    return columns


COLUMNS = _columns()
"""All columns that set something, by name; `patient` names the rows."""

EXCLUSIVE = (("tendon_transfer", "reafferentation"),)
"""Pairs of switches of which a patient can have one only."""


Entries = Mapping[str, Sequence[Any]]
"""Checked entries of all patients by column name."""


def acting_from(entries: Entries, name: str) -> list[float]:
    """Return when each entry of a column begins to act, at the earliest [s of the episode]."""
    if not (owner := COLUMNS[name].of):
        return [entry.onset[0] if isinstance(entry, Course) else 0.0 for entry in entries[name]]
    torn = zip(entries[name], entries[owner], strict=True)
    return [
        (time.start[0] if isinstance(time, Course) else time) if muscles else 0.0 for time, muscles in torn
    ]


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
        values = {
            COLUMNS[name].parameter: [entry for entry in entries[name] for _ in range(repeats)]
            for name in names
        }
        parameters = _tear(values) if condition == "tendon_tear" else _completed(condition, values)
        if "fatigue_rate" in values:
            parameters["affected"] = _tiring(values)
        if parameters:
            found.append(CONDITIONS[condition](**parameters))
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
    """Return the parameters of a tendon tear: all muscles that anybody tore, who tore which, and when.

    The time is that of a change of what is transmitted: whoever is told the parameters sees the tear come.
    """
    if "muscles" not in values:
        raise ValueError("cohort column tear_time: it needs column tendon_tear, which says what tears")
    torn = sorted({muscle for muscles in values["muscles"] for muscle in muscles})
    left = np.array([[float(muscle not in muscles) for muscle in torn] for muscles in values["muscles"]])
    transmission: Value = left
    if "time" in values:
        transmission = Ramp(1.0, left, onset=parameter_of(values["time"]))  # type: ignore[arg-type]
    return {"muscles": torn, "transmission": transmission} if torn else {}


def _tiring(values: Entries) -> np.ndarray:
    """Return the share of muscles that tires in each world, 0 for patients who neither tire nor are tired.

    Motor units that follow the excitation and never tire would still delay it: a patient would move otherwise
    than in a table without the column.
    """
    rates = values["fatigue_rate"]
    initial = values.get("initial", [0.0] * len(rates))
    return np.array([float((rate, tired) != (0.0, 0.0)) for rate, tired in zip(rates, initial, strict=True)])


def _completed(condition: str, values: Entries) -> dict[str, Any]:
    """Return the parameters of a condition: given ones, and what patients without it differ in."""
    kind = CONDITIONS[condition]
    parameters: dict[str, Any] = {name: parameter_of(entries) for name, entries in values.items()}
    given = [
        [entry != neutral for entry in values[name]]  # a course never is neutral
        for name, neutral in kind.NEUTRAL.items()
        if name in values
    ]
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


def parameter_of(entries: Sequence[float | Course]) -> Value:
    """Return the parameter that the entries of all worlds stand for."""
    if not any(isinstance(entry, Course) for entry in entries):
        return np.array(entries, dtype=float)
    constant = (0.0, 0.0)
    spans = [
        (e.start, e.end, e.onset) if isinstance(e, Course) else ((e, e), (e, e), constant) for e in entries
    ]
    start, end, onset = np.moveaxis(np.array(spans), 1, 0)
    if np.array_equal(start, end):
        return _between(start)
    return Ramp(_between(start), _between(end), onset=_between(onset))


def _between(spans: np.ndarray) -> np.ndarray | Uniform:
    """Return what lies in spans, shape (num_worlds, 2); a number a world where none has a width."""
    low, high = spans.T
    return low.copy() if np.array_equal(low, high) else Uniform(low.copy(), high.copy())
