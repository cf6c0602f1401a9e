"""The head of a page's panel: how far it is, and the buttons and keys that play, step and begin anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from myowarp.definitions.registry import check_choice
from myowarp.view.browser.controls import Wishes

PLAY, PAUSE, STEP, RESET = "Play", "Pause", "Step", "Reset"


class Drive:
    """Readings and buttons, in sight whatever tab is open.

    Attributes:
        status: What is written.
    """

    def __init__(self, live: Wishes, status: Callable[[], str]) -> None:
        """Add them to the container that is open.

        Args:
            live: What plays.
            status: Function that returns what is written, HTML.
        """
        self._live, self._read, gui = live, status, live.server.gui
        self.status = gui.add_html(status())
        self._buttons: Any = gui.add_button_group(
            "", self._offered(), hint="Keys: space plays and pauses, right arrow steps, R resets."
        )
        self._buttons.on_click(lambda _: live.ask("drive", lambda: self._press(self._buttons.value)))

    def refresh(self) -> None:
        """Show what is new."""
        self.status.content = self._read()
        if tuple(self._buttons.options) != self._offered():
            self._buttons.options = self._offered()

    def remove(self) -> None:
        """Take it out of the page."""
        self.status.remove()
        self._buttons.remove()

    def _offered(self) -> tuple[str, ...]:
        """Return the buttons that there are now."""
        return (PAUSE if self._live.playing else PLAY, STEP, RESET)

    def _press(self, button: str) -> None:
        """Do what a button says."""
        live = self._live
        actions = {PLAY: live.play, PAUSE: live.pause, STEP: live.single_step, RESET: live.reset}
        check_choice("button", button, tuple(actions))
        actions[button]()
