"""Path providers: lengths and moment arms of a model's tendons from elsewhere than the engine."""

from collections.abc import Mapping
from typing import Protocol

import mujoco_warp as mjw
import numpy as np


class Paths(Protocol):
    """A computation of a model's tendons in place of the engine's."""

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write `ten_length` and `ten_J`; poses, `cdof` and `subtree_com` are those of `qpos`."""

    def points(self, world: int) -> Mapping[str, np.ndarray]:
        """Return the points of tendons as they were followed last [m], by name, shape (n, 3) each."""

    def launch_velocity(self, model: mjw.Model, data: mjw.Data) -> None:
        """Add to `ten_velocity` and `actuator_velocity` what is not J qvel."""
