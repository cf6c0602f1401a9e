"""The panel of a page: what runs, the patient, and traces; readings as text and curves."""

from __future__ import annotations

import html
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from viser import uplot

from myowarp.definitions.condition import CONDITIONS
from myowarp.definitions.registry import check_choice
from myowarp.sim.patient import Knob
from myowarp.view.browser.controls import ERRORS, Controls
from myowarp.view.drawing.muscles import QUANTITIES, Quantity

FASTEST, SLOWEST = 10.0, 0.05
"""Speeds over real time that can be chosen."""
HISTORY = 180
"""Drawn frames that a trace goes back."""
MOST_TRACES = 8
"""Curves in a plot."""
INKS = ("#2563eb", "#dc2626", "#059669", "#d97706", "#7c3aed", "#0891b2", "#be185d", "#4d7c0f")
TRACED = {
    "activation": "activation",
    "excitation": "excitation",
    "force": "force / N",
    "fiber_length": "musculotendon length / m",
    "fatigue": "fatigue",
}
"""What the curves of muscles are, by what their colour is."""
NOTHING = "add ..."
PLAY, STEP, RESET = BUTTONS = ("Play / Pause", "Step", "Reset")


class Panel:
    """The controls and readings of a session, the same in all pages."""

    def __init__(self, live: Controls) -> None:
        """Make them."""
        self._live, self._gui, self._session = live, live.server.gui, live.session
        self._gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._gui.main_panel.dock_right()
        self._tabs = self._gui.add_tab_group()
        with self._tabs.add_tab("Run"):
            self._add_run()
        with self._tabs.add_tab("Patient"):
            self._add_patient()
        with self._tabs.add_tab("Traces"):
            self._muscle_traces = Traces(live, "muscle", tuple(live.session.sim.scene.muscles.names))
            joints = live.session.signals.joint_names if live.session.signals else ()
            self._joint_traces = Traces(live, "joint", joints)
        self.refresh()

    def remove(self) -> None:
        """Take all of it out of the page."""
        self._tabs.remove()

    def refresh(self) -> None:
        """Show time, speed, return and success, and bring the curves up to date."""
        self._status.content = status(self._live)
        self._muscle_traces.refresh()
        self._joint_traces.refresh()

    def record(self) -> None:
        """Keep the present values for the traces."""
        session, live = self._session, self._live
        if session.signals is None:
            return
        worlds = (session.world, session.twin)
        values = np.stack([self._muscle_values(world) for world in worlds])
        self._muscle_traces.record(values, TRACED[live.color])
        self._joint_traces.record(session.signals.joint_angles[list(worlds)], "angle / rad, slides m")

    def _muscle_values(self, world: int) -> np.ndarray:
        """Return what is `TRACED` of each muscle of a world, shape (num_muscles,)."""
        session, live = self._session, self._live
        assert session.signals is not None
        arrays = session.signals.muscles
        if live.color == "force":
            return arrays.force.numpy()[world]
        if live.color == "fiber_length":
            return arrays.length.numpy()[world]
        if live.color == "fatigue":
            found = session.signals.info.get("fatigue")
            return found.numpy()[world] if found is not None else np.zeros(arrays.force.shape[1])
        return getattr(arrays, live.color).numpy()[world]

    def _drive(self, button: str) -> None:
        """Do what a button says."""
        check_choice("button", button, BUTTONS)
        if button == PLAY:
            self._live.playing = not self._live.playing
        elif button == STEP:
            self._live.single_step()
        else:
            self._reset()

    def _reset(self) -> None:
        """Begin new episodes; a session that no reset heals is opened anew, as its patient was at first."""
        session, live = self._session, self._live
        try:
            session.restart()
        except ValueError as error:
            live.complain(f"{error}; the task is opened anew, without changes to the patient")
            live.open(session.title, session.policy)

    def _add_run(self) -> None:
        """Add readings, what drives, and what is chosen."""
        live, gui, session = self._live, self._gui, self._session
        self._status = gui.add_html(status(live))
        drive = gui.add_button_group("", BUTTONS)
        drive.on_click(lambda _: live.ask("drive", lambda: self._drive(drive.value)))
        label, ends = "speed / real time", (SLOWEST, FASTEST)
        self._slide(
            "speed", label, ends, 0.05, lambda: live.speed, lambda value: setattr(live, "speed", value)
        )
        tasks = live.choices.tasks
        self._choose("task", tasks, session.title, lambda task: live.open(task, session.policy))
        policies = live.choices.policies(session.sim.scene.spec)
        self._choose("policy", policies, lambda: session.policy, session.act)
        worlds = [str(world) for world in range(session.twin)]
        if len(worlds) > 1:
            self._choose("world", worlds, lambda: str(session.world), lambda name: session.show(int(name)))
        self._choose("color", QUANTITIES, lambda: live.color, self._set_color)
        self._legend = gui.add_html(legend(QUANTITIES[live.color]))
        follow = gui.add_checkbox("camera follows", live.follow)
        self._on("follow", follow, lambda value: setattr(live, "follow", value), lambda: live.follow)

    def _add_patient(self) -> None:
        """Add the knobs: each acts on the muscles that are chosen above them."""
        live, gui, patient = self._live, self._gui, self._session.patient
        if not patient.knobs:
            gui.add_markdown("This body has no conditions.")
            return
        beside = gui.add_checkbox("beside: the same without the change", live.session.beside)
        self._on("beside", beside, live.show_twin, lambda: live.session.beside)
        self._muscles = next(iter(patient.groups))
        if len(patient.groups) > 1:
            self._choose("muscles", patient.groups, lambda: self._muscles, self._choose_muscles)
        gui.add_button("Undo all changes").on_click(lambda _: live.ask("undo", self._undo))
        self._before = {knob: knob.parameter.values(0).copy() for knob in patient.knobs.values()}
        self._sliders: dict[Knob, Any] = {}
        self._hints: dict[Knob, viser.GuiMarkdownHandle] = {}
        for condition in dict.fromkeys(knob.condition for knob in patient.knobs.values()):
            with gui.add_folder(condition.replace("_", " ")):
                self._add_hint(condition)
                for knob in patient.knobs.values():
                    if knob.condition == condition:
                        self._add_slider(knob)
        self._show_hints()

    def _add_hint(self, condition: str) -> None:
        """Add what says why the sliders of a condition change nothing yet."""
        kind = CONDITIONS[condition]
        if knob := self._session.patient.knobs.get(f"{condition} {kind.NEEDS}"):
            text = f"No effect while *{kind.NEEDS}* is {kind.NEUTRAL[kind.NEEDS]:g}."
            self._hints[knob] = self._gui.add_markdown(text)

    def _add_slider(self, knob: Knob) -> None:
        """Add the slider of a knob."""

        def turn(value: float) -> None:
            self._session.turn(knob, value, self._session.patient.groups[self._muscles])
            self._show_hints()

        label, ends = knob.field.replace("_", " "), (knob.low, knob.high)
        self._sliders[knob] = self._slide(knob.name, label, ends, knob.step, lambda: self._value(knob), turn)

    def _value(self, knob: Knob) -> float:
        """Return what the chosen muscles have."""
        session = self._session
        return session.patient.value(knob, session.world, session.patient.groups[self._muscles])

    def _choose_muscles(self, muscles: str) -> None:
        """Let the knobs act on other muscles, and show theirs."""
        self._muscles = muscles
        self._show_knobs()

    def _undo(self) -> None:
        """Give the patient what it had at first."""
        for knob, values in self._before.items():
            knob.parameter.set(values, range(self._session.twin), range(len(values)))
        self._session.patient.forget()
        self._show_knobs()

    def _show_knobs(self) -> None:
        """Move the sliders to what there is."""
        for knob, slider in self._sliders.items():
            slider.value = self._value(knob)
        self._show_hints()

    def _show_hints(self) -> None:
        """Show the hints that hold for the chosen muscles."""
        for knob, hint in self._hints.items():
            hint.visible = self._value(knob) == CONDITIONS[knob.condition].NEUTRAL[knob.field]

    def _set_color(self, color: str) -> None:
        """Change what the colour of a muscle shows."""
        self._live.color = color
        self._legend.content = legend(QUANTITIES[color])
        self._muscle_traces.clear()

    def _slide(
        self,
        key: str,
        label: str,
        ends: tuple[float, float],
        step: float,
        now: Callable[[], float],
        do: Callable[[float], object],
    ) -> viser.GuiSliderHandle[float]:
        """Add a slider; who does not use a browser may send what lies outside of its ends."""
        low, high = ends
        handle = self._gui.add_slider(label, low, high, step, now())

        def check(value: float) -> None:
            if not low <= value <= high:
                raise ValueError(f"{key} must be from {low:g} to {high:g}, got {value:g}")
            do(value)

        self._on(key, handle, check, now)
        return handle

    def _choose(
        self, label: str, options: Any, now: str | Callable[[], str], do: Callable[[str], object]
    ) -> None:
        """Add a list to choose from."""
        current = now if callable(now) else lambda: now
        handle = self._gui.add_dropdown(label, tuple(options), initial_value=current())

        def check(name: str) -> None:
            check_choice(label, name, tuple(options))
            do(name)

        self._on(label, handle, check, current)

    def _on(self, key: str, handle: Any, do: Callable[[Any], object], now: Callable[[], Any]) -> None:
        """Have something done when a control is moved; a control that cannot have its way goes back."""

        def wish() -> None:
            if handle.value == now():
                return
            try:
                do(handle.value)
            except ERRORS:
                handle.value = now()
                raise
            self._live.message = ""

        handle.on_update(lambda _: self._live.ask(key, wish))


