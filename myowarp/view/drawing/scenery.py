"""Scenery of a picture besides the model: balls, capsules, floor, wall and lamp, put in by hand."""

from __future__ import annotations

import mujoco
import numpy as np

from myowarp.view.drawing import style as look

FLOOR_REACH = 4.0
"""Half a side of the floor, in units of the framed radius."""
LAMP = np.array((0.5, -0.7, 0.6))
"""Direction to the lamp above the viewer's left shoulder: to the right, up, forward."""
CAPSULE, NOWHERE, UPRIGHT = mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.eye(3).ravel()


def _next_geom(scene: mujoco.MjvScene) -> mujoco.MjvGeom:
    scene.ngeom += 1
    return scene.geoms[scene.ngeom - 1]


def add_sphere(scene: mujoco.MjvScene, place: np.ndarray, radius: float, rgba: tuple[float, ...]) -> None:
    """Adds a ball."""
    geom = _next_geom(scene)
    size, color = np.full(3, radius), np.array(rgba, dtype=np.float32)
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_SPHERE, size, place, np.eye(3).ravel(), color)
    geom.emission = 0.25
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def add_capsule(
    scene: mujoco.MjvScene,
    start: np.ndarray,
    end: np.ndarray,
    radius: float,
    color: np.ndarray,
    emission: float = 0.0,
) -> None:
    """Adds a capsule from one point to another."""
    geom = _next_geom(scene)
    mujoco.mjv_initGeom(geom, CAPSULE, NOWHERE, NOWHERE, UPRIGHT, color)
    mujoco.mjv_connector(geom, CAPSULE, radius, start, end)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    if emission:
        geom.emission = emission


def add_arrow(
    scene: mujoco.MjvScene, start: np.ndarray, end: np.ndarray, radius: float, rgba: tuple[float, ...]
) -> None:
    """Adds an arrow from one point to another."""
    geom, kind = _next_geom(scene), mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(geom, kind, NOWHERE, NOWHERE, UPRIGHT, np.array(rgba, dtype=np.float32))
    mujoco.mjv_connector(geom, kind, radius, start, end)
    geom.category, geom.emission = mujoco.mjtCatBit.mjCAT_DECOR, 0.25


def has_plane(model: mujoco.MjModel) -> bool:
    """Says whether a model has a floor or a wall."""
    return bool((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any())


def floor_height(model: mujoco.MjModel) -> float:
    """Returns the height of the floor [m]; without one that of the lowest body at rest."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    if planes.size:
        return float(model.geom_pos[planes, 2].min())
    data = mujoco.MjData(model)
    look.pose(model, data, look.rest_pose(model))
    points = (data.xpos[1:], data.site_xpos)
    return float(np.concatenate(points)[:, 2].min())


def add_floor(scene: mujoco.MjvScene, height: float, middle: np.ndarray, radius: float, pixel: float) -> None:
    """Draws squares on the floor below the camera's middle; they stand still while the camera goes along."""
    power = 10.0 ** np.floor(np.log10(radius))
    cell = power if radius > 3.0 * power else 0.5 * power
    center = np.round(middle[:2] / cell) * cell
    reach = np.ceil(FLOOR_REACH * radius / cell) * cell
    color = np.array((*look.PALE_RGB, 1.0), dtype=np.float32)
    for offset in np.arange(-reach, reach + 0.5 * cell, cell):
        for along in (0, 1):
            ends = np.full((2, 3), height)
            ends[:, along], ends[:, 1 - along] = center[along] + (-reach, reach), center[1 - along] + offset
            add_capsule(scene, ends[0], ends[1], 0.45 * pixel, color, emission=0.3)


def add_backdrop(scene: mujoco.MjvScene) -> None:
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


def brighten(scene: mujoco.MjvScene, pale: frozenset[int]) -> None:
    """Lets the geoms of these ids glow a little, so that they stay pale from any angle."""
    for geom in scene.geoms[: scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in pale:
            geom.emission, geom.specular, geom.reflectance = 0.45, 0.0, 0.0


def add_lamp(scene: mujoco.MjvScene) -> None:
    """Adds a lamp above the viewer's left shoulder, so that bones have a lit and a shaded side."""
    eye = scene.camera[0]
    forward, up = np.array(eye.forward), np.array(eye.up)
    right = np.cross(forward, up)
    lamp = scene.lights[scene.nlight]
    scene.nlight += 1
    lamp.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    lamp.headlight, lamp.castshadow, lamp.texid = 0, 0, -1
    lamp.pos[:] = eye.pos
    lamp.dir[:] = LAMP @ (right, up, forward)
    lamp.attenuation[:] = (1.0, 0.0, 0.0)
    lamp.ambient[:], lamp.diffuse[:], lamp.specular[:] = 0.0, 0.35, 0.15
