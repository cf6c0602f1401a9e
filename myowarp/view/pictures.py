"""The pictures of an environment: a renderer or a live viewer, opened when first needed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.view.snapshot import snapshot

if TYPE_CHECKING:
    from myowarp.sim.shards import Shards
    from myowarp.sim.simulation import Simulation
    from myowarp.view.human import HumanViewer
    from myowarp.view.render import WorldRenderer

LARGEST_SIDE = 8192  # px of a picture, which is drawn twice as large; OpenGL takes 16384


class Pictures:
    """Draws worlds of a simulation."""

    def __init__(self, size: tuple[int, int], camera: str | None) -> None:
        """Remember how to draw; nothing is opened yet.

        Args:
            size: Width and height of a picture [px].
            camera: Name of a camera of the model; None frames the limb.

        Raises:
            ValueError: The size is not two positive integers, or too large to draw.
        """
        sides = size if isinstance(size, (tuple, list)) else ()
        if len(sides) != 2 or not all(type(side) is int and 1 <= side <= LARGEST_SIDE for side in sides):
            raise ValueError(
                f"render_size must be two integers from 1 to {LARGEST_SIDE}, width and height, got {size!r}"
            )
        self._size, self._camera = size, camera
        self._renderer: WorldRenderer | None = None
        self._viewer: HumanViewer | None = None

    def frame(self, sim: Simulation | Shards, world: int) -> np.ndarray:
        """Return a picture of one world, (height, width, 3) uint8."""
        if self._renderer is None:
            from myowarp.view.render import WorldRenderer

            self._renderer = WorldRenderer(sim.full_model, *self._size, camera=self._camera)
        return self._renderer.frame(*snapshot(sim, world))

    def show(self, sim: Simulation | Shards) -> None:
        """Show world 0 in the live viewer."""
        if self._viewer is None:
            from myowarp.view.human import HumanViewer

            self._viewer = HumanViewer(sim.full_model)
        seen = snapshot(sim, 0)
        self._viewer.show(seen.qpos, seen.activation, seen.goals, shapes=[seen.shape])

    def close(self) -> None:
        """Close what is open."""
        for view in (self._renderer, self._viewer):
            if view is not None:
                view.close()
        self._renderer = self._viewer = None
