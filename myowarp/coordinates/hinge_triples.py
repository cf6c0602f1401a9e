"""Three hinges of a body that cross at right angles in turn, without the poles where two of them coincide.

Such a triple turns like a ball. Its angles a, b, c have poles, at which the first and the third axis are one:
their rates grow like 1/cos b there, and M by these angles gets as near to singular as 1/cos^2 b, beyond what
float32 can tell from singular at half a degree. In the directions e1, e2, e3 (the first axis, the second, and
what is normal to both) nothing of this happens:

    w = A u',    A = [1, 0, sin b; 0, 1, 0; 0, 0, cos b],    M_e = sum_b E' I_b E,    forces_e = A^-T forces,

so that the solver gets M_e, and u'' = A^-1 (its acceleration) (Featherstone, Rigid Body Dynamics Algorithms,
2008, section 3.3: any basis of a joint's motions serves). After the step the rotation itself is turned by the
new angular velocity, as that of a ball joint is, and the angles are read from it: an angular velocity stays
what it was while angles run through a pole.
"""

from collections.abc import Iterable

import mujoco
import numpy as np
import warp as wp

from myowarp.coordinates.reduction import Followers
from myowarp.engine.inertia import inert_vec, vec10
from myowarp.kernels.batching import batched
from myowarp.kernels.structs import struct_of
from myowarp.osim.bundle.couplings import Coupling

HINGE = mujoco.mjtJoint.mjJNT_HINGE.value
RIGHT = 1e-6  # cosine between axes that count as at right angles
NEAR = wp.constant(0.25)  # cos^2 b, from which on limits of the first and the third angle hold as others do
RETURN = wp.constant(5.0)  # rad/s
LIMIT = wp.constant(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT.value)
POLE = wp.constant(1e-6)  # least cos b: nearer to a pole rates stay what they are here


@wp.struct
class Triples:
    """Hinges that turn a body like a ball.

    Attributes:
        coordinate: Numbers of the three coordinates among the free ones, shape (num_triples, 3).
        position: Places of their positions among the free ones, shape (num_triples, 3).
        joint: Ids of the three joints, shape (num_triples, 3).
        dof: Their degrees of freedom, shape (num_triples, 3).
        address: Of their angles in qpos, shape (num_triples, 3).
        zero: Angles at which the third axis is normal to the others, shape (num_triples, 3).
        middle: Of the range of each angle, shape (num_triples, 3).
        limited: 1 where that range limits the first or the third angle to less than a turn, else 0.
        entry: Number in M of each entry in a row or column of these dofs, shape (num_entries,).
        row: Of each such entry, shape (num_entries,).
        column: Of each such entry, shape (num_entries,).
    """

    coordinate: wp.array2d[int]
    position: wp.array2d[int]
    joint: wp.array2d[int]
    dof: wp.array2d[int]
    address: wp.array2d[int]
    zero: wp.array2d[float]
    middle: wp.array2d[float]
    limited: wp.array2d[float]
    entry: wp.array[int]
    row: wp.array[int]
    column: wp.array[int]


@wp.struct
class Bodies:
    """Places of axes, and masses on them; fields are those of the engine's `Model` and `Data`."""

    dof_bodyid: wp.array[int]
    body_rootid: wp.array[int]
    xaxis: wp.array2d[wp.vec3]
    xanchor: wp.array2d[wp.vec3]
    subtree_com: wp.array2d[wp.vec3]
    cdof: wp.array2d[wp.spatial_vector]
    crb: wp.array2d[vec10]
    cfrc_int: wp.array2d[wp.spatial_vector]


@wp.struct
class LimitRows:
    """Constraint rows; fields are those of the engine's `Data.efc`."""

    type: wp.array2d[int]
    id: wp.array2d[int]
    vel: wp.array2d[float]
    D: wp.array2d[float]
    aref: wp.array2d[float]


@wp.func
def kept(x: float) -> float:
    """Return a number, away from 0 by at least POLE."""
    return wp.where(x < 0.0, wp.min(x, -POLE), wp.max(x, POLE))


