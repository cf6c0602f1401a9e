"""Contacts of planes, boxes and cylinders with what the engine has closed forms for, a kernel for each kind.

The functions are the engine's. Its own kernel holds those of all kinds and chooses among them in a loop that
Warp unrolls: every process has to generate its code once more to learn that it is compiled already, which for
a box takes a second.
"""

import functools

import warp as wp
from mujoco_warp._src.collision_core import Geom, contact_margin_gap
from mujoco_warp._src.collision_primitive import _PRIMITIVE_COLLISIONS
from mujoco_warp._src.types import GeomType

from myowarp.engine.stages.arrays import ContactPool
from myowarp.engine.stages.contact_search_kernel import (
    OURS,
    Candidates,
    ContactMaterial,
    Pair,
    Shapes,
    material_of,
)
from myowarp.kernels.batching import batched

CLOSED_FORMS = {
    kind: touch
    for kind, touch in _PRIMITIVE_COLLISIONS.items()
    if kind not in OURS and GeomType.MESH not in kind  # whose contact with a plane is a search, too
}
"""The engine's function for each kind of pairs that `contact_search` leaves on its list."""


@wp.func
def solid(shapes: Shapes, worldid: int, geomid: int) -> Geom:
    """Return a geom as the engine's functions want it; what describes meshes stays empty."""
    geom = Geom()
    geom.pos = shapes.geom_xpos[worldid, geomid]
    geom.rot = shapes.geom_xmat[worldid, geomid]
    geom.normal = wp.vec3(geom.rot[0, 2], geom.rot[1, 2], geom.rot[2, 2])
    geom.size = shapes.geom_size[batched(worldid, shapes.geom_size.shape[0]), geomid]
    geom.index = -1
    return geom


@wp.func
def listed_pair(shapes: Shapes, candidates: Candidates, i: int) -> Pair:
    """Return an entry of the engine's list."""
    pair = Pair()
    pair.geoms = candidates.collision_pair[i]
    pair.pairid = candidates.collision_pairid[i]
    pair.worldid = candidates.collision_worldid[i]
    margin, gap = contact_margin_gap(
        shapes.geom_margin,
        shapes.geom_gap,
        shapes.pair_margin,
        shapes.pair_gap,
        pair.geoms,
        pair.pairid[0],
        pair.worldid,
    )
    pair.margin = margin
    pair.gap = gap
    return pair


@functools.cache
def touch_kernel(kind: tuple[GeomType, GeomType]) -> wp.Kernel:
    """Return the kernel for a kind of pairs."""
    # One by one: Warp tells kernels apart by the numbers and functions they name, not by what tuples hold.
    type1, type2, touch = int(kind[0]), int(kind[1]), CLOSED_FORMS[kind]

    @wp.kernel(module="unique", enable_backward=False)
    def touch_pairs(
        # Model:
        shapes: Shapes,
        material: ContactMaterial,
        # Data in:
        naconmax_in: int,
        # In:
        candidates: Candidates,
        # Data out:
        contact_out: ContactPool,
    ):
        """Contacts of the pairs on the engine's list that are of this kind; for one thread."""
        thread = wp.tid()
        for i in range(thread, wp.min(candidates.ncollision[0], naconmax_in)):
            geoms = candidates.collision_pair[i]
            if shapes.geom_type[geoms[0]] != type1 or shapes.geom_type[geoms[1]] != type2:
                continue
            pair = listed_pair(shapes, candidates, i)
            condim, friction, solref, solreffriction, solimp, adhesion = material_of(material, pair)
            touch(
                naconmax_in,
                solid(shapes, pair.worldid, geoms[0]),
                solid(shapes, pair.worldid, geoms[1]),
                pair.worldid,
                pair.margin,
                pair.gap,
                condim,
                friction,
                solref,
                solreffriction,
                solimp,
                adhesion,
                geoms,
                pair.pairid,
                contact_out.dist,
                contact_out.pos,
                contact_out.frame,
                contact_out.includemargin,
                contact_out.friction,
                contact_out.solref,
                contact_out.solreffriction,
                contact_out.solimp,
                contact_out.dim,
                contact_out.geom,
                contact_out.efc_address,
                contact_out.worldid,
                contact_out.type,
                contact_out.geomcollisionid,
                contact_out.adhesion,
                contact_out.nacon,
            )

    return touch_pairs
