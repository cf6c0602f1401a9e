"""The page of a recorded motion: the trial plays, with forces in colour, loads as arrows and traces.

All that a page shows of a frame is sent together: bones, muscles, arrows, the line in the traces, and what
is written. So one picture is one moment. While no page is open, nothing moves.
"""

from __future__ import annotations

import time
from collections import deque
from html import escape
from typing import Any

import numpy as np
import viser

from myowarp.definitions.registry import check_choice
from myowarp.view.browser import status as html
from myowarp.view.browser.controls import USUAL, View, Wishes
from myowarp.view.browser.history import History
from myowarp.view.browser.moments import at_once
from myowarp.view.browser.page_style import SOFTWARE, STYLE
from myowarp.view.browser.readings import Kind, Moment
from myowarp.view.browser.scene import Figure, Floor
from myowarp.view.browser.traces import TRACES_HEIGHT, Traces
from myowarp.view.browser.widgets import Widgets
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, view_axes
from myowarp.view.drawing.muscles import QUANTITIES
from myowarp.view.drawing.recorded import Recorded

PICTURE = 1.0 / 20.0
"""Least time between two pictures [s]: traces are sent with each."""
TRAFFIC = 1.9e6
"""Bytes per second that pictures may take to a page."""
MOST_TRACED = 300
"""Moments of a trace."""
IDLE = 0.05
"""Time between two looks at what browsers ask for [s]."""
FASTEST, SLOWEST = 4.0, 0.05
"""Speeds over real time that can be chosen."""
LEGIBLE = 0.9
"""Share of the space above the traces that the body takes."""
FIRST = {"activation": 3, "force": 2, "joint angle": 1}
"""Number of each quantity's largest curves that are traced at first."""
PLAY, PAUSE, STEP, RESET = "Play", "Pause", "Step", "Reset"


def traced(recorded: Recorded) -> History:
    """Return the moments of a motion, with envelopes of electromyograms beside activations."""
    history = History()
    history.aim, count = "EMG", len(recorded.time)
    kept = np.unique(np.linspace(0, count - 1, min(count, MOST_TRACED)).round().astype(int))
    nothing = {name: np.full(len(course.items), np.nan) for name, course in recorded.courses.items()}
    moments = [
        Moment(
            float(recorded.time[frame]),
            1,
            (recorded.seen(frame),) * 2,
            {name: np.stack((c.values[frame], nothing[name])) for name, c in recorded.courses.items()},
            {name: c.measured[frame] for name, c in recorded.courses.items() if c.measured is not None},
        )
        for frame in kept
    ]
    history.moments = deque(moments)
    return history


