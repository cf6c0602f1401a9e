"""Controls of a page that ask the loop: sliders and lists that go back where they cannot have their way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from myowarp.definitions.registry import check_choice
from myowarp.view.browser.controls import Wishes


class Widgets:
    """Adds controls to the container that is open."""

    def __init__(self, live: Wishes) -> None:
        self._live, self._gui = live, live.server.gui

    def slide(
        self,
        key: str,
        label: str,
        ends: tuple[float, float],
        step: float,
        now: Callable[[], float],
        do: Callable[[float], object],
        hint: str = "",
    ) -> Any:
        """Add a slider; who does not use a browser may send what lies outside of its ends."""
        low, high = ends
        handle = self._gui.add_slider(label, low, high, step, min(max(now(), low), high), hint=hint or None)

        def check(value: float) -> None:
            if not low <= value <= high:
                raise ValueError(f"{key} must be from {low:g} to {high:g}, got {value:g}")
            do(value)

        self.on(key, handle, check, now)
        return handle

    def choose(
        self,
        label: str,
        options: Sequence[str],
        now: Callable[[], str],
        do: Callable[[str], object],
        hint: str = "",
    ) -> Any:
        """Add a list to choose from."""
        handle = self._gui.add_dropdown(label, tuple(options), initial_value=now(), hint=hint or None)

        def check(name: str) -> None:
            check_choice(label, name, handle.options)
            do(name)

        self.on(label, handle, check, now)
        return handle

    def tick(self, label: str, now: Callable[[], bool], do: Callable[[bool], object]) -> None:
        """Add a box to tick."""
        self.on(label, self._gui.add_checkbox(label, now()), do, now)

    def press(self, label: str, do: Callable[[], object]) -> None:
        """Add a button."""
        button = self._gui.add_button(label)
        button.on_click(lambda _: self._live.ask(label, do))

    def on(self, key: str, handle: Any, do: Callable[[Any], object], now: Callable[[], Any]) -> None:
        """Have something done when a browser moves a control; one that cannot have its way goes back.

        The value is that of the message: the page, too, moves controls, such as the time of what plays.
        """

        def wish(value: Any) -> None:
            if value == now():
                return
            try:
                do(value)
            except Exception:  # whatever it is, the control goes back, and the page says it
                handle.value = now()
                raise
            self._live.message = ""

        async def hear(event: Any) -> None:  # at once, before the page moves the control again
            if event.client_id is not None:
                value = handle.value
                self._live.ask(key, lambda: wish(value))

        handle.on_update(hear)
