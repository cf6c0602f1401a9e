"""Contacts in few launches, see `kernels/contact_search.py` and `kernels/primitive_contacts.py`."""

import contextlib
import functools
from collections.abc import Callable, Iterator
from unittest import mock

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import collision_driver
from mujoco_warp._src.collision_core import CollisionContext
from mujoco_warp._src.types import BroadphaseType, EnableBit, GeomType

from myowarp.engine.stages import FUSIONS, Fusion
from myowarp.engine.stages.arrays import ContactPool, filled
from myowarp.engine.stages.contact_search_kernel import (
    OURS,
    Candidates,
    ContactMaterial,
    Shapes,
    find_contacts,
)
from myowarp.engine.stages.primitive_contacts import CLOSED_FORMS, touch_kernel
from myowarp.kernels.batching import num_threads
from myowarp.models.slim import colliding_pairs
from myowarp.spec.scene import Scene

Kind = tuple[GeomType, GeomType]
Narrowphase = Callable[[mjw.Model, mjw.Data, CollisionContext, list[Kind]], None]


@FUSIONS.register("contact_search")
class ContactSearch(Fusion):
    """One launch for most contacts, and one for each kind with a closed form; others stay with the engine."""

    TOLERANCE = 1e-2  # the engine's own normals of deep contacts are off by as much

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why the search cannot be used, None if it can."""
        opt = scene.model.opt
        obstacles = {
            "no sphere, capsule or ellipsoid can touch another": _kinds(scene).isdisjoint(OURS),
            "the engine does not compare all pairs": opt.broadphase != BroadphaseType.NXN,
            "sleeping is on": bool(opt.enableflags & EnableBit.SLEEP),
            "meshes differ between worlds": scene.model.geom_dataid.shape[0] > 1,
        }
        return next((reason for reason, holds in obstacles.items() if holds), None)

    def __init__(self, scene: Scene) -> None:
        """Note what is left to the engine."""
        self._left = _kinds(scene) - set(OURS)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Have the engine begin with our search, and go on with the kinds of pairs that are left."""

        def for_what_is_left(engine: Narrowphase) -> Narrowphase:
            def narrowphase(
                model: mjw.Model, data: mjw.Data, context: CollisionContext, kinds: list[Kind]
            ) -> None:
                left = [kind for kind in kinds if kind in self._left]
                if not left:
                    return
                if data.nacon.device.is_cpu:  # which takes its time to find that threads have nothing to do
                    wp.capture_if(data.ncollision, lambda: engine(model, data, context, left))
                else:
                    engine(model, data, context, left)

            return narrowphase

        convex = collision_driver.convex_narrowphase
        primitive = functools.partial(launch_primitives, collision_driver.primitive_narrowphase)
        with (
            mock.patch.object(collision_driver, "nxn_broadphase", launch_search),
            mock.patch.object(collision_driver, "convex_narrowphase", for_what_is_left(convex)),
            mock.patch.object(collision_driver, "primitive_narrowphase", for_what_is_left(primitive)),
        ):
            yield


def _kinds(scene: Scene) -> set[Kind]:
    """Return the kinds of pairs that can touch."""
    types = scene.oracle.geom_type
    pairs = (sorted((types[first], types[second])) for first, second in colliding_pairs(scene.oracle))
    return {(GeomType(first), GeomType(second)) for first, second in pairs}


def launch_search(
    model: mjw.Model, data: mjw.Data, context: CollisionContext, awake_prev: wp.array | None = None
) -> None:
    """Search all worlds, in the place of `mujoco_warp._src.collision_driver.nxn_broadphase`."""
    threads = num_threads(data.nacon.device, model.nxn_geom_pair_filtered.shape[0])
    wp.launch(
        find_contacts,
        dim=(data.nworld, threads),
        inputs=[filled(Shapes, model, data), filled(ContactMaterial, model), data.naconmax, threads],
        outputs=[filled(ContactPool, data.contact, data), filled(Candidates, context, data)],
    )


def launch_primitives(
    engine: Narrowphase, model: mjw.Model, data: mjw.Data, context: CollisionContext, kinds: list[Kind]
) -> None:
    """Find the contacts of these kinds of pairs on the engine's list; those with meshes are left to it."""
    shapes, material = filled(Shapes, model, data), filled(ContactMaterial, model)
    candidates, contact = filled(Candidates, context, data), filled(ContactPool, data.contact, data)
    threads = num_threads(data.nacon.device, data.naconmax)
    for kind in kinds:
        if kind not in CLOSED_FORMS:
            engine(model, data, context, [kind])
            continue
        touch_pairs = touch_kernel(kind)
        wp.launch(
            touch_pairs,
            dim=threads,
            inputs=[shapes, material, data.naconmax, threads, candidates],
            outputs=[contact],
        )