class Traces:
    """Curves of chosen quantities over the last seconds: the shown world, and the twin dashed."""

    def __init__(self, live: Controls, kind: str, names: tuple[str, ...]) -> None:
        """Add a list to choose from, and room for the plot."""
        self._live, self._gui, self._names, self._kind = live, live.server.gui, names, kind
        self._chosen: list[str] = list(names[:1])
        self._times: deque[float] = deque(maxlen=HISTORY)
        self._values: deque[np.ndarray] = deque(maxlen=HISTORY)
        self._label = ""
        self._plot: viser.GuiUplotHandle | None = None
        self._drawn: object = None
        if not names:
            return
        self._list: Any = self._gui.add_dropdown(f"{kind}s", (NOTHING, *names), initial_value=NOTHING)
        self._list.on_update(lambda _: live.ask(f"trace {kind}", self._add))
        self._gui.add_button("Clear").on_click(lambda _: live.ask(f"clear {kind}", self._empty))
        self._folder = self._gui.add_folder(kind)

    def record(self, values: np.ndarray, label: str) -> None:
        """Keep values (2, num_names) of shown world and twin, unless nothing has moved."""
        session = self._live.session
        now = session.steps * session.sim.scene.control_dt
        self._label = label
        if not self._times or now > self._times[-1]:
            self._times.append(now)
            self._values.append(values)

    def clear(self) -> None:
        """Begin anew."""
        self._times.clear()
        self._values.clear()

    def refresh(self) -> None:
        """Draw what is new."""
        if not self._names:
            return
        beside = self._live.session.beside
        shown = (tuple(self._chosen), beside, self._label)
        if self._plot is not None:
            # Never removed: a browser does updates after removals, of what it got between two pictures.
            self._plot.visible = bool(self._chosen)
        if not self._chosen or len(self._times) < 2:
            return
        columns = [self._names.index(name) for name in self._chosen]
        values = np.stack(self._values)[:, : 1 + beside][:, :, columns].astype(float)
        data = (np.array(self._times), *values.reshape(len(values), -1).T.copy())
        if self._plot is None:
            with self._folder:
                self._plot = self._gui.add_uplot(
                    data, self._series(beside), title=self._label, aspect=1.4, scales={"x": {"time": False}}
                )
        elif shown != self._drawn:
            self._plot.series, self._plot.title, self._plot.data = self._series(beside), self._label, data
        elif not np.array_equal(self._plot.data[0], data[0]):
            self._plot.data = data
        self._drawn = shown

    def _series(self, beside: bool) -> tuple[uplot.Series, ...]:
        """Return names and looks of the curves."""
        found = [uplot.Series(label="time / s")]
        for twin in range(1 + beside):
            for ink, name in zip(INKS, self._chosen, strict=False):
                label = f"{name} before" if twin else name
                found.append(uplot.Series(label=label, stroke=ink, width=2, dash=(6, 4) if twin else ()))
        return tuple(found)

    def _add(self) -> None:
        """Draw one more."""
        name = self._list.value
        self._list.value = NOTHING
        if name == NOTHING:
            return
        check_choice(self._kind, name, self._names)
        if name not in self._chosen:
            self._chosen = [*self._chosen, name][-MOST_TRACES:]

    def _empty(self) -> None:
        """Draw none."""
        self._chosen = []


