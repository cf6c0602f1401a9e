"""A world shown live in a window: MuJoCo's passive viewer, with our muscles in its scene."""

from __future__ import annotations

import atexit
import os
import platform
import threading
import warnings
from collections.abc import Iterable

import mujoco
import numpy as np

from myowarp.view.drawing.render import GL_ERRORS, NoGraphicsError, open_graphics
from myowarp.view.drawing.snapshot import Snapshot
from myowarp.view.drawing.world import WorldDrawing, draw_bones_alone

ASPECT = 4 / 3
"""Width over height of what is framed; most windows are wider."""
CLOSING = 10.0
"""s: longest wait for the viewer's thread."""
HEIGHT = 720
"""Pixels of the window, about; a tendon is at least one wide."""


class Window:
    """Shows a world of a model as it moves."""

    def __init__(self, model: mujoco.MjModel, tips: Iterable[str] = (), color: str = "activation") -> None:
        """Open it.

        Args:
            model: The full (unslimmed) model; it is not changed.
            tips: Names of the sites at the ends of the limb.
            color: What the colour of a muscle shows, a name in `myowarp.view.drawing.muscles.QUANTITIES`.

        Raises:
            NoGraphicsError: No window opens here.
        """
        check_window()
        from mujoco import viewer

        others = set(threading.enumerate())
        self._drawing = WorldDrawing(model, tips, ASPECT, color)
        try:
            self._viewer = viewer.launch_passive(
                self._drawing.model, self._drawing.data, show_left_ui=False, show_right_ui=False
            )
        except RuntimeError as error:
            raise NoGraphicsError(str(error)) from error
        self._threads = set(threading.enumerate()) - others
        atexit.register(self.close)
        self._shift: np.ndarray | None = None
        self._fields = self._drawing.model.hfield_data.copy()
        with self._viewer.lock():
            draw_bones_alone(self._viewer.opt)

    def show(self, seen: Snapshot) -> None:
        """Show a moment of a world; nothing happens once the window was closed.

        Raises:
            ValueError: A shape is wrong or a position is not finite.
        """
        drawing, scene, camera = self._drawing, self._viewer.user_scn, self._viewer.cam
        drawing.check(seen)
        with self._viewer.lock():
            data = drawing.pose(seen)
            shift = drawing.framing.shift(data)
            if self._shift is None:
                framed = drawing.framing.camera(data, seen.goals)
                camera.azimuth, camera.elevation = framed.azimuth, framed.elevation
                camera.lookat[:], camera.distance = framed.lookat, framed.distance
            else:
                camera.lookat += shift - self._shift
            self._shift = shift
            scene.ngeom = 0
            drawing.add(scene, seen, np.array(camera.lookat), 2.0 * drawing.framing.radius / HEIGHT)
        if not np.array_equal(self._fields, drawing.model.hfield_data):
            self._fields = drawing.model.hfield_data.copy()
            for field in range(drawing.model.nhfield):
                self._viewer.update_hfield(field)
        self._viewer.sync()

    def close(self) -> None:
        """Close it; safe to call twice.

        The viewer's thread is waited for: it draws on while it ends, and GLFW ends with the process.
        """
        self._viewer.close()
        for thread in self._threads:
            thread.join(CLOSING)
        atexit.unregister(self.close)


def check_window() -> None:
    """Raise NoGraphicsError where no window opens; the viewer would say so in a thread, and never return.

    On macOS nothing is tried: only the main thread may, which is that of MuJoCo's `mjpython`.
    """
    if platform.system() == "Darwin":
        return
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from mujoco import viewer  # noqa: F401 (finds GLFW's library)
            from mujoco.glfw import GLContext

            context = open_graphics(GLContext, 1, 1)
            mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), 100).free()
            context.free()
    except GL_ERRORS as error:
        display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise NoGraphicsError(
            f"a window needs a display with OpenGL, got none at {display!r} ({reason.rstrip('.')})"
        ) from error
