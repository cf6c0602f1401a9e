"""The height field of a scene: found in its model, taken from the engine, touched by kernels of ours.

mujoco-warp keeps at most four contacts of a body with a height field, where MuJoCo C has one for every prism,
and all worlds share its heights.
"""

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import BroadphaseType, GeomType

from myowarp.definitions.ground import Ground
from myowarp.engine.stage import or_the_engines

ROUND = (GeomType.SPHERE, GeomType.CAPSULE, GeomType.ELLIPSOID)
"""Shapes whose contacts with a height field are ours."""


def height_field(host: mujoco.MjModel, model: mjw.Model) -> Ground | None:
    """Return the height field that round geoms of a model may touch, and take these pairs from the engine.

    None where there is none, where there are several, or where the engine does not go through all pairs: then
    all contacts are the engine's.
    """
    if not host.nhfield or model.opt.broadphase != BroadphaseType.NXN:
        return None
    pairs, pairids = model.nxn_geom_pair_filtered.numpy(), model.nxn_pairid_filtered.numpy()
    ordered = np.take_along_axis(pairs, np.argsort(host.geom_type[pairs], axis=1, kind="stable"), axis=1)
    kinds = host.geom_type[ordered]
    ours = (kinds[:, 0] == GeomType.HFIELD) & np.isin(kinds[:, 1], ROUND) & (pairids[:, 1] < 0)
    if len(np.unique(ordered[ours, 0])) != 1:
        return None
    with or_the_engines("height fields"):
        from myowarp.engine.stages.height_field import HeightField

        ground = HeightField(host, ordered[ours], pairids[ours])
        for name, others in (
            ("nxn_geom_pair_filtered", pairs[~ours]),
            ("nxn_pairid_filtered", pairids[~ours]),
        ):
            setattr(model, name, wp.array(others, dtype=wp.vec2i, shape=len(others)))
        kept = kinds[~ours].tolist()
        counts = list(model.geom_pair_type_count)  # what the engine has kernels for
        for kind in np.unique(kinds[ours], axis=0).tolist():
            first, second = kind
            counts[first * (2 * len(GeomType) - first - 1) // 2 + second] = kept.count(kind)
        model.geom_pair_type_count = tuple(counts)
        return ground
    return None