@wp.func
def along(tilt: float, rates: wp.vec3) -> wp.vec3:
    """A u': rates of the angles -> angular velocity along e."""
    return wp.vec3(rates[0] + wp.sin(tilt) * rates[2], rates[1], kept(wp.cos(tilt)) * rates[2])


@wp.func
def rates_of(tilt: float, w: wp.vec3) -> wp.vec3:
    """A^-1 w: along e -> rates of the angles."""
    third = w[2] / kept(wp.cos(tilt))
    return wp.vec3(w[0] - wp.sin(tilt) * third, w[1], third)


@wp.func
def forces_along(tilt: float, torques: wp.vec3) -> wp.vec3:
    """A^-T f: torques about the hinges -> torques along e."""
    third = (torques[2] - wp.sin(tilt) * torques[0]) / kept(wp.cos(tilt))
    return wp.vec3(torques[0], torques[1], third)


@wp.func
def three(values: wp.array2d[float], world: int, at: wp.vec3i) -> wp.vec3:
    """Return three entries of a row."""
    return wp.vec3(values[world, at[0]], values[world, at[1]], values[world, at[2]])


@wp.func
def put(values: wp.array2d[float], world: int, at: wp.vec3i, three_values: wp.vec3):
    """Set three entries of a row."""
    for k in range(3):
        values[world, at[k]] = three_values[k]


@wp.func
def numbers(table: wp.array2d[int], triple: int) -> wp.vec3i:
    """Return a row of a table."""
    return wp.vec3i(table[triple, 0], table[triple, 1], table[triple, 2])


@wp.kernel(enable_backward=False)
def straighten_speeds(
    # Params:
    triples: Triples,
    # In:
    positions: wp.array2d[float],
    # Out:
    speeds: wp.array2d[float],
    accelerations: wp.array2d[float],
):
    """w = A u', of speeds and of the accelerations that the solver starts from, in place."""
    worldid, triple = wp.tid()
    at = numbers(triples.coordinate, triple)
    tilt = positions[worldid, triples.position[triple, 1]] - triples.zero[triple, 1]
    put(speeds, worldid, at, along(tilt, three(speeds, worldid, at)))
    put(accelerations, worldid, at, along(tilt, three(accelerations, worldid, at)))


@wp.kernel(enable_backward=False)
def straighten_dynamics(
    # Params:
    triples: Triples,
    # Data in:
    qpos_in: wp.array2d[float],
    qfrc_applied_in: wp.array2d[float],
    qfrc_passive_in: wp.array2d[float],
    qfrc_actuator_in: wp.array2d[float],
    # In:
    bodies: Bodies,
    # Data out:
    M_out: wp.array2d[float],
    qfrc_bias_out: wp.array2d[float],
    # Out:
    directions: wp.array2d[wp.spatial_vector],
):
    """M_ij = d_i' I d_j, I composite inertia, d along e; bias such that forces - bias are along e."""
    worldid = wp.tid()
    for dof in range(directions.shape[1]):
        directions[worldid, dof] = bodies.cdof[worldid, dof]
    for triple in range(triples.joint.shape[0]):
        joint, at = numbers(triples.joint, triple), numbers(triples.dof, triple)
        body = bodies.dof_bodyid[at[0]]
        arm = bodies.subtree_com[worldid, bodies.body_rootid[body]] - bodies.xanchor[worldid, joint[0]]
        first = wp.normalize(bodies.xaxis[worldid, joint[0]])
        third = wp.normalize(wp.cross(first, bodies.xaxis[worldid, joint[1]]))
        e = wp.matrix_from_rows(first, wp.cross(third, first), third)
        tilt = qpos_in[worldid, triples.address[triple, 1]] - triples.zero[triple, 1]
        applied = three(qfrc_applied_in, worldid, at) + three(qfrc_passive_in, worldid, at)
        applied += three(qfrc_actuator_in, worldid, at)
        pushed = forces_along(tilt, applied)
        for k in range(3):
            direction = wp.spatial_vector(e[k], wp.cross(e[k], arm))
            directions[worldid, at[k]] = direction
            inertial = wp.dot(direction, bodies.cfrc_int[worldid, body])
            qfrc_bias_out[worldid, at[k]] = applied[k] - pushed[k] + inertial
    row, momentum = int(-1), wp.spatial_vector()
    for k in range(triples.entry.shape[0]):
        if triples.row[k] != row:
            row = triples.row[k]
            momentum = inert_vec(bodies.crb[worldid, bodies.dof_bodyid[row]], directions[worldid, row])
        M_out[worldid, triples.entry[k]] = wp.dot(directions[worldid, triples.column[k]], momentum)


