"""The engine's own arithmetic of composite inertias, private to mujoco-warp, for rooms above that need it."""

from mujoco_warp._src.math import inert_vec
from mujoco_warp._src.types import vec10

__all__ = ["inert_vec", "vec10"]
