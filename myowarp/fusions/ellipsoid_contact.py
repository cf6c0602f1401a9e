"""Ellipsoids against spheres, capsules and ellipsoids: see `kernels.ellipsoid_contact`.

Other convex pairs stay with the engine.
"""

import contextlib
from collections.abc import Iterator
from unittest import mock

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import collision_driver
from mujoco_warp._src.collision_core import CollisionContext
from mujoco_warp._src.types import GeomType

from myowarp.fusions import FUSIONS, Fusion
from myowarp.kernels.ellipsoid_contact import CollisionPairs, ContactMaterial, ellipsoid_contacts
from myowarp.kernels.engine_arrays import ContactPool, filled
from myowarp.models.slim import colliding_pairs
from myowarp.scene import Scene

OURS = (
    (GeomType.SPHERE, GeomType.ELLIPSOID),
    (GeomType.CAPSULE, GeomType.ELLIPSOID),
    (GeomType.ELLIPSOID, GeomType.ELLIPSOID),
)


@FUSIONS.register("ellipsoid_contact")
class EllipsoidContact(Fusion):
    """Contacts of ellipsoids by Newton's method on the support function."""

    TOLERANCE = 1e-2  # the engine's own normals of deep contacts are off by as much

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why this scene cannot use the fusion, None if it can."""
        types = scene.oracle.geom_type
        kinds = {
            tuple(sorted((types[first], types[second]))) for first, second in colliding_pairs(scene.oracle)
        }
        if kinds.isdisjoint(OURS):
            return "no ellipsoid can touch a sphere, capsule or ellipsoid"
        return None

    def __init__(self, scene: Scene) -> None:
        """Collect the engine's arrays."""
        model, data = scene.model, scene.data
        self.pairs, self.material = filled(CollisionPairs, model, data), filled(ContactMaterial, model)
        self.contact = filled(ContactPool, data.contact, data)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Launch our kernel for its pairs, and the engine's for all others."""
        engine = collision_driver.convex_narrowphase

        def narrowphase(
            model: mjw.Model,
            data: mjw.Data,
            context: CollisionContext,
            kinds: list[tuple[GeomType, GeomType]],
        ) -> None:
            engine(model, data, context, [kind for kind in kinds if kind not in OURS])
            wp.launch(
                ellipsoid_contacts,
                dim=data.naconmax,
                inputs=[
                    self.material,
                    data.naconmax,
                    self.pairs,
                    context.collision_pair,
                    context.collision_pairid,
                    context.collision_worldid,
                ],
                outputs=[self.contact],
            )

        with mock.patch.object(collision_driver, "convex_narrowphase", narrowphase):
            yield
