"""Traces: chosen quantities over the last seconds, drawn under the scene, and written as CSV or PNG."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from myowarp.definitions.registry import check_choice
from myowarp.inks import BLACK, BLUE, GREEN, PINK, VERMILION
from myowarp.view.browser.chart import Chart, Curve, as_png, as_svg
from myowarp.view.browser.controls import View, Wishes
from myowarp.view.browser.history import History
from myowarp.view.browser.page_style import TRACES as CLASS
from myowarp.view.browser.readings import Kind
from myowarp.view.drawing.framing import view_axes

CURVES = (BLUE, VERMILION, PINK, BLACK)
"""Of the curves in a chart; those of the twin are dashed, targets are green as in the picture."""
DASH, TARGET_DASH = (6, 4), (2, 3)
MOST = len(CURVES)
"""Curves of one quantity."""
MOST_CHARTS = 4
"""Quantities side by side."""
NOTHING = "add ..."
WIDTH, HEIGHT = 900, 150
"""Size of the picture [px]."""
ROOM = 62
"""px of the window around it."""
BORDER = 15
"""px between the window and the picture of the body."""
TRACES_HEIGHT = HEIGHT + ROOM + 2 * BORDER
"""px at the bottom of a page that the window takes."""
LEAST_FREE = 0.5
"""Share of the height that the body has at least."""


class Traces(abc.ABC):
    """The window with curves, and what is chosen in the panel.

    Attributes:
        chosen: Quantity and item of each curve.
    """

    def __init__(self, live: Wishes, kinds: dict[str, Kind], first: list[tuple[str, str]]) -> None:
        """Add the controls to the container that is open, and the window.

        Args:
            live: The page.
            kinds: What can be traced.
            first: What is traced at first.
        """
        self._live, self._gui, self._kinds, self.chosen = live, live.server.gui, kinds, list(first)
        gui = self._gui
        self._kind: Any = gui.add_dropdown("quantity", tuple(self._kinds))
        self._item: Any = gui.add_dropdown("of", (NOTHING, *self._kinds[self._kind.value].items))
        self._kind.on_update(lambda _: live.ask("quantity", self._offer))
        self._item.on_update(lambda _: self._ask(self._item.value))
        for label, do in (
            ("Clear traces", self.clear),
            ("Save CSV", self._save_csv),
            ("Save PNG", self._save_png),
        ):
            self._press(label, do)
        self._window = gui.add_panel()
        with self._window.add_tab("Traces"):
            self._picture = gui.add_html("")
        self._window.float(x=BORDER, y=-BORDER, width=WIDTH, height=HEIGHT + ROOM)

    def _press(self, label: str, do: Callable[[Any], None]) -> None:
        """Add a button; what it does is told which browser asked."""
        button, live = self._gui.add_button(label), self._live
        button.on_click(lambda event: live.ask(label, lambda: do(event.client)))

    def remove(self) -> None:
        """Take the window out of the page."""
        self._window.remove()

    def refresh(self) -> None:
        """Draw what is new."""
        charts = self.charts()
        advice = "Choose on the tab <i>Traces</i>, or click a muscle."
        shown, padding = (as_svg(charts, WIDTH, HEIGHT), "0 0.5em") if charts else (advice, "1em")
        self._picture.content = f"<div class='{CLASS}' style='padding:{padding}'>{shown}</div>"

    def add(self, kind: str, item: str) -> None:
        """Draw one more; the oldest of its quantity, or the oldest quantity, makes room.

        Raises:
            ValueError: There is no such quantity, or nothing of that name has it.
        """
        check_choice("quantity", kind, tuple(self._kinds))
        check_choice(kind, item, self._kinds[kind].items)
        if (kind, item) in self.chosen:
            return
        self.chosen.append((kind, item))
        own = [pair for pair in self.chosen if pair[0] == kind]
        if len(own) > MOST:
            self.chosen.remove(own[0])
        shown = list(dict.fromkeys(pair[0] for pair in self.chosen))
        if len(shown) > MOST_CHARTS:
            self.chosen = [pair for pair in self.chosen if pair[0] != shown[0]]

    def clear(self, _: object = None) -> None:
        """Draw none."""
        self.chosen = []

    @abc.abstractmethod
    def charts(self) -> list[Chart]:
        """Return a chart for each chosen quantity; none where there is nothing to draw yet."""

    @abc.abstractmethod
    def table(self) -> str:
        """Return the curves as CSV."""

    def by_kind(self) -> dict[str, list[str]]:
        """Return the chosen items by quantity."""
        kinds = dict.fromkeys(kind for kind, _ in self.chosen)
        return {kind: [item for own, item in self.chosen if own == kind] for kind in kinds}

    def _offer(self) -> None:
        """List what has the chosen quantity."""
        check_choice("quantity", self._kind.value, tuple(self._kinds))
        self._item.value = NOTHING  # first: with the options comes the next choice
        self._item.options = (NOTHING, *self._kinds[self._kind.value].items)

    def _ask(self, item: str) -> None:
        """Have drawn what was chosen."""
        if item != NOTHING:
            self._live.ask("trace", lambda: self._add(item))

    def _add(self, item: str) -> None:
        """Draw what was chosen."""
        self._item.value = NOTHING
        self.add(self._kind.value, item)

    def _save_csv(self, client: Any) -> None:
        """Send the curves as a table to the browser that asked."""
        client.send_file_download("traces.csv", self.table().encode())

    def _save_png(self, client: Any) -> None:
        """Send the curves as a picture to the browser that asked."""
        if charts := self.charts():
            client.send_file_download("traces.png", as_png(charts, WIDTH, HEIGHT))


class LiveTraces(Traces):
    """The last seconds of a session."""

    def __init__(
        self, live: Wishes, kinds: dict[str, Kind], history: History, first: list[tuple[str, str]]
    ) -> None:
        """See `Traces`; the history is what is drawn."""
        super().__init__(live, kinds, first)
        self._history = history

    def table(self) -> str:
        """Return the curves as CSV."""
        return self._history.table(self._kinds, self.chosen, self._live.beside)

    def charts(self) -> list[Chart]:
        """Return a chart for each chosen quantity."""
        history = self._history
        if len(history.moments) < 2:
            return []
        times, borders, beside = history.times, history.borders.tolist(), self._live.beside
        found = []
        for kind, items in self.by_kind().items():
            curves = []
            for item, ink in zip(items, CURVES, strict=False):
                index = self._kinds[kind].items.index(item)
                curves.append(Curve(item, history.values(kind, index, False), ink))
                if beside:
                    values = history.values(kind, index, True)
                    curves.append(Curve(f"{item} before", values, ink, DASH))
                targets = history.targets(kind, index)
                if np.isfinite(targets).any():
                    curves.append(Curve(f"{item} target", targets, GREEN, TARGET_DASH))
            found.append(Chart(titled(kind, self._kinds[kind].unit), times, curves, borders))
        return found


def titled(kind: str, unit: str) -> str:
    """Return a quantity with its unit."""
    return kind if unit == "1" else f"{kind} / {unit}"


def above_traces(camera: mujoco.MjvCamera, opening: float, aspect: float, size: tuple[int, int]) -> View:
    """Return a camera for which all is above the traces.

    Args:
        camera: Camera of a picture that what matters fills.
        opening: Its vertical field of view [rad].
        aspect: Width over height of that picture.
        size: Width and height of the page's picture [px].
    """
    width, height = size
    _, up, forward = view_axes(camera.azimuth, camera.elevation)
    free = max(height - TRACES_HEIGHT, LEAST_FREE * height)
    distance = camera.distance * height / free * max(1.0, aspect * free / max(width, 1))
    middle = camera.lookat - (height - free) / height * distance * np.tan(opening / 2.0) * up
    return middle - distance * forward, middle, opening
