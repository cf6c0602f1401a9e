"""The page of a recorded motion: the trial plays, with forces in colour, loads as arrows and traces.

All that a page shows of a frame is sent together: bones, muscles, arrows, the line in the traces, and what
is written. So one picture is one moment. While no page is open, nothing moves.
"""

from __future__ import annotations

import time
from html import escape
from typing import Any

import numpy as np
import viser

from myowarp.view.browser import status as html
from myowarp.view.browser.controls import USUAL, View, Wishes
from myowarp.view.browser.drive import Drive
from myowarp.view.browser.moments import at_once
from myowarp.view.browser.names import SIDES
from myowarp.view.browser.scene import Figure, Floor
from myowarp.view.browser.traces import TRACES_HEIGHT, above_traces
from myowarp.view.browser.trial_traces import TrialTraces
from myowarp.view.browser.widgets import Widgets
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing
from myowarp.view.drawing.muscles import QUANTITIES
from myowarp.view.drawing.recorded import Recorded

PICTURE = 1.0 / 20.0
"""Least time between two pictures [s]: traces are sent with each."""
TRAFFIC = 1.9e6
"""Bytes per second that pictures may take to a page."""
LATE = 0.25
"""Time between two pictures [s] beyond which the trial slows down, so that it is still seen to move."""
IDLE = 0.05
"""Time between two looks at what browsers ask for [s]."""
FASTEST, SLOWEST = 4.0, 0.05
"""Speeds over real time that can be chosen."""
ASPECT = 0.9 * USUAL[0] / (USUAL[1] - TRACES_HEIGHT)
"""Width over height of what the body fills above the traces."""
PICKED = ("activation", "force")
"""Quantities beside a muscle that was clicked; they are traced, too."""


