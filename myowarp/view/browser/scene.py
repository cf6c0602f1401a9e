"""A world in a page: bones and objects as meshes, muscles as bellies and tubes, goals as balls.

Meshes of bodies are sent once, as they lie in their bodies; what moves afterwards is the place of each body,
the rings of each belly, and all tubes and balls together. Only what has changed is sent.

All of it moves by properties of scene nodes, nothing by their transforms. viser's page applies transforms
before the next picture and properties after it: bones would be seen one picture ahead of their muscles, and
where software draws, a picture takes half a second. Properties that come together are applied together.
"""

from __future__ import annotations

import copy
from collections import defaultdict
from collections.abc import Callable, Set
from typing import Literal

import mujoco
import numpy as np
import trimesh
import viser

from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing
from myowarp.view.drawing.muscles import QUANTITIES, TENDON_RGB, TENDON_TINT, Muscles
from myowarp.view.drawing.render import coarsen
from myowarp.view.drawing.scenery import floor_height, has_plane
from myowarp.view.drawing.skeleton import Skeleton
from myowarp.view.drawing.snapshot import Snapshot
from myowarp.view.drawing.world import ARROW_RADIUS, GHOST_ALPHA, LINK_RADIUS, MARKER_RADIUS

CELL = 1 / 150
"""Smallest detail of a mesh that is sent, in units of the framed radius: some browsers draw in software."""
KEPT, KEPT_FAINT = ((0.8, 0.3), (4.0, 0.15)), ((0.8, 0.15), (4.0, 0.08))
"""Shares of its faces that are drawn of a mesh beyond distances, in units of the framed radius: its outline
stays. Faint are bones that no muscle moves, and the posture that is wanted."""
SIDES, CONE_SIDES = 6, 20
"""Faces around a tube and a cone."""
BALL_SIDES = (6, 12)
"""Rings of a ball, and points on each."""
BELLY, SMALL_BELLY, CROWD = (11, 8), (8, 6), 20
"""Rings of a belly and points on each, and where there are more muscles than the last number, small ones."""
OVERLAP = 0.45
"""Overlap of a tube with the next one, in units of its radius."""
STILL = 2e-5
"""m or 1: what has moved by less is not sent."""
SPARE = 1.25
"""Room for more tubes than there are now: muscles take and leave wrapping surfaces. A batch that needs more
grows, as a new one is not in the first picture."""
COPY_BYTES = 43
"""Place, turn, size and colour of a tube or ball."""
BODY_BYTES = 160
"""Messages that place a mesh of a body."""
BELLY_BYTES = 120
"""Message that shapes a belly, without its points."""
THINNEST = 0.002
"""Least radius of a tendon, in units of the framed radius."""
FLOOR_REACH, LINE = 6.0, 0.003
"""Half a side of the squares on the floor, and the radius of their lines, in units of the framed radius: a
pixel or two of a small page. Lines lie on the floor: in it, depths are too coarse to keep them in sight."""
PLANE_REACH = 200.0
"""Half a side of a plane, which has no end, in units of the framed radius: its corners are at the horizon."""
HEAD = 2.5
"""Radius of an arrow's head over that of the arrow."""
SPACING = 2.3
"""Distance from body to body, in units of the framed radius."""

_Lod = Literal["off"] | tuple[tuple[float, float], ...]


