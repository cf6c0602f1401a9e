"""Scores of walks: every measure beside a reference, with a normalised error, the worst first.

    curve over the cycle: root mean square of (mean - reference) / (greatest - least of the reference)
    measure of a stride:  |mean - reference| / |reference|, margins / 0.1 m, asymmetries as they are
    muscle:               share of the cycle in which it is on and should be off, or the other way round

Means are over episodes, each the mean of its strides, or over the strides of one walk; intervals are the
jackknife's over the same. The score is the mean over groups of their mean errors, of which each counts at
most 1: 0 is the reference, and at 1 nothing is like it.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.apps.reports.intervals import jackknife, wilson
from myowarp.apps.reports.walk_measures import Measured, Reference, as_reference, reference_dict
from myowarp.disk import in_place, plain
from myowarp.motion.strides import MUSCLES, UNITS, is_on

GROUPS = {
    "angles": ("_angle",),
    "moments": ("_moment",),
    "ground forces": ("ground_force", "first_peak", "valley", "second_peak"),
    "muscles": tuple(MUSCLES),
    "steps": ("speed", "step_length", "step_width", "cadence", "stance", "_asymmetry"),
    "price": ("metabolic_rate", "cost_of_transport"),
    "balance": ("margin_ahead", "margin_outwards", "falls"),
}
"""Groups of measures, by parts of their names."""
CURVE_UNITS = {"_angle": "°", "_moment": "N m/kg", "ground_force": "BW"}
SCALES = {
    "margin_ahead": 0.1,
    "margin_outwards": 0.1,
    "step_length_asymmetry": 100.0,
    "step_time_asymmetry": 100.0,
}
"""Sizes of an error of 1, in the unit of the measure; of others it is the reference."""


def price_at(speed: float) -> float:
    """Return a person's metabolic rate at a speed [W/kg], rest included: 29 + 0.0053 v^2 [cal/kg/min, m/min].

    Source: Ralston 1958, Int Z Angew Physiol 17:277, doi:10.1007/BF00698754.

    Args:
        speed: [m/s].
    """
    return (29.0 + 0.0053 * (60.0 * speed) ** 2) * 4.184 / 60.0


@dataclass(frozen=True)
class Row:
    """A measure beside its reference; None: not known.

    Attributes:
        name: Of the measure, with its side.
        group: Of `GROUPS`, or "pushes", which does not count in the score.
        unit: Of `value` and `reference`.
        value: Mean; of a curve its range, of a muscle the share of the cycle in which it is on [%].
        interval: Of the mean of a measure of a stride.
        reference: Of the reference, likewise.
        error: Normalised error, 0 for the reference.
        error_interval: 95 % interval of the error, not below 0.
        correlation: With the reference's curve.
    """

    name: str
    group: str
    unit: str
    value: float
    interval: tuple[float, float] | None = None
    reference: float | None = None
    error: float | None = None
    error_interval: tuple[float, float] | None = None
    correlation: float | None = None


@dataclass(frozen=True)
class Score:
    """A score.

    Attributes:
        rows: Measures, the greatest error first, those without a reference last.
        groups: Mean error of each group.
        total: Mean of the groups' errors, each at most 1.
    """

    rows: tuple[Row, ...]
    groups: Mapping[str, float]
    total: float


def score(walk: Measured, reference: Reference, pushed: tuple[int, int] | None = None) -> Score:
    """Return how far walks are from a reference.

    Args:
        walk: The walks.
        reference: The reference.
        pushed: Falls and episodes under pushes; None: there were none.
    """
    speed = float(walk.values["speed"].mean())
    rows = [_curve_row(name, own, reference) for name, own in walk.curves.items()]
    rows += [_value_row(name, own, reference, speed) for name, own in walk.values.items() if name != "weight"]
    rows.append(_falls_row("falls", "balance", walk.falls, walk.episodes))
    if pushed is not None:
        rows.append(_falls_row("falls_when_pushed", "pushes", *pushed))
    rows.sort(key=lambda row: math.inf if row.error is None else -row.error)
    errors = {group: [r.error for r in rows if r.group == group and r.error is not None] for group in GROUPS}
    groups = {group: float(np.mean(own)) for group, own in errors.items() if own}
    return Score(tuple(rows), groups, float(np.mean(np.minimum(list(groups.values()), 1.0))))


def group_of(name: str) -> str:
    """Return the group of a measure."""
    return next(group for group, parts in GROUPS.items() if any(part in name for part in parts))


def _falls_row(name: str, group: str, falls: int, episodes: int) -> Row:
    """Return the row of falls, of which people have none."""
    share, sure = falls / episodes, wilson(falls, episodes) if episodes > 1 else None
    return Row(name, group, "", share, sure, 0.0, share, sure)


def _curve_row(name: str, own: np.ndarray, reference: Reference) -> Row:
    """Return the row of a curve, or of a muscle's timing."""
    group, wanted = group_of(name), reference.of(name, reference.curves)
    if group == "muscles":
        on, should = is_on(own.mean(axis=0)), reference.of(name, reference.active)
        if should is None:
            return Row(name, group, "%", 100.0 * float(on[:-1].mean()))
        differs = _error(own, lambda some: float((is_on(some.mean(axis=0)) != should)[:-1].mean()))
        shares = (100.0 * float(x[:-1].mean()) for x in (on, should))
        return Row(name, group, "%", next(shares), None, next(shares), *differs)
    unit = next(unit for part, unit in CURVE_UNITS.items() if part in name)
    mean = own.mean(axis=0)
    if wanted is None or not (size := float(np.ptp(wanted[0]))):
        return Row(name, group, unit, float(np.ptp(mean)))
    error = _error(own, lambda some: float(np.sqrt(np.mean((some.mean(axis=0) - wanted[0]) ** 2))) / size)
    alike = float(np.corrcoef(mean, wanted[0])[0, 1]) if np.ptp(mean) else None
    return Row(name, group, unit, float(np.ptp(mean)), None, size, *error, alike)


