"""What a study finds: figures of merit beside those of a paper, claims, and how sure we are."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from myowarp.apps.reports.intervals import student
from myowarp.apps.reports.table import number


@dataclass(frozen=True)
class Merit:
    """A figure of merit: a row of the table.

    Attributes:
        quantity: What was measured, such as "error of the joint angle".
        unit: Its unit, "" for a pure number.
        condition: In whom, such as "2 kg, with assistance".
        values: Ours, one number a seed: the mean over its worlds. NaN counts as not measured.
        paper: The paper's value; None where it gives none.
        spread: What the paper gives behind its ±; None where it gives none.
        note: Where ours differs and why, or where the paper's value is from.
    """

    quantity: str
    unit: str
    condition: str
    values: Sequence[float] | np.ndarray
    paper: float | None = None
    spread: float | None = None
    note: str = ""

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
        """95 % interval of the mean over seeds, from Student's t; NaN with fewer than two."""
        if self.n < 2:
            return math.nan, math.nan
        low, high = student(self._known)
        return float(low), float(high)

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
    groups: Sequence[str], *quantities: tuple[str, str, Sequence[np.ndarray] | np.ndarray]
) -> list[Merit]:
    """Return a row for each condition and, within it, each quantity.

    Args:
        groups: In whom.
        quantities: What was measured, its unit, and ours, for each condition the values of the seeds.
    """
    return [
        Merit(name, unit, who, values[c]) for c, who in enumerate(groups) for name, unit, values in quantities
    ]


@dataclass(frozen=True)
class Claim:
    """A conclusion of the paper, or one of ours, and whether our numbers bear it out.

    Attributes:
        text: The conclusion, one sentence.
        holds: Whether ours agree; computed, never typed.
        why: Where they do not, why; or on how many seeds it rests.
    """

    text: str
    holds: bool
    why: str = ""


def read_claims(text: str, holds: Mapping[str, bool | np.bool_]) -> list[Claim]:
    """Return claims, one for each point of a list in Markdown.

    Args:
        text: Points of the form "* key: claim"; an indented line below one says why.
        holds: Whether each claim holds, by its key; no key is left over.

    Raises:
        ValueError: The keys are not those of the list.
    """
    points = re.findall(r"^\* (.+?): (.+)$(?:\n  (.+)$)?", text, flags=re.MULTILINE)
    keys = [key for key, _, _ in points]
    if sorted(keys) != sorted(holds):
        raise ValueError(f"claims must have the keys of the essay, {keys}, got {list(holds)}")
    return [Claim(claim, bool(holds[key]), why) for key, claim, why in points]
