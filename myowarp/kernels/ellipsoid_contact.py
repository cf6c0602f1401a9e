"""Contacts of ellipsoids with spheres, capsules and ellipsoids, from the engine's candidate pairs."""

import warp as wp
from mujoco_warp._src.collision_core import contact_margin_gap, contact_material_params, write_contact
from mujoco_warp._src.math import make_frame
from mujoco_warp._src.types import GeomType, vec5

from myowarp.kernels.engine_arrays import ContactPool
from myowarp.kernels.separation import Bodies, Touch, capsule_touch, ellipsoid_matrix, ellipsoid_touch

SPHERE = wp.constant(int(GeomType.SPHERE))
CAPSULE = wp.constant(int(GeomType.CAPSULE))
ELLIPSOID = wp.constant(int(GeomType.ELLIPSOID))
FAR = wp.constant(1e10)  # m


@wp.struct
class CollisionPairs:
    """What the broad phase found, and the shapes of all geoms; fields are the engine's."""

    geom_type: wp.array[int]
    geom_size: wp.array2d[wp.vec3]
    geom_margin: wp.array2d[float]
    geom_gap: wp.array2d[float]
    pair_margin: wp.array2d[float]
    pair_gap: wp.array2d[float]
    geom_xpos: wp.array2d[wp.vec3]
    geom_xmat: wp.array2d[wp.mat33]
    ncollision: wp.array[int]


@wp.struct
class ContactMaterial:
    """What a contact takes from its geoms or from its explicit pair; fields are the engine's."""

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
class Candidate:
    """A pair of geoms close to each other."""

    geoms: wp.vec2i
    pairid: wp.vec2i
    worldid: int
    margin: float
    gap: float


@wp.func
def write_touch(
    touch: Touch, candidate: Candidate, material: ContactMaterial, naconmax: int, contact: ContactPool
):
    """Append a contact to the pool, with the material of its geoms."""
    condim, friction, solref, solreffriction, solimp, adhesion = contact_material_params(
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
        candidate.geoms,
        candidate.pairid[0],
        candidate.worldid,
    )
    write_contact(
        naconmax,
        0,
        touch.dist,
        touch.pos,
        make_frame(touch.normal),
        candidate.margin,
        candidate.gap,
        condim,
        friction,
        solref,
        solreffriction,
        solimp,
        adhesion,
        candidate.geoms,
        candidate.pairid,
        candidate.worldid,
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


@wp.kernel(enable_backward=False)
def ellipsoid_contacts(
    # Model:
    material: ContactMaterial,
    # Data in:
    naconmax_in: int,
    # In:
    pairs: CollisionPairs,
    collision_pair: wp.array[wp.vec2i],
    collision_pairid: wp.array[wp.vec2i],
    collision_worldid: wp.array[int],
    # Data out:
    contact_out: ContactPool,
):
    """n = argmax f(n), dist = f(n), for every candidate pair of which the second geom is an ellipsoid."""
    collisionid = wp.tid()
    if collisionid >= wp.min(pairs.ncollision[0], naconmax_in):
        return
    geoms = collision_pair[collisionid]
    type1, type2 = pairs.geom_type[geoms[0]], pairs.geom_type[geoms[1]]
    if type2 != ELLIPSOID or (type1 != SPHERE and type1 != CAPSULE and type1 != ELLIPSOID):
        return
    worldid, pairid = collision_worldid[collisionid], collision_pairid[collisionid]
    margin, gap = contact_margin_gap(
        pairs.geom_margin, pairs.geom_gap, pairs.pair_margin, pairs.pair_gap, geoms, pairid[0], worldid
    )
    size1 = pairs.geom_size[worldid % pairs.geom_size.shape[0], geoms[0]]
    size2 = pairs.geom_size[worldid % pairs.geom_size.shape[0], geoms[1]]
    rotation1, rotation2 = pairs.geom_xmat[worldid, geoms[0]], pairs.geom_xmat[worldid, geoms[1]]
    c1 = pairs.geom_xpos[worldid, geoms[0]]
    bodies = Bodies()
    bodies.p = pairs.geom_xpos[worldid, geoms[1]] - c1
    bodies.e2 = ellipsoid_matrix(size2, rotation2)
    bodies.rotation1 = rotation2
    bodies.rotation2 = rotation2
    # A collision sensor wants the distance however large it is.
    bodies.cutoff = wp.where(pairid[1] < 0, margin + gap, FAR)
    touch = Touch()
    if type1 == ELLIPSOID:
        bodies.e1 = ellipsoid_matrix(size1, rotation1)
        bodies.rotation1 = rotation1
        touch = ellipsoid_touch(bodies, c1)
    else:
        axis = wp.vec3(rotation1[0, 2], rotation1[1, 2], rotation1[2, 2])
        touch = capsule_touch(bodies, c1, axis, size1[0], wp.where(type1 == CAPSULE, size1[1], 0.0))
    if touch.dist >= bodies.cutoff:
        return
    candidate = Candidate()
    candidate.geoms = geoms
    candidate.pairid = pairid
    candidate.worldid = worldid
    candidate.margin = margin
    candidate.gap = gap
    write_touch(touch, candidate, material, naconmax_in, contact_out)
