"""The loop behind a page: steps in real time, draws what is new, and does what browsers ask for.

Browsers ask from threads of their own; the loop does it between two steps, and what is asked for twice before
that once. While no page is open, nothing moves.
"""

from __future__ import annotations

import copy
import time
from collections import deque
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import viser

from myowarp.definitions.body import BODIES
from myowarp.progress import listening
from myowarp.view.browser.controls import Controls, View
from myowarp.view.browser.history import History
from myowarp.view.browser.moments import at_once
from myowarp.view.browser.panel import Panel
from myowarp.view.browser.readings import Moment, Readings
from myowarp.view.browser.scene import Figure, Floor
from myowarp.view.browser.session import Choices, Session
from myowarp.view.browser.task_tree import title_of
from myowarp.view.browser.traces import above_traces
from myowarp.view.browser.updates import name_page
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, motion_samples, view_axes

FRAME = 1.0 / 30.0
"""Least time between two frames [s]."""
TRAFFIC = 1.9e6
"""Bytes per second that bodies and muscles may take to a page; before there are more, frames get rarer."""
READING = 0.5
"""Time between two readings and plots [s]."""
LATE = 0.25
"""Delay [s] beyond which the page stops catching up and shows that it is slower than real time."""
LETTERS = 1.5
"""Size of the text above bodies over viser's."""
PICKED = ("activation", "force")
"""Quantities beside a muscle that was clicked; they are traced, too."""
ASPECT = 1.75
"""Of the picture beside the panel and above the traces, about."""
NEAR_REST = 0.25
"""Share of the way to the ends of its ranges on which a model's file is in the picture."""


