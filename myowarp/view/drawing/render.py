"""Pictures of worlds, drawn off screen by MuJoCo.

The simulation steps a slimmed model; pictures are made from the full one, which has the meshes. Only
positions are computed (no collision, no dynamics), so drawing never disturbs a simulation.

MuJoCo chooses its OpenGL from ``MUJOCO_GL`` while ``mujoco`` is imported, and takes GLFW where the variable
is unset, which needs a display. Where nothing was chosen and Linux has no display, EGL is taken here.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import platform
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import view_axes
from myowarp.view.drawing.muscles import QUANTITIES
from myowarp.view.drawing.overlay import OVERSAMPLING, Overlay, font_size
from myowarp.view.drawing.scenery import add_backdrop, add_lamp, brighten
from myowarp.view.drawing.snapshot import Snapshot
from myowarp.view.drawing.world import WorldDrawing

SEPARATOR_PX = 2
"""Width of the line between the tiles of a grid."""
SEPARATOR_RGB = (150, 156, 165)
MOST_GEOMS = 20000
"""Shapes in a picture, pieces of muscles included."""
FACETS = (14, 6)
"""Faces of round shapes, around and along."""
COARSE = 1.0
"""px: what is smaller in a mesh is not drawn."""
LEAST_CELLS = 6
"""Cells that a mesh is long at least: one that is smaller than a pixel keeps a shape."""
GL_ERRORS = (ImportError, RuntimeError, AttributeError, OSError, ctypes.ArgumentError, mujoco.FatalError)
"""Errors of a missing or broken OpenGL: PyOpenGL looks functions up on a library that is None."""


class NoGraphicsError(RuntimeError):
    """No OpenGL was found to draw with."""


class _Canvas:
    """MuJoCo's surface off screen.

    Attributes:
        scene: What is to be drawn.
        context: What it is drawn with.
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int) -> None:
        """Open it.

        Args:
            model: The model; it is told the size and how fine to draw.
            height: Of the picture [px].
            width: Of the picture [px].

        Raises:
            NoGraphicsError: No OpenGL was found, or ``MUJOCO_GL`` switches drawing off.
        """
        chosen = os.environ.get("MUJOCO_GL", "")
        shows = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        headless = platform.system() == "Linux" and not shows
        if chosen.lower() in ("disable", "disabled", "off", "false", "0"):
            raise NoGraphicsError(
                f"drawing needs OpenGL, got MUJOCO_GL={chosen}; unset it or set MUJOCO_GL=egl"
            )
        model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        model.vis.quality.offsamples = 0
        model.vis.quality.numslices, model.vis.quality.numstacks = FACETS
        self._model, self._area = model, mujoco.MjrRect(0, 0, width, height)
        self.scene, self._fields = mujoco.MjvScene(model, MOST_GEOMS), model.hfield_data.copy()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                on_egl = headless and not chosen
                module = importlib.import_module("mujoco.egl") if on_egl else mujoco
                self._graphics = open_graphics(module.GLContext, width, height)
                self.context = mujoco.MjrContext(model, font_size(height))
        except GL_ERRORS as error:
            raise no_graphics(chosen or ("egl" if headless else "glfw"), error) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self.context)
        self.close = weakref.finalize(self, _free, self._graphics, self.context)

    def update(self, data: mujoco.MjData, camera: mujoco.MjvCamera, option: mujoco.MjvOption) -> None:
        """Put what MuJoCo draws of the model into the scene, and nothing else."""
        if not np.array_equal(self._fields, self._model.hfield_data):
            self._fields = self._model.hfield_data.copy()
            self._graphics.make_current()
            for field in range(self._model.nhfield):
                mujoco.mjr_uploadHField(self._model, self.context, field)
        category = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateCamera(self._model, data, camera, self.scene)  # floors without end lie below it
        mujoco.mjv_updateScene(self._model, data, option, None, camera, category, self.scene)

    def draw(self) -> None:
        """Draw the scene."""
        self._graphics.make_current()
        mujoco.mjr_render(self._area, self.scene, self.context)

    def read(self) -> np.ndarray:
        """Return what was drawn, uint8, shape (height, width, 3)."""
        image = np.empty((self._area.height, self._area.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(image, None, self._area, self.context)
        return image[::-1]


def open_graphics(kind: Callable[[int, int], Any], width: int, height: int) -> Any:
    """Open one of MuJoCo's OpenGL contexts and make it current.

    GLFW opens none without a word where no display answers. MuJoCo's drawing must not be asked for then: it
    raises once, and ends the process when it is asked again, for whatever context.

    Raises:
        RuntimeError: GLFW opened none.
    """
    graphics = kind(width, height)
    graphics.make_current()
    if type(graphics).__module__ == "mujoco.glfw":
        glfw = importlib.import_module("glfw")
        if not glfw.get_current_context():
            raise RuntimeError("GLFW opens no window")
    return graphics


def _free(graphics: Any, context: mujoco.MjrContext) -> None:
    """Free what MuJoCo keeps in an OpenGL context, and the context."""
    with graphics.as_current():
        context.free()
    graphics.free()


def no_graphics(backend: str, error: Exception) -> NoGraphicsError:
    """Return an error that says what is missing."""
    reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    return NoGraphicsError(
        f"drawing needs OpenGL, got no working '{backend}' backend ({reason.rstrip('.')}); on Debian or "
        "Ubuntu without a display run `apt-get install libegl1 libgl1` and set MUJOCO_GL=egl"
    )


class WorldRenderer:
    """Draws worlds of one model: bones, muscles as tubes, targets, tips, and the posture that is wanted."""

    def __init__(
        self,
        model: mujoco.MjModel,
        width: int = 640,
        height: int = 480,
        camera: str | mujoco.MjvCamera | None = None,
        *,
        tips: Iterable[str] = (),
        color: str = "activation",
        legend: bool = False,
    ):
        """Prepares a private copy of the model for drawing and opens an OpenGL context.

        Args:
            model: the full (unslimmed) model; it is not changed.
            width: image width [px].
            height: image height [px].
            camera: name of a camera of the model, or a camera; None frames the limb, tips, targets, objects.
            tips: names of the sites at the ends of the limb.
            color: what the colour of a muscle shows, a name in `myowarp.view.drawing.muscles.QUANTITIES`.
            legend: whether to draw what the colours mean.

        Raises:
            ValueError: the camera or the colour is unknown, or the image is too large.
            NoGraphicsError: no OpenGL was found.
        """
        names = [model.camera(i).name for i in range(model.ncam)]
        if isinstance(camera, str) and camera not in names:
            raise ValueError(f"camera '{camera}' unknown; available: {', '.join(sorted(names)) or 'none'}")
        check_size(width, height)
        self.width, self.height, self._legend = width, height, legend
        self.camera = _fixed_camera(model, camera) if isinstance(camera, str) else camera
        self._drawing = WorldDrawing(model, tips, width / height, color)
        self.framing, self.muscles = self._drawing.framing, self._drawing.muscles
        self._model = self._drawing.model
        coarsen(self._model, COARSE * 2.0 * self.framing.radius / min(width, height))
        pale = look.pale_geoms(model)
        if look.carried_root(model):
            pale &= ~look.ground_geoms(model)  # its slopes are seen by their shades
        self._pale = frozenset(np.flatnonzero(pale).tolist())
        drawn = look.drawn_geoms(self._model)
        self._alpha = self._model.geom_rgba[:, 3].copy()
        self._cullable = drawn[self._model.geom_type[drawn] == mujoco.mjtGeom.mjGEOM_MESH]
        size = OVERSAMPLING * width, OVERSAMPLING * height
        self._canvas: _Canvas | None = _Canvas(self._model, *size[::-1])
        self._overlay = Overlay(self._canvas.context, *size)

    def __enter__(self) -> WorldRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def fit(self, film: Iterable[Snapshot]) -> None:
        """Fits the picture to what a film shows, instead of what the joints' ranges allow."""

        def moments() -> Iterator[tuple[mujoco.MjData, Mapping[str, np.ndarray]]]:
            for seen in film:
                yield self._drawing.pose(seen), seen.goals
                if seen.ghost is not None:
                    look.pose(self._model, self._drawing.data, seen.ghost)
                    yield self._drawing.data, {}

        self.framing.fit(moments())

    def frame(self, seen: Snapshot, caption: Sequence[str] = (), legend: bool | None = None) -> np.ndarray:
        """Draws one world.

        Args:
            seen: what it shows. A site of the model with the name of a goal gives its size; `<tip>_target`
                is joined to the site `<tip>` by a line.
            caption: lines of text.
            legend: whether to draw the legend; None: as the renderer was made.

        Returns:
            Image, uint8, shape ``(height, width, 3)``.

        Raises:
            ValueError: a shape is wrong or a position is not finite.
            RuntimeError: the renderer was closed.
        """
        if (canvas := self._canvas) is None:
            raise RuntimeError("frame needs an open WorldRenderer, got a closed one; make a new one")
        self._drawing.check(seen)
        data = self._drawing.pose(seen)
        framed = self.framing.camera(data, seen.goals)
        camera = framed if self.camera is None else self.camera
        self._hide_what_is_outside(data, camera)
        canvas.update(data, camera, self._drawing.option)
        brighten(canvas.scene, self._pale)
        pixel = 2.0 * self.framing.radius / min(self.width, self.height)
        self._drawing.add(canvas.scene, seen, np.array(framed.lookat), pixel)
        add_backdrop(canvas.scene)
        add_lamp(canvas.scene)
        canvas.draw()
        self._overlay.text(caption)
        if (self._legend if legend is None else legend) and self.muscles.any:
            self._overlay.legend(QUANTITIES[self._drawing.color])
        return _shrunk(canvas.read())

    @property
    def scene(self) -> mujoco.MjvScene | None:
        """MuJoCo's scene, with the geoms of the last picture; None after `close`."""
        return None if self._canvas is None else self._canvas.scene

    def close(self) -> None:
        """Frees the OpenGL context; safe to call twice."""
        if self._canvas is not None:
            self._canvas.close()
        self._canvas = None

    def _hide_what_is_outside(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> None:
        """Leaves out geoms outside of the picture: the skeleton beside an elbow costs more than the elbow."""
        self._model.geom_rgba[:, 3] = self._alpha
        if camera.type == mujoco.mjtCamera.mjCAMERA_FREE:
            half = np.tan(np.radians(self._model.vis.global_.fovy) / 2) * np.array(
                (self.width / self.height, 1.0)
            )
            axes = view_axes(camera.azimuth, camera.elevation)
            corners = (look.geom_box(self._model, data, self._cullable) - camera.lookat) @ axes.T
            side = corners[:, :2].reshape(-1, 8, 2)
            reach = (half * (corners[:, 2:] + camera.distance)).reshape(-1, 8, 2)
            outside = ((side > reach).all(axis=1) | (side < -reach).all(axis=1)).any(axis=1)
            self._model.geom_rgba[self._cullable[outside], 3] = 0.0


def _fixed_camera(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    """Returns a camera of the model."""
    camera = mujoco.MjvCamera()
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(name).id
    return camera


def check_size(width: int, height: int) -> None:
    """Raises ValueError if a picture of this size cannot be drawn."""
    if not (width >= 1 and height >= 1 and max(width, height) <= look.LARGEST):
        raise ValueError(f"a picture needs 1 to {look.LARGEST} px on each side, got {width} by {height}")


def tiled(tiles: Sequence[np.ndarray], columns: int | None = None) -> np.ndarray:
    """Puts images of one size into one image, row by row, with a line between them.

    Args:
        tiles: images, uint8, shape ``(height, width, 3)`` each.
        columns: tiles in a row; by default the grid is as square as it can be.

    Raises:
        ValueError: there is no image.
    """
    if not tiles:
        raise ValueError("a grid needs one picture at least, got none")
    columns = min(columns or int(np.ceil(len(tiles) ** 0.5)), len(tiles))
    rows = -(-len(tiles) // columns)
    height, width = np.array(tiles[0].shape[:2]) + SEPARATOR_PX
    shape = rows * height - SEPARATOR_PX, columns * width - SEPARATOR_PX, 3
    image = np.full(shape, SEPARATOR_RGB, np.uint8)
    for index, tile in enumerate(tiles):
        row, column = divmod(index, columns)
        top, left = row * height, column * width
        image[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    return image


def coarsen(model: mujoco.MjModel, cell: float) -> None:
    """Merges vertices of a mesh in one cell of a grid [m]: faces below a pixel cost time for nothing."""
    for mesh in range(model.nmesh):
        first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        faces = slice(face, face + model.mesh_facenum[mesh])
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        size = min(cell, np.ptp(vertices, axis=0).max(initial=0.0) / LEAST_CELLS)
        _, chosen, own = np.unique(np.round(vertices / size), axis=0, return_index=True, return_inverse=True)
        merged = chosen[own.ravel()][model.mesh_face[faces]]
        kept = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
        count = int(kept.sum())
        if count:
            model.mesh_face[face : face + count] = merged[kept]
            for corners in (model.mesh_facenormal, model.mesh_facetexcoord):
                corners[face : face + count] = corners[faces][kept]
            model.mesh_facenum[mesh] = count


def _shrunk(image: np.ndarray) -> np.ndarray:
    """Averages blocks of 2 by 2 drawn pixels into image pixels."""
    rows = image[0::2].astype(np.uint16)
    rows += image[1::2]
    pairs = rows.reshape(len(rows), -1, 6)
    return ((pairs[:, :, :3] + pairs[:, :, 3:]) >> 2).astype(np.uint8)
