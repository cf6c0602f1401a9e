"""The panel of a page: how it goes, the patient, what runs, the body, and what is traced."""

from __future__ import annotations

from myowarp.view.browser import status as html
from myowarp.view.browser.body_tab import BodyTab
from myowarp.view.browser.controls import Controls
from myowarp.view.browser.drive import Drive
from myowarp.view.browser.history import History
from myowarp.view.browser.patient_tab import PatientTab
from myowarp.view.browser.readings import Readings
from myowarp.view.browser.run_tab import RunTab
from myowarp.view.browser.traces import LiveTraces
from myowarp.view.browser.widgets import Widgets


class Panel:
    """The controls and readings of a session, the same in all pages."""

    def __init__(self, live: Controls, readings: Readings, history: History) -> None:
        """Make them."""
        gui, widgets = live.server.gui, Widgets(live)
        self._drive = Drive(live, lambda: html.status(live))
        self._tabs = gui.add_tab_group()
        with self._tabs.add_tab("Patient"):  # first: its sliders are what a page is opened for
            self.patient = PatientTab(live, widgets)
        with self._tabs.add_tab("Run"):
            self._run = RunTab(live, widgets)
        with self._tabs.add_tab("Body"):
            self._body = BodyTab(live, widgets)
        with self._tabs.add_tab("Traces"):
            self.traces = LiveTraces(live, readings.kinds, history, readings.first)
        self.refresh()

    def remove(self) -> None:
        """Take all of it out of the page."""
        self._drive.remove()
        self._tabs.remove()
        self.traces.remove()

    def refresh(self) -> None:
        """Show what is new."""
        self._drive.refresh()
        self._run.refresh()
        self._body.refresh()
        self.traces.refresh()
