"""What to draw and from where: colours, clutter and framing shared by the viewers.

Everything here reads a compiled, unslimmed ``mujoco.MjModel`` and plain NumPy arrays. Muscles are the
actuators that pull on a spatial tendon, in actuator order, whatever their gain and bias types are, so
the order is that of the activation array of the simulation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

from myowarp.models.couplings import POINT_JOINTS

RELAXED_RGB = np.array((0.45, 0.55, 0.68))
"""Blue-grey of a muscle at activation 0."""
TENSED_RGB = np.array((0.86, 0.10, 0.12))
"""Red of a muscle at activation 1."""
UNKNOWN_RGB = np.array((0.72, 0.36, 0.36))
"""Muscle whose activation was not given."""
TARGET_RGB = np.array((0.10, 0.68, 0.30))
TIP_RGB = np.array((0.98, 0.62, 0.10))
BONE_RGB = np.array((0.86, 0.82, 0.74))
"""Bones of the limb; myo-sim gives them several greys."""
PALE_RGB = np.array((0.70, 0.72, 0.75))
"""Bones that neither move nor carry a muscle, floors and walls: pale, so that the limb stands out."""
BACKDROP_RGB = np.array((0.72, 0.75, 0.79))
"""Wall behind the scene before light falls on it; it ends as pale as `SKY_RGB`."""
SKY_RGB = np.array((0.88, 0.92, 0.97))

VISIBLE_GEOM_GROUPS = (0, 1, 2)
"""MuJoCo draws these groups by default; myo-sim keeps collision geoms in 3 and above."""


ROUND_GEOMS = (mujoco.mjtGeom.mjGEOM_SPHERE.value, mujoco.mjtGeom.mjGEOM_CAPSULE.value)

MARGIN = 1.35
"""Camera distance over the one at which the range of motion of single joints just fits."""


def muscle_tendons(model: mujoco.MjModel) -> np.ndarray:
    """Returns the tendon id of each muscle, in actuator order, shape ``(num_muscles,)``."""
    on_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    return model.actuator_trnid[on_tendon, 0].copy()


def activation_rgb(activation: np.ndarray | None, num_muscles: int) -> np.ndarray:
    """Maps activation to colour.

    Args:
        activation: muscle activation [1], shape ``(num_muscles,)``; None for a neutral colour.
        num_muscles: number of muscles.

    Returns:
        Colours in 0..1, shape ``(num_muscles, 3)``.

    Raises:
        ValueError: the shape is wrong.
    """
    if activation is None:
        return np.tile(UNKNOWN_RGB, (num_muscles, 1))
    level = np.asarray(activation, dtype=float)
    if level.shape != (num_muscles,):
        raise ValueError(f"activation needs one value per muscle, shape ({num_muscles},), got {level.shape}")
    level = np.nan_to_num(np.clip(level, 0.0, 1.0))[:, None]
    return (1.0 - level) * RELAXED_RGB + level * TENSED_RGB


def geometry(model: mujoco.MjModel, data: mujoco.MjData, key: tuple[str, str]) -> np.ndarray:
    """Returns a view of the row of a field of the model, or of ``mocap_quat``, that a geom or body has.

    Args:
        model: the model.
        data: the data.
        key: name of the field, and of the geom or body.
    """
    field, name = key
    if field == "mocap_quat":
        return data.mocap_quat[model.body(name).mocapid[0]]
    return getattr(model, field)[getattr(model, field.partition("_")[0])(name).id]


def pose(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    shape: Mapping[tuple[str, str], np.ndarray] | None = None,
) -> None:
    """Sets ``qpos`` and computes the positions that drawing needs, without collision or dynamics.

    Args:
        model: the model, whose geometry takes the values of ``shape``.
        data: the data to fill.
        qpos: generalised position, shape ``(nq,)``.
        shape: geometry of one world: (field of model or data, name of geom or body) to values.

    Raises:
        ValueError: the shape is wrong or a value is not finite.
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


