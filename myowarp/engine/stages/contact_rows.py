"""Constraint rows of contacts with pyramidal friction cones: one thread, on the CPU device.

Each friction direction k of a contact gives two rows, normal ± friction_k direction_k, whose Jacobian is that
of the two bodies' relative motion at the contact point (MuJoCo documentation, Computation, "Friction cones").
mujoco-warp computes every column of every row, and the stiffness of every row; here only the columns of the
two kinematic chains are computed, once for all rows of the contact, and the stiffness once.

Where our solver follows, it computes what the chains do along normal and tangents by itself
(`contact_frame.cpp`), and no Jacobian of an edge is written.
"""

from pathlib import Path

import warp as wp
from mujoco_warp._src.constraint import _contact_kbimp, _efc_D
from mujoco_warp._src.types import ConstraintType

from myowarp.engine.stages.arrays import ConstraintRows, ContactPool
from myowarp.kernels.batching import batched


@wp.struct
class KinematicTree:
    """Bodies, their degrees of freedom, and what moves when a contact pushes."""

    body_weldid: wp.array[int]
    body_rootid: wp.array[int]
    body_dofnum: wp.array[int]
    body_dofadr: wp.array[int]
    dof_parentid: wp.array[int]
    geom_bodyid: wp.array[int]
    body_invweight0: wp.array2d[wp.vec2]


@wp.struct
class RowOptions:
    """Options of the model that shape a row."""

    timestep: wp.array[float]
    disableflags: int
    impratio_invsqrt: wp.array[float]


@wp.func_native("for (int i = 0; i < row.shape[0]; ++i) row.data[i] = 0.0f;")
def clear(row: wp.array[float]):
    """Set a row to zero, by whole vectors."""
    ...


@wp.func
def write_entry(world: int, row: int, number: int, dof: int, value: float, rows: ConstraintRows):
    """Write an entry of J, the `number`-th of its row where J is sparse."""
    if rows.J_rownnz.shape[1] == 0:
        rows.J[world, row, dof] = value
    else:
        place = rows.J_rowadr[world, row] + number
        rows.J_colind[world, 0, place] = dof
        rows.J[world, 0, place] = value


@wp.func
def last_dof(tree: KinematicTree, body: int) -> int:
    """Return the last degree of freedom that moves a body, -1 if none does."""
    moved = tree.body_weldid[body]
    return wp.max(-1, tree.body_dofadr[moved] + tree.body_dofnum[moved] - 1)


FRAME = Path(__file__).with_name("contact_frame.cpp").read_text()


@wp.func_native(FRAME + Path(__file__).with_suffix(".cpp").read_text())
def write_jacobians(
    tree: KinematicTree,
    contacts: ContactPool,
    subtree_com: wp.array2d[wp.vec3],
    cdof: wp.array2d[wp.spatial_vector],
    cvel: wp.array2d[wp.spatial_vector],
    in_solver: bool,
    rows: ConstraintRows,
):
    """Write J qvel of the rows of all contacts that have places, and J unless the solver does without."""
    ...


@wp.kernel(enable_backward=False)
def write_contact_rows(
    # Model:
    tree: KinematicTree,
    # Params:
    options: RowOptions,
    # Data in:
    subtree_com_in: wp.array2d[wp.vec3],
    cdof_in: wp.array2d[wp.spatial_vector],
    cvel_in: wp.array2d[wp.spatial_vector],
    # In:
    contacts: ContactPool,
    in_solver: bool,
    # Out:
    rows: ConstraintRows,
):
    """J = normal' (J_2 - J_1) ± friction_k direction_k' (J_2 - J_1), aref = -k imp dist - b J qvel.

    For one thread. Functions take structs by value: for every contact, only numbers.
    """
    thread = wp.tid()
    write_jacobians(tree, contacts, subtree_com_in, cdof_in, cvel_in, in_solver, rows)
    for conid in range(thread, wp.min(contacts.nacon[0], contacts.dist.shape[0])):
        first = contacts.efc_address[conid, 0]
        if first < 0:
            continue
        worldid, condim, margin = contacts.worldid[conid], contacts.dim[conid], contacts.includemargin[conid]
        geoms, friction = contacts.geom[conid], contacts.friction[conid][0]
        weights = tree.body_invweight0[batched(worldid, tree.body_invweight0.shape[0])]
        weight = weights[tree.geom_bodyid[geoms[0]]][0] + weights[tree.geom_bodyid[geoms[1]]][0]
        kind = int(ConstraintType.CONTACT_FRICTIONLESS)
        if condim > 1:
            kind = int(ConstraintType.CONTACT_PYRAMIDAL)
            ratio = friction * options.impratio_invsqrt[batched(worldid, options.impratio_invsqrt.shape[0])]
            weight = (weight + friction * friction * weight) * 2.0 * ratio * ratio
        distance = contacts.dist[conid] - margin
        timestep = options.timestep[batched(worldid, options.timestep.shape[0])]
        spring = _contact_kbimp(
            options.disableflags, timestep, contacts.solref[conid], contacts.solimp[conid], distance, False
        )
        stiffness = _efc_D(weight, spring[2])
        for row in range(first, wp.min(first + wp.max(1, 2 * (condim - 1)), rows.aref.shape[1])):
            rows.type[worldid, row] = kind
            rows.id[worldid, row] = conid
            rows.pos[worldid, row] = contacts.dist[conid]
            rows.margin[worldid, row] = margin
            rows.D[worldid, row] = stiffness
            rows.aref[worldid, row] = -spring[0] * spring[2] * distance - spring[1] * rows.vel[worldid, row]
            rows.frictionloss[worldid, row] = 0.0
