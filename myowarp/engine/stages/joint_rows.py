"""Constraint rows of joints and tendons, and the places of all rows: one thread, on the CPU device.

Equalities of joints, friction losses, limits of hinges, slides and tendons, contacts, in this order, as
mujoco-warp's `make_constraint` lays them out; all of a row but J is the work of its `_efc_row`. There every
possible row is a thread of its own, which copies some thirty arrays before it finds that it has nothing to
do. The rows of contacts only get their places here.
"""

import warp as wp
from mujoco_warp._src.constraint import _efc_row
from mujoco_warp._src.types import ConstraintType, ContactType, vec5, vec12

from myowarp.engine.stages.arrays import ConstraintRows, ContactPool
from myowarp.engine.stages.contact_rows import KinematicTree, RowOptions, write_entry
from myowarp.engine.stages.row_places import RowPlaces, add_row, place_contact
from myowarp.kernels.batching import batched


@wp.struct
class JointConstraints:
    """Constraints of joints and tendons; fields are those of the engine's `Model`."""

    qpos0: wp.array2d[float]
    jnt_qposadr: wp.array[int]
    jnt_dofadr: wp.array[int]
    dof_invweight0: wp.array2d[float]
    eq_jnt_adr: wp.array[int]
    eq_obj1id: wp.array[int]
    eq_obj2id: wp.array[int]
    eq_solref: wp.array2d[wp.vec2]
    eq_solimp: wp.array2d[vec5]
    eq_data: wp.array2d[vec12]
    dof_frictionloss: wp.array2d[float]
    dof_solref: wp.array2d[wp.vec2]
    dof_solimp: wp.array2d[vec5]
    jnt_limited_slide_hinge_adr: wp.array[int]
    jnt_range: wp.array2d[wp.vec2]
    jnt_margin: wp.array2d[float]
    jnt_solref: wp.array2d[wp.vec2]
    jnt_solimp: wp.array2d[vec5]
    tendon_limited_adr: wp.array[int]
    tendon_range: wp.array2d[wp.vec2]
    tendon_margin: wp.array2d[float]
    tendon_solref_lim: wp.array2d[wp.vec2]
    tendon_solimp_lim: wp.array2d[vec5]
    tendon_invweight0: wp.array2d[float]
    ten_J_rownnz: wp.array[int]  # noqa: N815
    ten_J_rowadr: wp.array[int]  # noqa: N815
    ten_J_colind: wp.array[int]  # noqa: N815


@wp.struct
class JointState:
    """Positions of joints and tendons; fields are those of `Data`."""

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    eq_active: wp.array2d[bool]
    ten_J: wp.array2d[float]  # noqa: N815
    ten_length: wp.array2d[float]


@wp.func
def write_row(
    options: RowOptions,
    world: int,
    row: int,
    kind: int,
    source: int,
    distance: float,
    margin: float,
    speed: float,
    frictionloss: float,
    invweight: float,
    solref: wp.vec2,
    solimp: vec5,
    rows: ConstraintRows,
):
    """Write all of a row but J."""
    _efc_row(
        options.disableflags,
        world,
        options.timestep[batched(world, options.timestep.shape[0])],
        row,
        distance,
        distance,
        invweight,
        solref,
        solimp,
        margin,
        speed,
        frictionloss,
        kind,
        source,
        False,
        0.0,
        rows.type,
        rows.id,
        rows.pos,
        rows.margin,
        rows.D,
        rows.vel,
        rows.aref,
        rows.frictionloss,
    )


