"""The tab of the patient: who it is, the twin without the change, and a slider for each parameter."""

from __future__ import annotations

from typing import Any

import viser

from myowarp.definitions.condition import CONDITIONS
from myowarp.sim.patient import Knob
from myowarp.sim.presets import PRESETS, offered
from myowarp.view.browser.controls import Controls
from myowarp.view.browser.names import places
from myowarp.view.browser.session import HEALTHY
from myowarp.view.browser.widgets import Widgets

BESIDE = "beside: the same without the change"
ADVICE = "Pull *remaining strength* down to 0.3, and tick *beside*."
FIRST = ("sarcopenia", "joint_device", "exoskeleton")
"""Conditions that come first, in this order."""
UNDO = "Undo all changes"
JOINER = "\u2060"
"""Keeps a line from ending behind the stroke of 1/s."""
Dial = tuple[Knob, ...]
"""The same parameter at all places of a body: one slider acts on those that are chosen."""


class PatientTab:
    """The knobs: each acts on the muscles that are chosen above them.

    Attributes:
        muscles: Name of the chosen muscles' group.
        sliders: The slider of each parameter.
    """

    def __init__(self, live: Controls, widgets: Widgets) -> None:
        """Add the controls to the container that is open."""
        self._live, self._gui, self._widgets = live, live.server.gui, widgets
        self.sliders: dict[Dial, Any] = {}
        self._hints: dict[Dial, viser.GuiMarkdownHandle] = {}
        self._places: dict[str, tuple[str, ...]] = {}
        patient = live.session.patient
        if not patient.knobs:
            self._gui.add_markdown("This body has no conditions.")
            return
        self.muscles = next(iter(patient.groups))
        if "sarcopenia strength" in patient.knobs:
            self._gui.add_markdown(ADVICE)
        self._add_preset()
        widgets.tick(BESIDE, lambda: live.session.beside, live.show_twin)
        if len(patient.groups) > 1:
            widgets.choose(
                "muscles",
                tuple(patient.groups),
                lambda: self.muscles,
                self._choose_muscles,
                "Muscles on which the sliders below act.",
            )
        conditions = dict.fromkeys(knob.condition for knob in patient.knobs.values())
        for condition in dict.fromkeys((*FIRST, *conditions)):
            if condition in conditions:
                with self._gui.add_folder(CONDITIONS[condition].TITLE or condition.replace("_", " ")):
                    self._add_sliders([k for k in patient.knobs.values() if k.condition == condition])
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

    def _add_sliders(self, knobs: list[Knob]) -> None:
        """Add the sliders of a condition, and where it may be worn at several places, a list of those."""
        (condition,), at = {knob.condition for knob in knobs}, dict.fromkeys(knob.place for knob in knobs)
        offered = places(tuple(at)) if any(at) else {"": ("",)}
        self._places[condition] = next(iter(offered.values()))
        if len(offered) > 1:
            named = lambda: next(n for n, own in offered.items() if own == self._places[condition])  # noqa: E731

            def move(name: str) -> None:
                self._places[condition] = offered[name]
                self._show_knobs()

            self._widgets.choose("worn at", tuple(offered), named, move, "Joint on which the sliders act.")
        for field in dict.fromkeys(knob.field for knob in knobs):
            self._add_slider(tuple(knob for knob in knobs if knob.field == field))

    def _add_slider(self, dial: Dial) -> None:
        """Add the slider of a parameter, and what says why it has no effect now."""

        def turn(value: float) -> None:
            for knob in self._acting(dial):
                self._live.session.turn(knob, value, self._chosen)
            self._show_hints()

        knob = dial[0]
        now = lambda: self._value(self._acting(dial))  # noqa: E731 (the slider's present value)
        self.sliders[dial] = self._widgets.slide(
            f"{knob.condition} {knob.field}",
            knob.label.replace("/", "/" + JOINER),
            (knob.low, knob.high),
            knob.step,
            now,
            turn,
            knob.doc,
        )
        self._hints[dial] = self._gui.add_markdown("", visible=False)

    def _acting(self, dial: Dial) -> Dial:
        """Return what a slider acts on: the parameter at the chosen places."""
        return tuple(knob for knob in dial if knob.place in self._places[knob.condition])

    @property
    def _chosen(self) -> tuple[str, ...]:
        """The chosen muscles."""
        return self._live.session.patient.groups[self.muscles]

    def _value(self, knobs: Dial) -> float:
        """Return what the chosen muscles have, the mean of some knobs, with three figures."""
        session = self._live.session
        values = [session.patient.value(knob, session.world, self._chosen) for knob in knobs]
        return float(f"{sum(values) / len(values):.3g}")

    def _choose_muscles(self, muscles: str) -> None:
        """Let the knobs act on other muscles, and show theirs."""
        self.muscles = muscles
        self._show_knobs()

    def _show_knobs(self) -> None:
        """Move the sliders to what there is."""
        for dial, slider in self.sliders.items():
            slider.value = self._value(self._acting(dial))
        self._show_hints()

    def _show_hints(self) -> None:
        """Show why sliders have no effect on the chosen muscles; once where several have the same reason."""
        session, said = self._live.session, set()
        for dial, hint in self._hints.items():
            knob = self._acting(dial)[0]
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
