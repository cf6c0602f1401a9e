"""The height field of MyoSuite's legs: 12 m by 12 m, 100 by 100 points, a base of 1 mm."""

import mujoco
import numpy as np

TERRAIN = "terrain"
"""Name of the field and of its geom."""
FIELD_POINTS = 100  # along each side
HALF_LENGTH = 6.0  # m
BASE = 0.001  # m


def add_field(spec: mujoco.MjSpec, heights: np.ndarray, place: float = 0.0) -> None:
    """Add the field to the world.

    Args:
        spec: The model, in place.
        heights: Of its points above `place` [m], rows along x, shape (FIELD_POINTS, FIELD_POINTS); the lowest
            is 0.
        place: Height of the field above the floor [m].
    """
    highest = float(heights.max()) or 1.0  # MuJoCo keeps them from 0 to 1
    size = (HALF_LENGTH, HALF_LENGTH, highest, BASE)
    rows, columns = heights.shape
    spec.add_hfield(
        name=TERRAIN, size=size, nrow=rows, ncol=columns, userdata=(heights / highest).ravel().tolist()
    )
    geom = spec.worldbody.add_geom(name=TERRAIN, type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=TERRAIN)
    geom.pos, geom.material = (0.0, 0.0, place), "matfloor"
