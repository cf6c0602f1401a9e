"""Mass of a body that hangs on a limb, set per world.

The engine needs the mass of every subtree that the body is in, besides the body's own: it divides by it when
it computes the point about which it takes moments. Fields that MuJoCo derives from masses at compile time
only to choose the softness of limits and contacts (`dof_invweight0`, `body_invweight0`) stay as they are.
"""

import mujoco
import numpy as np
import warp as wp

from myowarp.kernels.structs import struct_of

MASS_FIELDS = ("body_mass", "body_subtreemass")
"""Names of the model's fields that `set_body_mass` writes per world."""


@wp.struct
class WeighedBody:
    """A body, and the subtrees that it is in.

    Attributes:
        bodyid: The body.
        lineage: The body, its parent, and so on to the world.
        subtree_size: Bodies in the subtree of each of them, itself included; they follow it in order.
        subtree_mass: Nominal mass of each of these subtrees [kg].
        mass: Nominal mass of every body [kg], shape (nbody,).
    """

    bodyid: int
    lineage: wp.array[int]
    subtree_size: wp.array[int]
    subtree_mass: wp.array[float]
    mass: wp.array[float]


def weighed_body(model: mujoco.MjModel, name: str) -> WeighedBody:
    """Return the body called `name` on the current Warp device."""
    lineage = [model.body(name).id]
    while lineage[-1]:
        lineage.append(int(model.body_parentid[lineage[-1]]))
    size = np.ones(model.nbody, dtype=int)
    for bodyid in range(model.nbody - 1, 0, -1):
        size[model.body_parentid[bodyid]] += size[bodyid]
    return struct_of(
        WeighedBody,
        bodyid=lineage[0],
        lineage=lineage,
        subtree_size=size[lineage],
        subtree_mass=model.body_subtreemass[lineage],
        mass=model.body_mass,
    )


@wp.func
def set_body_mass(
    body: WeighedBody,
    worldid: int,
    mass: float,
    body_mass: wp.array2d[float],
    body_subtreemass: wp.array2d[float],
):
    """Set the mass [kg] in a world; subtree mass = nominal + what its bodies now weigh beyond nominal.

    The sum is taken anew each time, so it depends on the present masses alone: with nominal masses it is the
    nominal one, bit for bit.
    """
    body_mass[worldid, body.bodyid] = mass
    for i in range(body.lineage.shape[0]):
        root = body.lineage[i]
        total = body.subtree_mass[i]
        for member in range(root, root + body.subtree_size[i]):
            total += body_mass[worldid, member] - body.mass[member]
        body_subtreemass[worldid, root] = total
