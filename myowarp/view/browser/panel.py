"""The panel of a page: what runs, the patient, the body, and what is traced."""

from __future__ import annotations

from myowarp.view.browser.body_tab import BodyTab
from myowarp.view.browser.controls import Controls
from myowarp.view.browser.history import History
from myowarp.view.browser.patient_tab import PatientTab
from myowarp.view.browser.readings import Readings
from myowarp.view.browser.run_tab import RunTab
from myowarp.view.browser.traces import Traces
from myowarp.view.browser.widgets import Widgets


class Panel:
    """The controls and readings of a session, the same in all pages."""

    def __init__(self, live: Controls, readings: Readings, history: History) -> None:
        """Make them."""
        gui, widgets = live.server.gui, Widgets(live)
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        self._tabs = gui.add_tab_group()
        with self._tabs.add_tab("Run"):
            self._run = RunTab(live, widgets)
        with self._tabs.add_tab("Patient"):
            self.patient = PatientTab(live, widgets)
        with self._tabs.add_tab("Body"):
            self._body = BodyTab(live, widgets)
        with self._tabs.add_tab("Traces"):
            self.traces = Traces(live, readings.kinds, history)
        self.refresh()

    def remove(self) -> None:
        """Take all of it out of the page."""
        self._tabs.remove()
        self.traces.remove()

    def refresh(self) -> None:
        """Show what is new."""
        self._run.refresh()
        self._body.refresh()
        self.traces.refresh()
