"""A world shown live in a window, by Newton's OpenGL viewer; pages in the browser are `myowarp.view.browser`.

Newton only draws here: MuJoCo places the bodies of the full model and its muscle paths, and the viewer
gets meshes, instances and lines. Nothing of Newton's physics is used, and Newton is imported only when a
viewer is made.
"""

from __future__ import annotations

import importlib
import os
import platform
from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import Any, Literal

import mujoco
import numpy as np

from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing, view_axes
from myowarp.view.drawing.muscles import QUANTITIES, RELAXED_RGB
from myowarp.view.drawing.render import NoGraphicsError
from myowarp.view.drawing.snapshot import Snapshot
from myowarp.view.modes import NEEDED

Backend = Literal["gl", "null"]
LINE_PX = 4.0
"""Width of a muscle on the screen."""
MARKER_RADIUS = 0.035
"""Radius of a target, in units of the framed radius."""
SURFACE = (0.7, 0.0, 0.0, 0.0)
"""Newton's material of an instance: roughness, metallic, checker, texture."""


SHAPES = {
    mujoco.mjtGeom.mjGEOM_MESH.value: "MESH",
    mujoco.mjtGeom.mjGEOM_PLANE.value: "PLANE",
    mujoco.mjtGeom.mjGEOM_SPHERE.value: "SPHERE",
    mujoco.mjtGeom.mjGEOM_CAPSULE.value: "CAPSULE",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID.value: "ELLIPSOID",
    mujoco.mjtGeom.mjGEOM_CYLINDER.value: "CYLINDER",
    mujoco.mjtGeom.mjGEOM_BOX.value: "BOX",
}
"""MuJoCo's geom types and Newton's names for them; height fields are not drawn."""


