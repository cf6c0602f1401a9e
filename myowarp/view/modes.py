"""The ways to show worlds, and what has to be installed for each."""

import importlib.util
import os
import platform
from typing import Literal

from myowarp.definitions.registry import check_choice

NEEDED = {"gl": ("newton", "pyglet", "imgui_bundle"), "viser": ("viser",), "null": ("newton",)}
"""Packages of each kind of viewer."""


def live_viewer() -> Literal["gl", "viser"]:
    """Return the kind of viewer for this machine: a window; on Linux without a display, a browser page."""
    return "gl" if platform.system() != "Linux" or os.environ.get("DISPLAY") else "viser"


def render_modes() -> tuple[str, ...]:
    """Return Gymnasium's names of the ways to show worlds, without those that need what is not installed."""
    shows = all(map(importlib.util.find_spec, NEEDED[live_viewer()]))
    return ("human", "rgb_array") if shows else ("rgb_array",)


def check_viser(what: str) -> None:
    """Raise ImportError if the package that draws pages is not installed."""
    if importlib.util.find_spec("viser") is None:
        raise ImportError(f'{what} needs viser, which is not installed; run `pip install "myowarp[view]"`')


def check_render_mode(mode: str | None) -> None:
    """Raise if there is no such render mode.

    Raises:
        ValueError: It is unknown.
        ImportError: Its viewer is not installed.
    """
    check_choice("render_mode", mode, (None, "human", "rgb_array"))
    if mode == "human" and mode not in render_modes():
        packages = " and ".join(NEEDED[live_viewer()])
        raise ImportError(
            f'render_mode="human" needs {packages}, got an installation without; run '
            '`pip install "myowarp[view]"`'
        )
