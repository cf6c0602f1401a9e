"""Pictures of worlds, drawn off screen by MuJoCo's own renderer.

The simulation steps a slimmed model; pictures are made from the full one, which has the meshes. Only
positions are computed (no collision, no dynamics), so drawing never disturbs a simulation.

MuJoCo chooses its OpenGL backend from ``MUJOCO_GL`` while ``mujoco`` is imported, and takes GLFW where
the variable is unset, which needs a display. Here the variable is set to ``egl`` when a renderer is made
on a Linux machine without a display, and the choice is read again, so the order of imports is free.
"""

from __future__ import annotations

import copy
import ctypes
import importlib
import os
import platform
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property

import mujoco
import numpy as np

from myowarp.definitions.registry import check_choice
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, view_axes
from myowarp.view.drawing.muscles import QUANTITIES, TENDON_RGB, TENDON_TINT, Muscles
from myowarp.view.drawing.overlay import OVERSAMPLING, Overlay, font_size
from myowarp.view.drawing.scenery import (
    add_backdrop,
    add_capsule,
    add_floor,
    add_lamp,
    add_sphere,
    brighten,
    floor_height,
    has_plane,
)
from myowarp.view.drawing.skeleton import Skeleton
from myowarp.view.drawing.snapshot import Snapshot

SEPARATOR_PX = 2
"""Width of the line between the tiles of a grid."""
SEPARATOR_RGB = (150, 156, 165)
MARKER_RADIUS = (0.035, 0.10)
"""Smallest and largest radius of a target marker, in units of the framed radius."""
FACETS = (14, 6)
"""Faces of round shapes, around and along."""
MOST_GEOMS = 20000
"""Shapes in a picture, pieces of muscles included."""
COARSE = 1.0
"""px: what is smaller in a mesh is not drawn."""
GHOST_ALPHA = 0.28
LINK_RADIUS = 0.005
"""Radius of the line from a tip to its target, in units of the framed radius."""
GL_ERRORS = (ImportError, RuntimeError, AttributeError, OSError, ctypes.ArgumentError, mujoco.FatalError)
"""What a missing or broken OpenGL raises: PyOpenGL looks functions up on a library that is None."""


class NoGraphicsError(RuntimeError):
    """No OpenGL was found to draw with."""


def choose_backend() -> str:
    """Makes MuJoCo draw through EGL where nothing was chosen and no display is there.

    Returns:
        The backend in use: the value of ``MUJOCO_GL``, or ``"glfw"`` for MuJoCo's default.

    Raises:
        NoGraphicsError: ``MUJOCO_GL`` switches rendering off, or EGL does not load.
    """
    headless = not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if platform.system() == "Linux" and headless and not os.environ.get("MUJOCO_GL"):
        os.environ["MUJOCO_GL"] = "egl"
        try:
            importlib.reload(mujoco.rendering.classic.gl_context)
        except GL_ERRORS as error:
            # Left in place, the variable would make the next process fail in `import mujoco` itself.
            del os.environ["MUJOCO_GL"]
            raise _no_graphics("egl", error) from error
    backend = os.environ.get("MUJOCO_GL") or "glfw"
    if backend.lower() in ("disable", "disabled", "off", "false", "0"):
        raise NoGraphicsError(f"drawing needs OpenGL, got MUJOCO_GL={backend}; unset it or set MUJOCO_GL=egl")
    return backend


def _no_graphics(backend: str, error: Exception) -> NoGraphicsError:
    reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    return NoGraphicsError(
        f"drawing needs OpenGL, got no working '{backend}' backend ({reason.rstrip('.')}); on Debian or "
        "Ubuntu without a display run `apt-get install libegl1 libgl1` and set MUJOCO_GL=egl"
    )


