"""A world as MuJoCo draws it: posed in a copy of its model, with muscles, targets and a ghost put in by hand.

Pictures and the window share it.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from functools import cached_property

import mujoco
import numpy as np

from myowarp.definitions.registry import check_choice
from myowarp.view.drawing import style as look
from myowarp.view.drawing.framing import Framing
from myowarp.view.drawing.muscles import QUANTITIES, TENDON_RGB, TENDON_TINT, Muscles
from myowarp.view.drawing.scenery import (
    add_arrow,
    add_capsule,
    add_floor,
    add_sphere,
    floor_height,
)
from myowarp.view.drawing.skeleton import Skeleton
from myowarp.view.drawing.snapshot import Snapshot

MARKER_RADIUS = (0.035, 0.10)
"""Smallest and largest radius of a target marker, in units of the framed radius."""
GHOST_ALPHA = 0.28
LINK_RADIUS = 0.005
"""Radius of the line from a tip to its target, in units of the framed radius."""

ARROW_RADIUS = 0.012
"""Radius of the arrow of a force, in units of the framed radius."""


class WorldDrawing:
    """Poses worlds of one model, and adds to a scene what MuJoCo does not draw.

    Attributes:
        model: A copy of the model, changed in what only drawing reads.
        data: What was posed last.
        framing: The camera.
        muscles: The muscles.
        color: What the colour of a muscle shows, a name in `QUANTITIES`.
    """

    def __init__(self, model: mujoco.MjModel, tips: Iterable[str], aspect: float, color: str) -> None:
        """Prepare the copy.

        Args:
            model: The full (unslimmed) model; it is not changed.
            tips: Names of the sites at the ends of the limb.
            aspect: Width of the picture over its height.
            color: As above.

        Raises:
            ValueError: The colour is unknown.
        """
        check_choice("muscle color", color, tuple(QUANTITIES))
        self._skeleton = Skeleton(model)
        self.framing = Framing(model, tips, aspect, self._skeleton)
        self.muscles, self.color = Muscles(model, self.framing.radius), color
        self.model = _prepared(model, self.framing.radius)
        self.data = mujoco.MjData(self.model)
        self._nominal: dict[tuple[str, str], np.ndarray] = {}  # of what some world had for itself
        self.option = mujoco.MjvOption()
        draw_bones_alone(self.option)
        self._tips = look.tip_sites(model, tips)
        drawn = look.drawn_geoms(self.model)
        moving = look.moving_bodies(model) & look.limb_trees(model)
        self._ghostly = drawn[moving[model.geom_bodyid[drawn]]]
        self._floor = floor_height(model) if self.framing.follows else None

    def check(self, seen: Snapshot) -> None:
        """Raise ValueError if a snapshot does not fit the model."""
        number = len(self.muscles.tendons)
        for name, values in seen.muscles.items():
            if np.shape(values) != (number,):
                raise ValueError(
                    f"{name} needs one value per muscle, shape ({number},), got {np.shape(values)}"
                )
        for name, place in seen.goals.items():
            if np.shape(place) != (3,) or not np.isfinite(place).all():
                raise ValueError(f"site '{name}' needs a finite world position of shape (3,), got {place}")

    def pose(self, seen: Snapshot) -> mujoco.MjData:
        """Return the data in a world's pose, with its own geometry."""
        for key in seen.shape:
            self._nominal.setdefault(key, look.geometry(self.model, self.data, key).copy())
        look.pose(self.model, self.data, seen.qpos, self._nominal | dict(seen.shape), seen.paths)
        return self.data

    def add(self, scene: mujoco.MjvScene, seen: Snapshot, middle: np.ndarray, pixel: float) -> None:
        """Add to a scene of the world that was posed last.

        Args:
            scene: The scene.
            seen: What was posed.
            middle: Where the camera looks [m].
            pixel: Width of a pixel there [m].
        """
        self._add_muscles(scene, seen, 0.55 * pixel)
        self._add_skeleton(scene, self.data, look.BONE_RGB, 1.0)
        if seen.ghost is not None:
            self._add_ghost(scene, seen.ghost)
        self._add_markers(scene, seen.goals, pixel)
        for start, end in seen.arrows:
            add_arrow(scene, start, end, ARROW_RADIUS * self.framing.radius, (*look.FORCE_RGB, 1.0))
        if self._floor is not None:
            add_floor(scene, self._floor, middle, self.framing.radius, pixel)

    def _add_muscles(self, scene: mujoco.MjvScene, seen: Snapshot, thinnest: float) -> None:
        tubes = self.muscles.tubes(self.data, seen.muscles, thinnest)
        rgb = QUANTITIES[self.color].rgb(self.muscles.values(self.color, seen.muscles, self.data))
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
        mujoco.mjv_addGeoms(model, data, self.option, mujoco.MjvPerturb(), category, scene)
        for geom in scene.geoms[first : scene.ngeom]:
            geom.emission, geom.specular = 0.35, 0.0
        self._add_skeleton(scene, data, look.TARGET_RGB, GHOST_ALPHA)

    @cached_property
    def _ghost(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The model with nothing but the moving bones, translucent."""
        model = copy.copy(self.model)
        model.geom_matid[:], model.geom_rgba[:, 3] = -1, 0.0
        model.geom_rgba[self._ghostly] = (*look.TARGET_RGB, GHOST_ALPHA)
        return model, mujoco.MjData(model)

    def _add_markers(self, scene: mujoco.MjvScene, goals: Mapping[str, np.ndarray], pixel: float) -> None:
        radius = self.framing.radius
        for site, size in zip(self._tips, look.tip_radii(self.model, self._tips, radius), strict=True):
            add_sphere(scene, self.data.site_xpos[site], size, (*look.TIP_RGB, 1.0))
        for name, place in goals.items():
            site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name)
            size = self.model.site_size[site, 0] if site >= 0 else 0.0
            size = np.clip(size, MARKER_RADIUS[0] * radius, MARKER_RADIUS[1] * radius)
            add_sphere(scene, place, size, (*look.TARGET_RGB, 0.65))
        color = np.array((*look.TARGET_RGB, 0.8), dtype=np.float32)
        for tip, target in look.marker_pairs(self.model, goals):
            link = max(LINK_RADIUS * radius, 0.7 * pixel)
            add_capsule(scene, self.data.site_xpos[tip], target, link, color, emission=0.25)


SUNK = 0.005  # m; a floor lies as much below a height field, which else flickers where it is level


def _prepared(model: mujoco.MjModel, radius: float) -> mujoco.MjModel:
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
    model.vis.headlight.ambient[:] = 0.38
    model.vis.headlight.diffuse[:] = 0.45
    model.vis.headlight.specular[:] = 0.10
    if root := look.carried_root(model):
        _lead_outdoors(model, root)
    return model


def _lead_outdoors(model: mujoco.MjModel, root: int) -> None:
    """Takes a body that is carried away out of its room, onto a floor without end; lamps go along with it."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    walls, ground = look.room_geoms(model), look.ground_geoms(model)
    model.geom_matid[walls], model.geom_rgba[walls, 3] = -1, 0.0
    planes = ground & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    slopes = ground & ~planes
    model.geom_size[planes, :2] = 0.0
    model.geom_pos[planes, 2] -= SUNK * slopes.any()
    model.geom_sameframe[planes] = 0  # else they stay in the frame of the world
    model.geom_rgba[planes, :3], model.geom_rgba[slopes, :3] = look.SKY_RGB, look.PALE_RGB
    lamps = model.light_bodyid == 0
    model.light_bodyid[lamps] = root
    model.light_mode[lamps] = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    model.light_type[lamps] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    model.light_pos0[lamps] = model.light_pos[lamps] - data.xpos[root]
    model.light_diffuse[lamps] *= 0.5  # they lit a room


def draw_bones_alone(option: mujoco.MjvOption) -> None:
    """Have MuJoCo draw bones and objects: muscles and markers are put in by hand."""
    option.sitegroup[:] = 0
    option.tendongroup[:] = 0
    option.geomgroup[:] = 0
    option.geomgroup[list(look.VISIBLE_GEOM_GROUPS)] = 1