@wp.func
def write_equality(
    joints: JointConstraints,
    options: RowOptions,
    state: JointState,
    world: int,
    eqid: int,
    places: RowPlaces,
    rows: ConstraintRows,
):
    """Row of q1 - q1_0 = polynomial(q2 - q2_0), or of q1 - q1_0 = c where there is no second joint."""
    joint1, joint2 = joints.eq_obj1id[eqid], joints.eq_obj2id[eqid]
    row = add_row(world, places.ne, wp.where(joint2 > -1, 2, 1), True, places, rows)
    if row < 0:
        return
    qpos, qvel = state.qpos[world], state.qvel[world]
    qpos0 = joints.qpos0[batched(world, joints.qpos0.shape[0])]
    invweights = joints.dof_invweight0[batched(world, joints.dof_invweight0.shape[0])]
    c = joints.eq_data[batched(world, joints.eq_data.shape[0]), eqid]
    place1, dof1 = joints.jnt_qposadr[joint1], joints.jnt_dofadr[joint1]
    target, speed, invweight = c[0], float(qvel[dof1]), float(invweights[dof1])
    write_entry(world, row, 0, dof1, 1.0, rows)
    if joint2 > -1:
        place2, dof2 = joints.jnt_qposadr[joint2], joints.jnt_dofadr[joint2]
        x = qpos[place2] - qpos0[place2]
        target = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])))
        slope = c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + x * 4.0 * c[4]))
        speed = qvel[dof1] - qvel[dof2] * slope
        invweight = invweights[dof1] + invweights[dof2]
        write_entry(world, row, 1, dof2, -slope, rows)
    write_row(
        options,
        world,
        row,
        int(ConstraintType.EQUALITY),
        eqid,
        qpos[place1] - qpos0[place1] - target,
        0.0,
        speed,
        0.0,
        invweight,
        joints.eq_solref[batched(world, joints.eq_solref.shape[0]), eqid],
        joints.eq_solimp[batched(world, joints.eq_solimp.shape[0]), eqid],
        rows,
    )


@wp.func
def write_friction(
    joints: JointConstraints,
    options: RowOptions,
    state: JointState,
    world: int,
    dof: int,
    frictionloss: float,
    places: RowPlaces,
    rows: ConstraintRows,
) -> int:
    """Row of a degree of freedom's friction; returns it, -1 if it does not fit."""
    row = add_row(world, places.nf, 1, False, places, rows)
    if row >= 0:
        write_entry(world, row, 0, dof, 1.0, rows)
        write_row(
            options,
            world,
            row,
            int(ConstraintType.FRICTION_DOF),
            dof,
            0.0,
            0.0,
            state.qvel[world, dof],
            frictionloss,
            joints.dof_invweight0[batched(world, joints.dof_invweight0.shape[0]), dof],
            joints.dof_solref[batched(world, joints.dof_solref.shape[0]), dof],
            joints.dof_solimp[batched(world, joints.dof_solimp.shape[0]), dof],
            rows,
        )
    return row


@wp.func
def write_joint_limit(
    joints: JointConstraints,
    options: RowOptions,
    state: JointState,
    world: int,
    joint: int,
    distance: float,
    margin: float,
    sign: float,
    places: RowPlaces,
    rows: ConstraintRows,
):
    """Row of a joint that is closer to an end of its range than its margin; sign: 1 at the lower end."""
    row = add_row(world, places.nl, 1, True, places, rows)
    if row < 0:
        return
    dof = joints.jnt_dofadr[joint]
    write_entry(world, row, 0, dof, sign, rows)
    write_row(
        options,
        world,
        row,
        int(ConstraintType.LIMIT_JOINT),
        joint,
        distance,
        margin,
        sign * state.qvel[world, dof],
        0.0,
        joints.dof_invweight0[batched(world, joints.dof_invweight0.shape[0]), dof],
        joints.jnt_solref[batched(world, joints.jnt_solref.shape[0]), joint],
        joints.jnt_solimp[batched(world, joints.jnt_solimp.shape[0]), joint],
        rows,
    )


