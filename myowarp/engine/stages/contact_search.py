"""Contacts in few launches: those of spheres, capsules and ellipsoids in one, see `contact_search_kernel`."""

from typing import ClassVar

import mujoco_warp as mjw
import warp as wp
from mujoco_warp import BroadphaseType, DeterminismType, DisableBit, GeomType
from mujoco_warp._src.collision_core import create_collision_context
from mujoco_warp._src.collision_driver import MJ_COLLISION_TABLE, CollisionType, convex_narrowphase

from myowarp.engine.slim import colliding_pairs
from myowarp.engine.stage import Stage
from myowarp.engine.stages.arrays import ContactPool, filled
from myowarp.engine.stages.contact_filter import ContactFilter
from myowarp.engine.stages.contact_search_kernel import (
    OURS,
    Candidates,
    ContactMaterial,
    Shapes,
    find_contacts,
)
from myowarp.engine.stages.primitive_contacts import CLOSED_FORMS, touch_kernel
from myowarp.engine.stepped import Stepped
from myowarp.kernels.launch import launch

Kind = tuple[GeomType, GeomType]


def _kinds(stepped: Stepped) -> set[Kind]:
    """Return the kinds of pairs that can touch, but for those of a ground of ours."""
    types = stepped.oracle.geom_type
    pairs = colliding_pairs(stepped.oracle) - (stepped.ground.pairs if stepped.ground else set())
    kinds = (sorted((types[first], types[second])) for first, second in pairs)
    return {(GeomType(first), GeomType(second)) for first, second in kinds}


class ContactSearch(Stage):
    """One launch for most contacts, and one for each kind with a closed form; others stay with the engine."""

    REPLACES = ("collision",)
    TOLERANCE = 1e-2  # the engine's own normals of deep contacts are off by as much
    OBSTACLES: ClassVar = {
        "nothing that can touch has a closed form": lambda stepped: _kinds(stepped).isdisjoint(
            {*OURS, *CLOSED_FORMS}
        ),
        "the engine does not compare all pairs": lambda stepped: (
            stepped.model.opt.broadphase != BroadphaseType.NXN
        ),
        "contacts are sorted": lambda stepped: bool(
            stepped.model.opt.deterministic & DeterminismType.CONTACTS
        ),
        "meshes differ between worlds": lambda stepped: stepped.model.geom_dataid.shape[0] > 1,
        "there are distance fields or moving surfaces": lambda stepped: bool(
            stepped.model.has_sdf_geom or stepped.model.flg_surfacevel
        ),
        "the user filters contacts": lambda stepped: stepped.model.callback.contactfilter is not None,
    }

    def __init__(self, stepped: Stepped) -> None:
        """Sort the kinds of pairs that are left by who finds their contacts."""
        super().__init__(stepped)
        table = dict(MJ_COLLISION_TABLE)
        if stepped.model.opt.disableflags & DisableBit.NATIVECCD:
            table[GeomType.BOX, GeomType.BOX] = CollisionType.PRIMITIVE
        others = _kinds(stepped) - set(OURS)
        left = [kind for kind in table if kind in others]
        primitive = [kind for kind in left if table[kind] == CollisionType.PRIMITIVE]
        self._convex = [kind for kind in left if table[kind] == CollisionType.CONVEX]
        self._closed = [kind for kind in primitive if kind in CLOSED_FORMS]
        self._primitive = [kind for kind in primitive if kind not in CLOSED_FORMS]
        with wp.ScopedDevice(stepped.device):
            self._context = create_collision_context(stepped.data.naconmax)
        self._filter = ContactFilter(stepped)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Find the contacts of all worlds, as `mujoco_warp.collision` does."""
        data.ncollision.zero_()
        data.nacon.zero_()
        if model.opt.disableflags & (DisableBit.CONSTRAINT | DisableBit.CONTACT):
            return
        shared = {
            "shapes": filled(Shapes, model, data),
            "material": filled(ContactMaterial, model),
            "candidates": filled(Candidates, self._context, data),
            "contact": filled(ContactPool, data.contact, data),
        }
        self._filter.launch(model, data)
        launch(find_contacts, data.nworld, data, near=self._filter.near, **shared)
        if not (self._convex or self._closed or self._primitive):
            return

        def find_others() -> None:
            if self._convex:
                convex_narrowphase(model, data, self._context, self._convex)
            for kind in self._closed:
                touch_pairs = touch_kernel(kind)
                launch(touch_pairs, 1, data, **shared)
            if self._primitive:
                mjw.primitive_narrowphase(model, data, self._context, self._primitive)

        wp.capture_if(data.ncollision, find_others)
