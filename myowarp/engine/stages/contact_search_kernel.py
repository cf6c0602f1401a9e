"""Contacts of pairs that may touch: the distance itself wherever it has a short way to be found.

The engine lists the pairs of geoms whose spheres and boxes meet, and goes through the list once for every
family of shapes. Here a pair is done with in one go: spheres and capsules in closed form, ellipsoids by
Newton's method (`stages.separation`); pairs of other shapes go on the engine's list.
"""

import warp as wp
from mujoco_warp._src.collision_core import contact_material_params, write_contact
from mujoco_warp._src.collision_driver import _add_geom_pair, _obb_filter, _plane_filter
from mujoco_warp._src.collision_primitive_core import capsule_capsule, sphere_capsule, sphere_sphere
from mujoco_warp._src.math import make_frame
from mujoco_warp._src.types import GeomType, vec5

from myowarp.engine.stages.arrays import ContactPool
from myowarp.engine.stages.separation import (
    FAR,
    Bodies,
    Touch,
    capsule_touch,
    ellipsoid_matrix,
    ellipsoid_touch,
    roundness,
)
from myowarp.kernels.batching import batched

SPHERE = wp.constant(int(GeomType.SPHERE))
CAPSULE = wp.constant(int(GeomType.CAPSULE))
ELLIPSOID = wp.constant(int(GeomType.ELLIPSOID))
CYLINDER = wp.constant(int(GeomType.CYLINDER))
INNER = wp.constant(0.999)  # of a cylinder's half length

OURS = tuple(
    (GeomType(first), GeomType(second))
    for first in (SPHERE, CAPSULE, ELLIPSOID)
    for second in (SPHERE, CAPSULE, ELLIPSOID)
    if first <= second
)
"""Kinds of pairs that are done with here; the engine sorts a pair by type."""


@wp.struct
class Shapes:
    """All geoms, and the pairs of them that are not excluded; fields are the engine's."""

    geom_type: wp.array[int]
    geom_size: wp.array2d[wp.vec3]
    geom_aabb: wp.array3d[wp.vec3]
    geom_rbound: wp.array2d[float]
    geom_margin: wp.array2d[float]
    geom_gap: wp.array2d[float]
    pair_margin: wp.array2d[float]
    pair_gap: wp.array2d[float]
    nxn_geom_pair_filtered: wp.array[wp.vec2i]
    nxn_pairid_filtered: wp.array[wp.vec2i]
    geom_xpos: wp.array2d[wp.vec3]
    geom_xmat: wp.array2d[wp.mat33]


@wp.struct
class ContactMaterial:
    """Properties of a contact, of its geoms or of its explicit pair; fields are the engine's."""

    geom_condim: wp.array[int]
    geom_priority: wp.array[int]
    geom_solmix: wp.array2d[float]
    geom_solref: wp.array2d[wp.vec2]
    geom_solimp: wp.array2d[vec5]
    geom_friction: wp.array2d[wp.vec3]
    geom_adhesion: wp.array2d[float]
    pair_dim: wp.array[int]
    pair_solref: wp.array2d[wp.vec2]
    pair_solreffriction: wp.array2d[wp.vec2]
    pair_solimp: wp.array2d[vec5]
    pair_adhesion: wp.array2d[float]
    pair_friction: wp.array2d[vec5]


@wp.struct
class Candidates:
    """Pairs left to the engine; fields are its own."""

    ncollision: wp.array[int]
    collision_pair: wp.array[wp.vec2i]
    collision_pairid: wp.array[wp.vec2i]
    collision_worldid: wp.array[int]


@wp.struct
class NearPairs:
    """Pairs that may touch in each world, which `contact_filter` finds.

    Attributes:
        num: Of each world.
        pairs: Numbers of the pairs.
        normals: About where f of a pair with an ellipsoid is largest.
        kept: The best n tried for every pair, a block of worlds after the other, worlds in lanes.
    """

    num: wp.array[int]
    pairs: wp.array2d[int]
    normals: wp.array2d[wp.vec3]
    kept: wp.array[float]


@wp.struct
class Pair:
    """Two geoms, sorted by type, and the distances at which they touch [m]."""

    geoms: wp.vec2i
    pairid: wp.vec2i
    worldid: int
    margin: float
    gap: float


@wp.struct
class Geom:
    """A geom's shape and pose in the world [m], its box in its own frame; a plane has no bounding sphere."""

    type: int
    size: wp.vec3
    bound: float
    box_center: wp.vec3
    box_size: wp.vec3
    pos: wp.vec3
    rotation: wp.mat33


@wp.struct
class Touches:
    """Closest points of two geoms; parallel capsules have two."""

    first: Touch
    second: Touch