class Figure:
    """A world in a page.

    Attributes:
        muscles: Its muscles.
        tubes: Tendons, bones without meshes and lines, as they are in the page.
        pick: Called with the name of a muscle that was clicked; None: muscles are not to be clicked.
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
        pick: Callable[[str], None] | None = None,
    ) -> None:
        """Send what does not change.

        Args:
            server: Where.
            name: Its node in the page, a path; what moves the node moves all of it.
            model: The full model; it is not changed.
            radius: Framed radius [m], which sets the scale of muscles and markers.
            tips: Names of the sites at the ends of the limb.
            ghost: Whether it is only the translucent limb in the posture that is wanted.
            pick: Called with the name of a muscle that was clicked; None: muscles are not to be clicked.
        """
        self._server, self._name, self._radius, self._is_ghost = server, name, radius, ghost
        self._root = server.scene.add_frame(name, show_axes=False)
        self._model = copy.copy(model)
        coarsen(self._model, CELL * radius)
        self._data = mujoco.MjData(self._model)
        self._nominal: dict[tuple[str, str], np.ndarray] = {}
        self._given, self.pick = model, pick
        on_tendon = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON)
        self._names = [model.actuator(int(actuator)).name for actuator in on_tendon]
        self.muscles, self._skeleton = Muscles(model, radius), Skeleton(model)
        self._rings, self._sides = SMALL_BELLY if len(self.muscles.tendons) > CROWD else BELLY
        self._tips = [] if ghost else look.tip_sites(model, tips)
        self._tip_radii = look.tip_radii(model, self._tips, radius)
        self._rgba = look.shown_rgba(model)
        self._geoms = self._drawn()
        roots = look.rigid_roots(model)
        leads = roots == np.arange(model.nbody)
        self._followers = {root: np.flatnonzero((roots == root) & ~leads) for root in self._geoms}
        self.tubes = _Batch(server, f"{name}/tubes", *_tube(), GHOST_ALPHA if ghost else None)
        ball = trimesh.creation.uv_sphere(1.0, BALL_SIDES)
        self._balls = _Batch(server, f"{name}/balls", ball.vertices, ball.faces)
        self._heads = _Batch(server, f"{name}/heads", *_cone())
        self._ghost: Figure | None = None
        self._bellies: dict[int, viser.MeshHandle] = {}
        self._meshes: dict[int, list[_Batch]] = {}
        self._lies: dict[int, np.ndarray] = {}
        mujoco.mj_kinematics(self._model, self._data)
        for root in self._geoms:
            self._prepare_meshes(root, frozenset())

    @property
    def data(self) -> mujoco.MjData:
        """Return the last shown state, posed."""
        return self._data

    def show(
        self,
        seen: Snapshot,
        color: str = "activation",
        hidden: Set[str] = frozenset(),
        shift: Callable[[mujoco.MjData], np.ndarray] = lambda _: np.zeros(3),
    ) -> None:
        """Show a moment.

        Args:
            seen: What the world looks like.
            color: What the colour of a muscle shows, a name in `QUANTITIES`.
            hidden: Names of bodies that are not there.
            shift: Function from the data, posed, to how far all of it is moved aside [m], shape (3,).

        Raises:
            ValueError: A position is not finite.
        """
        for key in seen.shape:
            self._nominal.setdefault(key, look.geometry(self._model, self._data, key).copy())
        look.pose(self._model, self._data, seen.qpos, self._nominal | dict(seen.shape), seen.paths)
        self._draw(seen, color, hidden, shift(self._data))

    def _draw(self, seen: Snapshot, color: str, hidden: Set[str], aside: np.ndarray) -> None:
        """Send what is posed, moved aside."""
        for root in self._geoms:
            if not np.array_equal(self._lies[root], self._layout(root, hidden)):
                self._prepare_meshes(root, hidden)
            for mesh in self._meshes[root]:
                mesh.show(self._data.xpos[[root]] + aside, self._data.xquat[[root]], np.ones((1, 3)))
        self._show_tubes(seen, color, aside)
        if not self._is_ghost:
            self._show_balls(seen, aside)
            self._show_heads(seen, aside)
            self._show_ghost(seen.ghost, hidden, aside)

    def middle_of(self, muscle: str) -> np.ndarray | None:
        """Return the middle of the belly of a muscle as it was shown last [m]; None where there is none."""
        handle = self._bellies.get(self._names.index(muscle)) if muscle in self._names else None
        return None if handle is None else handle.vertices.mean(axis=0)

    @property
    def bytes_per_frame(self) -> int:
        """Return about the most bytes that a frame sends."""
        belly = BELLY_BYTES + 12 * self._rings * self._sides
        meshes = BODY_BYTES * sum(map(len, self._meshes.values())) + belly * len(self._bellies)
        return meshes + COPY_BYTES * (self.tubes.room + self._balls.room)

    def remove(self) -> None:
        """Take it out of the page."""
        self._root.remove()

    def _drawn(self) -> dict[int, np.ndarray]:
        """Return the geoms to draw of bodies that move as one, by the first; of a ghost the limb's."""
        model = self._model
        geoms = look.drawn_geoms(model)
        if self._is_ghost:
            limb = look.moving_bodies(model) & look.limb_trees(model)
            geoms = geoms[limb[model.geom_bodyid[geoms]]]
        roots = look.rigid_roots(model)[model.geom_bodyid[geoms]]
        return {int(root): geoms[roots == root] for root in np.unique(roots)}

    def _layout(self, root: int, hidden: Set[str]) -> np.ndarray:
        """Return what the meshes of bodies that move as one follow from, all in one array."""
        model, geoms = self._model, self._geoms[root]
        fields = model.geom_dataid[geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_HFIELD]]
        parts = [model.geom_size[geoms], model.geom_pos[geoms], model.geom_quat[geoms]]
        parts += [model.body_pos[self._followers[root]], self._worn(geoms, hidden)]
        parts += [look.field_of(model, int(field)) for field in fields]
        return np.concatenate([part.ravel() for part in parts])

    def _worn(self, geoms: np.ndarray, hidden: Set[str]) -> np.ndarray:
        """Return a mask over geoms: True where their bodies are there."""
        bodies = self._model.geom_bodyid[geoms]
        return np.array([not hidden or self._model.body(body).name not in hidden for body in bodies])

    def _prepare_meshes(self, root: int, hidden: Set[str]) -> None:
        """Make meshes of bodies that move as one, in the frame of the first, those of one colour as one."""
        for mesh in self._meshes.get(root, ()):
            mesh.remove()
        model, data, parts = self._model, self._data, defaultdict(list)
        self._lies[root] = self._layout(root, hidden)
        geoms = self._geoms[root][self._worn(self._geoms[root], hidden)]
        place, turn = data.xpos[root], data.xmat[root].reshape(3, 3)
        faint = look.pale_geoms(model) | self._is_ghost
        for geom in geoms:
            vertices, faces = _surface(model, int(geom), PLANE_REACH * self._radius)
            placed = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            kept = KEPT_FAINT if faint[geom] else KEPT
            parts[tuple(self._rgba[geom].round(3)), kept].append(((placed - place) @ turn, faces))
        slopes = bool((model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_HFIELD).any())
        self._meshes[root] = [
            _Batch(
                self._server,
                f"{self._name}/body_{root}/mesh_{index}",
                *_joined(pieces),
                opacity=GHOST_ALPHA if self._is_ghost else rgba[3] if rgba[3] < 1.0 else None,
                lod="off" if slopes else tuple((far * self._radius, share) for far, share in kept),
                rgb=look.TARGET_RGB if self._is_ghost else np.array(rgba[:3]),
            )
            for index, ((rgba, kept), pieces) in enumerate(parts.items())
        ]

    def _show_tubes(self, seen: Snapshot, color: str, aside: np.ndarray) -> None:
        """Place muscles, bones without meshes, and lines from tips to targets."""
        starts, ends, radii = self._skeleton.bones(self._data)
        rgb = np.tile(look.TARGET_RGB if self._is_ghost else look.BONE_RGB, (len(radii), 1))
        if self._is_ghost:
            self.tubes.show_between(starts + aside, ends + aside, radii, rgb)
            return
        thinnest = THINNEST * self._radius
        tubes = self.muscles.tubes(self._data, seen.muscles, thinnest, pieces=1)
        belly = QUANTITIES[color].rgb(self.muscles.values(color, seen.muscles, self._data))
        tendon = (1.0 - TENDON_TINT) * TENDON_RGB + TENDON_TINT * belly
        known = np.ones(len(belly), bool) if seen.activation is None else ~np.isnan(seen.activation)
        bellies = self.muscles.bellies(self._data, seen.muscles, thinnest, self._rings)
        shapes = bellies.vertices(self._sides) + aside
        for muscle, shape in zip(bellies.muscles, shapes, strict=True):
            self._show_belly(
                muscle, shape if known[muscle] else shape[:1].repeat(len(shape), 0), belly[muscle]
            )
        shown = known[tubes.owner] & ~tubes.belly
        painted = tendon[tubes.owner]
        links = [
            (self._data.site_xpos[tip], place) for tip, place in look.marker_pairs(self._given, seen.goals)
        ]
        link_ends = np.array(links).reshape(-1, 2, 3)
        lines = np.concatenate((link_ends, seen.arrows))
        thin = np.repeat((LINK_RADIUS, ARROW_RADIUS), (len(links), len(seen.arrows))) * self._radius
        inks = np.repeat((look.TARGET_RGB, look.FORCE_RGB), (len(links), len(seen.arrows)), axis=0)
        self.tubes.show_between(
            np.concatenate((tubes.starts[shown], starts, lines[:, 0])) + aside,
            np.concatenate((tubes.ends[shown], ends, lines[:, 1])) + aside,
            np.concatenate((tubes.radii[shown], radii, thin)),
            np.concatenate((painted[shown], rgb, inks)),
        )

    def _show_belly(self, muscle: int, vertices: np.ndarray, rgb: np.ndarray) -> None:
        """Shape and colour the belly of a muscle; one that is torn is a point."""
        handle, color = self._bellies.get(muscle), tuple((255 * rgb).round().astype(int).tolist())
        if handle is None:
            self._bellies[muscle] = self._server.scene.add_mesh_simple(
                f"{self._name}/belly_{muscle}",
                vertices.astype(np.float32),
                _around(self._rings, self._sides),
                color=color,
                cast_shadow=False,
                receive_shadow=False,
            )
            if (pick := self.pick) is not None:
                self._bellies[muscle].on_click(lambda _: pick(self._names[muscle]))
            return
        if np.abs(vertices - handle.vertices).max() > STILL:
            handle.vertices = vertices.astype(np.float32)
        if handle.color != color:
            handle.color = color

    def _show_balls(self, seen: Snapshot, aside: np.ndarray) -> None:
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
        self._balls.show(places + aside, turns, np.tile(radii[:, None], 3), np.array(colors).reshape(-1, 3))

    def _show_heads(self, seen: Snapshot, aside: np.ndarray) -> None:
        """Place the heads of arrows, beyond their ends."""
        along = seen.arrows[:, 1] - seen.arrows[:, 0]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        radii, ends = np.full(len(along), HEAD * ARROW_RADIUS * self._radius), seen.arrows[:, 1] + aside
        tips = ends + 2.0 * radii[:, None] * along
        self._heads.show_between(ends, tips, radii, np.tile(look.FORCE_RGB, (len(along), 1)))

    def _show_ghost(self, wanted: np.ndarray | None, hidden: Set[str], aside: np.ndarray) -> None:
        """Show the posture that the goal asks for."""
        if wanted is not None:
            if self._ghost is None:
                name = f"{self._name}/ghost"
                self._ghost = Figure(self._server, name, self._given, self._radius, ghost=True)
            self._ghost.show(Snapshot(wanted), hidden=hidden, shift=lambda _: aside)


