"""Parts to draw and their colours, shared by pictures and viewers.

Everything here reads a compiled, unslimmed ``mujoco.MjModel`` and plain NumPy arrays. Muscles are the
actuators that pull on a spatial tendon, in actuator order, whatever their gain and bias types are, so
the order is that of the activation array of the simulation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np

TARGET_RGB = np.array((0.10, 0.68, 0.30))
TIP_RGB = np.array((0.98, 0.62, 0.10))
FORCE_RGB = np.array((0.05, 0.42, 0.62))
"""Arrows of forces from outside."""
BONE_RGB = np.array((0.86, 0.82, 0.74))
"""Bones of the limb; myo-sim gives them several greys."""
PALE_RGB = np.array((0.70, 0.72, 0.75))
"""Bones that neither move nor carry a muscle, floors and walls: pale, so that the limb stands out."""
BACKDROP_RGB = np.array((0.72, 0.75, 0.79))
"""Wall behind the scene before light falls on it; it ends as pale as `SKY_RGB`."""
SKY_RGB = np.array((0.88, 0.92, 0.97))
FADED = 0.35
"""Opacity of bones that no muscle moves, in the page; in films light that they give off fades them."""

TRAVEL = 1.0
"""m: range of a slide from which on it carries the whole body away."""

DEVICE, WORN = "exo_", 0.4
"""Prefix of bodies that are worn over muscles, and their opacity in the page."""

VISIBLE_GEOM_GROUPS = (0, 1, 2)
"""MuJoCo draws these groups by default; myo-sim keeps collision geoms in 3 and above."""


LARGEST = 4096
"""Pixels on a side of a picture, at most."""

ROUND_GEOMS = (mujoco.mjtGeom.mjGEOM_SPHERE.value, mujoco.mjtGeom.mjGEOM_CAPSULE.value)


def muscle_tendons(model: mujoco.MjModel) -> np.ndarray:
    """Returns the tendon id of each muscle, in actuator order, shape ``(num_muscles,)``."""
    on_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    return model.actuator_trnid[on_tendon, 0].copy()


def geometry(model: mujoco.MjModel, data: mujoco.MjData, key: tuple[str, str]) -> np.ndarray:
    """Returns a view of the row of a field of the model, or of ``mocap_*``, that a geom or body has.

    Args:
        model: the model.
        data: the data.
        key: name of the field, and of the geom, body or height field.
    """
    field, name = key
    if field == "hfield_data":
        return field_of(model, model.hfield(name).id).reshape(-1)
    if field.startswith("mocap_"):
        return getattr(data, field)[model.body(name).mocapid[0]]
    return getattr(model, field)[getattr(model, field.partition("_")[0])(name).id]


def field_of(model: mujoco.MjModel, hfield: int) -> np.ndarray:
    """Returns a view of the heights of a height field, in units of its size, shape ``(nrow, ncol)``."""
    rows, columns = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
    first = int(model.hfield_adr[hfield])
    return model.hfield_data[first : first + rows * columns].reshape(rows, columns)


def pose(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    shape: Mapping[tuple[str, str], np.ndarray] | None = None,
    paths: Sequence[np.ndarray] = (),
) -> None:
    """Sets ``qpos`` and computes the positions that drawing needs, without collision or dynamics.

    Args:
        model: the model, whose geometry takes the values of ``shape``.
        data: the data to fill.
        qpos: generalised position, shape ``(nq,)``.
        shape: geometry of one world: (field of model or data, name of geom or body) to values.
        paths: points of each muscle's path [m], in place of those of MuJoCo's tendons.

    Raises:
        ValueError: a shape is wrong or a value is not finite.
    """
    qpos = np.asarray(qpos, dtype=float)
    if qpos.shape != (model.nq,):
        raise ValueError(f"qpos needs shape ({model.nq},), got {qpos.shape}")
    if not np.isfinite(qpos).all():
        bad = int(np.flatnonzero(~np.isfinite(qpos))[0])
        raise ValueError(f"qpos needs finite values, got {qpos[bad]} at index {bad}; reset that world first")
    data.qpos[:] = qpos
    for key, values in (shape or {}).items():
        geometry(model, data, key)[:] = values
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    mujoco.mj_tendon(model, data)
    if paths:
        _lead(model, data, paths)


def _lead(model: mujoco.MjModel, data: mujoco.MjData, paths: Sequence[np.ndarray]) -> None:
    """Puts points of paths where MuJoCo keeps those of its tendons."""
    tendons, points, room = muscle_tendons(model), np.concatenate(paths), data.wrap_xpos.reshape(-1, 3)
    if len(paths) != len(tendons) or len(points) > len(room) or not np.isfinite(points).all():
        raise ValueError(
            f"paths need one list of finite points for each of {len(tendons)} muscles, {len(room)} points at "
            f"most, got {len(paths)} lists with {len(points)} points"
        )
    counts = [len(path) for path in paths]
    room[: len(points)], data.wrap_obj.reshape(-1)[: len(points)] = points, SITE
    data.ten_wrapnum[:] = 0
    data.ten_wrapnum[tendons], data.ten_wrapadr[tendons] = counts, np.cumsum([0, *counts[:-1]])
    data.ten_length[tendons] = [np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in paths]


def rest_pose(model: mujoco.MjModel) -> np.ndarray:
    """Returns the keyframe `default`, as converted models have it, else the model's zero, shape (nq,)."""
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "default")
    return (model.qpos0 if key < 0 else model.key_qpos[key]).copy()