class TrialPage(Wishes):
    """A recorded motion in a page.

    Attributes:
        frame: What is shown.
        figure: The body.
        tag: What stands beside the muscle that was clicked.
        drive: Readings and buttons.
        slider: Time of what is shown.
        traces: Curves of the trial.
    """

    def __init__(self, server: viser.ViserServer, recorded: Recorded) -> None:
        """Show a motion, from its beginning.

        Args:
            server: Where.
            recorded: What.
        """
        super().__init__(server)
        self.recorded, self.frame = recorded, 0
        self.color, self._clock, self._last = recorded.colored, float(recorded.time[0]), 0.0
        self._picked, self._drawn = "", 0.0
        model, scene = recorded.model, server.scene
        self._framing = Framing(model, (), ASPECT)
        self._framing.look_along(recorded.across)
        self.figure = Figure(
            server, "/world/body", model, self._framing.radius,
            pick=lambda muscle: self.ask("pick", lambda: self.pick(muscle)),
        )  # fmt: skip
        self._fit()
        self._floor = Floor(server, "/floor", model, self._framing, always=True)
        self.tag = scene.add_label("/picked", "", visible=False)
        self._add_panel()
        seen = recorded.seen(0)
        look.pose(model, self.figure.data, seen.qpos, paths=seen.paths)
        self._camera = self._framing.camera(self.figure.data, {})
        self._camera.lookat[:] -= self._framing.shift(self.figure.data)
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
                self._go_on(min(now - self._last, LATE))
            self._last = now if watched else 0.0
            if watched and (asked or now >= self._drawn + self._every):
                self._drawn = now
                self.draw()
            self._stopped.wait(max(min(self._drawn + self._every - time.monotonic(), IDLE), 0.001))

    def single_step(self) -> None:
        """Pause, and show the next frame; after the last comes the first."""
        self.show((self.frame + 1) % len(self.recorded.time))

    def show(self, frame: int) -> None:
        """Pause, and show a frame."""
        self.playing, self.frame = False, frame
        self._clock = self.time

    def reset(self) -> None:
        """Show the first frame."""
        self.frame, self._clock = 0, float(self.recorded.time[0])

    def pick(self, muscle: str) -> None:
        """Name a muscle in the picture, with what it does, and trace it; one that is named no longer."""
        self._picked = "" if muscle == self._picked else muscle
        for kind, course in self.recorded.courses.items():
            if self._picked in course.items and kind in PICKED:
                self.traces.add(kind, self._picked)

    def draw(self) -> None:
        """Send the shown frame, all of it together."""
        seen = self.recorded.seen(self.frame)

        def send() -> None:
            self.figure.show(seen, self.color, shift=self._shift)
            self._floor.show(self._shift(self.figure.data))
            self.traces.now = self.time
            self.traces.refresh()
            self.drive.refresh()
            if self.slider.value != self.time:
                self.slider.value = self.time
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
        return max(PICTURE, self.figure.bytes_per_frame / TRAFFIC)

    def _shift(self, data: Any) -> np.ndarray:
        """Return how far all is moved aside [m], so that the body stays in the middle."""
        return -self._framing.shift(data) if self.follow else np.zeros(3)

    def _add_panel(self) -> None:
        """Add controls and traces."""
        gui, widgets, recorded = self.server.gui, Widgets(self), self.recorded
        self.drive = Drive(self, self._said)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Trial"):
            first, last = map(float, recorded.time[[0, -1]])
            self.slider = widgets.slide(
                "time", "time [s]", (first, last), 1e-3, lambda: self.time,
                lambda value: self.show(recorded.frame_at(value)), "Pauses, and shows this moment.",
            )  # fmt: skip
            widgets.slide(
                "speed", "× real time", (SLOWEST, FASTEST), 0.05, lambda: self.speed,
                lambda value: setattr(self, "speed", value),
            )  # fmt: skip
            colors = [name for name in QUANTITIES if name in ("fiber_length", *recorded.courses)]
            widgets.choose("color", colors, lambda: self.color, self._paint, "What muscles' colours show.")
            self._legend = gui.add_html(html.legend(QUANTITIES[self.color]))
            widgets.tick("camera follows", lambda: self.follow, lambda on: setattr(self, "follow", on))
        with tabs.add_tab("Traces"):
            self.traces = TrialTraces(self, widgets, recorded)
        self.bind_keys()

    def _paint(self, color: str) -> None:
        """Change what the colour of a muscle shows."""
        self.color = color
        self._legend.content = html.legend(QUANTITIES[color])

    def _said(self) -> str:
        """Return what is written on the shown frame, HTML."""
        recorded = self.recorded
        rows = [
            f"<b>{'' if self.playing else 'paused · '}{self.time:.3f} s</b> · frame {self.frame + 1} of "
            f"{len(recorded.time)}",
        ]
        if recorded.newtons_per_metre:
            rows.append(f"loads: an arrow of 1 m is {recorded.newtons_per_metre:.0f} N")
        if recorded.cycles:
            found = (
                f"{SIDES[side]}{begin:.2f} to {end:.2f} s" for side, (begin, end) in recorded.cycles.items()
            )
            rows.append(f"gait cycle: {', '.join(found)}")
        if not {"force", "activation"} & set(recorded.courses):
            rows.append("no muscle forces beside the motion; <code>myowarp motion forces</code> finds them")
        if self.message:
            rows.append(f"<span style='color:{html.BAD}'>{escape(self.message)}</span>")
        return html.block(rows)

    def _name_picked(self) -> None:
        """Write beside the muscle that was clicked what it does."""
        place = self.figure.middle_of(self._picked)
        self.tag.visible = place is not None
        if place is None:
            return
        parts = [self._picked]
        for kind in PICKED:
            if kind in self.recorded.courses:
                course = self.recorded.courses[kind]
                if self._picked in course.items:
                    value = course.values[self.frame, course.items.index(self._picked)]
                    parts.append(f"{kind} {value:.3g}" + ("" if course.unit == "1" else f" {course.unit}"))
        self.tag.text, self.tag.position = " · ".join(parts), place

    def _fit(self) -> None:
        """Point the camera at the trial instead of the joints' ranges."""
        count = len(self.recorded.time)
        chosen = np.unique(np.linspace(0, count - 1, min(count, 24)).round().astype(int))
        model, figure = self.recorded.model, self.figure

        def moments() -> Any:
            for frame in chosen:
                seen = self.recorded.seen(int(frame))
                look.pose(model, figure.data, seen.qpos, paths=seen.paths)
                yield figure.data, {f"arrow {k}": end for k, end in enumerate(seen.arrows[:, 1])}

        self._framing.fit(moments())

    def view(self, width: int, height: int) -> View:
        """Return the camera for a picture of a size [px]: all is above the traces."""
        opening = float(np.radians(self.recorded.model.vis.global_.fovy))
        return above_traces(self._camera, opening, ASPECT, (width, height))