class HumanViewer:
    """Shows a world of a model as it moves."""

    def __init__(
        self,
        model: mujoco.MjModel,
        backend: Backend = "gl",
        title: str = "MyoWarp",
        tips: Iterable[str] = (),
    ):
        """Opens the viewer.

        Args:
            model: the full (unslimmed) model; it is not changed.
            backend: ``"gl"`` for a window, ``"null"`` to draw nothing (tests).
            title: name of the window.
            tips: names of the sites at the ends of the limb.

        Raises:
            ValueError: the backend is unknown.
            NoGraphicsError: a package or a display is missing.
        """
        self._model, self._data = model, mujoco.MjData(model)
        self._tendons = look.muscle_tendons(model)
        self._tips = look.tip_sites(model, tips)
        framing = Framing(model, tips, 16 / 9)
        self._radius = framing.radius
        look.pose(model, self._data, look.rest_pose(model))
        camera = framing.camera(self._data, {})
        self._tip_radii = look.tip_radii(model, self._tips, self._radius)
        geoms = look.drawn_geoms(model)
        self._geoms = [int(g) for g in geoms if int(model.geom_type[g]) in SHAPES]
        self._still = ~look.moving_bodies(model)[model.geom_bodyid] & (
            model.body_mocapid[model.geom_bodyid] < 0
        )
        self._rgb = look.shown_rgba(model)[:, :3]
        self._shown = False
        self._newton, self._wp = _import_newton(backend)
        self.viewer = _open_viewer(self._newton, backend, title)
        self._log_shapes()
        self.viewer.camera_speed = 2.0 * self._radius
        # Newton's yaw and pitch are MuJoCo's azimuth and elevation.
        eye = camera.lookat - camera.distance * view_axes(camera.azimuth, camera.elevation)[2]
        self.viewer.set_camera(eye, camera.elevation, camera.azimuth)

    def __enter__(self) -> HumanViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def running(self) -> bool:
        """False once the window was closed."""
        return self.viewer is not None and self.viewer.is_running()

    def show(self, seen: Snapshot) -> None:
        """Shows a moment of a world; places and turns of its own geometry are shown, sizes stay nominal.

        Raises:
            ValueError: a shape is wrong or a position is not finite.
            RuntimeError: the viewer was closed.
        """
        if self.viewer is None:
            raise RuntimeError("show needs an open HumanViewer, got a closed one; make a new one")
        look.pose(self._model, self._data, seen.qpos, seen.shape)
        self.viewer.begin_frame(0.0)
        self._log_geoms()
        self._log_muscles(seen.activation)
        self._log_markers(seen.goals)
        self.viewer.end_frame()

    def close(self) -> None:
        """Closes the window; safe to call twice."""
        if self.viewer is not None:
            self.viewer.close()
        self.viewer = None

    def _transforms(self) -> np.ndarray:
        """Returns position and quaternion (x, y, z, w) of the drawn geoms, shape ``(num_geoms, 7)``."""
        out = np.empty((len(self._geoms), 7), dtype=np.float32)
        quat = np.empty(4)
        for row, geom in enumerate(self._geoms):
            mujoco.mju_mat2Quat(quat, self._data.geom_xmat[geom])
            out[row, :3] = self._data.geom_xpos[geom]
            out[row, 3:] = quat[[1, 2, 3, 0]]
        return out

    def _log_shapes(self) -> None:
        """Registers each distinct shape once; instances of it are placed in every frame."""
        self._shape: dict[int, str] = {}
        known: dict[tuple[Any, ...], str] = {}
        for geom in self._geoms:
            kind, mesh = int(self._model.geom_type[geom]), int(self._model.geom_dataid[geom])
            size = tuple(self._model.geom_size[geom].tolist())
            key = (kind, mesh) if kind == mujoco.mjtGeom.mjGEOM_MESH else (kind, size)
            if key not in known:
                known[key] = f"/shape_{len(known)}"
                self._log_shape(known[key], kind, size, mesh)
            self._shape[geom] = known[key]
        self.viewer.log_geo("/ball", self._newton.GeoType.SPHERE, (1.0,), 0.0, True, hidden=True)

    def _log_shape(self, name: str, kind: int, size: tuple[float, ...], mesh: int) -> None:
        if kind != mujoco.mjtGeom.mjGEOM_MESH:
            scale = (
                tuple(2 * (half or 10.0) for half in size[:2])
                if kind == mujoco.mjtGeom.mjGEOM_PLANE
                else size
            )
            self.viewer.log_geo(
                name, getattr(self._newton.GeoType, SHAPES[kind]), scale, 0.0, True, hidden=True
            )
            return
        model = self._model
        first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        points = self._array(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], self._wp.vec3)
        faces = model.mesh_face[face : face + model.mesh_facenum[mesh]].ravel()
        indices = self._wp.array(faces, dtype=self._wp.int32, device=self.viewer.device)
        self.viewer.log_mesh(name, points, indices, hidden=True, backface_culling=False)

    def _log_geoms(self) -> None:
        """Places the geoms; what cannot move is sent once."""
        one = np.ones((1, 3))
        for geom, place in zip(self._geoms, self._transforms(), strict=True):
            if self._shown and self._still[geom]:
                continue
            xform = self._wp.array(place[None], dtype=self._wp.transform, device=self.viewer.device)
            self._place(f"/geom_{geom}", self._shape[geom], xform, one, self._rgb[geom][None])
        self._shown = True

    def _log_muscles(self, activation: np.ndarray | None) -> None:
        """Draws muscles as lines; NaN hides one."""
        level = np.full(len(self._tendons), np.nan) if activation is None else activation
        if level.shape != (len(self._tendons),):
            raise ValueError(f"activation needs shape ({len(self._tendons)},), got {level.shape}")
        rgb = QUANTITIES["activation"].rgb(level)
        starts, ends, owner = look.tendon_segments(self._model, self._data, self._tendons)
        if activation is not None:
            shown = ~np.isnan(activation)[owner]
            starts, ends, owner = starts[shown], ends[shown], owner[shown]
        # A constant number of pieces lets the viewer keep its buffers while muscles wrap and unwrap.
        spare = 2 * self._model.nwrap - len(starts)
        fill = np.zeros((spare, 3)) if not len(ends) else np.tile(ends[-1], (spare, 1))
        colors = np.concatenate((rgb[owner], np.tile(RELAXED_RGB, (spare, 1))))
        lines = (np.concatenate((starts, fill)), np.concatenate((ends, fill)), colors)
        if len(colors):
            arrays = (self._array(part, self._wp.vec3) for part in lines)
            self.viewer.log_lines("/muscles", *arrays, width=LINE_PX / 100.0)

    def _log_markers(self, goals: Mapping[str, np.ndarray]) -> None:
        """Draws tips and targets as instances of one ball."""
        places = [*self._data.site_xpos[self._tips], *goals.values()]
        if not places:
            return
        radii = np.array(self._tip_radii + [MARKER_RADIUS * self._radius] * len(goals))
        colors = np.array([look.TIP_RGB] * len(self._tips) + [look.TARGET_RGB] * len(goals))
        xforms = np.tile(np.array((0, 0, 0, 0, 0, 0, 1.0)), (len(places), 1))
        xforms[:, :3] = places
        xforms = self._wp.array(xforms, dtype=self._wp.transform, device=self.viewer.device)
        self._place("/markers", "/ball", xforms, np.tile(radii[:, None], 3), colors)

    def _place(self, name: str, shape: str, xforms: Any, scales: np.ndarray, colors: np.ndarray) -> None:
        surface = self._wp.array(
            np.tile(SURFACE, (len(scales), 1)), dtype=self._wp.vec4, device=self.viewer.device
        )
        scales, colors = self._array(scales, self._wp.vec3), self._array(colors, self._wp.vec3)
        self.viewer.log_instances(name, shape, xforms, scales, colors, surface)

    def _array(self, values: np.ndarray, dtype: type):
        return self._wp.array(
            np.ascontiguousarray(values, dtype=np.float32), dtype=dtype, device=self.viewer.device
        )


