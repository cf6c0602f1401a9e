"""What a page shows of a world: bones and objects as meshes, muscles as one batch of tubes, goals as balls.

Meshes are sent once, as they lie in their bodies; what moves afterwards is the place of each body, and of all
tubes and balls together. Only what has changed is sent.
"""

from __future__ import annotations

import copy
from collections import defaultdict
from collections.abc import Set

import mujoco
import numpy as np
import trimesh
import viser

from myowarp.view.drawing import style as look
from myowarp.view.drawing.muscles import QUANTITIES, TENDON_RGB, TENDON_TINT, Muscles
from myowarp.view.drawing.render import coarsen
from myowarp.view.drawing.scenery import floor_height, has_plane
from myowarp.view.drawing.skeleton import Skeleton
from myowarp.view.drawing.snapshot import Snapshot
from myowarp.view.drawing.world import GHOST_ALPHA, LINK_RADIUS, MARKER_RADIUS

CELL, GHOST_CELL = 1 / 150, 1 / 80
"""What is smaller in a mesh is not sent, in units of the framed radius: some browsers draw in software."""
SIDES = 10
"""Faces around a tube."""
OVERLAP = 0.45
"""How far a tube reaches into the next one, in units of its radius."""
STILL = 2e-5
"""m or 1: a body that has moved by less is not sent."""
SPARE = 1.25
"""Room for more tubes than there are now: muscles take and leave wrapping surfaces."""
COPY_BYTES = 43
"""Place, turn, size and colour of a tube or ball."""
BODY_BYTES = 120
"""Messages that place a body."""
PLANE_REACH = 20.0
"""Half a side of a plane without end, in units of the framed radius."""
SPACING = 2.3
"""Distance from body to body, in units of the framed radius."""