def status(live: Controls) -> str:
    """Return the readings, HTML."""
    session = live.session
    state = "" if live.playing else "paused · "
    rows = [
        f"<b>{state}{session.time:.2f} s · step {session.steps}</b>"
        + (" · <b style='color:#059669'>success</b>" if session.success else ""),
        f"return {session.returns[session.world]:.2f} · {live.factor:.2f} × real time",
    ]
    if live.session.beside:
        rows.append(f"return before the change {session.returns[session.twin]:.2f}")
    if live.message:
        rows.append(f"<span style='color:#b91c1c'>{html.escape(live.message)}</span>")
    terms = "".join(
        f"<tr><td>{html.escape(name)}</td><td style='text-align:right;padding-left:1em'>{value:.3f}</td></tr>"
        for name, value in session.terms.items()
    )
    return f"<div style='padding:0.5em 1em;font-size:0.85em'>{'<br>'.join(rows)}<table>{terms}</table></div>"


def legend(quantity: Quantity) -> str:
    """Return the colours of a quantity with its name and its ends, HTML."""
    stops = ",".join(f"rgb({r:.0f},{g:.0f},{b:.0f})" for r, g, b in 255 * np.array(quantity.colors))
    return (
        "<div style='padding:0 1em 0.5em;font-size:0.8em'>"
        f"<div style='height:0.8em;border-radius:3px;background:linear-gradient(to right,{stops})'></div>"
        f"<div style='display:flex;justify-content:space-between'><span>{quantity.low:g}</span>"
        f"<span>{html.escape(quantity.label)}</span><span>{quantity.high:g}</span></div></div>"
    )