def _open_renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    """Makes a ``mujoco.Renderer``, with one clear error where OpenGL is missing."""
    backend = choose_backend()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return mujoco.Renderer(model, height, width, MOST_GEOMS, mujoco.mjtFontScale(font_size(height)))
    except GL_ERRORS as error:
        raise _no_graphics(backend, error) from error


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
        check_choice("muscle color", color, tuple(QUANTITIES))
        check_size(width, height)
        self.width, self.height, self.camera = width, height, camera
        self._skeleton = Skeleton(model)
        self.framing = Framing(model, tips, width / height, self._skeleton)
        self.muscles = Muscles(model, self.framing.radius)
        self.color, self._legend = color, legend
        self._model = _prepared(model, self.framing.radius, OVERSAMPLING * width, OVERSAMPLING * height)
        coarsen(self._model, COARSE * 2.0 * self.framing.radius / min(width, height))
        self._data = mujoco.MjData(self._model)
        self._nominal: dict[tuple[str, str], np.ndarray] = {}  # of what some world had for itself
        self._option = _drawing_options()
        self._tips = look.tip_sites(model, tips)
        self._pale = frozenset(np.flatnonzero(look.pale_geoms(model)).tolist())
        drawn = look.drawn_geoms(self._model)
        moving = look.moving_bodies(model) & look.limb_trees(model)
        self._ghostly = drawn[moving[model.geom_bodyid[drawn]]]
        self._alpha = self._model.geom_rgba[:, 3].copy()
        self._cullable = drawn[self._model.geom_type[drawn] == mujoco.mjtGeom.mjGEOM_MESH]
        self._floor = floor_height(model) if self.framing.follows and not has_plane(model) else None
        self._renderer = _open_renderer(self._model, OVERSAMPLING * height, OVERSAMPLING * width)
        context = self._renderer._mjr_context
        self._overlay = Overlay(context, OVERSAMPLING * width, OVERSAMPLING * height)

    def __enter__(self) -> WorldRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def fit(self, film: Iterable[Snapshot]) -> None:
        """Fits the picture to what a film shows, instead of what the joints' ranges allow."""

        def moments() -> Iterator[tuple[mujoco.MjData, Mapping[str, np.ndarray]]]:
            for seen in film:
                yield self._posed(seen), seen.goals
                if seen.ghost is not None:
                    look.pose(self._model, self._data, seen.ghost)
                    yield self._data, {}

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
        if self._renderer is None:
            raise RuntimeError("frame needs an open WorldRenderer, got a closed one; make a new one")
        self._check(seen)
        data = self._posed(seen)
        framed = self.framing.camera(data, seen.goals)
        camera = framed if self.camera is None else self.camera
        self._hide_what_is_outside(data, camera)
        self._renderer.update_scene(data, camera, self._option)
        scene = self._renderer.scene
        brighten(scene, self._pale)
        pixel = 2.0 * self.framing.radius / min(self.width, self.height)
        self._add_muscles(scene, seen, 0.55 * pixel)
        self._add_skeleton(scene, data, look.BONE_RGB, 1.0)
        if seen.ghost is not None:
            self._add_ghost(scene, seen.ghost)
        self._add_markers(scene, seen.goals, pixel)
        if self._floor is not None:
            add_floor(scene, self._floor, np.array(framed.lookat), self.framing.radius, pixel)
        add_backdrop(scene)
        add_lamp(scene)
        return self._drawn(caption, self._legend if legend is None else legend)

    def frame_grid(
        self,
        film: Sequence[Snapshot],
        captions: Sequence[Sequence[str]] = (),
        columns: int | None = None,
    ) -> np.ndarray:
        """Draws several worlds as tiles of one image, row by row.

        Args:
            film: what each world shows.
            captions: lines of text for each world; none for no text.
            columns: tiles in a row; by default the grid is as square as it can be.

        Returns:
            Image, uint8; each tile has the renderer's width and height. Unused tiles stay blank.

        Raises:
            ValueError: a shape is wrong, or there is no world.
        """
        captions = captions or [()] * len(film)
        return tiled([self.frame(*world) for world in zip(film, captions, strict=True)], columns)

    def close(self) -> None:
        """Frees the OpenGL context; safe to call twice."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None

    def _check(self, seen: Snapshot) -> None:
        """Raises ValueError if a snapshot does not fit the model."""
        number = len(self.muscles.tendons)
        for name, values in seen.muscles.items():
            if np.shape(values) != (number,):
                raise ValueError(
                    f"{name} needs one value per muscle, shape ({number},), got {np.shape(values)}"
                )
        for name, place in seen.goals.items():
            if np.shape(place) != (3,) or not np.isfinite(place).all():
                raise ValueError(f"site '{name}' needs a finite world position of shape (3,), got {place}")

    def _posed(self, seen: Snapshot) -> mujoco.MjData:
        """Returns the data in a world's pose, with its own geometry."""
        for key in seen.shape:
            self._nominal.setdefault(key, look.geometry(self._model, self._data, key).copy())
        look.pose(self._model, self._data, seen.qpos, self._nominal | dict(seen.shape))
        return self._data

    def _drawn(self, caption: Sequence[str], legend: bool) -> np.ndarray:
        """Returns the picture of the scene, with what is written on it."""
        renderer, size = self._renderer, (OVERSAMPLING * self.height, OVERSAMPLING * self.width, 3)
        image, area = np.empty(size, dtype=np.uint8), mujoco.MjrRect(0, 0, size[1], size[0])
        renderer._gl_context.make_current()
        mujoco.mjr_render(area, renderer.scene, renderer._mjr_context)
        self._overlay.text(caption)
        if legend and self.muscles.any:
            self._overlay.legend(QUANTITIES[self.color])
        mujoco.mjr_readPixels(image, None, area, renderer._mjr_context)
        return _shrunk(image[::-1])

    def _add_muscles(self, scene: mujoco.MjvScene, seen: Snapshot, thinnest: float) -> None:
        tubes = self.muscles.tubes(self._data, seen.muscles.get("strength"), thinnest)
        rgb = QUANTITIES[self.color].rgb(self.muscles.values(self.color, seen.muscles, self._data))
        tendon = (1.0 - TENDON_TINT) * TENDON_RGB + TENDON_TINT * rgb
        hidden = np.isnan(seen.activation) if seen.activation is not None else np.zeros(len(rgb), dtype=bool)
        colors = np.where(tubes.belly[:, None], rgb[tubes.owner], tendon[tubes.owner])
        colors = np.concatenate((colors, np.ones((len(colors), 1))), axis=1).astype(np.float32)
        for k in np.flatnonzero(~hidden[tubes.owner]):
            add_capsule(scene, tubes.starts[k], tubes.ends[k], tubes.radii[k], colors[k])

    def _add_skeleton(
        self, scene: mujoco.MjvScene, data: mujoco.MjData, rgb: np.ndarray, alpha: float
    ) -> None:
        color = np.array((*rgb, alpha), dtype=np.float32)
        for start, end, radius in zip(*self._skeleton.bones(data), strict=True):
            add_capsule(scene, start, end, radius, color)

    def _add_ghost(self, scene: mujoco.MjvScene, wanted: np.ndarray) -> None:
        """Adds the limb in the wanted posture, translucent."""
        model, data = self._ghost
        look.pose(model, data, wanted)
        first = scene.ngeom
        category = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_addGeoms(model, data, self._option, mujoco.MjvPerturb(), category, scene)
        for geom in scene.geoms[first : scene.ngeom]:
            geom.emission, geom.specular = 0.35, 0.0
        self._add_skeleton(scene, data, look.TARGET_RGB, GHOST_ALPHA)

    @cached_property
    def _ghost(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The model with nothing but the moving bones, translucent."""
        model = copy.copy(self._model)
        model.geom_matid[:], model.geom_rgba[:, 3] = -1, 0.0
        model.geom_rgba[self._ghostly] = (*look.TARGET_RGB, GHOST_ALPHA)
        return model, mujoco.MjData(model)

    def _hide_what_is_outside(self, data: mujoco.MjData, camera: str | mujoco.MjvCamera) -> None:
        """Leaves out geoms outside of the picture: the skeleton beside an elbow costs more than the elbow."""
        self._model.geom_rgba[:, 3] = self._alpha
        if isinstance(camera, mujoco.MjvCamera) and camera.type == mujoco.mjtCamera.mjCAMERA_FREE:
            half = np.tan(np.radians(self._model.vis.global_.fovy) / 2) * np.array(
                (self.width / self.height, 1.0)
            )
            axes = view_axes(camera.azimuth, camera.elevation)
            corners = (look.geom_box(self._model, data, self._cullable) - camera.lookat) @ axes.T
            side = corners[:, :2].reshape(-1, 8, 2)
            reach = (half * (corners[:, 2:] + camera.distance)).reshape(-1, 8, 2)
            outside = ((side > reach).all(axis=1) | (side < -reach).all(axis=1)).any(axis=1)
            self._model.geom_rgba[self._cullable[outside], 3] = 0.0

    def _add_markers(self, scene: mujoco.MjvScene, goals: Mapping[str, np.ndarray], pixel: float) -> None:
        radius = self.framing.radius
        for site, size in zip(self._tips, look.tip_radii(self._model, self._tips, radius), strict=True):
            add_sphere(scene, self._data.site_xpos[site], size, (*look.TIP_RGB, 1.0))
        for name, place in goals.items():
            site = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, name)
            size = self._model.site_size[site, 0] if site >= 0 else 0.0
            size = np.clip(size, MARKER_RADIUS[0] * radius, MARKER_RADIUS[1] * radius)
            add_sphere(scene, place, size, (*look.TARGET_RGB, 0.65))
        color = np.array((*look.TARGET_RGB, 0.8), dtype=np.float32)
        for tip, target in look.marker_pairs(self._model, goals):
            link = max(LINK_RADIUS * radius, 0.7 * pixel)
            add_capsule(scene, self._data.site_xpos[tip], target, link, color, emission=0.25)


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


def _prepared(model: mujoco.MjModel, radius: float, width: int, height: int) -> mujoco.MjModel:
    """Copies the model and changes what only drawing reads."""
    model = copy.copy(model)
    hidden = look.wrapping_geoms(model)
    model.geom_matid[hidden] = -1
    model.geom_rgba[hidden, 3] = 0.0
    bone, pale = look.bone_geoms(model), look.pale_geoms(model)
    plain = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_matid >= 0)
    model.geom_rgba[plain] = model.mat_rgba[model.geom_matid[plain]]
    model.geom_matid[plain] = -1  # the renderer looks for what is hidden in the geom's own colour
    model.geom_rgba[bone, :3] = look.BONE_RGB
    model.geom_rgba[pale, :3] = look.PALE_RGB
    model.geom_matid[pale] = -1
    model.stat.extent = 2.0 * radius
    model.vis.map.znear, model.vis.map.zfar = 0.01, 50.0
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    model.vis.quality.offsamples = 0
    model.vis.quality.numslices, model.vis.quality.numstacks = FACETS
    model.vis.headlight.ambient[:] = 0.38
    model.vis.headlight.diffuse[:] = 0.45
    model.vis.headlight.specular[:] = 0.10
    return model


def coarsen(model: mujoco.MjModel, cell: float) -> None:
    """Merges vertices of a mesh in one cell of a grid [m]: faces below a pixel cost time for nothing."""
    for mesh in range(model.nmesh):
        first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        faces = slice(face, face + model.mesh_facenum[mesh])
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        _, chosen, own = np.unique(np.round(vertices / cell), axis=0, return_index=True, return_inverse=True)
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


def _drawing_options() -> mujoco.MjvOption:
    """Bones alone: muscles and markers are drawn by hand."""
    option = mujoco.MjvOption()
    option.sitegroup[:] = 0
    option.tendongroup[:] = 0
    option.geomgroup[:] = 0
    option.geomgroup[list(look.VISIBLE_GEOM_GROUPS)] = 1
    return option