@wp.kernel(enable_backward=False)
def straighten_rows(
    # Params:
    triples: Triples,
    timestep: wp.array[float],
    # Data in:
    nefc_in: wp.array[int],
    # In:
    positions: wp.array2d[float],
    # Out:
    rows: LimitRows,
    J: wp.array3d[float],
    actuator_moment: wp.array3d[float],
):
    """row_e = row A^-1, of constraints and of moment arms, in place.

    Near a pole a small turn moves the first and the third angle far beyond their limits, and tells nothing of
    where the body is: these limits fade within 30 degrees from it. There an angle gets far beyond its limit,
    which sends it back at RETURN at most.
    """
    worldid = wp.tid()
    h = timestep[batched(worldid, timestep.shape[0])]
    for triple in range(triples.coordinate.shape[0]):
        at = numbers(triples.coordinate, triple)
        tilt = positions[worldid, triples.position[triple, 1]] - triples.zero[triple, 1]
        for row in range(wp.min(nefc_in[worldid], J.shape[1])):
            before = three(J[worldid], row, at)
            after = forces_along(tilt, before)
            put(J[worldid], row, at, after)
            outer = before[0] != 0.0 or before[2] != 0.0
            if outer and rows.type[worldid, row] == LIMIT:
                away = wp.min(wp.length_sq(before) / wp.length_sq(after) / NEAR, 1.0)
                rows.D[worldid, row] = rows.D[worldid, row] * away * away * away
                most = wp.max(RETURN - rows.vel[worldid, row], 0.0) / h
                rows.aref[worldid, row] = wp.min(rows.aref[worldid, row], most)
        for row in range(actuator_moment.shape[1]):
            arms = three(actuator_moment[worldid], row, at)
            put(actuator_moment[worldid], row, at, forces_along(tilt, arms))


@wp.func
def nearest(angle: float, to: float) -> float:
    """Return an angle plus or minus whole turns."""
    return angle + 2.0 * wp.pi * wp.round((to - angle) / (2.0 * wp.pi))


@wp.kernel(enable_backward=False)
def turn_triples(
    # Params:
    triples: Triples,
    timestep: wp.array[float],
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # Out:
    positions: wp.array2d[float],
    speeds: wp.array2d[float],
    accelerations: wp.array2d[float],
):
    """R <- exp(h w) R, R = X(a) Y(b) Z(c); angles, rates A^-1 w and accelerations A^-1 w' from along e.

    With the rates before the step, w changes by h A' u' besides what the solver has added. Around a pole the
    first and the third angle gather whole turns, which no limit may take for a way to go back.
    """
    worldid, triple = wp.tid()
    at, place = numbers(triples.coordinate, triple), numbers(triples.position, triple)
    h = timestep[batched(worldid, timestep.shape[0])]
    zero = wp.vec3(triples.zero[triple, 0], triples.zero[triple, 1], triples.zero[triple, 2])
    angle = three(qpos_in, worldid, numbers(triples.address, triple)) - zero
    u = three(qvel_in, worldid, numbers(triples.dof, triple))
    s, c = wp.sin(angle[1]), wp.cos(angle[1])
    put(accelerations, worldid, at, rates_of(angle[1], three(accelerations, worldid, at)))
    moving = wp.vec3(u[1] * u[2] * c, -u[0] * u[2] * c, u[1] * (u[0] - u[2] * s))
    # From here on in the frame before the first hinge.
    x, y, z = wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0), wp.vec3(0.0, 0.0, 1.0)
    first = wp.quat_from_axis_angle(x, angle[0])
    w = wp.quat_rotate(first, three(speeds, worldid, at) + h * moving)
    swing = wp.length(w)
    step = wp.quat_from_axis_angle(w / wp.max(swing, 1.0e-12), h * swing)
    R = step * first * wp.quat_from_axis_angle(y, angle[1]) * wp.quat_from_axis_angle(z, angle[2])
    R = wp.normalize(R)
    # Of the two triples of angles that make R, (a, b, c) and (a + pi, pi - b, c + pi), the nearer one.
    third = wp.quat_rotate(R, z)
    a = nearest(wp.atan2(-third[1], third[2]), angle[0])
    if wp.abs(a - angle[0]) > 0.5 * wp.pi:
        a = nearest(a + wp.pi, angle[0])
    # What is left is Y(b) Z(c): b and c make up for any error of a, which near a pole is great.
    rest = wp.quat_from_axis_angle(x, -a) * R
    column, row = wp.quat_rotate(rest, z), wp.quat_rotate_inv(rest, y)
    b = nearest(wp.atan2(column[0], column[2]), angle[1])
    c_new = nearest(wp.atan2(row[0], row[1]), angle[2])
    angles = zero + wp.vec3(a, b, c_new)
    for k in range(3):
        turns = wp.round((angles[k] - triples.middle[triple, k]) / (2.0 * wp.pi))
        positions[worldid, place[k]] = angles[k] - 2.0 * wp.pi * turns * triples.limited[triple, k]
    put(speeds, worldid, at, rates_of(b, wp.quat_rotate_inv(wp.quat_from_axis_angle(x, a), w)))