def _value_row(name: str, own: np.ndarray, reference: Reference, speed: float) -> Row:
    """Return the row of a measure of a stride."""
    wanted: float | None = reference.values.get(name, (None, None))[0]
    if wanted is None and name in GROUPS["price"]:
        wanted = price_at(speed) / (speed if name == "cost_of_transport" else 1.0)
    interval = _known(jackknife(own, lambda some: float(some.mean())))
    value, group, unit = float(own.mean()), group_of(name), UNITS[name]
    if wanted is None or not (scale := SCALES.get(name, abs(wanted))):
        return Row(name, group, unit, value, interval, wanted)
    error, spread = abs(value - wanted) / scale, None
    if interval is not None:  # of an absolute value: 0 where the reference is inside
        ends = sorted(abs(end - wanted) / scale for end in interval)
        spread = (0.0 if interval[0] <= wanted <= interval[1] else ends[0], ends[1])
    return Row(name, group, unit, value, interval, wanted, error, spread)


def _error(
    own: np.ndarray, statistic: Callable[[np.ndarray], float]
) -> tuple[float, tuple[float, float] | None]:
    """Return an error and its interval."""
    found = _known(jackknife(own, statistic))
    return statistic(own), found and (max(0.0, found[0]), max(0.0, found[1]))


def _known(interval: tuple[float, float]) -> tuple[float, float] | None:
    return interval if np.isfinite(interval).all() else None


def as_dict(walk: Measured, found: Score, reference: Reference, head: Mapping[str, Any]) -> dict[str, Any]:
    """Return all of a score for JSON; under `walk` what another walk may be compared with."""
    counts = {name: getattr(walk, name) for name in ("episodes", "falls", "strides", "steps", "over")}
    compared = {"name": reference.name, "sources": list(reference.sources)}
    said = {**head, **counts, "score": found.total, "groups": dict(found.groups), "reference": compared}
    rows = [asdict(row) for row in found.rows]
    own: dict[str, Any] = plain({**said, "measures": rows, "walk": reference_dict(as_reference(walk))})
    return own


def write_json(path: Path, said: Mapping[str, Any]) -> None:
    """Write a score or a reference, whole or not at all; numbers of a list stand in one line.

    Raises:
        OSError: The file cannot be written.
    """
    with in_place(path) as scratch:
        text = re.sub(r"(?<=[\[\d,])\n\s*(?=[-\d\]])", "", json.dumps(said, indent=1))
        scratch.write_text(text + "\n", encoding="utf-8")