def _check_display() -> None:
    """Raises ``NoGraphicsError`` where no X server answers."""
    if platform.system() != "Linux":
        return
    display, answers = os.environ.get("DISPLAY", ""), None
    try:
        from pyglet.libs.x11 import xlib

        answers = xlib.XOpenDisplay(display.encode()) if display else None
        if answers:
            xlib.XCloseDisplay(answers)
    except ImportError as error:
        raise NoGraphicsError(
            f"the 'gl' viewer needs the X11 client library, got '{error}'; on Debian or Ubuntu run "
            "`apt-get install libx11-6` or run `myowarp view`"
        ) from error
    if not answers:
        raise NoGraphicsError(
            f"the 'gl' viewer needs an X display, got DISPLAY={display!r} where no server answers; run "
            "`myowarp view` and open its page in a browser"
        )


def _import_newton(backend: str) -> tuple[ModuleType, ModuleType]:
    """Imports Newton and Warp, and what the backend needs besides, or says what to install."""
    if backend not in NEEDED:
        raise ValueError(f"viewer backend '{backend}' unknown; available: {', '.join(sorted(NEEDED))}")
    try:
        for package in ("newton.viewer", *NEEDED[backend]):
            importlib.import_module(package)
        return importlib.import_module("newton"), importlib.import_module("warp")
    except ImportError as error:
        raise NoGraphicsError(
            f"the '{backend}' viewer needs Newton and its packages, got '{error}'; install them with "
            '`pip install "myowarp[view]"`'
        ) from error


def _open_viewer(newton: ModuleType, backend: str, title: str):
    """Opens the Newton viewer; ``PYGLET_HEADLESS`` asks for a window that nobody sees (tests)."""
    if backend == "null":
        return newton.viewer.ViewerNull()
    import pyglet

    headless = bool(os.environ.get("PYGLET_HEADLESS"))
    pyglet.options.headless = headless
    if not headless:
        _check_display()
    viewer = newton.viewer.ViewerGL(width=1280, height=720, headless=headless)
    viewer.renderer.set_title(title)
    viewer.renderer.line_width = LINE_PX
    viewer.renderer.draw_shadows = False
    viewer.renderer.sky_upper = viewer.renderer.sky_lower = tuple(look.SKY_RGB)
    return viewer