def wrapping_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns the ids of the geoms that tendons wrap around; they are not anatomy and are hidden."""
    wraps = np.isin(
        model.wrap_type, (mujoco.mjtWrap.mjWRAP_SPHERE.value, mujoco.mjtWrap.mjWRAP_CYLINDER.value)
    )
    return np.unique(model.wrap_objid[wraps])


def drawn_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns the ids of the geoms worth drawing: visible group, opaque, no wrapping surface and no room."""
    own, alpha = model.geom_matid >= 0, model.geom_rgba[:, 3].copy()
    alpha[own] = model.mat_rgba[model.geom_matid[own], 3]
    keep = np.isin(model.geom_group, VISIBLE_GEOM_GROUPS) & (alpha > 0)
    keep[wrapping_geoms(model)] = False
    return np.flatnonzero(keep & ~room_geoms(model))


def carried_root(model: mujoco.MjModel) -> int:
    """Return the body of the limb that a free joint or long slides carry away; 0 for none."""
    limb, moving = limb_trees(model), moving_bodies(model)
    for joint in range(model.njnt):
        body, kind = int(model.jnt_bodyid[joint]), model.jnt_type[joint]
        long = np.ptp(model.jnt_range[joint]) >= TRAVEL or not model.jnt_limited[joint]
        slides = kind == mujoco.mjtJoint.mjJNT_SLIDE and long
        outermost = model.body_rootid[body] == body or not moving[model.body_parentid[body]]
        if limb[body] and outermost and (kind == mujoco.mjtJoint.mjJNT_FREE or slides):
            return body
    return 0


def room_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over geoms: True for a room around a body that would walk through its walls."""
    still = model.body_weldid[model.geom_bodyid] == 0
    idle = (model.geom_contype == 0) & (model.geom_conaffinity == 0)
    meshes = still & idle & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    if not meshes.any() or not (root := carried_root(model)):
        return np.zeros_like(meshes)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    around = np.linalg.norm(data.geom_xpos - data.xpos[root], axis=1) < model.geom_rbound
    return meshes & (meshes & around).any()  # with what hangs on its walls


def tip_sites(model: mujoco.MjModel, tips: Iterable[str]) -> list[int]:
    """Returns the ids of the sites of these names that the model has."""
    ids = (mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip) for tip in tips)
    return [site for site in ids if site >= 0]


def tip_radii(model: mujoco.MjModel, tips: list[int], framed: float) -> list[float]:
    """Returns a radius [m] for each tip marker, larger than a round finger end that would hide it."""
    radii, drawn = [], drawn_geoms(model)
    for site in tips:
        own = [g for g in drawn if model.geom_bodyid[g] == model.site_bodyid[site]]
        round_ends = [model.geom_size[g, 0] for g in own if model.geom_type[g] in ROUND_GEOMS]
        radii.append(float(np.clip(1.15 * max(round_ends, default=0.0), 0.022 * framed, 0.2 * framed)))
    return radii


def moving_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over bodies: True where the body or an ancestor has a joint."""
    moving = np.zeros(model.nbody, dtype=bool)
    for body in range(1, model.nbody):
        moving[body] = model.body_dofnum[body] > 0 or moving[model.body_parentid[body]]
    return moving


