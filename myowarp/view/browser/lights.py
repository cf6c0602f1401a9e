"""The films' lights in a page: from everywhere, from the viewer, and from a lamp above the left shoulder."""

from __future__ import annotations

import viser

from myowarp.view.drawing.framing import view_axes
from myowarp.view.drawing.scenery import LAMP

AMBIENT, HEADLIGHT, SHOULDER = 0.7, 1.7, 1.7
"""Intensities, so that muscles look like their legend."""


def add_lights(server: viser.ViserServer, name: str, azimuth: float, elevation: float) -> None:
    """Light a scene for a camera at these angles [deg]; the lights stay where they are when it moves.

    Args:
        server: Where.
        name: Their node in the page, a path.
        azimuth: As of MuJoCo's free camera.
        elevation: As of MuJoCo's free camera.
    """
    axes = view_axes(azimuth, elevation)
    server.scene.add_light_ambient(f"{name}/ambient", intensity=AMBIENT)
    for kind, intensity, along in (("headlight", HEADLIGHT, axes[2]), ("lamp", SHOULDER, LAMP @ axes)):
        server.scene.add_light_directional(f"{name}/{kind}", intensity=intensity, position=tuple(-along))