def wrapping_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns the ids of the geoms that tendons wrap around; they are not anatomy and are hidden."""
    wraps = np.isin(
        model.wrap_type, (mujoco.mjtWrap.mjWRAP_SPHERE.value, mujoco.mjtWrap.mjWRAP_CYLINDER.value)
    )
    return np.unique(model.wrap_objid[wraps])


def drawn_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns the ids of the geoms worth drawing: visible group, not transparent, no wrapping surface."""
    own, alpha = model.geom_matid >= 0, model.geom_rgba[:, 3].copy()
    alpha[own] = model.mat_rgba[model.geom_matid[own], 3]
    keep = np.isin(model.geom_group, VISIBLE_GEOM_GROUPS) & (alpha > 0)
    keep[wrapping_geoms(model)] = False
    return np.flatnonzero(keep)


def tip_sites(model: mujoco.MjModel) -> list[int]:
    """Returns the ids of the sites that mark an end effector: named ``...tip...`` and no target."""
    names = [(i, model.site(i).name.lower()) for i in range(model.nsite)]
    return [i for i, name in names if "tip" in name and "target" not in name]


def tip_radii(model: mujoco.MjModel, tips: list[int], framed: float) -> list[float]:
    """Returns a radius [m] for each tip marker, larger than a round finger end that would hide it."""
    radii = []
    for site in tips:
        own = [g for g in drawn_geoms(model) if model.geom_bodyid[g] == model.site_bodyid[site]]
        round_ends = [model.geom_size[g, 0] for g in own if model.geom_type[g] in ROUND_GEOMS]
        radii.append(float(np.clip(1.15 * max(round_ends, default=0.0), 0.03 * framed, 0.08 * framed)))
    return radii


def moving_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over bodies: True where the body or an ancestor has a joint."""
    moving = np.zeros(model.nbody, dtype=bool)
    for body in range(1, model.nbody):
        moving[body] = model.body_dofnum[body] > 0 or moving[model.body_parentid[body]]
    return moving


def acting_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over bodies: True below more than a quarter of the longest chain's joints.

    That is every moving body of an elbow or a finger, and of an arm with a hand the hand.
    """
    depth = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        depth[body] = depth[model.body_parentid[body]] + model.body_dofnum[body]
    return 4 * depth > depth.max()


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


def bone_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Returns a mask over geoms: True for light grey meshes of the limb, not for devices and objects."""
    light, spread = model.geom_rgba[:, :3].min(axis=1), np.ptp(model.geom_rgba[:, :3], axis=1)
    mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    return mesh & limb_bodies(model)[model.geom_bodyid] & (light > 0.7) & (spread < 0.1)


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


PULLEY = -2
"""``mjData.wrap_obj`` of a pulley, where a path branches: -2 pulley, -1 site, else geom id."""


TRAVEL = 1.0
"""m: range of a slide from which on it carries the whole body away; no picture holds that."""


def motion_samples(model: mujoco.MjModel) -> Iterator[np.ndarray]:
    """Yields the reference pose and each limited joint at both ends of its range.

    The reference is the keyframe `default`, as converted models have it, else the model's zero.
    """
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "default")
    rest = model.qpos0 if key < 0 else model.key_qpos[key]
    yield rest.copy()
    hinge, slide = (model.jnt_type == kind for kind in POINT_JOINTS)
    near = hinge | (slide & (np.ptp(model.jnt_range, axis=1) < TRAVEL))
    for joint in np.flatnonzero(near & (model.jnt_limited != 0)):
        for end in model.jnt_range[joint]:
            qpos = rest.copy()
            qpos[model.jnt_qposadr[joint]] = end
            yield qpos


def limb_points(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points that a picture must contain: geoms of acting bodies over the range of motion, and muscle paths.

    Where the acting bodies are but the end of the limb, muscle paths may leave the picture.

    Returns:
        ``(rest, motion, away)``: points [m] of shape ``(n, 3)`` in the reference pose and over the range of
        motion, and the vector [m] from the middle of the motionless geoms to the middle of the moving ones
        (zero where nothing is motionless).
    """
    data = mujoco.MjData(model)
    drawn = drawn_geoms(model)
    drawn = drawn[model.geom_type[drawn] != mujoco.mjtGeom.mjGEOM_PLANE]
    moving, acting = moving_bodies(model), acting_bodies(model)
    limb, still = drawn[acting[model.geom_bodyid[drawn]]], drawn[~moving[model.geom_bodyid[drawn]]]
    limb = limb if len(limb) else drawn
    tendons, clouds = muscle_tendons(model), []
    for qpos in motion_samples(model):
        pose(model, data, qpos)
        whole = (acting == moving).all() or not len(limb)
        paths = tendon_segments(model, data, tendons)[:2] if whole else ()
        clouds.append(np.concatenate((geom_box(model, data, limb), *paths)))
    if not len(clouds[0]):
        raise ValueError(
            "the camera needs a geom or a muscle to look at, got a model with neither; pass a camera"
        )
    away = limb_middle(data, limb) - limb_middle(data, still) if len(still) and len(limb) else np.zeros(3)
    return clouds[0], np.concatenate(clouds), away


