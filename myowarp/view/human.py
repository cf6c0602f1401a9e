"""Worlds shown live in a Newton viewer: a window (OpenGL) or a browser page (Viser).

Newton only draws here: MuJoCo places the bodies of the full model and its muscle paths, and the viewer
gets meshes, instances and lines. Nothing of Newton's physics is used, and Newton is imported only when a
viewer is made.
"""

from __future__ import annotations

import importlib
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType
from typing import Any, Literal

import mujoco
import numpy as np

from myowarp.view import style as look
from myowarp.view.framing import Framing, view_axes
from myowarp.view.modes import NEEDED, live_viewer
from myowarp.view.muscles import QUANTITIES, RELAXED_RGB
from myowarp.view.render import NoGraphicsError

Backend = Literal["gl", "viser", "null"]
LINE_PX = 4.0
"""Width of a muscle on the screen."""
MARKER_RADIUS = 0.035
"""Radius of a target, in units of the framed radius."""
SPACING = 2.3
"""Distance between neighbouring worlds, in units of the framed radius."""
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
    """Shows one or several worlds of a model as they move."""

    def __init__(
        self,
        model: mujoco.MjModel,
        backend: Backend | None = None,
        port: int = 8080,
        title: str = "MyoWarp",
        tips: Iterable[str] = (),
    ):
        """Opens the viewer.

        Args:
            model: the full (unslimmed) model; it is not changed.
            backend: ``"gl"`` for a window, ``"viser"`` for a page in the browser, ``"null"`` to draw nothing
                (tests); by default a window where a display is there, else the browser.
            port: port of the browser page on this machine; the next free one is taken.
            title: name of the window or page.
            tips: names of the sites at the ends of the limb.

        Raises:
            ValueError: the backend is unknown.
            NoGraphicsError: a package or a display is missing.
        """
        backend = backend or live_viewer()
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
        self._pale, self._bone = look.pale_geoms(model), look.bone_geoms(model)
        self._shown = 0
        self._newton, self._wp = _import_newton(backend)
        self.viewer = _open_viewer(self._newton, backend, port, title)
        self.backend = backend
        self._camera = camera
        self._log_shapes()

    def __enter__(self) -> HumanViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def running(self) -> bool:
        """False once the window was closed."""
        return self.viewer is not None and self.viewer.is_running()

    @property
    def url(self) -> str | None:
        """Address of the browser page, or None for a window."""
        return getattr(self.viewer, "url", None) if self.backend == "viser" and self.viewer else None

    def show(
        self,
        qpos: np.ndarray,
        activation: np.ndarray | None = None,
        sites: Mapping[str, np.ndarray] | None = None,
        time: float = 0.0,
        shapes: Sequence[Mapping[tuple[str, str], np.ndarray]] | None = None,
    ) -> None:
        """Shows one moment of one or several worlds, side by side.

        Args:
            qpos: generalised position, shape ``(nq,)`` or ``(num_worlds, nq)``.
            activation: muscle activation [1], shape ``(num_muscles,)`` or ``(num_worlds, num_muscles)``,
                or None; NaN hides a muscle.
            sites: task targets: name to position in its world [m], shape ``(3,)`` or ``(num_worlds, 3)``.
            time: simulated time [s].
            shapes: for each world its own geometry, as in ``WorldRenderer.frame``; places and turns are
                shown, sizes stay nominal.

        Raises:
            ValueError: a shape is wrong or a position is not finite.
            RuntimeError: the viewer was closed.
        """
        if self.viewer is None:
            raise RuntimeError("show needs an open HumanViewer, got a closed one; make a new one")
        qpos = np.atleast_2d(qpos)
        count = len(qpos)
        activation = None if activation is None else np.atleast_2d(activation)
        sites = {name: np.atleast_2d(place) for name, place in (sites or {}).items()}
        _check_count(count, activation, sites)
        if count != self._shown:
            self._arrange(count)
        shapes = shapes or [{}] * count
        moments = [
            self._moment(world, qpos, activation, sites, shapes[world], self._shift[world])
            for world in range(count)
        ]
        self.viewer.begin_frame(float(time))
        self._log_geoms(np.stack([moment[0] for moment in moments]), count)
        self._log_muscles(moments)
        self._log_markers(moments)
        self.viewer.end_frame()

    def close(self) -> None:
        """Closes the window, or stops the server; safe to call twice."""
        if self.viewer is not None:
            self.viewer.close()
        self.viewer = None

    def _moment(
        self,
        world: int,
        qpos: np.ndarray,
        activation: np.ndarray | None,
        sites: Mapping[str, np.ndarray],
        shape: Mapping[tuple[str, str], np.ndarray],
        shift: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """Returns geom transforms, muscle pieces with colours, and markers of one world, moved aside."""
        look.pose(self._model, self._data, qpos[world], shape)
        level = np.full(len(self._tendons), np.nan) if activation is None else activation[world]
        if level.shape != (len(self._tendons),):
            raise ValueError(f"activation needs shape ({len(self._tendons)},), got {level.shape}")
        rgb = QUANTITIES["activation"].rgb(level)
        starts, ends, owner = look.tendon_segments(self._model, self._data, self._tendons)
        if activation is not None:
            shown = ~np.isnan(activation[world])[owner]
            starts, ends, owner = starts[shown], ends[shown], owner[shown]
        # A constant number of pieces lets the viewer keep its buffers while muscles wrap and unwrap.
        spare = 2 * self._model.nwrap - len(starts)
        fill = np.zeros((spare, 3)) if not len(ends) else np.tile(ends[-1], (spare, 1))
        lines = np.concatenate((starts, fill)) + shift, np.concatenate((ends, fill)) + shift
        colors = np.concatenate((rgb[owner], np.tile(RELAXED_RGB, (spare, 1))))
        targets = np.array([place[world] for place in sites.values()]).reshape(-1, 3)
        places = np.concatenate((self._data.site_xpos[self._tips], targets)) + shift
        return self._transforms(shift), *lines, colors, places

    def _transforms(self, shift: np.ndarray) -> np.ndarray:
        """Returns position and quaternion (x, y, z, w) of the drawn geoms, shape ``(num_geoms, 7)``."""
        out = np.empty((len(self._geoms), 7), dtype=np.float32)
        quat = np.empty(4)
        for row, geom in enumerate(self._geoms):
            mujoco.mju_mat2Quat(quat, self._data.geom_xmat[geom])
            out[row, :3] = self._data.geom_xpos[geom] + shift
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

    def _log_geoms(self, transforms: np.ndarray, count: int) -> None:
        """Places the geoms of all worlds; what cannot move is sent only when the number of worlds changes."""
        fresh, self._shown = count != self._shown, count
        for row, geom in enumerate(self._geoms):
            if not fresh and self._still[geom]:
                continue
            name, ones = f"/geom_{geom}", np.ones((count, 3))
            xforms = self._wp.array(transforms[:, row], dtype=self._wp.transform, device=self.viewer.device)
            crowded = count > 1 and bool(self._pale[geom])
            self._place(name, self._shape[geom], xforms, ones, ones * self._color(geom), hidden=crowded)

    def _color(self, geom: int) -> np.ndarray:
        model = self._model
        if self._pale[geom]:
            return look.SKY_RGB
        if self._bone[geom]:
            return look.BONE_RGB
        material = model.geom_matid[geom]
        return (model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom])[:3]

    def _log_muscles(self, moments: list[tuple[np.ndarray, ...]]) -> None:
        starts, ends, colors = (
            self._array(np.concatenate([m[i] for m in moments]), self._wp.vec3) for i in (1, 2, 3)
        )
        if len(starts):
            self.viewer.log_lines("/muscles", starts, ends, colors, width=LINE_PX / 100.0)

    def _log_markers(self, moments: list[tuple[np.ndarray, ...]]) -> None:
        """Draws tips and targets as instances of one ball."""
        places = np.concatenate([moment[4] for moment in moments])
        if not len(places):
            return
        targets = len(moments[0][4]) - len(self._tips)
        radii = np.array(self._tip_radii + [MARKER_RADIUS * self._radius] * targets)
        colors = np.array([look.TIP_RGB] * len(self._tips) + [look.TARGET_RGB] * targets)
        xforms = np.tile(np.array((0, 0, 0, 0, 0, 0, 1.0)), (len(places), 1))
        xforms[:, :3] = places
        xforms = self._wp.array(xforms, dtype=self._wp.transform, device=self.viewer.device)
        scales = np.tile(radii[:, None], (len(moments), 3))
        self._place("/markers", "/ball", xforms, scales, np.tile(colors, (len(moments), 1)))

    def _place(
        self, name: str, shape: str, xforms: Any, scales: np.ndarray, colors: np.ndarray, hidden: bool = False
    ) -> None:
        surface = self._wp.array(
            np.tile(SURFACE, (len(scales), 1)), dtype=self._wp.vec4, device=self.viewer.device
        )
        scales, colors = self._array(scales, self._wp.vec3), self._array(colors, self._wp.vec3)
        self.viewer.log_instances(name, shape, xforms, scales, colors, surface, hidden=hidden)

    def _array(self, values: np.ndarray, dtype: type):
        return self._wp.array(
            np.ascontiguousarray(values, dtype=np.float32), dtype=dtype, device=self.viewer.device
        )

    def _arrange(self, count: int) -> None:
        """Sets worlds out in rows that face the camera, and moves the camera back until all are seen.

        Newton's yaw and pitch are MuJoCo's azimuth and elevation.
        """
        camera = self._camera
        axes = view_axes(camera.azimuth, camera.elevation)
        columns = int(np.ceil(count**0.5))
        row, column = np.divmod(np.arange(count), columns)
        across, down = column - (columns - 1) / 2, row - row.max() / 2
        step = SPACING * self._radius
        self._shift = step * (across[:, None] * axes[0] - down[:, None] * axes[1])
        self.viewer.camera_speed = 2.0 * self._radius
        eye = camera.lookat - (1.2 * columns - 0.2) * camera.distance * axes[2]
        self.viewer.set_camera(eye, camera.elevation, camera.azimuth)


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
            "`apt-get install libx11-6` or use backend='viser'"
        ) from error
    if not answers:
        raise NoGraphicsError(
            f"the 'gl' viewer needs an X display, got DISPLAY={display!r} where no server answers; use "
            "backend='viser' and open its page in a browser"
        )


def _check_count(count: int, activation: np.ndarray | None, sites: Mapping[str, np.ndarray]) -> None:
    if activation is not None and len(activation) != count:
        raise ValueError(f"activation needs one row per world, {count}, got {len(activation)}")
    for name, places in sites.items():
        if places.shape != (count, 3):
            raise ValueError(f"site '{name}' needs world positions of shape ({count}, 3), got {places.shape}")


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


def _open_viewer(newton: ModuleType, backend: str, port: int, title: str):
    """Opens the Newton viewer; ``PYGLET_HEADLESS`` asks for a window that nobody sees (tests)."""
    if backend == "null":
        return newton.viewer.ViewerNull()
    if backend == "viser":
        return newton.viewer.ViewerViser(host="127.0.0.1", port=port, label=title, verbose=False)
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
