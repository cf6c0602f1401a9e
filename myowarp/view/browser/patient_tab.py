"""The tab of the patient: who it is, the twin without the change, and a slider for each parameter."""

from __future__ import annotations

from typing import Any

import viser

from myowarp.sim.patient import Knob
from myowarp.sim.presets import PRESETS, offered
from myowarp.view.browser.controls import Controls
from myowarp.view.browser.session import HEALTHY
from myowarp.view.browser.widgets import Widgets

BESIDE = "beside: the same without the change"
UNDO = "Undo all changes"
JOINER = "\u2060"
"""Keeps a line from ending behind the stroke of 1/s."""


class PatientTab:
    """The knobs: each acts on the muscles that are chosen above them."""

    def __init__(self, live: Controls, widgets: Widgets) -> None:
        """Add the controls to the container that is open."""
        self._live, self._gui, self._widgets = live, live.server.gui, widgets
        self._sliders: dict[Knob, Any] = {}
        self._hints: dict[Knob, viser.GuiMarkdownHandle] = {}
        patient = live.session.patient
        if not patient.knobs:
            self._gui.add_markdown("This body has no conditions.")
            return
        self._muscles = next(iter(patient.groups))
        self._add_preset()
        widgets.tick(BESIDE, lambda: live.session.beside, live.show_twin)
        if len(patient.groups) > 1:
            widgets.choose(
                "muscles",
                tuple(patient.groups),
                lambda: self._muscles,
                self._choose_muscles,
                "Muscles on which the sliders below act.",
            )
        for condition in dict.fromkeys(knob.condition for knob in patient.knobs.values()):
            with self._gui.add_folder(condition.replace("_", " ")):
                for knob in patient.knobs.values():
                    if knob.condition == condition:
                        self._add_slider(knob)
        widgets.press(UNDO, lambda: self._become(HEALTHY))
        self._show_hints()

    def _add_preset(self) -> None:
        """Add the list of patients, with what each has and where that is from."""
        session = self._live.session
        names = (HEALTHY, *offered(session.patient))
        self._preset = self._widgets.choose(
            "preset", names, lambda: session.preset, self._become, "A patient from the literature."
        )
        self._source = self._gui.add_markdown(_source_of(session.preset))

    def _become(self, preset: str) -> None:
        """Make the patient another one."""
        session = self._live.session
        session.become(preset)
        self._preset.value = preset
        self._source.content = _source_of(preset)
        if preset != HEALTHY and not session.beside:
            self._live.notify(f"Tick {BESIDE.partition(':')[0]!r} to see both.", "blue")
        self._show_knobs()

    def _add_slider(self, knob: Knob) -> None:
        """Add the slider of a knob, and what says why it has no effect now."""

        def turn(value: float) -> None:
            self._live.session.turn(knob, value, self._chosen)
            self._show_hints()

        unit = knob.unit.replace("/", "/" + JOINER)
        label = knob.field.replace("_", " ") + (f" [{unit}]" if unit else "")
        ends = (knob.low, knob.high)
        now = lambda: self._value(knob)  # noqa: E731 (one name for the slider's present value)
        self._sliders[knob] = self._widgets.slide(knob.name, label, ends, knob.step, now, turn, knob.doc)
        self._hints[knob] = self._gui.add_markdown("", visible=False)

    @property
    def _chosen(self) -> tuple[str, ...]:
        """The chosen muscles."""
        return self._live.session.patient.groups[self._muscles]

    def _value(self, knob: Knob) -> float:
        """Return what the chosen muscles have, with three figures."""
        session = self._live.session
        return float(f"{session.patient.value(knob, session.world, self._chosen):.3g}")

    def _choose_muscles(self, muscles: str) -> None:
        """Let the knobs act on other muscles, and show theirs."""
        self._muscles = muscles
        self._show_knobs()

    def _show_knobs(self) -> None:
        """Move the sliders to what there is."""
        for knob, slider in self._sliders.items():
            slider.value = self._value(knob)
        self._show_hints()

    def _show_hints(self) -> None:
        """Show why sliders have no effect on the chosen muscles; once where several have the same reason."""
        session, said = self._live.session, set()
        for knob, hint in self._hints.items():
            reason = session.patient.idle(knob, session.world, self._chosen)
            show = bool(reason) and (knob.condition, reason) not in said
            said.add((knob.condition, reason))
            if hint.content != reason:
                hint.content = reason
            if hint.visible != show:
                hint.visible = show


def _source_of(preset: str) -> str:
    """Return what a patient has and where its values are from, Markdown."""
    if preset == HEALTHY:
        return ""
    return f"{PRESETS[preset].doc} *{PRESETS[preset].source}*"
