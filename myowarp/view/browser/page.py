"""A page without a panel: what `render_mode="human"` opens where no window opens."""

from __future__ import annotations

import mujoco
import numpy as np
from rich.console import Console

from myowarp.view.browser.lights import add_lights
from myowarp.view.browser.moments import at_once
from myowarp.view.browser.scene import Figure
from myowarp.view.browser.server import close_server, open_server
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, view_axes
from myowarp.view.drawing.snapshot import Snapshot


class Page:
    """Shows a world on this machine.

    Attributes:
        server: The page's server.
    """

    def __init__(self, model: mujoco.MjModel, tips: tuple[str, ...], color: str, title: str) -> None:
        """Open it at a free port, and say where.

        Args:
            model: The full model.
            tips: Names of the sites at the ends of the limb.
            color: What the colour of a muscle shows, a name in `myowarp.view.drawing.muscles.QUANTITIES`.
            title: Title of the page.
        """
        self._color = color
        framing = Framing(model, tips)
        self.server = open_server(0, title)
        self._figure = Figure(self.server, "/world", model, framing.radius, tips)
        look.pose(model, self._figure.data, look.rest_pose(model))
        camera, start = framing.camera(self._figure.data, {}), self.server.initial_camera
        start.look_at, start.fov = camera.lookat, float(np.radians(model.vis.global_.fovy))
        forward = view_axes(camera.azimuth, camera.elevation)[2]
        start.position = camera.lookat - camera.distance * forward
        add_lights(self.server, forward)
        Console(stderr=True, highlight=False).print(f"Open http://localhost:{self.server.get_port()}")

    def show(self, seen: Snapshot) -> None:
        """Show a moment.

        Raises:
            ValueError: A position is not finite.
        """
        at_once(self.server, lambda: self._figure.show(seen, self._color))

    def close(self) -> None:
        """Stop serving."""
        close_server(self.server)