class Floor:
    """Squares on the floor under a body that goes about."""

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        model: mujoco.MjModel,
        framing: Framing,
        *,
        always: bool = False,
    ) -> None:
        """Prepare the lines.

        Args:
            server: Where.
            name: Its node in the page.
            model: The full model.
            framing: The camera, which goes along.
            always: Whether there is a floor under what stays where it is, too, unless the model has its own.
        """
        radius = framing.radius
        self._cell = float(10.0 ** np.floor(np.log10(radius)))
        self._reach = np.ceil(FLOOR_REACH * radius / self._cell) * self._cell
        self._height, self._radius, self._hidden = (
            floor_height(model) + LINE * radius,
            radius,
            not (framing.follows or (always and not has_plane(model))),
        )
        self._lines = _Batch(server, name, *_tube())

    def show(self, aside: np.ndarray) -> None:
        """Show them, moved aside as the world is [m]; they stand still in it."""
        if self._hidden:
            return
        middle = np.round(-aside[:2] / self._cell) * self._cell
        offsets = np.arange(-self._reach, self._reach + 0.5 * self._cell, self._cell)
        ends = np.full((2, 2, len(offsets), 3), self._height)  # start or end, along x or y, line
        for side, sign in enumerate((-1.0, 1.0)):
            for along in (0, 1):
                ends[side, along, :, along] = middle[along] + sign * self._reach
                ends[side, along, :, 1 - along] = middle[1 - along] + offsets
        starts, stops = ends.reshape(2, -1, 3) + aside
        count = len(starts)
        rgb = np.tile(look.PALE_RGB, (count, 1))
        self._lines.show_between(starts, stops, np.full(count, LINE * self._radius), rgb)


