"""What of an audit stands in the table, what of it is a finding, and what differs from upstream's version."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from myowarp.apps.studies.audit.measure import Audit
from myowarp.apps.studies.audit.runs import EARLY_STEPS

Value = float | None


def _percent(share: Value) -> Value:
    """Return a share in percent."""
    return None if share is None else 100.0 * share


@dataclass(frozen=True)
class Figure:
    """A column of the table.

    Attributes:
        head: Heading; the part after a comma is the unit.
        meaning: What it says, one sentence.
        read: Takes it from an audit; None: nothing to say.
        digits: Decimals shown.
        bad: Whether a value is a finding.
        finding: The finding as a sentence with a field for the value as it is shown.
    """

    head: str
    meaning: str
    read: Callable[[Audit], Value]
    digits: int = 0
    bad: Callable[[float], bool] = lambda value: False
    finding: str = ""

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
    Figure(
        "targets solvable, %",
        "Targets that geometry lets be met well enough to be solved.",
        lambda a: _percent(a.targets.solvable),
        bad=lambda value: value < 95.0,
        finding="Only {}% of the targets can be solved at all.",
    ),
    Figure(
        "targets exact, %",
        "Targets that geometry lets be met exactly.",
        lambda a: _percent(a.targets.exact),
    ),
    Figure(
        "thumb off, mm",
        "Largest distance of the thumb tip in a target posture from where it was published.",
        lambda a: None if a.targets.thumb_off is None else 1e3 * a.targets.thumb_off,
        digits=1,
        bad=lambda value: value > 1.0,
        finding="Target postures are not those published: the thumb tip is {} mm off.",
    ),
    Figure(
        "fails early, %",
        f"Starts from which zero actions fail within {EARLY_STEPS} steps, in the worst reset.",
        lambda a: _percent(_early(a)),
        digits=1,
        bad=lambda value: value > 5.0,
        finding=f"From {{}}% of the starts of a reset the task fails within {EARLY_STEPS} steps.",
    ),
    Figure(
        "failed zero, %",
        "Episodes that end by failure with zero actions.",
        lambda a: _percent(a.scores["zero"].failed),
        bad=lambda value: value > 50.0,
        finding="{}% of the episodes fail when nothing is done.",
    ),
    Figure(
        "failed random, %",
        "Episodes that end by failure with random actions.",
        lambda a: _percent(a.scores["random"].failed),
    ),
    Figure(
        "success zero, %",
        "Episodes that succeed with zero actions.",
        lambda a: _percent(a.scores["zero"].success),
        bad=lambda value: value > 50.0,
        finding="{}% of the episodes succeed when nothing is done.",
    ),
    Figure(
        "success random, %",
        "Episodes that succeed with random actions.",
        lambda a: _percent(a.scores["random"].success),
    ),
    Figure("return zero", "Mean return with zero actions.", lambda a: a.scores["zero"].return_mean),
    Figure("return random", "Mean return with random actions.", lambda a: a.scores["random"].return_mean),
    Figure(
        "gain of failing",
        "Reward of a failing step less that of living on for a horizon.",
        lambda a: a.failing.failure_gain,
        bad=lambda value: value > 0.0,
        finding="Failing in the first step earns {} more than living to the horizon does.",
    ),
    Figure(
        "constant columns",
        "Observation columns that never changed.",
        lambda a: len(a.constant_columns),
        bad=lambda value: value > 0,
        finding="Observation columns that never change: {}.",
    ),
    Figure(
        "silent terms",
        "Reward terms with a weight that never left 0.",
        lambda a: len(_weighted_silent(a)),
        bad=lambda value: value > 0,
        finding="Reward terms that never leave 0: {}.",
    ),
    Figure(
        "faults",
        "Steps of a world with a fault.",
        lambda a: sum(a.faults.values()),
        bad=lambda value: value > 0,
        finding="{} steps had a fault.",
    ),
    Figure(
        "margin, %",
        "Room left for contacts, or constraint rows if less.",
        _margin,
        bad=lambda value: value < 10.0,
        finding="Contacts or constraint rows leave a margin of {}%.",
    ),
    Figure(
        "inertia",
        "Largest ratio of an object's inertia to that of the solid of its mass and shape.",
        lambda a: a.objects.inertia_ratio,
        digits=1,
        bad=lambda value: abs(value - 1.0) > 0.05,
        finding="An object's inertia is {} times that of a solid of its mass and shape.",
    ),
    Figure(
        "friction, %",
        "Drawn friction coefficients that a contact has, too.",
        lambda a: _percent(a.objects.friction_effective),
        bad=lambda value: value < 99.0,
        finding="Only {}% of the drawn friction coefficients have an effect.",
    ),
    Figure(
        "gimbal",
        "Worst condition number of the map from an object's joint rates to its angular velocity.",
        lambda a: a.objects.gimbal,
        digits=1,
        bad=lambda value: value > 10.0,
        finding="An object's rotational joints come close to gimbal lock, condition number {}.",
    ),
)
"""The columns of the table, in order."""


def findings(audit: Audit) -> list[str]:
    """Return what speaks against the task, a sentence each."""
    named = {
        "constant columns": _shortened(audit.constant_columns),
        "silent terms": _shortened(_weighted_silent(audit)),
    }
    bad = [figure for figure in FIGURES if figure.is_bad(audit)]
    return [figure.finding.format(named.get(figure.head, figure.text(audit))) for figure in bad]


def _shortened(names: tuple[str, ...], most: int = 8) -> str:
    """Return names with commas, the first few of many."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def changes(audit: Audit, upstream: Audit | None) -> Iterator[tuple[Figure, str, str]]:
    """Yield the figures that are shown otherwise than in upstream's version: figure, there, here."""
    if upstream is not None and audit.id != upstream.id:
        for figure in FIGURES:
            there, here = figure.text(upstream), figure.text(audit)
            if there != here:
                yield figure, there, here