def limb_middle(data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Returns the mean position of geoms [m], shape ``(3,)``."""
    return data.geom_xpos[geoms].mean(axis=0)


def view_axes(azimuth: float, elevation: float) -> np.ndarray:
    """Returns rows right, up, forward of MuJoCo's free camera at these angles [deg], shape ``(3, 3)``."""
    a, e = np.radians((azimuth, elevation))
    forward = np.array((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)))
    right = np.array((np.sin(a), -np.cos(a), 0.0))
    return np.stack((right, np.cross(right, forward), forward))


def broadside(rest: np.ndarray, motion: np.ndarray, away: np.ndarray) -> tuple[float, float]:
    """Azimuth and elevation [deg] that look at the flattest side of a limb, slightly turned.

    The camera looks along the direction in which the points spread least, at rest and in motion alike,
    from the side on which the limb lies as seen from the motionless part of the body.

    Args:
        rest: points in the reference pose [m], shape ``(n, 3)``.
        motion: points over the range of motion [m], shape ``(m, 3)``.
        away: direction from the motionless part to the limb [m], shape ``(3,)``.
    """
    spread = sum(cov / np.trace(cov) for cov in (np.cov(rest.T), np.cov(motion.T)))
    forward = np.linalg.eigh(spread)[1][:, 0]
    along = forward @ away
    if abs(along) < 0.25 * np.linalg.norm(away) or not along:
        along = forward[np.argmax(np.abs(forward))]
    forward = -forward if along > 0 else forward
    azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
    elevation = np.degrees(np.arcsin(np.clip(forward[2], -1, 1)))
    return float(azimuth + 15.0), float(np.clip(elevation - 12.0, -75.0, 30.0))


def frame_camera(model: mujoco.MjModel, aspect: float) -> tuple[mujoco.MjvCamera, float]:
    """Free camera that frames the moving limb, and the size of what it frames.

    Args:
        model: the full model; its vertical field of view is used.
        aspect: image width over height.

    Returns:
        ``(camera, radius)``: the camera and half the larger side [m] of the framed region.
    """
    rest, motion, away = limb_points(model)
    points = np.concatenate((rest, motion))
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = broadside(rest, motion, away)
    axes = view_axes(camera.azimuth, camera.elevation)
    seen = points @ axes.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    offset = seen - middle
    half = np.tan(np.radians(model.vis.global_.fovy) / 2) * np.array((aspect, 1.0))
    depth = np.abs(offset[:, :2]) / half - offset[:, 2:]
    camera.distance = MARGIN * float(depth.max())
    camera.lookat[:] = middle @ axes
    return camera, float(np.abs(offset[:, :2]).max())


def marker_pairs(model: mujoco.MjModel, sites: Mapping[str, np.ndarray]) -> list[tuple[int, np.ndarray]]:
    """Pairs ``<tip>_target`` positions with the site ``<tip>`` where the model has one."""
    pairs = []
    for name, position in sites.items():
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name.removesuffix("_target"))
        if name.endswith("_target") and site >= 0:
            pairs.append((site, np.asarray(position, dtype=float)))
    return pairs