class Live(Controls):
    """A session in a page.

    Attributes:
        panel: Controls and readings.
        figure: The shown world.
        twin: Its twin without the change; None: it is not shown.
        tag: What stands beside the muscle that was clicked.
        history: Moments to look back at.
    """

    panel: Panel
    figure: Figure
    twin: Figure | None
    tag: viser.LabelHandle
    history: History
    _picked: str
    _labels: dict[str, viser.LabelHandle]

    def __init__(self, server: viser.ViserServer, session: Session, choices: Choices) -> None:
        """Show a session.

        Args:
            server: Where.
            session: What.
            choices: What can be chosen.
        """
        super().__init__(server, session, choices)
        self.bind_keys()
        self._progress: deque[tuple[float, int]] = deque()
        self._due = self._drawn = self._read = 0.0
        self._open()

    def run(self) -> None:
        """Run until `stop`."""
        while not self._stopped.is_set():
            if self.obey():
                self._drawn = self._read = 0.0
            now = time.monotonic()
            watched = bool(self.server.get_clients())
            if self.playing and watched and now >= self._due:
                self._step(now)
            if watched and now >= self._drawn + self._frame:
                self.draw(now)
            now = time.monotonic()
            until = min(self._due, self._drawn + self._frame) if self.playing and watched else now + FRAME
            self._stopped.wait(max(until - now, 0.0))

    def open(self, task: str, policy: str) -> None:
        """Show another task; what is shown is covered until it is there."""
        cover = self.server.gui.add_modal(f"Preparing {task}")
        with cover:
            doing = self.server.gui.add_markdown("Building the body ...")
            bar: Any = self.server.gui.add_progress_bar(0.0, animated=True)

        def tell(title: str, done: int, total: int) -> None:
            doing.content, bar.value = f"{title} ...", 100.0 * done / max(total, 1)

        try:
            with listening(tell):
                self.session = self.choices.open(task, policy)
            self._close()
            self._open()
        finally:
            cover.close()

    def show_twin(self, beside: bool) -> None:
        """Show or hide the twin, from the state that the shown world is in."""
        self.session.match()
        if beside and self.twin is None:
            self.twin = self._figure("/twin")
        elif not beside and self.twin is not None:
            self.twin.remove()
            self.twin = None
        self.session.beside = beside
        self._labels["/twin"].visible = self._labels["/world"].visible = beside
        self.aim()

    def single_step(self) -> None:
        """Pause, and make one step."""
        self.playing, self.back = False, 0.0
        self.session.step()
        self._drawn = self._read = 0.0

    def pick(self, muscle: str) -> None:
        """Name a muscle in the picture, with what it does, and trace it; one that is named no longer."""
        self._picked = "" if muscle == self._picked else muscle
        if self._picked:
            for kind in PICKED:
                if muscle in self._readings.kinds.get(kind, ("", ()))[1]:
                    self.panel.traces.add(kind, muscle)

    def draw(self, now: float) -> None:
        """Send what is new."""
        in_time = now < self._drawn + 2.0 * self._frame
        self._drawn = self._drawn + self._frame if in_time else now
        moment = self._moment()

        def place() -> None:
            self._place(self.figure, 0, moment, np.zeros(3))
            if self.twin is not None:
                self._place(self.twin, 1, moment, self._side)

        at_once(self.server, place)
        if now >= self._read + READING:
            self._read = now
            self._measure(now)
            with self.server.atomic():
                self.panel.refresh()
                self._show_picked(moment)

    def _moment(self) -> Moment:
        """Return what is to be seen: what there is now, or what there was."""
        before = self.history.back(self.back) if self.back > 0.0 else None
        if before is not None:
            return before
        moment = self._readings.read()
        self.history.add(moment)
        return moment

    def _show_picked(self, moment: Moment) -> None:
        """Write beside the muscle that was clicked what it does."""
        place = self.figure.middle_of(self._picked)
        self.tag.visible = place is not None
        if place is None:
            return
        group = BODIES[self.session.sim.scene.spec.body].group_of(self._picked)
        parts = [f"{self._picked} ({group})" if group else self._picked]
        for kind in PICKED:
            unit, items = self._readings.kinds.get(kind, ("", ()))
            if self._picked in items:
                value = moment.values[kind][0, items.index(self._picked)]
                parts.append(f"{kind} {value:.3g}" + ("" if unit == "1" else f" {unit}"))
        self.tag.text, self.tag.position = " · ".join(parts), place

    @property
    def _frame(self) -> float:
        """Time between two frames [s]."""
        figures = [self.figure] + ([self.twin] if self.twin is not None else [])
        return max(FRAME, sum(figure.bytes_per_frame for figure in figures) / TRAFFIC)

    def _step(self, now: float) -> None:
        """Make the step that is due."""
        dt = self.session.sim.scene.control_dt / self.speed
        self._due = self._due + dt if now < self._due + dt + LATE else now + dt
        if not self.attempt(self.session.step):
            self.playing = False

    def _measure(self, now: float) -> None:
        """Find out how fast it is, over the last second."""
        self._progress.append((now, self.session.steps))
        while len(self._progress) > 1 and now - self._progress[0][0] > 1.0 + READING:
            self._progress.popleft()
        (begin, first), steps = self._progress[0], self.session.steps
        elapsed = (steps - first) * self.session.sim.scene.control_dt
        self.factor = elapsed / (now - begin) if now > begin else 0.0

    def _open(self) -> None:
        """Send all that a session's page begins with."""
        model, scene = self.session.sim.full_model, self.server.scene
        self._readings, self.history, self.back = Readings(self.session), History(), 0.0
        self._picked, self.tag = "", scene.add_label("/picked", "", visible=False)
        self._framing = Framing(model, BODIES[self.session.sim.scene.spec.body].tips, ASPECT)
        if self.session.file is not None:
            self._framing.fit(self._near_rest(model))
        self._progress.clear()
        name_page(self.server, title_of(self.session.title))
        self._roots = {name: scene.add_frame(name, show_axes=False) for name in ("/world", "/twin")}
        self.figure = self._figure("/world")
        self.twin = None
        look.pose(model, self.figure.data, look.rest_pose(model))
        self._camera = self._framing.camera(self.figure.data, {})
        axes = view_axes(self._camera.azimuth, self._camera.elevation)
        self._side, self._farther = self._framing.twin()
        above = self._camera.lookat + 0.55 * self._framing.height * axes[1]
        self._labels = {
            name: scene.add_label(
                f"{name}_label", text, position=above + shift, visible=False, font_screen_scale=LETTERS
            )
            for name, text, shift in (("/world", "changed", 0.0), ("/twin", "before", self._side))
        }
        file = self.session.file
        self._floor = Floor(self.server, "/world/floor", model, self._framing, always=file is not None)
        if not self.session.scored:
            self.playing = False
            self.session.pose(look.rest_pose(model))
        self.panel = Panel(self, self._readings, self.history)
        if self.session.beside:
            self.show_twin(True)
        else:
            self.aim()

    def _near_rest(self, model: mujoco.MjModel) -> Iterator[tuple[mujoco.MjData, dict[str, np.ndarray]]]:
        """Yield poses near rest: those at the ends of joints without limits make the body small."""
        rest, data = look.rest_pose(model), mujoco.MjData(model)
        for pose in motion_samples(model):
            look.pose(model, data, rest + NEAR_REST * (pose - rest))
            yield data, {}

    def _close(self) -> None:
        """Take a session out of the page."""
        for node in (self.tag, *self._labels.values(), *self._roots.values()):
            node.remove()
        self.panel.remove()

    def _figure(self, name: str) -> Figure:
        """Return a world's figure under a node."""
        sim = self.session.sim
        tips = BODIES[sim.scene.spec.body].tips
        return Figure(
            self.server,
            f"{name}/body",
            sim.full_model,
            self._framing.radius,
            tips,
            pick=lambda muscle: self.ask("pick", lambda: self.pick(muscle)),
        )

    def _place(self, figure: Figure, twin: int, moment: Moment, aside: np.ndarray) -> None:
        """Show the world or its twin; the body stays in the middle, and the floor goes by."""
        session = self.session
        hidden = session.hidden(session.twin if twin else session.world)

        def shift(data: mujoco.MjData) -> np.ndarray:
            return aside - (self._framing.shift(data) if self.follow else 0.0)

        try:
            seen = moment.seen[twin]
            if session.file is not None:  # nobody has asked for the goals of the task that was made of it
                seen = seen._replace(ghost=None, goals={})
            figure.show(seen, self.color, hidden, shift)
        except ValueError as error:  # a state that is not finite; the next step resets it
            self.message = str(error)
            return
        if figure is self.figure:
            self._floor.show(shift(figure.data))

    def view(self, width: int, height: int) -> View:
        """Return the camera for a picture of a size [px]: all is above the traces."""
        camera = copy.copy(self._camera)
        if self.session.beside:
            camera.distance *= self._farther
            camera.lookat += 0.5 * self._side
        opening = float(np.radians(self.session.sim.full_model.vis.global_.fovy))
        return above_traces(camera, opening, ASPECT, (width, height))