def mobile_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over bodies: True where the body moves or a task moves it (mocap)."""
    return moving_bodies(model) | (model.body_mocapid >= 0)


def rigid_roots(model: mujoco.MjModel) -> np.ndarray:
    """Returns for each body the first of those that move with it as one; in the world, its tree's.

    Bodies that stand in the world are trees of their own, because a task may put each elsewhere.
    """
    return np.where(model.body_weldid == 0, model.body_rootid, model.body_weldid)


def limb_trees(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over bodies: True in the trees that muscles pull on; everywhere where there are none."""
    sites = model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE]
    pulled = np.isin(model.body_rootid, model.body_rootid[model.site_bodyid[sites]])
    return pulled if pulled.any() else np.ones(model.nbody, dtype=bool)


def limb_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over bodies: True where the body moves or a muscle path touches it."""
    limb = moving_bodies(model)
    sites = model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE]
    limb[model.site_bodyid[sites]] = True
    limb[model.geom_bodyid[wrapping_geoms(model)]] = True
    return limb


def pale_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over geoms: True for planes and for what belongs to no part of the limb."""
    return ~limb_bodies(model)[model.geom_bodyid] | (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)


def ground_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over geoms: True for planes and height fields that stand still."""
    level = np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD))
    return level & (model.body_weldid[model.geom_bodyid] == 0)


def bone_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over geoms: True for light grey meshes of the limb, not for devices and objects."""
    light, spread = model.geom_rgba[:, :3].min(axis=1), np.ptp(model.geom_rgba[:, :3], axis=1)
    mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    return mesh & limb_bodies(model)[model.geom_bodyid] & (light > 0.7) & (spread < 0.1)


def shown_rgba(model: mujoco.MjModel) -> np.ndarray:
    """Returns colours of geoms: bones of one tone, the rest but planes faded, devices see-through.

    Shape ``(ngeom, 4)``.
    """
    rgba, own = model.geom_rgba.copy(), model.geom_matid >= 0
    rgba[own] = model.mat_rgba[model.geom_matid[own]]
    pale = pale_geoms(model)
    rgba[bone_geoms(model), :3] = BONE_RGB
    rgba[pale, :3] = PALE_RGB
    rgba[pale & ~ground_geoms(model), 3] *= FADED
    worn = [model.body(int(body)).name.startswith(DEVICE) for body in model.geom_bodyid]
    rgba[worn, 3] *= WORN
    return rgba


def geom_box(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Returns the corners of the geoms' bounding boxes in the world [m], shape ``(8 * len(geoms), 3)``."""
    sign = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, 8).T
    local = model.geom_aabb[geoms, None, :3] + sign * model.geom_aabb[geoms, None, 3:]
    turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return (np.einsum("gij,gkj->gki", turn, local) + data.geom_xpos[geoms, None]).reshape(-1, 3)


def tendon_segments(
    model: mujoco.MjModel, data: mujoco.MjData, tendons: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Straight pieces of the muscle paths.

    Returns:
        ``(starts, ends, owner)``: end points [m] of shape ``(n, 3)`` and, for each piece, the index into
        ``tendons``. The number of pieces changes when a path touches or leaves a wrapping surface.
    """
    points, kinds = data.wrap_xpos.reshape(-1, 3), data.wrap_obj.reshape(-1)
    starts, ends, owner = [], [], []
    for index, tendon in enumerate(tendons):
        first, count = data.ten_wrapadr[tendon], data.ten_wrapnum[tendon]
        path, kind = points[first : first + count], kinds[first : first + count]
        joined = (kind[:-1] != PULLEY) & (kind[1:] != PULLEY)
        starts.append(path[:-1][joined])
        ends.append(path[1:][joined])
        owner.append(np.full(int(joined.sum()), index))
    if not starts:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=int)
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(owner)


SITE, PULLEY = -1, -2
"""``mjData.wrap_obj`` of a site and of a pulley, where a path branches: -2 pulley, -1 site, else geom id."""


def marker_pairs(model: mujoco.MjModel, sites: Mapping[str, np.ndarray]) -> list[tuple[int, np.ndarray]]:
    """Pairs ``<tip>_target`` positions with the site ``<tip>`` where the model has one."""
    pairs = []
    for name, position in sites.items():
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name.removesuffix("_target"))
        if name.endswith("_target") and site >= 0:
            pairs.append((site, np.asarray(position, dtype=float)))
    return pairs
