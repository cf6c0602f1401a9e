"""The ways to show worlds, and what they need."""

import importlib.util
import os
import platform

from myowarp.definitions.registry import check_choice
from myowarp.extras import check_installed


def has_display() -> bool:
    """Return whether a window may open: on Linux with a display, on macOS under MuJoCo's `mjpython`.

    Whether the display answers, and has OpenGL, is found out by opening the window.
    """
    if platform.system() == "Darwin":
        return "MJPYTHON_BIN" in os.environ
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return platform.system() != "Linux" or bool(named)


def has_browser() -> bool:
    """Return whether a browser may open: on Linux with a display. One in the terminal would take it over."""
    return platform.system() != "Linux" or has_display()


def render_modes() -> tuple[str, ...]:
    """Return Gymnasium's names of the ways to show worlds, without those that need what is not there."""
    shows = has_display() or importlib.util.find_spec("viser") is not None
    return ("human", "rgb_array") if shows else ("rgb_array",)


def check_viser(what: str) -> None:
    """Raise ImportError if the package that draws pages is not installed."""
    check_installed(what, "viser", "view")


def check_render_mode(mode: str | None) -> None:
    """Raise if there is no such render mode.

    Raises:
        ValueError: It is unknown.
        ImportError: What shows it is not installed.
    """
    check_choice("render_mode", mode, (None, "human", "rgb_array"))
    if mode == "human" and not has_display():
        check_viser('render_mode="human" without a display')