@wp.func
def write_tendon_limit(
    joints: JointConstraints,
    options: RowOptions,
    state: JointState,
    world: int,
    tendon: int,
    distance: float,
    margin: float,
    sign: float,
    places: RowPlaces,
    rows: ConstraintRows,
):
    """Row of a tendon that is closer to an end of its range than its margin; sign: 1 at the lower end."""
    rownnz, first = joints.ten_J_rownnz[tendon], joints.ten_J_rowadr[tendon]
    row = add_row(world, places.nl, rownnz, True, places, rows)
    if row < 0:
        return
    speed = float(0.0)
    for i in range(rownnz):
        dof, value = joints.ten_J_colind[first + i], sign * state.ten_J[world, first + i]
        write_entry(world, row, i, dof, value, rows)
        speed += value * state.qvel[world, dof]
    write_row(
        options,
        world,
        row,
        int(ConstraintType.LIMIT_TENDON),
        tendon,
        distance,
        margin,
        speed,
        0.0,
        joints.tendon_invweight0[batched(world, joints.tendon_invweight0.shape[0]), tendon],
        joints.tendon_solref_lim[batched(world, joints.tendon_solref_lim.shape[0]), tendon],
        joints.tendon_solimp_lim[batched(world, joints.tendon_solimp_lim.shape[0]), tendon],
        rows,
    )


@wp.func
def write_limits(
    joints: JointConstraints,
    options: RowOptions,
    state: JointState,
    world: int,
    places: RowPlaces,
    rows: ConstraintRows,
):
    """Rows of all joints and tendons at an end of their range."""
    qpos = state.qpos[world]
    ranges = joints.jnt_range[batched(world, joints.jnt_range.shape[0])]
    margins = joints.jnt_margin[batched(world, joints.jnt_margin.shape[0])]
    for i in range(joints.jnt_limited_slide_hinge_adr.shape[0]):
        joint = joints.jnt_limited_slide_hinge_adr[i]
        value, ends, margin = qpos[joints.jnt_qposadr[joint]], ranges[joint], margins[joint]
        above, below = value - ends[0], ends[1] - value
        distance = wp.min(above, below) - margin
        if distance < 0.0:
            sign = wp.where(above < below, 1.0, -1.0)
            write_joint_limit(joints, options, state, world, joint, distance, margin, sign, places, rows)
    lengths = state.ten_length[world]
    spans = joints.tendon_range[batched(world, joints.tendon_range.shape[0])]
    gaps = joints.tendon_margin[batched(world, joints.tendon_margin.shape[0])]
    for i in range(joints.tendon_limited_adr.shape[0]):
        tendon = joints.tendon_limited_adr[i]
        length, span, gap = lengths[tendon], spans[tendon], gaps[tendon]
        longer, shorter = length - span[0], span[1] - length
        slack = wp.min(longer, shorter) - gap
        if slack < 0.0:
            side = wp.where(longer < shorter, 1.0, -1.0)
            write_tendon_limit(joints, options, state, world, tendon, slack, gap, side, places, rows)


@wp.kernel(enable_backward=False)
def write_joint_rows(
    # Model:
    tree: KinematicTree,
    joints: JointConstraints,
    # Params:
    options: RowOptions,
    # In:
    state: JointState,
    contacts: ContactPool,
    # Out:
    places: RowPlaces,
    rows: ConstraintRows,
):
    """aref = -k imp distance - b J qvel; row i of J is that of an equality, a friction or a limit."""
    first = wp.tid()
    for worldid in range(first, places.nefc.shape[0]):
        places.ne[worldid] = 0
        places.nf[worldid] = 0
        places.nl[worldid] = 0
        places.nefc[worldid] = 0
        places.jtdaj_nblock[worldid] = 0
        places.efc_nnz[worldid] = 0
        for i in range(joints.eq_jnt_adr.shape[0]):
            eqid = joints.eq_jnt_adr[i]
            if state.eq_active[worldid, eqid]:
                write_equality(joints, options, state, worldid, eqid, places, rows)
        losses = joints.dof_frictionloss[batched(worldid, joints.dof_frictionloss.shape[0])]
        for dof in range(losses.shape[0]):
            row = int(-1)
            if losses[dof] > 0.0:
                row = write_friction(joints, options, state, worldid, dof, losses[dof], places, rows)
            places.dof_frictionadr[worldid, dof] = row
        write_limits(joints, options, state, worldid, places, rows)
    for conid in range(wp.min(contacts.nacon[0], contacts.dist.shape[0])):
        in_reach = contacts.dist[conid] - contacts.includemargin[conid] < 0.0
        if in_reach and (contacts.type[conid] & int(ContactType.CONSTRAINT)) != 0:
            place_contact(tree, contacts, conid, places, rows)
