"""Results of a study: figures of merit beside those of a paper, claims, and how sure we are."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from myowarp.apps.reports.intervals import mean_interval
from myowarp.apps.reports.table import number

POSITIVE, PERCENT, CHANGE = (0.0, math.inf), (0.0, 100.0), (-100.0, math.inf)
"""Bounds of a mean: of root mean squares, of shares."""


@dataclass(frozen=True)
class Merit:
    """A figure of merit: a row of the table.

    Attributes:
        quantity: What was measured, such as "error of the joint angle".
        unit: Its unit, "" for a pure number.
        condition: In whom, such as "2 kg, with assistance".
        values: Ours, one number a seed: the mean over its worlds. NaN counts as not measured.
        paper: The paper's value; None where it gives none. Values of others stand in `note`.
        spread: What the paper gives behind its ±; None where it gives none.
        note: Where ours differs and why, or where a value of others is from.
        within: Least and greatest possible mean.
    """

    quantity: str
    unit: str
    condition: str
    values: Sequence[float] | np.ndarray
    paper: float | None = None
    spread: float | None = None
    note: str = ""
    within: tuple[float, float] = (-math.inf, math.inf)

    @property
    def _known(self) -> np.ndarray:
        """The values that were measured."""
        values = np.asarray(self.values, dtype=float)
        return values[np.isfinite(values)]

    @property
    def n(self) -> int:
        """Number of seeds."""
        return len(self._known)

    @property
    def mean(self) -> float:
        """Mean over the seeds."""
        return float(self._known.mean()) if self.n else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean over seeds, see `mean_interval`; NaN where there is none."""
        return mean_interval(self._known, *self.within)

    @property
    def label(self) -> str:
        """Quantity and unit."""
        return f"{self.quantity} [{self.unit}]" if self.unit else self.quantity

    @property
    def difference(self) -> float | None:
        """Ours minus the paper's."""
        return None if self.paper is None else self.mean - self.paper

    def as_dict(self) -> dict[str, Any]:
        """Return the row by the names of its columns."""
        low, high = self.interval
        return {
            "quantity": self.quantity,
            "unit": self.unit,
            "condition": self.condition,
            "paper": self.paper,
            "paper_spread": self.spread,
            "ours": self.mean,
            "low": low,
            "high": high,
            "difference": self.difference,
            "n": self.n,
            "note": self.note,
        }

    def cells(self) -> tuple[str, str, str]:
        """Return the paper's value, ours and their difference as a table shows them."""
        paper = number(self.paper) + ("" if self.spread is None else f" ± {number(self.spread)}")
        low, high = self.interval
        ours = number(self.mean) + (f" ({number(low)} to {number(high)})" if math.isfinite(low) else "")
        return paper, ours, number(self.difference)


def merits(
    groups: Sequence[str],
    *quantities: tuple[str, str, Sequence[np.ndarray] | np.ndarray],
    within: tuple[float, float] = (-math.inf, math.inf),
) -> list[Merit]:
    """Return a row for each condition and, within it, each quantity.

    Args:
        groups: In whom.
        quantities: What was measured, its unit, and ours, for each condition the values of the seeds.
        within: Least and greatest possible mean of all of them.
    """
    return [
        Merit(name, unit, who, values[c], within=within)
        for c, who in enumerate(groups)
        for name, unit, values in quantities
    ]


def rises(differences: Sequence[float] | np.ndarray) -> bool | None:
    """Return whether the mean of paired differences is above 0, None where the 95 % interval does not tell.

    Values that are all the same count as they are.
    """
    values = np.asarray(differences, dtype=float)
    values = values[np.isfinite(values)]
    low, high = mean_interval(values)
    if math.isnan(low):
        low = high = float(values.mean()) if len(values) > 1 else math.nan
    return True if low > 0.0 else False if high <= 0.0 else None


def stays(differences: Sequence[float] | np.ndarray, margin: float) -> bool | None:
    """Return whether the mean of paired differences is less than a margin, up or down.

    Yes if the 95 % interval lies within the margin, no if it lies outside, None where it crosses it.
    """
    values = np.asarray(differences, dtype=float)
    return both(rises(values + margin), rises(margin - values))


def both(*answers: bool | np.bool_ | None) -> bool | None:
    """Return whether all answers are yes: no if one is no, else None if one is open."""
    if any(answer is not None and not answer for answer in answers):
        return False
    return None if any(answer is None for answer in answers) else True


@dataclass(frozen=True)
class Claim:
    """A conclusion of the paper or a hypothesis of our own, and whether our numbers bear it out.

    Attributes:
        text: The conclusion, one sentence.
        holds: Whether ours bear it out, None where they do not tell; computed, never typed.
        why: Where they do not, why; or on how many seeds it rests.
        own: Whether it is a hypothesis of our own, of which the paper says nothing.
    """

    text: str
    holds: bool | None
    why: str = ""
    own: bool = False

    @property
    def verdict(self) -> str:
        """One of agrees, differs, holds, does not hold, not decided."""
        if self.holds is None:
            return "not decided"
        return ("does not hold", "holds")[self.holds] if self.own else ("differs", "agrees")[self.holds]


def read_claims(paper: str, own: str, holds: Mapping[str, bool | np.bool_ | None]) -> list[Claim]:
    """Return claims, one for each point of two lists in Markdown.

    Args:
        paper: Conclusions of the paper, points of the form "* key: claim"; an indented line below one says
            why.
        own: Hypotheses of our own, in the same form.
        holds: Whether each claim holds, None if that is open, by its key; no key is left over.

    Raises:
        ValueError: The keys are not those of the lists.
    """
    points = [
        (*found, mine)
        for text, mine in ((paper, False), (own, True))
        for found in re.findall(r"^\* (.+?): (.+)$(?:\n  (.+)$)?", text, flags=re.MULTILINE)
    ]
    keys = [key for key, *_ in points]
    if sorted(keys) != sorted(holds):
        raise ValueError(f"claims must have the keys of the essay, {keys}, got {list(holds)}")
    return [
        Claim(claim, None if holds[key] is None else bool(holds[key]), why, mine)
        for key, claim, why, mine in points
    ]
