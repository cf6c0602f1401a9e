"""Traces of a recorded motion: left over right, over time or a gait cycle, as they are or by body weight."""

from __future__ import annotations

import numpy as np

from myowarp.motion.gait import PERCENT, mirrored, over_cycle, side_of
from myowarp.view.browser.chart import Chart, Curve, as_csv
from myowarp.view.browser.controls import Wishes
from myowarp.view.browser.readings import Kind
from myowarp.view.browser.traces import CURVES, DASH, TARGET_DASH, Traces, titled
from myowarp.view.browser.widgets import Widgets
from myowarp.view.drawing.recorded import Recorded

MOST_TRACED = 300
"""Moments of a trace."""
FIRST = {"activation": 2, "force": 2, "joint angle": 1}
"""Number of each quantity's largest curves that are traced at first."""


class TrialTraces(Traces):
    """Curves of a whole trial, with a line at what is shown.

    Attributes:
        now: Time that is shown [s].
        sides: Whether the other side of each item is drawn, too, dashed.
        percent: Whether curves are over the gait cycle of their side.
        by_weight: Whether forces are over the body's weight, and moments and powers over its mass.
    """

    def __init__(self, live: Wishes, widgets: Widgets, recorded: Recorded) -> None:
        """Add the controls to the container that is open, and the window."""
        self._recorded, self.now = recorded, float(recorded.time[0])
        courses = recorded.courses
        two_sided = any(mirrored(k) != k for course in courses.values() for k in course.items)
        self.sides, self.percent, self.by_weight = two_sided, False, False

        def tick(label: str, field: str) -> None:
            widgets.tick(label, lambda: getattr(self, field), lambda on: setattr(self, field, on))

        if two_sided:
            tick("left over right (dashed)", "sides")
        if recorded.cycles:
            tick("over % of the gait cycle", "percent")
        tick("by body weight", "by_weight")
        kinds = {name: Kind(course.unit, course.items) for name, course in courses.items()}
        first = [(kind, courses[kind].items[k]) for kind, number in FIRST.items() if kind in courses
                 for k in largest(recorded, kind)[:number]]  # fmt: skip
        super().__init__(live, kinds, first)

    def table(self) -> str:
        """Return the curves as CSV."""
        charts = self.charts()
        return as_csv(charts) if charts else ""

    def charts(self) -> list[Chart]:
        """Return a chart for each chosen quantity."""
        recorded, charts = self._recorded, []
        count = len(recorded.time)
        kept = np.unique(np.linspace(0, count - 1, min(count, MOST_TRACED)).round().astype(int))
        percent = self.percent and bool(recorded.cycles)
        along, axis, now = recorded.time[kept], "time / s", self.now
        if percent:
            along, axis = PERCENT, "% gait cycle"
            begin, end = recorded.cycle_of("")
            now = 100.0 * (self.now - begin) / (end - begin)
        for kind, items in self.by_kind().items():
            course, curves = recorded.courses[kind], []
            factor, unit = self._measure(course.unit)
            for item, ink in zip(items, CURVES, strict=False):
                for name in dict.fromkeys((item, mirrored(item)) if self.sides else (item,)):
                    if name not in course.items or (name != item and name in items):
                        continue
                    side = side_of(name)[1]
                    dash = DASH if self.sides and side == "l" else ()  # of each item alike, as in figures
                    index = course.items.index(name)
                    shown = [(name, course.values[:, index], dash)]
                    if course.measured is not None and np.isfinite(course.measured[:, index]).any():
                        shown.append((f"{name} EMG", course.measured[:, index], TARGET_DASH))
                    for label, values, pattern in shown:
                        drawn = (
                            over_cycle(recorded.time, values, recorded.cycle_of(side))
                            if percent
                            else values[kept]
                        )
                        curves.append(Curve(label, factor * drawn, ink, pattern))
            inside = along[0] <= now <= along[-1]
            charts.append(Chart(titled(kind, unit), along, curves, axis=axis, now=now if inside else None))
        return charts

    def _measure(self, unit: str) -> tuple[float, str]:
        """Return what a quantity is multiplied with, and the unit that it then has."""
        mass = self._recorded.mass
        known = {
            "N": (1.0 / (mass * self._recorded.gravity), "body weight"),
            "N m": (1.0 / mass, "N m/kg"),
            "W": (1.0 / mass, "W/kg"),
        }
        return known.get(unit, (1.0, unit)) if self.by_weight else (1.0, unit)


def largest(recorded: Recorded, kind: str) -> list[int]:
    """Return the numbers of items, the greatest value first, of two sides the greater one alone.

    Items with an electromyogram come before others.
    """
    course = recorded.courses[kind]
    known = np.nan_to_num(course.values)
    most = np.ptp(known, axis=0) if kind == "joint angle" else np.abs(known).max(axis=0)
    seen = np.zeros(len(most), bool) if course.measured is None else np.isfinite(course.measured).any(axis=0)
    order = [int(k) for k in np.lexsort((-most, ~seen))]
    names = [course.items[k] for k in order]
    return [k for place, k in enumerate(order) if mirrored(course.items[k]) not in names[:place]]
