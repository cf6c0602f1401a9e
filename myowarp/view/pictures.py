"""The pictures of an environment: a renderer or a live viewer, opened when first needed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from myowarp.definitions.body import BODIES
from myowarp.definitions.registry import check_choice
from myowarp.process import warn_once
from myowarp.sim.signals import Signals
from myowarp.view.drawing.muscles import QUANTITIES
from myowarp.view.drawing.snapshot import Snapshot, snapshot
from myowarp.view.drawing.style import LARGEST
from myowarp.view.modes import check_viser, has_display

if TYPE_CHECKING:
    from myowarp.sim.simulation import Simulation
    from myowarp.view.browser.page import Page
    from myowarp.view.drawing.render import WorldRenderer
    from myowarp.view.window import Window


class Pictures:
    """Draws worlds of a simulation.

    Attributes:
        viewer: Window or page that shows a world live; None: not opened.
    """

    def __init__(
        self,
        size: tuple[int, int],
        camera: str | None = None,
        color: str = "activation",
        legend: bool = False,
    ) -> None:
        """Remember how to draw; nothing is opened yet.

        Args:
            size: Width and height of a picture [px].
            camera: Name of a camera of the model; None frames the limb, tips, targets and objects.
            color: What the colour of a muscle shows, a name in `myowarp.view.drawing.muscles.QUANTITIES`.
            legend: Whether to draw what the colours mean.

        Raises:
            ValueError: The size is not two positive integers, or too large; the colour is unknown.
        """
        sides = size if isinstance(size, (tuple, list)) else ()
        if len(sides) != 2 or not all(type(side) is int and 1 <= side <= LARGEST for side in sides):
            raise ValueError(
                f"render_size must be two integers from 1 to {LARGEST}, width and height, got {size!r}"
            )
        check_choice("muscle color", color, tuple(QUANTITIES))
        self._size, self._camera, self._color, self._legend = size, camera, color, legend
        self._signals: Signals | None = None
        self._renderer: WorldRenderer | None = None
        self.viewer: Window | Page | None = None

    def attach(self, sim: Simulation) -> None:
        """Have the simulation compute what the colours show, if it does not yet; before it is stepped."""
        if self._color == "force" and sim.scene.muscles.names:
            self._signals = Signals(sim)

    def snapshot(self, sim: Simulation, world: int) -> Snapshot:
        """Return what a picture of a world shows now."""
        return snapshot(sim, world, self._signals)

    def renderer(self, sim: Simulation) -> WorldRenderer:
        """Return the renderer of the simulation's worlds; opened once.

        Raises:
            myowarp.view.drawing.render.NoGraphicsError: No OpenGL was found.
        """
        if self._renderer is None:
            from myowarp.view.drawing.render import WorldRenderer

            tips = BODIES[sim.scene.spec.body].tips
            self._renderer = WorldRenderer(
                sim.full_model, *self._size, self._camera, tips=tips, color=self._color, legend=self._legend
            )
        return self._renderer

    def frame(self, sim: Simulation, world: int, caption: Sequence[str] = ()) -> np.ndarray:
        """Return a picture of one world, (height, width, 3) uint8, with lines of text on it."""
        return self.renderer(sim).frame(self.snapshot(sim, world), caption)

    def show(self, sim: Simulation, world: int = 0) -> None:
        """Show a world in a window, or in a page where none opens."""
        if self.viewer is None:
            self.viewer = self._open_viewer(sim)
        self.viewer.show(self.snapshot(sim, world))

    def _open_viewer(self, sim: Simulation) -> Window | Page:
        """Open a window, or a page where none opens.

        Raises:
            ImportError: No window opens, and the package that draws pages is not installed.
        """
        model, spec = sim.full_model, sim.scene.spec
        tips = BODIES[spec.body].tips
        if has_display():
            from myowarp.view.drawing.render import NoGraphicsError
            from myowarp.view.window import Window

            try:
                return Window(model, tips, self._color)
            except NoGraphicsError as error:
                warn_once(f"{error}; a page in the browser takes its place")
        check_viser('render_mode="human" without a window')
        from myowarp.view.browser.page import Page

        return Page(model, tips, self._color, spec.key)

    def close(self) -> None:
        """Close what is open."""
        for view in (self._renderer, self.viewer):
            if view is not None:
                view.close()
        self._renderer = self.viewer = None