@wp.func
def material_of(material: ContactMaterial, pair: Pair):
    """Return condim, friction, solref, solreffriction, solimp and adhesion of a contact."""
    return contact_material_params(
        material.geom_condim,
        material.geom_priority,
        material.geom_solmix,
        material.geom_solref,
        material.geom_solimp,
        material.geom_friction,
        material.geom_adhesion,
        material.pair_dim,
        material.pair_solref,
        material.pair_solreffriction,
        material.pair_solimp,
        material.pair_adhesion,
        material.pair_friction,
        pair.geoms,
        pair.pairid[0],
        pair.worldid,
    )


@wp.func
def write_touch(
    touch: Touch, pair: Pair, material: ContactMaterial, id: int, naconmax: int, contact: ContactPool
):
    """Append a contact to the pool, with the material of its geoms."""
    condim, friction, solref, solreffriction, solimp, adhesion = material_of(material, pair)
    write_contact(
        naconmax,
        id,
        touch.dist,
        touch.pos,
        make_frame(touch.normal),
        pair.margin,
        pair.gap,
        condim,
        friction,
        solref,
        solreffriction,
        solimp,
        adhesion,
        pair.geoms,
        pair.pairid,
        pair.worldid,
        contact.dist,
        contact.pos,
        contact.frame,
        contact.includemargin,
        contact.friction,
        contact.solref,
        contact.solreffriction,
        contact.solimp,
        contact.dim,
        contact.geom,
        contact.efc_address,
        contact.worldid,
        contact.type,
        contact.geomcollisionid,
        contact.adhesion,
        contact.nacon,
    )


@wp.func
def geom_at(
    kind: int,
    size: wp.vec3,
    bound: float,
    box_center: wp.vec3,
    box_size: wp.vec3,
    pos: wp.vec3,
    rotation: wp.mat33,
) -> Geom:
    """Return a geom."""
    geom = Geom()
    geom.type = kind
    geom.size = size
    geom.bound = bound
    geom.box_center = box_center
    geom.box_size = box_size
    geom.pos = pos
    geom.rotation = rotation
    return geom


@wp.func
def touch_at(dist: float, pos: wp.vec3, normal: wp.vec3) -> Touch:
    """Return a touch."""
    touch = Touch()
    touch.dist = dist
    touch.pos = pos
    touch.normal = normal
    return touch


@wp.func
def long_axis(rotation: wp.mat33) -> wp.vec3:
    """Return the z axis of a frame."""
    return wp.vec3(rotation[0, 2], rotation[1, 2], rotation[2, 2])


@wp.func
def round_touches(one: Geom, two: Geom) -> Touches:
    """Closest points of two spheres or capsules."""
    touches = Touches()
    touches.second.dist = FAR
    axis1, axis2 = long_axis(one.rotation), long_axis(two.rotation)
    radius1, radius2 = one.size[0], two.size[0]
    if one.type == SPHERE:
        dist, pos, normal = sphere_sphere(one.pos, radius1, two.pos, radius2)
        if two.type == CAPSULE:
            dist, pos, normal = sphere_capsule(one.pos, radius1, two.pos, axis2, radius2, two.size[1])
        touches.first = touch_at(dist, pos, normal)
    else:
        dists, points, normals = capsule_capsule(
            one.pos, axis1, radius1, one.size[1], two.pos, axis2, radius2, two.size[1]
        )
        touches.first = touch_at(dists[0], points[0], normals[0])
        touches.second = touch_at(dists[1], points[1], normals[1])
    return touches


@wp.func
def touch_with_ellipsoid(one: Geom, two: Geom, cutoff: float, start: wp.vec3) -> Touch:
    """n = argmax f(n), dist = f(n): where a sphere, capsule or ellipsoid and an ellipsoid are closest."""
    bodies = Bodies()
    bodies.p = two.pos - one.pos
    bodies.start = start
    bodies.e2 = ellipsoid_matrix(two.size, two.rotation)
    bodies.rotation1 = two.rotation
    bodies.rotation2 = two.rotation
    bodies.cutoff = cutoff
    bodies.roundness = roundness(two.size)
    if one.type == ELLIPSOID:
        bodies.roundness += roundness(one.size)
        bodies.e1 = ellipsoid_matrix(one.size, one.rotation)
        bodies.rotation1 = one.rotation
        return ellipsoid_touch(bodies, one.pos)
    half = wp.where(one.type == CAPSULE, one.size[1], 0.0)
    return capsule_touch(bodies, one.pos, long_axis(one.rotation), one.size[0], half)


@wp.func
def boxes_meet(one: Geom, two: Geom, cutoff: float) -> bool:
    """Return whether two geoms may be less than `cutoff` apart."""
    pos1, pos2, rotation1, rotation2 = one.pos, two.pos, one.rotation, two.rotation
    if one.bound == 0.0 or two.bound == 0.0:
        return _plane_filter(one.bound, two.bound, cutoff, 0.0, pos1, pos2, rotation1, rotation2)
    center1, center2, size1, size2 = one.box_center, two.box_center, one.box_size, two.box_size
    return _obb_filter(center1, center2, size1, size2, cutoff, 0.0, pos1, pos2, rotation1, rotation2)


