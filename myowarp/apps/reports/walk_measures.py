"""Measures of walks, episode by episode, and references that they are compared with: people, or a trial."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.motion.gait import PERCENT, side_of
from myowarp.motion.strides import LEAST_ADVANCE, MUSCLES, Strides, is_on, within

SHIPPED = Path(__file__).with_name("walk_reference.json")
"""The package's reference, which benchmarks/walk_reference.py writes."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measures of walks, episode by episode, or stride by stride of one walk.

    Attributes:
        name: Of the walks.
        curves: By name with its side, of walks without a fall, shape (n, 101).
        values: By name in `UNITS`, likewise, shape (n,).
        episodes: Number of walks.
        falls: Walks that ended with a fall.
        strides: Number of strides, of walks without a fall.
        steps: Number of steps of all walks.
        over: What n counts, "episodes" or "strides".
    """

    name: str
    curves: Mapping[str, np.ndarray]
    values: Mapping[str, np.ndarray]
    episodes: int
    falls: int
    strides: int
    steps: int
    over: str


def measured(name: str, walks: Sequence[Strides]) -> Measured:
    """Return the measures of walks, all but falls of those that go on to the end.

    Raises:
        ValueError: All end with a fall, or none has a whole stride.
    """
    falls, steps = sum(walk.fell for walk in walks), sum(walk.steps for walk in walks)
    if walks and falls == len(walks):
        raise ValueError(
            f"a score needs walks that go on; {name} falls in {falls} of {falls} episodes, once in "
            f"{steps / falls:.3g} steps"
        )
    able = [walk for walk in walks if len(walk.values.get("speed", ())) and not walk.fell]
    if not able:
        raise ValueError(
            "a score needs a whole stride, from a heel strike to the next one of the same foot, "
            f"{LEAST_ADVANCE:g} m ahead or more; {name} has {steps} heel strikes and no such stride"
        )
    one = len(walks) == 1
    parts = ("curves", "values")
    found = {part: defaultdict[str, list[np.ndarray]](list) for part in parts}
    for walk in able:
        for part in parts:
            for key, rows in getattr(walk, part).items():
                known = rows[np.isfinite(rows.reshape(len(rows), -1)).all(axis=1)]
                if len(known):
                    found[part][key].append(known if one else known.mean(axis=0, keepdims=True))
    curves, values = ({key: np.concatenate(rows) for key, rows in found[part].items()} for part in parts)
    strides = sum(len(walk.values["speed"]) for walk in able)
    over = "strides" if one else "episodes"
    return Measured(name, curves, values, len(walks), falls, strides, steps, over)


@dataclass(frozen=True, eq=False)
class Reference:
    """A person's walk, or several people's.

    Attributes:
        name: Of it.
        sources: Where its numbers come from.
        curves: Mean and standard deviation over `PERCENT` of the cycle, shape (2, 101), by name with its
            side, or without where both sides have the same one.
        values: Mean and standard deviation of measures of `UNITS`.
        active: Where in the cycle muscles are on, (101,) bool, by name likewise.
    """

    name: str
    sources: Sequence[str]
    curves: Mapping[str, np.ndarray]
    values: Mapping[str, tuple[float, float]]
    active: Mapping[str, np.ndarray] = field(default_factory=dict)

    def of(self, name: str, among: Mapping[str, Any]) -> Any:
        """Return what it has of a name with a side, None where it has nothing."""
        return among.get(name, among.get(side_of(name)[0]))


def as_reference(walk: Measured) -> Reference:
    """Return walks as what others are compared with."""
    muscles = {name: rows for name, rows in walk.curves.items() if side_of(name)[0] in MUSCLES}
    return Reference(
        walk.name,
        (walk.name,),
        {
            name: np.array([rows.mean(axis=0), rows.std(axis=0)])
            for name, rows in walk.curves.items()
            if name not in muscles
        },
        {name: (float(rows.mean()), float(rows.std())) for name, rows in walk.values.items()},
        {name: is_on(rows.mean(axis=0)) for name, rows in muscles.items()},
    )


def pooled(name: str, people: Iterable[Measured], sources: Sequence[str]) -> Reference:
    """Return the reference of several people, both sides together; everybody counts alike.

    The standard deviation is that of all strides about this mean.
    """
    curves, values = defaultdict[str, list[np.ndarray]](list), defaultdict[str, list[np.ndarray]](list)
    for person in people:
        sides = defaultdict[str, list[np.ndarray]](list)
        for key, rows in person.curves.items():
            if side_of(key)[0] not in MUSCLES:
                sides[side_of(key)[0]].append(rows)
        for key, parts in sides.items():
            curves[key].append(np.concatenate(parts))
        for key, rows in person.values.items():
            values[key].append(rows)

    def both(people: list[np.ndarray]) -> np.ndarray:
        mean = np.mean([rows.mean(axis=0) for rows in people], axis=0)
        return np.array([mean, np.sqrt(np.mean((np.concatenate(people) - mean) ** 2, axis=0))])

    found = {key: both(rows) for key, rows in curves.items()}
    pairs = {key: both(rows) for key, rows in values.items()}
    return Reference(name, sources, found, {key: (float(x[0]), float(x[1])) for key, x in pairs.items()})


def read_reference(path: Path = SHIPPED) -> Reference:
    """Return the reference of a file: the package's, or `score.json` of another walk.

    Raises:
        ValueError: It is no such file.
        OSError: It cannot be read.
    """
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        found = said.get("walk", said)
        at, curves = np.array(found["percent"]), found["curves"]
        return Reference(
            found["name"],
            tuple(found["sources"]),
            {n: np.array([np.interp(PERCENT, at, row) for row in rows]) for n, rows in curves.items()},
            {name: (float(mean), float(spread)) for name, (mean, spread) in found["values"].items()},
            {name: within(spans) for name, spans in found["active"].items()},
        )
    except (ValueError, AttributeError, KeyError, TypeError) as error:  # also of JSON, and of text
        raise ValueError(
            f"reference {str(path)!r} must be score.json of `myowarp score`, or a trial's folder"
        ) from error


def reference_dict(reference: Reference, every: int = 2) -> dict[str, Any]:
    """Return a reference as its file has it, curves at every so many percent."""
    return {
        "name": reference.name,
        "sources": list(reference.sources),
        "percent": PERCENT[::every].tolist(),
        "curves": {
            name: [[float(f"{x:.4g}") for x in row[::every]] for row in rows]
            for name, rows in reference.curves.items()
        },
        "values": {name: [float(f"{x:.4g}") for x in pair] for name, pair in reference.values.items()},
        "active": {name: spans_of(on) for name, on in reference.active.items()},
    }


def spans_of(on: np.ndarray) -> list[list[float]]:
    """Return where in the cycle something is on as spans [%], what `within` reads."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(int), [0]])))
    return [[float(PERCENT[a]), float(PERCENT[b - 1])] for a, b in edges.reshape(-1, 2)]