def triples_of(model: mujoco.MjModel, ties: Iterable[Coupling]) -> list[tuple[list[int], float]]:
    """Return the joints of each triple, and the angle by which its third axis leans out of the normal.

    Args:
        model: The model.
        ties: Its couplings: a hinge that follows, or is followed, is in no triple; nor is one with damping or
            inertia of its own.
    """
    tied = {joint for tie in ties for joint in (tie.joint, tie.driver)}
    dof = model.jnt_dofadr
    plain = (model.jnt_type == HINGE) & (model.dof_damping[dof] == 0) & (model.dof_armature[dof] == 0)
    plain &= ~model.dof_dampingpoly[dof].any(axis=1)
    plain[sorted(tied - {-1})] = False
    found: list[tuple[list[int], float]] = []
    for first in range(model.njnt - 2):
        joints = [first, first + 1, first + 2]
        a, b, c = model.jnt_axis[joints]
        taken = bool(found) and found[-1][0][-1] >= first
        one_place = (
            len(set(model.jnt_bodyid[joints])) == 1 and not np.ptp(model.jnt_pos[joints], axis=0).any()
        )
        if taken or not one_place or not plain[joints].all() or max(abs(a @ b), abs(b @ c)) > RIGHT:
            continue
        found.append((joints, float(np.arctan2(c @ a, c @ np.cross(a, b)))))
    return found


def triple_tables(
    model: mujoco.MjModel, found: list[tuple[list[int], float]], followers: Followers
) -> Triples:
    """Return triples on the current Warp device.

    Args:
        model: The model.
        found: What `triples_of` returns, not empty.
        followers: How its degrees of freedom follow the coordinates.
    """
    joint = np.array([joints for joints, _ in found])
    dof, address = model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    zero = model.qpos0[address]
    zero[:, 1] -= [lean for _, lean in found]
    rows = np.repeat(np.arange(model.nv), model.M_rownnz)
    touched = np.isin(rows, dof) | np.isin(model.M_colind, dof)
    ranges = model.jnt_range[joint]
    limited = model.jnt_limited[joint].astype(bool) & (np.ptp(ranges, axis=2) < 2 * np.pi)
    return struct_of(
        Triples,
        joint=joint,
        dof=dof,
        address=address,
        coordinate=followers.coordinate.numpy()[dof],
        position=followers.position.numpy()[dof],
        zero=zero,
        middle=ranges.mean(axis=2),
        limited=limited & [True, False, True],
        entry=np.flatnonzero(touched),
        row=rows[touched],
        column=model.M_colind[touched],
    )