@wp.func
def closest(one: Geom, two: Geom, cutoff: float, start: wp.vec3) -> Touches:
    """Return the closest points of two spheres, capsules or ellipsoids; beyond the cutoff a bound will do."""
    if two.type <= CAPSULE:
        return round_touches(one, two)
    touches = Touches()
    touches.first = touch_with_ellipsoid(one, two, cutoff, start)
    touches.second.dist = FAR
    return touches


@wp.func
def side_touch(capsule: Geom, cylinder: Geom) -> tuple[Touch, bool]:
    """Return the closest points of a capsule and a cylinder's capsule, and whether on the cylinder's side.

    There, with n across its axis, both have the same f(n), a maximum. It is the highest where the bodies are
    apart, or less deep in each other than the first is thick: that ball rolls within their sum.
    """
    touches = round_touches(capsule, cylinder)
    touch = touches.first
    inner = touch.pos + (0.5 * touch.dist + cylinder.size[0]) * touch.normal - cylinder.pos
    along = wp.abs(wp.dot(long_axis(cylinder.rotation), inner))
    alone = touches.second.dist >= FAR
    return touch, alone and touch.dist > -capsule.size[0] and along < INNER * cylinder.size[1]


@wp.kernel(enable_backward=False)
def find_contacts(
    # Model:
    shapes: Shapes,
    material: ContactMaterial,
    # Data in:
    naconmax_in: int,
    # In:
    near: NearPairs,
    # Data out:
    contact_out: ContactPool,
    # Out:
    candidates: Candidates,
):
    """dist(geom_1, geom_2) < margin + gap. Functions take structs by value: for every pair, only numbers."""
    worldid = wp.tid()
    bound = shapes.geom_rbound[batched(worldid, shapes.geom_rbound.shape[0])]
    size = shapes.geom_size[batched(worldid, shapes.geom_size.shape[0])]
    box = shapes.geom_aabb[batched(worldid, shapes.geom_aabb.shape[0])]
    margins = shapes.geom_margin[batched(worldid, shapes.geom_margin.shape[0])]
    gaps = shapes.geom_gap[batched(worldid, shapes.geom_gap.shape[0])]
    kind, xpos, xmat = shapes.geom_type, shapes.geom_xpos[worldid], shapes.geom_xmat[worldid]
    pair = Pair()
    pair.worldid = worldid
    for k in range(near.num[worldid]):
        i = near.pairs[worldid, k]
        a, b = shapes.nxn_geom_pair_filtered[i][0], shapes.nxn_geom_pair_filtered[i][1]
        pair.pairid = shapes.nxn_pairid_filtered[i]
        pair.margin = margins[a] + margins[b]
        pair.gap = gaps[a] + gaps[b]
        if pair.pairid[0] >= 0:
            pair.margin = shapes.pair_margin[batched(worldid, shapes.pair_margin.shape[0]), pair.pairid[0]]
            pair.gap = shapes.pair_gap[batched(worldid, shapes.pair_gap.shape[0]), pair.pairid[0]]
        # A collision sensor wants the distance however large it is.
        cutoff = wp.where(pair.pairid[1] < 0, pair.margin + pair.gap, FAR)
        pair.geoms = wp.vec2i(a, b)
        if kind[a] > kind[b]:
            pair.geoms = wp.vec2i(b, a)
        a, b = pair.geoms[0], pair.geoms[1]
        one = geom_at(kind[a], size[a], bound[a], box[a, 0], box[a, 1], xpos[a], xmat[a])
        two = geom_at(kind[b], size[b], bound[b], box[b, 0], box[b, 1], xpos[b], xmat[b])
        ours = one.type >= SPHERE and two.type <= ELLIPSOID
        if ours:
            touches = closest(one, two, cutoff, near.normals[worldid, k])
            if touches.first.dist < cutoff:
                write_touch(touches.first, pair, material, 0, naconmax_in, contact_out)
            if touches.second.dist < cutoff:
                write_touch(touches.second, pair, material, 1, naconmax_in, contact_out)
            continue
        if not boxes_meet(one, two, cutoff):
            continue
        if one.type == CAPSULE and two.type == CYLINDER:
            touch, is_whole = side_touch(one, two)
            if touch.dist >= cutoff:
                continue
            if is_whole:
                write_touch(touch, pair, material, 0, naconmax_in, contact_out)
                continue
        _add_geom_pair(
            naconmax_in,
            a,
            b,
            one.type,
            two.type,
            worldid,
            pair.pairid,
            candidates.ncollision,
            candidates.collision_pair,
            candidates.collision_pairid,
            candidates.collision_worldid,
        )
