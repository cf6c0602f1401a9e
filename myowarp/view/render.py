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
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from myowarp.view import style as look

SEPARATOR_PX = 2
"""Width of the line between the tiles of a grid."""
SEPARATOR_RGB = (150, 156, 165)
MARKER_RADIUS = (0.035, 0.10)
"""Smallest and largest radius of a target marker, in units of the framed radius."""
OVERSAMPLING = 2
"""Drawn pixels per image pixel and side; for meshes faster than Mesa's multisampling, and smoother."""
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
            return mujoco.Renderer(model, height, width)
    except GL_ERRORS as error:
        raise _no_graphics(backend, error) from error


class WorldRenderer:
    """Draws worlds of one model: bones, muscles coloured by activation, targets and tips."""

    def __init__(
        self,
        model: mujoco.MjModel,
        width: int = 640,
        height: int = 480,
        camera: str | mujoco.MjvCamera | None = None,
    ):
        """Prepares a private copy of the model for drawing and opens an OpenGL context.

        Args:
            model: the full (unslimmed) model; it is not changed.
            width: image width [px].
            height: image height [px].
            camera: name of a camera of the model, or a camera; None frames the moving limb.

        Raises:
            ValueError: the camera is unknown.
            NoGraphicsError: no OpenGL was found.
        """
        names = [model.camera(i).name for i in range(model.ncam)]
        if isinstance(camera, str) and camera not in names:
            raise ValueError(f"camera '{camera}' unknown; available: {', '.join(sorted(names)) or 'none'}")
        self.width, self.height = width, height
        self.tendons = look.muscle_tendons(model)
        self.num_muscles = len(self.tendons)
        framed, self.radius = look.frame_camera(model, width / height)
        self.camera = framed if camera is None else camera
        self._model = _prepared(model, self.radius, OVERSAMPLING * width, OVERSAMPLING * height)
        self._data = mujoco.MjData(self._model)
        self._nominal: dict[tuple[str, str], np.ndarray] = {}  # of what some world had for itself
        self._option = _drawing_options()
        self._tips = look.tip_sites(model)
        self._tip_radii = look.tip_radii(model, self._tips, self.radius)
        self._pale = frozenset(np.flatnonzero(look.pale_geoms(model)).tolist())
        pixel = 2.0 * self.radius / min(width, height)
        self._thin = max(self.radius * 0.035 / max(self.num_muscles, 1) ** 0.5, 0.9 * pixel)
        self._link_radius = max(LINK_RADIUS * self.radius, 0.7 * pixel)
        self._renderer = _open_renderer(self._model, OVERSAMPLING * height, OVERSAMPLING * width)

    def __enter__(self) -> WorldRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def frame(
        self,
        qpos: np.ndarray,
        activation: np.ndarray | None = None,
        sites: Mapping[str, np.ndarray] | None = None,
        shape: Mapping[tuple[str, str], np.ndarray] | None = None,
    ) -> np.ndarray:
        """Draws one world.

        Args:
            qpos: generalised position, shape ``(nq,)``.
            activation: muscle activation [1], shape ``(num_muscles,)``, or None; NaN hides a muscle.
            sites: task targets: name to position in the world [m], shape ``(3,)``. A site of the model of
                that name gives the size; ``<tip>_target`` is joined to the site ``<tip>`` by a line.
            shape: geometry of this world alone: (field of model or data, name of geom or body) to values.

        Returns:
            Image, uint8, shape ``(height, width, 3)``.

        Raises:
            ValueError: a shape is wrong or a position is not finite.
            RuntimeError: the renderer was closed.
        """
        if self._renderer is None:
            raise RuntimeError("frame needs an open WorldRenderer, got a closed one; make a new one")
        rgb = look.activation_rgb(activation, self.num_muscles)
        for key in shape or {}:
            self._nominal.setdefault(key, look.geometry(self._model, self._data, key).copy())
        look.pose(self._model, self._data, qpos, self._nominal | dict(shape or {}))
        self._model.tendon_rgba[self.tendons, :3] = rgb
        self._model.tendon_rgba[self.tendons, 3] = 1.0 if activation is None else ~np.isnan(activation)
        bulge = 0.5 if activation is None else np.clip(np.nan_to_num(activation), 0.0, 1.0)
        self._model.tendon_width[self.tendons] = self._thin * (0.75 + 0.75 * bulge)
        self._renderer.update_scene(self._data, self.camera, self._option)
        scene = self._renderer.scene
        _brighten(scene, self._pale)
        _add_backdrop(scene)
        _add_lamp(scene)
        self._add_markers(scene, sites or {})
        return _shrunk(self._renderer.render())

    def frame_grid(self, looks: Sequence[tuple[Any, ...]], columns: int | None = None) -> np.ndarray:
        """Draws several worlds as tiles of one image, row by row.

        Args:
            looks: for each world the arguments of `frame`.
            columns: tiles in a row; by default the grid is as square as it can be.

        Returns:
            Image, uint8; each tile has the renderer's width and height. Unused tiles stay blank.

        Raises:
            ValueError: a shape is wrong, or there is no world.
        """
        count = len(looks)
        if not count:
            raise ValueError("frame_grid needs the looks of one world at least, got none")
        columns = min(columns or int(np.ceil(count**0.5)), count)
        rows = -(-count // columns)
        step = np.array((self.height, self.width)) + SEPARATOR_PX
        image = np.full(
            (rows * step[0] - SEPARATOR_PX, columns * step[1] - SEPARATOR_PX, 3), SEPARATOR_RGB, np.uint8
        )
        for world in range(count):
            top, left = np.array(divmod(world, columns)) * step
            image[top : top + self.height, left : left + self.width] = self.frame(*looks[world])
        return image

    def close(self) -> None:
        """Frees the OpenGL context; safe to call twice."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None

    def _add_markers(self, scene: mujoco.MjvScene, sites: Mapping[str, np.ndarray]) -> None:
        for site, radius in zip(self._tips, self._tip_radii, strict=True):
            _add_sphere(scene, self._data.site_xpos[site], radius, (*look.TIP_RGB, 1.0))
        for name, position in sites.items():
            place = np.asarray(position, dtype=float)
            if place.shape != (3,) or not np.isfinite(place).all():
                raise ValueError(f"site '{name}' needs a finite world position of shape (3,), got {position}")
            site = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, name)
            size = self._model.site_size[site, 0] if site >= 0 else 0.0
            size = np.clip(size, MARKER_RADIUS[0] * self.radius, MARKER_RADIUS[1] * self.radius)
            _add_sphere(scene, place, size, (*look.TARGET_RGB, 0.65))
        for tip, target in look.marker_pairs(self._model, sites):
            _add_link(scene, self._data.site_xpos[tip], target, self._link_radius)


def _prepared(model: mujoco.MjModel, radius: float, width: int, height: int) -> mujoco.MjModel:
    """Copies the model and changes what only drawing reads."""
    model = copy.copy(model)
    hidden = look.wrapping_geoms(model)
    model.geom_matid[hidden] = -1
    model.geom_rgba[hidden, 3] = 0.0
    bone, pale = look.bone_geoms(model), look.pale_geoms(model)
    model.geom_rgba[bone, :3] = look.BONE_RGB
    model.geom_rgba[pale, :3] = look.PALE_RGB
    model.geom_matid[pale] = -1
    model.tendon_matid[:] = -1
    model.tendon_rgba[:, 3] = 0.0
    model.tendon_rgba[look.muscle_tendons(model), 3] = 1.0
    model.stat.extent = 2.0 * radius
    model.vis.map.znear, model.vis.map.zfar = 0.01, 50.0
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    model.vis.quality.offsamples = 0
    model.vis.headlight.ambient[:] = 0.38
    model.vis.headlight.diffuse[:] = 0.45
    model.vis.headlight.specular[:] = 0.10
    return model


def _shrunk(image: np.ndarray) -> np.ndarray:
    """Averages blocks of 2 by 2 drawn pixels into image pixels."""
    rows = image[0::2].astype(np.uint16)
    rows += image[1::2]
    pairs = rows.reshape(len(rows), -1, 6)
    return ((pairs[:, :, :3] + pairs[:, :, 3:]) >> 2).astype(np.uint8)


def _drawing_options() -> mujoco.MjvOption:
    """Bones and muscles, no sites: markers are drawn by hand in one size."""
    option = mujoco.MjvOption()
    option.sitegroup[:] = 0
    option.tendongroup[:] = 1
    option.geomgroup[:] = 0
    option.geomgroup[list(look.VISIBLE_GEOM_GROUPS)] = 1
    return option


def _next_geom(scene: mujoco.MjvScene) -> mujoco.MjvGeom:
    scene.ngeom += 1
    return scene.geoms[scene.ngeom - 1]


def _add_sphere(scene: mujoco.MjvScene, place: np.ndarray, radius: float, rgba: tuple[float, ...]) -> None:
    geom = _next_geom(scene)
    size, color = np.full(3, radius), np.array(rgba, dtype=np.float32)
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_SPHERE, size, place, np.eye(3).ravel(), color)
    geom.emission = 0.25
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def _add_link(scene: mujoco.MjvScene, start: np.ndarray, end: np.ndarray, radius: float) -> None:
    geom = _next_geom(scene)
    color = np.array((*look.TARGET_RGB, 0.8), dtype=np.float32)
    mujoco.mjv_initGeom(
        geom, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.eye(3).ravel(), color
    )
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)
    geom.emission = 0.25
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def _add_backdrop(scene: mujoco.MjvScene) -> None:
    """Stands a bright wall behind everything: without a sky box MuJoCo clears to black."""
    eye = scene.camera[0]
    forward, up = np.array(eye.forward, dtype=float), np.array(eye.up, dtype=float)
    far = 0.9 * eye.frustum_far
    half = 1.5 * far / eye.frustum_near * max(eye.frustum_top, eye.frustum_width, 1e-6)
    turn = np.stack((np.cross(up, -forward), up, -forward), axis=1)
    geom = _next_geom(scene)
    size, color = np.array((2 * half, 2 * half, 1.0)), np.array((*look.BACKDROP_RGB, 1.0), dtype=np.float32)
    place = np.array(eye.pos, dtype=float) + far * forward
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_PLANE, size, place, turn.ravel(), color)
    geom.emission, geom.specular, geom.reflectance = 0.2, 0.0, 0.0
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def _brighten(scene: mujoco.MjvScene, pale: frozenset[int]) -> None:
    """Lets the geoms of these ids glow a little, so that they stay pale from any angle."""
    for geom in scene.geoms[: scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in pale:
            geom.emission, geom.specular, geom.reflectance = 0.45, 0.0, 0.0


def _add_lamp(scene: mujoco.MjvScene) -> None:
    """Adds a lamp above the viewer's left shoulder, so that bones have a lit and a shaded side."""
    eye = scene.camera[0]
    forward, up = np.array(eye.forward), np.array(eye.up)
    right = np.cross(forward, up)
    lamp = scene.lights[scene.nlight]
    scene.nlight += 1
    lamp.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    lamp.headlight, lamp.castshadow, lamp.texid = 0, 0, -1
    lamp.pos[:] = eye.pos
    lamp.dir[:] = 0.6 * forward - 0.7 * up + 0.5 * right
    lamp.attenuation[:] = (1.0, 0.0, 0.0)
    lamp.ambient[:], lamp.diffuse[:], lamp.specular[:] = 0.0, 0.35, 0.15
