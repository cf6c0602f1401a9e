"""What an experiment finds: figures of merit beside the paper's, claims, and how sure we are."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONFIDENCE = 0.95
POINTS = 20_001  # at which a density is summed; good to 1e-4


def t_quantile(degrees: int) -> float:
    """Return what Student's t stays within, up and down, with probability 0.95.

    With t = sqrt(n) tan(angle) for n degrees of freedom, the density of the angle is cos(angle)^(n - 1).
    """
    angle = np.linspace(0.0, 0.5 * math.pi, POINTS)
    density = np.cos(angle) ** (degrees - 1)
    below = np.concatenate(([0.0], np.cumsum(density[1:] + density[:-1])))
    return math.sqrt(degrees) * math.tan(float(np.interp(CONFIDENCE, below / below[-1], angle)))


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
    values: tuple[float, ...]
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
        half = t_quantile(self.n - 1) * float(self._known.std(ddof=1)) / math.sqrt(self.n)
        return self.mean - half, self.mean + half

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


@dataclass(frozen=True)
class Findings:
    """What an experiment returns.

    Attributes:
        merits: Rows of the table.
        claims: Conclusions.
        text: Paragraphs (Markdown) of the page: where we differ from the paper, and why.
        draw: Draws into an empty matplotlib figure 8 inches wide; the height may be set.
        over: What the values of the figures of merit are over, and the intervals with them.
        in_worlds: Whether each seed had the number of worlds that was asked for; the protocol says else.
    """

    merits: tuple[Merit, ...]
    claims: tuple[Claim, ...]
    text: str
    draw: Callable[[Figure], None]
    over: str = "seeds"
    in_worlds: bool = True