class _Batch:
    """Copies of one mesh, each with a place, a turn, a size and a colour; sent together.

    Attributes:
        handle: The copies in the page; None: nothing was sent yet.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        opacity: float | None = None,
        lod: _Lod = "off",
        rgb: np.ndarray | None = None,
    ) -> None:
        self._server, self._name, self._mesh = server, name, (vertices, faces)
        self._opacity, self._lod, self._rgb = opacity, lod, rgb
        self.handle: viser.BatchedMeshHandle | None = None
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

    def show(
        self, places: np.ndarray, turns: np.ndarray, scales: np.ndarray, rgb: np.ndarray | None = None
    ) -> None:
        """Place the copies; rows (n, 3), (n, 4), (n, 3), (n, 3); without colours all have the batch's."""
        count = len(places)
        if rgb is None:
            assert self._rgb is not None
            rgb = np.tile(self._rgb, (count, 1))
        grown = count > self.room
        if grown:
            self.room = int(np.ceil(SPARE * count)) if self._rgb is None else count
        if not self.room:
            return
        spare = self.room - count
        places = np.concatenate((places, np.zeros((spare, 3)))).astype(np.float32)
        turns = np.concatenate((turns, np.tile((1.0, 0.0, 0.0, 0.0), (spare, 1)))).astype(np.float32)
        scales = np.concatenate((scales, np.zeros((spare, 3)))).astype(np.float32)
        colors = (255 * _linear(np.concatenate((rgb, np.zeros((spare, 3)))))).round().astype(np.uint8)
        if self.handle is None:
            self.handle = self._server.scene.add_batched_meshes_simple(
                self._name,
                *self._mesh,
                turns,
                places,
                batched_scales=scales,
                batched_colors=colors,
                opacity=self._opacity,
                lod=self._lod,
                cast_shadow=False,
                receive_shadow=False,
            )
            return
        for field, values in (("positions", places), ("wxyzs", turns), ("scales", scales)):
            if grown or np.abs(values - getattr(self.handle, f"batched_{field}")).max() > STILL:
                setattr(self.handle, f"batched_{field}", values)
        if grown or not np.array_equal(colors, self.handle.batched_colors):
            self.handle.batched_colors = colors

    def remove(self) -> None:
        """Take the copies out of the page."""
        if self.handle is not None:
            self.handle.remove()
        self.handle, self.room = None, 0


