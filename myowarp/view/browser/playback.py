"""A film that the reader turns while it plays: viser's recording of bodies and muscles.

A `.viser` file is played by viser's page; an `.html` file is page and recording in one.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import viser

from myowarp.disk import in_place
from myowarp.view.browser.lights import add_lights
from myowarp.view.browser.scene import SPACING, Figure, Floor
from myowarp.view.browser.server import close_server, open_server
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, view_axes
from myowarp.view.drawing.muscles import QUANTITIES
from myowarp.view.drawing.snapshot import Snapshot

FASTEST = 30.0
"""1/s: of more pictures some are left out."""
KEY = (
    "<div style='position:fixed;left:50%;bottom:44px;transform:translateX(-50%);width:min(15rem,60vw);"
    "padding:4px 8px;border-radius:4px;background:#fffc;color:#222;font:12px/1.3 system-ui,sans-serif;"
    "pointer-events:none;z-index:9'><div style='height:9px;border-radius:3px;background:{colors}'></div>"
    "<div style='display:flex;justify-content:space-between'><span>{low:g}</span><span>{label}</span>"
    "<span>{high:g}</span></div></div>"
)
"""The legend of muscle colours, above viser's bar of times."""


class Take(NamedTuple):
    """A world over time.

    Attributes:
        model: The full model.
        tips: Names of the sites at the ends of the limb.
        frames: What it looked like, by step.
        captions: Lines of text, by step.
    """

    model: mujoco.MjModel
    tips: tuple[str, ...]
    frames: Sequence[Snapshot]
    captions: Sequence[Sequence[str]]


class _Actor:
    """A world in the recording: its body, with the text above it."""

    def __init__(
        self, server: viser.ViserServer, name: str, take: Take, color: str, place: np.ndarray
    ) -> None:
        """Send what does not change."""
        self.take, self._color, self._place = take, color, place
        self.framing = Framing(take.model, take.tips, 1.0)
        self.figure = Figure(server, f"{name}/body", take.model, self.framing.radius, take.tips)
        self._floor = Floor(server, f"{name}/floor", take.model, self.framing)
        look.pose(take.model, self.figure.data, look.rest_pose(take.model))
        self.camera = self.framing.camera(self.figure.data, {})
        up = view_axes(self.camera.azimuth, self.camera.elevation)[1]
        above = place + self.camera.lookat + 1.05 * self.framing.radius * up
        self._label = server.scene.add_label(f"{name}_label", "", position=above)

    def show(self, step: int) -> None:
        """Show a step."""
        self.figure.show(self.take.frames[step], self._color, shift=self._shift)
        self._floor.show(self._shift(self.figure.data))
        self._label.text = " · ".join(self.take.captions[step])

    def _shift(self, data: mujoco.MjData) -> np.ndarray:
        """Return how far all is moved aside [m], shape (3,)."""
        return self._place - self.framing.shift(data)


def write_playback(path: Path, takes: Sequence[Sequence[Take]], color: str, fps: float) -> None:
    """Write worlds as they move, side by side.

    Args:
        path: File to write, `.viser` or `.html`.
        takes: Rows of worlds with the same number of frames.
        color: What the colour of a muscle shows, a name in `myowarp.view.drawing.muscles.QUANTITIES`.
        fps: Frames per second.
    """
    server = open_server(0, path.stem)
    try:
        sky = (255 * look.SKY_RGB).round().astype(np.uint8)
        server.scene.set_background_image(sky.reshape(1, 1, 3), "png")
        first = takes[0][0]
        framing = Framing(first.model, first.tips, 1.0)
        axes, apart = view_axes(framing.azimuth, framing.elevation), SPACING * framing.radius
        add_lights(server, axes[2])
        actors = [
            _Actor(server, f"/{row}_{column}", take, color, apart * (column * axes[0] - row * axes[1]))
            for row, line in enumerate(takes)
            for column, take in enumerate(line)
        ]
        _aim(server, actors[0], apart, len(takes), len(takes[0]))
        stride = int(np.ceil(fps / FASTEST))
        serializer = None
        for step in range(0, len(first.frames), stride):
            for actor in actors:
                actor.show(step)
            serializer = serializer or server.get_scene_serializer()
            serializer.insert_sleep(stride / fps)
        assert serializer is not None
        if path.suffix.lower() == ".html":
            key = QUANTITIES[color]
            drawn = KEY.format(colors=key.css(), low=key.low, high=key.high, label=key.label)
            content = serializer.as_html().replace("</body>", f"{drawn}</body>").encode()
        else:
            content = serializer.serialize()
        with in_place(path) as scratch:
            scratch.write_bytes(content)
    finally:
        close_server(server)


def _aim(server: viser.ViserServer, actor: _Actor, apart: float, rows: int, columns: int) -> None:
    """Point the camera at the middle of all bodies."""
    camera = actor.camera
    axes = view_axes(camera.azimuth, camera.elevation)
    middle = camera.lookat + 0.5 * apart * ((columns - 1) * axes[0] - (rows - 1) * axes[1])
    start = server.initial_camera
    start.look_at, start.fov = middle, float(np.radians(actor.take.model.vis.global_.fovy))
    start.position = middle - (0.3 + 0.7 * max(rows, columns)) * camera.distance * axes[2]