class Figure:
    """A world in a page.

    Attributes:
        muscles: Its muscles.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        model: mujoco.MjModel,
        radius: float,
        tips: tuple[str, ...] = (),
        *,
        ghost: bool = False,
    ) -> None:
        """Send what does not change.

        Args:
            server: Where.
            name: Its node in the page, a path; what moves the node moves all of it.
            model: The full model; it is not changed.
            radius: Framed radius [m], which sets the scale of muscles and markers.
            tips: Names of the sites at the ends of the limb.
            ghost: Whether it is only the translucent limb in the posture that is wanted.
        """
        self._server, self._name, self._radius, self._is_ghost = server, name, radius, ghost
        self._root = server.scene.add_frame(name, show_axes=False)
        self._model = copy.copy(model)
        coarsen(self._model, (GHOST_CELL if ghost else CELL) * radius)
        self._data = mujoco.MjData(self._model)
        self._nominal: dict[tuple[str, str], np.ndarray] = {}
        self._given = model
        self.muscles, self._skeleton = Muscles(model, radius), Skeleton(model)
        self._tips = [] if ghost else look.tip_sites(model, tips)
        self._tip_radii = look.tip_radii(model, self._tips, radius)
        self._rgba = look.shown_rgba(model)
        self._geoms = self._drawn()
        self._tubes = _Batch(server, f"{name}/tubes", *_tube(), GHOST_ALPHA if ghost else None)
        ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
        self._balls = _Batch(server, f"{name}/balls", ball.vertices, ball.faces)
        self._ghost: Figure | None = None
        self._frames: dict[int, viser.FrameHandle] = {}
        self._meshes: dict[int, list[viser.SceneNodeHandle]] = {}
        self._sizes: dict[int, np.ndarray] = {}
        for body in self._geoms:
            self._frames[body] = server.scene.add_frame(f"{name}/body_{body}", show_axes=False)
            self._send_meshes(body)

    @property
    def data(self) -> mujoco.MjData:
        """What was shown last, posed."""
        return self._data

    def show(self, seen: Snapshot, color: str = "activation", hidden: Set[str] = frozenset()) -> None:
        """Show a moment.

        Args:
            seen: What the world looks like.
            color: What the colour of a muscle shows, a name in `QUANTITIES`.
            hidden: Names of bodies that are not there.

        Raises:
            ValueError: A position is not finite.
        """
        for key in seen.shape:
            self._nominal.setdefault(key, look.geometry(self._model, self._data, key).copy())
        look.pose(self._model, self._data, seen.qpos, self._nominal | dict(seen.shape))
        for body, frame in self._frames.items():
            if not np.array_equal(self._sizes[body], self._model.geom_size[self._geoms[body]]):
                self._send_meshes(body)
            frame.visible = self._model.body(body).name not in hidden
            _move(frame, self._data.xpos[body], self._data.xquat[body])
        self._show_tubes(seen, color)
        if not self._is_ghost:
            self._show_balls(seen)
            self._show_ghost(seen.ghost, hidden)

    @property
    def bytes_per_frame(self) -> int:
        """What a frame sends at most, about."""
        return BODY_BYTES * len(self._frames) + COPY_BYTES * (self._tubes.room + self._balls.room)

    def remove(self) -> None:
        """Take it out of the page."""
        self._root.remove()

    def _drawn(self) -> dict[int, np.ndarray]:
        """Return the geoms to draw of each body that has some; of a ghost those of the limb that move."""
        model = self._model
        geoms = look.drawn_geoms(model)
        geoms = geoms[model.geom_type[geoms] != mujoco.mjtGeom.mjGEOM_HFIELD]
        if self._is_ghost:
            limb = look.moving_bodies(model) & look.limb_trees(model)
            geoms = geoms[limb[model.geom_bodyid[geoms]]]
        bodies = model.geom_bodyid[geoms]
        return {int(body): geoms[bodies == body] for body in np.unique(bodies)}

    def _send_meshes(self, body: int) -> None:
        """Send the geoms of a body, in its frame, those of one colour as one mesh."""
        for handle in self._meshes.get(body, ()):
            handle.remove()
        model, parts = self._model, defaultdict(list)
        self._sizes[body] = model.geom_size[self._geoms[body]].copy()
        for geom in self._geoms[body]:
            vertices, faces = _surface(model, int(geom), PLANE_REACH * self._radius)
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
            placed = vertices @ turn.reshape(3, 3).T + model.geom_pos[geom]
            parts[tuple(self._rgba[geom].round(3))].append((placed, faces))
        self._meshes[body] = [
            self._server.scene.add_mesh_simple(
                f"{self._name}/body_{body}/mesh_{index}",
                *_joined(pieces),
                color=tuple(look.TARGET_RGB if self._is_ghost else rgba[:3]),
                opacity=GHOST_ALPHA if self._is_ghost else rgba[3] if rgba[3] < 1.0 else None,
                side="front" if self._is_ghost else "double",
                cast_shadow=False,
                receive_shadow=False,
            )
            for index, (rgba, pieces) in enumerate(parts.items())
        ]

    def _show_tubes(self, seen: Snapshot, color: str) -> None:
        """Place muscles, bones without meshes, and lines from tips to targets."""
        starts, ends, radii = self._skeleton.bones(self._data)
        rgb = np.tile(look.TARGET_RGB if self._is_ghost else look.BONE_RGB, (len(radii), 1))
        if self._is_ghost:
            self._tubes.show_between(starts, ends, radii, rgb)
            return
        tubes = self.muscles.tubes(self._data, seen.muscles, 0.002 * self._radius)
        belly = QUANTITIES[color].rgb(self.muscles.values(color, seen.muscles, self._data))
        tendon = (1.0 - TENDON_TINT) * TENDON_RGB + TENDON_TINT * belly
        known = np.ones(len(belly), bool) if seen.activation is None else ~np.isnan(seen.activation)
        shown = known[tubes.owner]
        painted = np.where(tubes.belly[:, None], belly[tubes.owner], tendon[tubes.owner])
        links = [
            (self._data.site_xpos[tip], place) for tip, place in look.marker_pairs(self._given, seen.goals)
        ]
        link_ends = np.array(links).reshape(-1, 2, 3)
        self._tubes.show_between(
            np.concatenate((tubes.starts[shown], starts, link_ends[:, 0])),
            np.concatenate((tubes.ends[shown], ends, link_ends[:, 1])),
            np.concatenate((tubes.radii[shown], radii, np.full(len(links), LINK_RADIUS * self._radius))),
            np.concatenate((painted[shown], rgb, np.tile(look.TARGET_RGB, (len(links), 1)))),
        )

    def _show_balls(self, seen: Snapshot) -> None:
        """Place tips and targets."""
        places = np.concatenate(
            (self._data.site_xpos[self._tips], [*seen.goals.values()] or np.zeros((0, 3)))
        )
        sites = [mujoco.mj_name2id(self._given, mujoco.mjtObj.mjOBJ_SITE, name) for name in seen.goals]
        sizes = np.array([self._given.site_size[site, 0] if site >= 0 else 0.0 for site in sites])
        low, high = MARKER_RADIUS[0] * self._radius, MARKER_RADIUS[1] * self._radius
        radii = np.concatenate((self._tip_radii, np.clip(sizes, low, high)))
        colors = [look.TIP_RGB] * len(self._tips) + [look.TARGET_RGB] * len(sites)
        turns = np.tile((1.0, 0.0, 0.0, 0.0), (len(places), 1))
        self._balls.show(places, turns, np.tile(radii[:, None], 3), np.array(colors).reshape(-1, 3))

    def _show_ghost(self, wanted: np.ndarray | None, hidden: Set[str]) -> None:
        """Show the posture that the goal asks for."""
        if wanted is not None:
            if self._ghost is None:
                name = f"{self._name}/ghost"
                self._ghost = Figure(self._server, name, self._given, self._radius, ghost=True)
            self._ghost.show(Snapshot(wanted), hidden=hidden)


def add_floor(server: viser.ViserServer, name: str, model: mujoco.MjModel, radius: float) -> None:
    """Draw squares on the floor, which move as their node does, unless the model has a floor of its own."""
    if has_plane(model):
        return
    power, side = 10.0 ** np.floor(np.log10(radius)), PLANE_REACH * radius
    server.scene.add_grid(
        name,
        side,
        side,
        position=(0.0, 0.0, floor_height(model)),
        cell_size=power,
        section_size=5 * power,
        cell_color=(225, 228, 232),
        section_color=(190, 195, 200),
    )


class _Batch:
    """Copies of one mesh, each with a place, a turn, a size and a colour; sent together."""

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        opacity: float | None = None,
    ) -> None:
        self._server, self._name, self._mesh, self._opacity = server, name, (vertices, faces), opacity
        self._handle: viser.BatchedMeshHandle | None = None
        self.room = 0

    def show_between(self, starts: np.ndarray, ends: np.ndarray, radii: np.ndarray, rgb: np.ndarray) -> None:
        """Place tubes from points (n, 3) to points (n, 3) [m]."""
        along = ends - starts
        lengths = np.linalg.norm(along, axis=1)
        axes = along / np.maximum(lengths, 1e-9)[:, None]
        # The turn from z to an axis a is (1 + a_z, -a_y, a_x, 0), normalised; from z to -z any half turn.
        turns = np.stack((1.0 + axes[:, 2], -axes[:, 1], axes[:, 0], np.zeros(len(axes))), axis=1)
        turns[axes[:, 2] < -1.0 + 1e-6] = (0.0, 1.0, 0.0, 0.0)
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        scales = np.stack((radii, radii, lengths + OVERLAP * radii), axis=1)
        self.show((starts + ends) / 2, turns, scales, rgb)

    def show(self, places: np.ndarray, turns: np.ndarray, scales: np.ndarray, rgb: np.ndarray) -> None:
        """Place the copies; rows (n, 3), (n, 4), (n, 3), (n, 3)."""
        count = len(places)
        if count > self.room or (self._handle is None and count):
            self.remove()
            self.room = int(np.ceil(SPARE * count))
        if not self.room:
            return
        spare = self.room - count
        places = np.concatenate((places, np.zeros((spare, 3)))).astype(np.float32)
        turns = np.concatenate((turns, np.tile((1.0, 0.0, 0.0, 0.0), (spare, 1)))).astype(np.float32)
        scales = np.concatenate((scales, np.zeros((spare, 3)))).astype(np.float32)
        colors = (255 * np.concatenate((rgb, np.zeros((spare, 3))))).round().astype(np.uint8)
        if self._handle is None:
            self._handle = self._server.scene.add_batched_meshes_simple(
                self._name,
                *self._mesh,
                turns,
                places,
                batched_scales=scales,
                batched_colors=colors,
                opacity=self._opacity,
                lod="off",
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            return
        handle = self._handle
        handle.batched_positions, handle.batched_wxyzs = places, turns
        handle.batched_scales, handle.batched_colors = scales, colors

    def remove(self) -> None:
        """Take the copies out of the page."""
        if self._handle is not None:
            self._handle.remove()
        self._handle, self.room = None, 0


def _move(frame: viser.FrameHandle, place: np.ndarray, turn: np.ndarray) -> None:
    """Move a node, if it is not there already."""
    if np.abs(place - frame.position).max() > STILL:
        frame.position = place
    if np.abs(turn - frame.wxyz).max() > STILL:
        frame.wxyz = turn


def _tube() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of an open tube along z, of length and radius 1."""
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circle = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    vertices = np.concatenate([np.column_stack((circle, np.full(SIDES, z))) for z in (-0.5, 0.5)])
    here, after = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
    quads = ((here, after, SIDES + after), (here, SIDES + after, SIDES + here))
    return vertices, np.concatenate([np.column_stack(quad) for quad in quads])


def _surface(model: mujoco.MjModel, geom: int, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [m] and faces of a geom, in its own frame."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        faces = model.mesh_face[face : face + model.mesh_facenum[mesh]]
        used, renumbered = np.unique(faces, return_inverse=True)
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        return vertices[used], renumbered.reshape(faces.shape)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        box = trimesh.creation.box(2.0 * size)
        box.unmerge_vertices()  # else its edges look round
        return box.vertices, box.faces
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        x, y = (half or reach for half in size[:2])
        return np.array(((-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0))), np.array(((0, 1, 2), (0, 2, 3)))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        round_ = trimesh.creation.capsule(2.0 * size[1], size[0], count=(16, 16))
        round_.apply_translation(-round_.bounds.mean(axis=0))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        round_ = trimesh.creation.cylinder(size[0], 2.0 * size[1], sections=32)
        round_.unmerge_vertices()
    else:
        round_ = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        round_.apply_scale(size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
    return round_.vertices, round_.faces


def _joined(pieces: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return meshes as one."""
    firsts = np.cumsum([0] + [len(vertices) for vertices, _ in pieces])
    faces = [faces + first for (_, faces), first in zip(pieces, firsts[:-1], strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]).astype(np.float32), np.concatenate(faces)