def _linear(rgb: np.ndarray) -> np.ndarray:
    """Return colours as light: viser takes those of batches so, all others as sRGB (IEC 61966-2-1)."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def _around(rings: int, sides: int) -> np.ndarray:
    """Return the faces between rings of points."""
    here, after = np.arange(sides), np.roll(np.arange(sides), -1)
    quads = ((here, after, sides + after), (here, sides + after, sides + here))
    band = np.concatenate([np.column_stack(quad) for quad in quads])
    return np.concatenate([band + sides * ring for ring in range(rings - 1)])


def _tube() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of an open tube along z, of length and radius 1."""
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circle = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    vertices = np.concatenate([np.column_stack((circle, np.full(SIDES, z))) for z in (-0.5, 0.5)])
    return vertices, _around(2, SIDES)


def _cone() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a cone along z, of length and radius 1, its middle at 0."""
    cone = trimesh.creation.cone(1.0, 1.0, sections=CONE_SIDES)
    return cone.vertices - (0.0, 0.0, 0.5), cone.faces


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
    if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        return _landscape(model, int(model.geom_dataid[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        box = trimesh.creation.box(2.0 * size)
        box.unmerge_vertices()  # else its edges look round
        return box.vertices, box.faces
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        corners = reach * np.array(((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)))
        return corners, np.array(((0, 1, 2), (0, 2, 3)))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        # Of radius 1, as vertices of a tiny one would be merged.
        round_ = trimesh.creation.capsule(2.0 * size[1] / size[0], 1.0, count=(16, 16))
        round_.apply_translation(-round_.bounds.mean(axis=0))
        round_.apply_scale(size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        round_ = trimesh.creation.cylinder(size[0], 2.0 * size[1], sections=32)
        round_.unmerge_vertices()
    else:
        round_ = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        round_.apply_scale(size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
    return round_.vertices, round_.faces


def _landscape(model: mujoco.MjModel, hfield: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [m] and faces of a height field: two triangles a cell, as MuJoCo cuts it."""
    heights = look.field_of(model, hfield)
    (x, y, z), (rows, columns) = model.hfield_size[hfield, :3], heights.shape
    grid = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
    number = np.arange(heights.size).reshape(rows, columns)
    start, right, up, end = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.stack([start, right, end, start, end, up], axis=-1).reshape(-1, 3)
    return np.stack([*grid, z * heights], axis=-1).reshape(-1, 3), faces


def _joined(pieces: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return meshes as one."""
    firsts = np.cumsum([0] + [len(vertices) for vertices, _ in pieces])
    faces = [faces + first for (_, faces), first in zip(pieces, firsts[:-1], strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]).astype(np.float32), np.concatenate(faces)
