"""The last seconds of a session, to look back at: what was drawn, and what can be traced."""

from __future__ import annotations

from collections import deque

import numpy as np

from myowarp.view.browser.chart import csv_of
from myowarp.view.browser.readings import Kind, Moment

SECONDS = 10.0
"""Length of the history at real time [s]."""
FRAMES = 300
"""Moments that are kept."""


class History:
    """Moments of a session, the last one at the end.

    Attributes:
        moments: The moments.
    """

    def __init__(self) -> None:
        """Begin without any."""
        self.moments: deque[Moment] = deque(maxlen=FRAMES)

    def add(self, moment: Moment) -> None:
        """Keep a moment, unless no time has passed."""
        if not self.moments or moment.time > self.moments[-1].time:
            self.moments.append(moment)

    def back(self, seconds: float) -> Moment | None:
        """Return the moment that was some seconds before the last; None where nothing is known."""
        if not self.moments:
            return None
        times = self.times
        return self.moments[int(np.abs(times - (times[-1] - seconds)).argmin())]

    @property
    def times(self) -> np.ndarray:
        """Times of the moments [s], shape (num_moments,)."""
        return np.array([moment.time for moment in self.moments])

    @property
    def borders(self) -> np.ndarray:
        """Times at which an episode begins [s]."""
        episodes = np.array([moment.episode for moment in self.moments])
        return self.times[1:][np.diff(episodes) != 0]

    def values(self, kind: str, item: int, twin: bool) -> np.ndarray:
        """Return a quantity of an item over time, shape (num_moments,)."""
        return np.array([moment.values[kind][int(twin), item] for moment in self.moments])

    def targets(self, kind: str, item: int) -> np.ndarray:
        """Return what is wanted of an item over time, shape (num_moments,); NaN where nothing is."""
        return np.array([m.targets[kind][item] if kind in m.targets else np.nan for m in self.moments])

    def table(self, kinds: dict[str, Kind], chosen: list[tuple[str, str]], beside: bool) -> str:
        """Return chosen quantities as CSV: time, episode, and a column for each, the twin's after its own."""
        names = ["time [s]", "episode"]
        columns = [self.times, np.array([moment.episode for moment in self.moments])]
        for kind, item in chosen:
            index = kinds[kind].items.index(item)
            for twin in range(1 + beside):
                names.append(f"{kind} of {item}{' before' if twin else ''} [{kinds[kind].unit}]")
                columns.append(self.values(kind, index, bool(twin)))
        return csv_of(names, columns)
