"""Figures of an audit: columns of the table, findings, and differences from upstream's version."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from myowarp.apps.reports.essay import sections
from myowarp.apps.studies.audit.measure import Audit
from myowarp.apps.studies.audit.runs import EARLY_STEPS
from myowarp.process import listed

TEXTS = Path(__file__).with_suffix(".md")
MOST = 8
"""Names in a finding."""
Value = float | None


def _percent(share: Value) -> Value:
    """Return a share in percent."""
    return None if share is None else 100.0 * share


@dataclass(frozen=True)
class Figure:
    """A column of the table; its texts are below its heading in figures.md.

    Attributes:
        head: Heading; the part after a comma is the unit.
        read: Takes it from an audit; None: nothing to say.
        digits: Decimals shown.
        bad: Whether a value is a finding.
    """

    head: str
    read: Callable[[Audit], Value]
    digits: int = 0
    bad: Callable[[float], bool] = lambda value: False

    @property
    def meaning(self) -> str:
        """Return its meaning, one sentence."""
        return self._texts[0].format(early_steps=EARLY_STEPS)

    def finding(self, value: str) -> str:
        """Return the finding as a sentence with the value as it is shown."""
        return self._texts[1].format(value, early_steps=EARLY_STEPS)

    @property
    def _texts(self) -> list[str]:
        """Meaning and, where a value can be one, finding."""
        return sections(TEXTS)[self.head].split("\n\n")

    @property
    def name(self) -> str:
        """Heading without its unit."""
        return self.head.partition(", ")[0]

    @property
    def unit(self) -> str:
        """Unit, with a space before it, or nothing."""
        unit = self.head.partition(", ")[2]
        return f" {unit}" if unit else ""

    def text(self, audit: Audit) -> str:
        """Return the value as it is shown; a dash for None."""
        value = self.read(audit)
        return "-" if value is None else f"{value:z.{self.digits}f}"

    def is_bad(self, audit: Audit) -> bool:
        """Whether the value is a finding."""
        value = self.read(audit)
        return value is not None and self.bad(value)


def _early(audit: Audit) -> Value:
    """Largest share of early failures over the resets."""
    return max((share for share in audit.early_failure.values() if share is not None), default=None)


def _weighted_silent(audit: Audit) -> tuple[str, ...]:
    """Names of the terms that count in the reward and never left 0."""
    weights = {term.name: term.weight for term in audit.terms}
    return tuple(name for name in audit.silent_terms if weights[name] != 0.0)


def _margin(audit: Audit) -> Value:
    """Smaller margin of contacts and rows; without contacts rows have an exact bound that may be full."""
    load = audit.load
    return None if load.pool_margin is None else min(load.pool_margin, load.rows_margin)


FIGURES = (
    Figure("targets solvable, %", lambda a: _percent(a.targets.solvable), bad=lambda value: value < 95.0),
    Figure("targets exact, %", lambda a: _percent(a.targets.exact)),
    Figure(
        "thumb off, mm",
        lambda a: None if a.targets.thumb_off is None else 1e3 * a.targets.thumb_off,
        digits=1,
        bad=lambda value: value > 1.0,
    ),
    Figure("fails early, %", lambda a: _percent(_early(a)), digits=1, bad=lambda value: value > 5.0),
    Figure("failed zero, %", lambda a: _percent(a.scores["zero"].failed), bad=lambda value: value > 50.0),
    Figure("failed random, %", lambda a: _percent(a.scores["random"].failed)),
    Figure("success zero, %", lambda a: _percent(a.scores["zero"].success), bad=lambda value: value > 50.0),
    Figure("success random, %", lambda a: _percent(a.scores["random"].success)),
    Figure("return zero", lambda a: a.scores["zero"].return_mean),
    Figure("return random", lambda a: a.scores["random"].return_mean),
    Figure("gain of failing", lambda a: a.failing.failure_gain, bad=lambda value: value > 0.0),
    Figure("constant columns", lambda a: len(a.constant_columns), bad=lambda value: value > 0),
    Figure("silent terms", lambda a: len(_weighted_silent(a)), bad=lambda value: value > 0),
    Figure("faults", lambda a: sum(a.faults.values()), bad=lambda value: value > 0),
    Figure("margin, %", _margin, bad=lambda value: value < 10.0),
    Figure("inertia", lambda a: a.objects.inertia_ratio, digits=1, bad=lambda value: abs(value - 1.0) > 0.05),
    Figure("friction, %", lambda a: _percent(a.objects.friction_effective), bad=lambda value: value < 99.0),
    Figure("gimbal", lambda a: a.objects.gimbal, digits=1, bad=lambda value: value > 10.0),
)
"""The columns of the table, in order."""


def findings(audit: Audit) -> list[str]:
    """Return what speaks against the task, a sentence each."""
    named = {
        "constant columns": listed(audit.constant_columns, MOST),
        "silent terms": listed(_weighted_silent(audit), MOST),
    }
    bad = [figure for figure in FIGURES if figure.is_bad(audit)]
    return [figure.finding(named.get(figure.head, figure.text(audit))) for figure in bad]


def changes(audit: Audit, upstream: Audit | None) -> Iterator[tuple[Figure, str, str]]:
    """Yield the figures that are shown otherwise than in upstream's version: figure, there, here."""
    if upstream is not None and audit.id != upstream.id:
        for figure in FIGURES:
            there, here = figure.text(upstream), figure.text(audit)
            if there != here:
                yield figure, there, here
