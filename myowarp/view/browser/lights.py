"""The films' lights in a page: from everywhere, from the viewer, and from a lamp above the left shoulder."""

from __future__ import annotations

import numpy as np
import viser

from myowarp.view.drawing.framing import view_axes
from myowarp.view.drawing.scenery import LAMP

AMBIENT, HEADLIGHT, SHOULDER = 0.7, 1.7, 1.7
"""Intensities, so that muscles look like their legend."""


def add_lights(server: viser.ViserServer, forward: np.ndarray) -> None:
    """Light a page for a camera that looks along a direction (3,), in place of the lights that it has.

    The lights stay where they are when the camera moves.
    """
    across = float(np.hypot(forward[0], forward[1]))
    axes = view_axes(*np.degrees((np.arctan2(forward[1], forward[0]), np.arctan2(forward[2], across))))
    server.scene.add_light_ambient("/lights/ambient", intensity=AMBIENT)
    for kind, intensity, along in (("headlight", HEADLIGHT, axes[2]), ("lamp", SHOULDER, LAMP @ axes)):
        server.scene.add_light_directional(f"/lights/{kind}", intensity=intensity, position=tuple(-along))
