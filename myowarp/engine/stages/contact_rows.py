"""Constraint rows of contacts with pyramidal friction cones: one thread a contact, on the CPU device.

Each friction direction k of a contact gives two rows, normal ± friction_k direction_k, whose Jacobian is that
of the two bodies' relative motion at the contact point (MuJoCo documentation, Computation, "Friction cones").
mujoco-warp computes every column of every row, and the stiffness of every row; here only the columns of the
two kinematic chains are computed, once for all rows of the contact, and the stiffness once.
"""

import warp as wp
from mujoco_warp._src.constraint import _contact_kbimp, _efc_D
from mujoco_warp._src.types import ConstraintType, vec5

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


@wp.func
def row_value(directions: wp.spatial_vector, friction: vec5, row: int, condim: int) -> float:
    """Return a pyramid edge's component from those along normal, tangents and rotations."""
    if condim == 1:
        return directions[0]
    k = row / 2
    sign = 1.0 - 2.0 * float(row % 2)
    return directions[0] + sign * friction[k] * directions[k + 1]


@wp.func
def along_frame(frame: wp.mat33, linear: wp.vec3, angular: wp.vec3) -> wp.spatial_vector:
    """Return a motion's components along a contact's normal and tangents, and about them."""
    return wp.spatial_vector(frame @ linear, frame @ angular)


@wp.func
def write_jacobian(
    tree: KinematicTree,
    contacts: ContactPool,
    qvel: wp.array[float],
    subtree_com: wp.array[wp.vec3],
    cdof: wp.array[wp.spatial_vector],
    conid: int,
    first: int,
    num_rows: int,
    rows: ConstraintRows,
) -> wp.spatial_vector:
    """Write the rows of J; returns the velocity of body 2 against body 1 along the contact's frame."""
    worldid = contacts.worldid[conid]
    frame, point, geoms = contacts.frame[conid], contacts.pos[conid], contacts.geom[conid]
    body1, body2 = tree.geom_bodyid[geoms[0]], tree.geom_bodyid[geoms[1]]
    if rows.J_rownnz.shape[1] == 0:
        for i in range(num_rows):
            clear(rows.J[worldid, first + i])
    arm1 = point - subtree_com[tree.body_rootid[body1]]
    arm2 = point - subtree_com[tree.body_rootid[body2]]
    dof1, dof2 = last_dof(tree, body1), last_dof(tree, body2)
    velocity = wp.spatial_vector()
    column = int(0)
    while dof1 != dof2:  # what moves both bodies moves neither against the other
        dof = wp.max(dof1, dof2)
        angular, linear = wp.spatial_top(cdof[dof]), wp.spatial_bottom(cdof[dof])
        if dof == dof2:
            motion = along_frame(frame, linear + wp.cross(angular, arm2), angular)
            dof2 = tree.dof_parentid[dof2]
        else:
            motion = -along_frame(frame, linear + wp.cross(angular, arm1), angular)
            dof1 = tree.dof_parentid[dof1]
        velocity += qvel[dof] * motion
        for i in range(num_rows):
            value = row_value(motion, contacts.friction[conid], i, contacts.dim[conid])
            write_entry(worldid, first + i, column, dof, value, rows)
        column += 1
    return velocity


@wp.func
def row_stiffness(
    tree: KinematicTree, options: RowOptions, contacts: ContactPool, conid: int, impedance: float
) -> float:
    """Return D of the rows of a contact."""
    worldid, geoms, friction = contacts.worldid[conid], contacts.geom[conid], contacts.friction[conid][0]
    weights = tree.body_invweight0[batched(worldid, tree.body_invweight0.shape[0])]
    weight = weights[tree.geom_bodyid[geoms[0]]][0] + weights[tree.geom_bodyid[geoms[1]]][0]
    if contacts.dim[conid] > 1:
        ratio = friction * options.impratio_invsqrt[batched(worldid, options.impratio_invsqrt.shape[0])]
        weight = (weight + friction * friction * weight) * 2.0 * ratio * ratio
    return _efc_D(weight, impedance)


@wp.kernel(enable_backward=False)
def write_contact_rows(
    # Model:
    tree: KinematicTree,
    # Params:
    options: RowOptions,
    # Data in:
    qvel_in: wp.array2d[float],
    subtree_com_in: wp.array2d[wp.vec3],
    cdof_in: wp.array2d[wp.spatial_vector],
    # In:
    threads: int,
    contacts: ContactPool,
    # Out:
    rows: ConstraintRows,
):
    """J = normal' (J_2 - J_1) ± friction_k direction_k' (J_2 - J_1), aref = -k imp dist - b J qvel."""
    thread = wp.tid()
    for conid in range(thread, wp.min(contacts.nacon[0], contacts.dist.shape[0]), threads):
        first = contacts.efc_address[conid, 0]
        if first < 0:
            continue
        worldid, condim, margin = contacts.worldid[conid], contacts.dim[conid], contacts.includemargin[conid]
        num_rows = wp.min(wp.max(1, 2 * (condim - 1)), rows.aref.shape[1] - first)
        velocity = write_jacobian(
            tree,
            contacts,
            qvel_in[worldid],
            subtree_com_in[worldid],
            cdof_in[worldid],
            conid,
            first,
            num_rows,
            rows,
        )
        kind = int(ConstraintType.CONTACT_PYRAMIDAL)
        if condim == 1:
            kind = int(ConstraintType.CONTACT_FRICTIONLESS)
        distance = contacts.dist[conid] - margin
        timestep = options.timestep[batched(worldid, options.timestep.shape[0])]
        spring = _contact_kbimp(
            options.disableflags, timestep, contacts.solref[conid], contacts.solimp[conid], distance, False
        )
        stiffness = row_stiffness(tree, options, contacts, conid, spring[2])
        for row in range(first, first + num_rows):
            speed = row_value(velocity, contacts.friction[conid], row - first, condim)
            rows.type[worldid, row] = kind
            rows.id[worldid, row] = conid
            rows.pos[worldid, row] = contacts.dist[conid]
            rows.margin[worldid, row] = margin
            rows.D[worldid, row] = stiffness
            rows.vel[worldid, row] = speed
            rows.aref[worldid, row] = -spring[0] * spring[2] * distance - spring[1] * speed
            rows.frictionloss[worldid, row] = 0.0
