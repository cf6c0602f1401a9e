"""Grounds: height fields whose contacts are found by kernels of ours, world by world."""

from typing import Protocol

import mujoco_warp as mjw
import warp as wp


class Ground(Protocol):
    """The height field of a scene.

    Attributes:
        hfield: Id of the height field in the model.
        heights: In the field's frame [m], rows along x, shape (1 or num_worlds, num_rows, num_columns); a
            task that has them differ between worlds puts an array of its own here, `scene.zeros`. None may
            exceed the field's `size` in z.
    """

    hfield: int
    heights: wp.array

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        """Pairs of geoms whose contacts it finds."""

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Append contacts with the field to those that were found."""