class TrialPage(Wishes):
    """A recorded motion in a page.

    Attributes:
        frame: What is shown.
    """

    def __init__(self, server: viser.ViserServer, recorded: Recorded, title: str) -> None:
        """Show a motion, from its beginning.

        Args:
            server: Where.
            recorded: What.
            title: What it is called.
        """
        super().__init__(server)
        self.recorded, self.frame, self._title = recorded, 0, title
        self.color, self._clock, self._last = recorded.colored, float(recorded.time[0]), 0.0
        self._picked, self._drawn = "", 0.0
        model, scene = recorded.model, server.scene
        server.gui.add_html(STYLE + SOFTWARE)
        self._framing = Framing(model, (), LEGIBLE * USUAL[0] / (USUAL[1] - TRACES_HEIGHT))
        self._framing.look_along(recorded.across)
        self._figure = Figure(
            server, "/world/body", model, self._framing.radius,
            pick=lambda muscle: self.ask("pick", lambda: self.pick(muscle)),
        )  # fmt: skip
        self._fit()
        self._floor = Floor(server, "/floor", model, self._framing, always=True)
        self._tag = scene.add_label("/picked", "", visible=False)
        self._history = traced(recorded)
        self._add_panel()
        seen = recorded.seen(0)
        look.pose(model, self._figure.data, seen.qpos, paths=seen.paths)
        self._camera = self._framing.camera(self._figure.data, {})
        self._camera.lookat[:] -= self._framing.shift(self._figure.data)
        self.aim()
        self.draw()

    @property
    def time(self) -> float:
        """Time of what is shown [s]."""
        return float(self.recorded.time[self.frame])

    def run(self) -> None:
        """Run until `stop`."""
        while not self._stopped.is_set():
            asked, now = self.obey(), time.monotonic()
            watched = bool(self.server.get_clients())
            if self.playing and watched and self._last:
                self._go_on(now - self._last)
            self._last = now if watched else 0.0
            if watched and (asked or now >= self._drawn + self._every):
                self._drawn = now
                self.draw()
            self._stopped.wait(max(min(self._drawn + self._every - time.monotonic(), IDLE), 0.001))

    def play(self) -> None:
        """Go on from what is shown."""
        self.playing = True

    def toggle(self) -> None:
        """Play, or pause."""
        self.playing = not self.playing

    def step(self) -> None:
        """Pause, and show the next frame; after the last comes the first."""
        self.show((self.frame + 1) % len(self.recorded.time))

    def show(self, frame: int) -> None:
        """Pause, and show a frame."""
        self.playing, self.frame = False, frame
        self._clock = self.time

    def restart(self) -> None:
        """Show the first frame."""
        self.frame, self._clock = 0, float(self.recorded.time[0])

    def pick(self, muscle: str) -> None:
        """Name a muscle in the picture, with what it does, and trace it; one that is named no longer."""
        self._picked = "" if muscle == self._picked else muscle
        for kind, course in self.recorded.courses.items():
            if self._picked in course.items and kind in FIRST:
                self._traces.add(kind, self._picked)

    def draw(self) -> None:
        """Send the shown frame, all of it together."""
        seen = self.recorded.seen(self.frame)

        def send() -> None:
            self._figure.show(seen, self.color, shift=self._shift)
            self._floor.show(self._shift(self._figure.data))
            self._history.now = self.time
            self._traces.refresh()
            self._status.content = self._said()
            if self._slider.value != self.time:
                self._slider.value = self.time
            if tuple(self._drive.options) != self._buttons():
                self._drive.options = self._buttons()
            self._name_picked()

        at_once(self.server, send)

    def _go_on(self, seconds: float) -> None:
        """Let time pass; after the end comes the beginning."""
        first, last = self.recorded.time[[0, -1]]
        self._clock += seconds * self.speed
        if self._clock > last:
            self._clock = float(first)
        self.frame = self.recorded.frame_at(self._clock)

    @property
    def _every(self) -> float:
        """Time between two pictures [s]."""
        return max(PICTURE, self._figure.bytes_per_frame / TRAFFIC)

    def _shift(self, data: Any) -> np.ndarray:
        """Return how far all is moved aside [m], so that the body stays in the middle."""
        return -self._framing.shift(data) if self.follow else np.zeros(3)

    def _buttons(self) -> tuple[str, ...]:
        return (PAUSE if self.playing else PLAY, STEP, RESET)

    def _press(self, button: str) -> None:
        """Do what a button says."""
        check_choice("button", button, (PLAY, PAUSE, STEP, RESET))
        {PLAY: self.toggle, PAUSE: self.toggle, STEP: self.step, RESET: self.restart}[button]()

    def _add_panel(self) -> None:
        """Add controls and traces."""
        gui, widgets, recorded = self.server.gui, Widgets(self), self.recorded
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        tabs = gui.add_tab_group()
        with tabs.add_tab("Trial"):
            self._status = gui.add_html(self._said())
            self._drive: Any = gui.add_button_group(
                "", self._buttons(), hint="Keys: space plays and pauses, right arrow steps, R begins anew."
            )
            self._drive.on_click(lambda _: self.ask("drive", lambda: self._press(self._drive.value)))
            first, last = map(float, recorded.time[[0, -1]])
            self._slider = widgets.slide(
                "time", "time [s]", (first, last), 1e-3, lambda: self.time,
                lambda value: self.show(recorded.frame_at(value)), "Pauses, and shows this moment.",
            )  # fmt: skip
            widgets.slide(
                "speed", "speed / real time", (SLOWEST, FASTEST), 0.05, lambda: self.speed,
                lambda value: setattr(self, "speed", value),
            )  # fmt: skip
            colors = [name for name in QUANTITIES if name in ("fiber_length", *recorded.courses)]
            widgets.choose("color", colors, lambda: self.color, self._paint, "What muscles' colours show.")
            self._legend = gui.add_html(html.legend(QUANTITIES[self.color]))
            widgets.tick("camera follows", lambda: self.follow, lambda on: setattr(self, "follow", on))
        with tabs.add_tab("Traces"):
            kinds = {name: Kind(course.unit, course.items) for name, course in recorded.courses.items()}
            self._traces = Traces(self, kinds, self._history)
        self._traces.chosen = [
            (kind, recorded.courses[kind].items[k])
            for kind, number in FIRST.items()
            if kind in recorded.courses
            for k in largest(recorded, kind)[:number]
        ]
        self.bind("Play or pause", "space", self.toggle)
        self.bind("Step", "arrowright", self.step)
        self.bind("Begin anew", "R", self.restart)

    def _paint(self, color: str) -> None:
        """Change what the colour of a muscle shows."""
        self.color = color
        self._legend.content = html.legend(QUANTITIES[color])

    def _said(self) -> str:
        """Return what is written on the shown frame, HTML."""
        recorded = self.recorded
        rows = [
            f"<b>{escape(self._title)}</b>",
            f"<b>{'' if self.playing else 'paused · '}{self.time:.3f} s</b> · frame {self.frame + 1} of "
            f"{len(recorded.time)}",
        ]
        if recorded.newtons_per_metre:
            rows.append(f"loads: an arrow of 1 m is {recorded.newtons_per_metre:.0f} N")
        if not {"force", "activation"} & set(recorded.courses):
            rows.append("no muscle forces beside the motion; <code>myowarp motion forces</code> finds them")
        if self.message:
            rows.append(f"<span style='color:{html.BAD}'>{escape(self.message)}</span>")
        return f"<div style='padding:0.5em 1em;font-size:0.85em'>{'<br>'.join(rows)}</div>"

    def _name_picked(self) -> None:
        """Write beside the muscle that was clicked what it does."""
        place = self._figure.middle_of(self._picked)
        self._tag.visible = place is not None
        if place is None:
            return
        parts = [self._picked]
        for kind in ("activation", "force"):
            if kind in self.recorded.courses:
                course = self.recorded.courses[kind]
                if self._picked in course.items:
                    value = course.values[self.frame, course.items.index(self._picked)]
                    parts.append(f"{kind} {value:.3g}" + ("" if course.unit == "1" else f" {course.unit}"))
        self._tag.text, self._tag.position = " · ".join(parts), place

    def _fit(self) -> None:
        """Point the camera at the trial instead of the joints' ranges."""
        count = len(self.recorded.time)
        chosen = np.unique(np.linspace(0, count - 1, min(count, 24)).round().astype(int))
        model, figure = self.recorded.model, self._figure

        def moments() -> Any:
            for frame in chosen:
                seen = self.recorded.seen(int(frame))
                look.pose(model, figure.data, seen.qpos, paths=seen.paths)
                yield figure.data, {f"arrow {k}": end for k, end in enumerate(seen.arrows[:, 1])}

        self._framing.fit(moments())

    def view(self, width: int, height: int) -> View:
        """Return the camera for a picture of a size [px]: all is above the traces."""
        camera = self._camera
        _, up, forward = view_axes(camera.azimuth, camera.elevation)
        opening = float(np.radians(self.recorded.model.vis.global_.fovy))
        free = max(height - TRACES_HEIGHT, 0.5 * height)
        aspect = LEGIBLE * USUAL[0] / (USUAL[1] - TRACES_HEIGHT)
        distance = camera.distance * height / free * max(1.0, aspect * free / max(width, 1))
        below = (height - free) / height * distance * np.tan(opening / 2.0)
        middle = camera.lookat - below * up
        return middle - distance * forward, middle, opening


def largest(recorded: Recorded, kind: str) -> list[int]:
    """Return the numbers of items, the greatest value first; those with an electromyogram before others."""
    course = recorded.courses[kind]
    known = np.nan_to_num(course.values)
    most = np.ptp(known, axis=0) if kind == "joint angle" else np.abs(known).max(axis=0)
    seen = np.zeros(len(most), bool) if course.measured is None else np.isfinite(course.measured).any(axis=0)
    return [int(k) for k in np.lexsort((-most, ~seen))]
