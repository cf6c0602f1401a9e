"""From all degrees of freedom to those that follow none, and back: the kernels of `free_coordinates`."""

import warp as wp

from myowarp.engine.stages.arrays import InertiaRows
from myowarp.kernels.batching import batched


@wp.struct
class Followers:
    """Degrees of freedom as functions of coordinates; pieces are those of `couplings.Pieces`.

    Attributes:
        place: In qpos of each position of the free joints, shape (num_positions,).
        dof: That shows each coordinate, shape (num_coordinates,).
        coordinate: That each dof follows, shape (nv,).
        position: Of that coordinate, among those of the free joints, shape (nv,); -1 for dofs of balls and
            free joints.
        address: Of each dof's joint in qpos, shape (nv,).
        first_curve: Of each dof, and the number of all, shape (nv + 1,).
        first_piece: Of each curve, and the number of all, shape (num_curves + 1,).
        breaks: Where pieces begin, shape (num_pieces,).
        coefficients: Ascending in powers of the distance from there, shape (num_pieces, num_terms).
    """

    place: wp.array[int]
    dof: wp.array[int]
    coordinate: wp.array[int]
    position: wp.array[int]
    address: wp.array[int]
    first_curve: wp.array[int]
    first_piece: wp.array[int]
    breaks: wp.array[float]
    coefficients: wp.array2d[float]


@wp.struct
class Coordinates:
    """State of the free coordinates; fields are those of the engine's `Data`."""

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    qacc: wp.array2d[float]
    qacc_warmstart: wp.array2d[float]


@wp.struct
class Moments:
    """Moments of actuators along all joints; fields are those of the engine's `Data`."""

    moment_rownnz: wp.array2d[int]
    moment_rowadr: wp.array2d[int]
    moment_colind: wp.array2d[int]
    actuator_moment: wp.array2d[float]


@wp.struct
class Acting:
    """Inertia and what moves all joints; fields are those of the engine's `Data`."""

    M: wp.array2d[float]
    qvel: wp.array2d[float]
    qfrc_applied: wp.array2d[float]
    qfrc_passive: wp.array2d[float]
    qfrc_actuator: wp.array2d[float]
    qfrc_bias: wp.array2d[float]


@wp.struct
class Damping:
    """Damping of joints; fields are those of the engine's `Model`."""

    dof_damping: wp.array2d[float]
    dof_dampingpoly: wp.array2d[wp.vec2]


@wp.struct
class RowJacobian:
    """Constraint rows; fields are those of the engine's `Data.efc`; J is dense where `J_rownnz` is empty."""

    J_rownnz: wp.array2d[int]
    J_rowadr: wp.array2d[int]
    J_colind: wp.array3d[int]
    J: wp.array3d[float]
    aref: wp.array2d[float]


@wp.struct
class Reduced:
    """Outputs along the free coordinates; fields are those of `Data` and `Model`."""

    M: wp.array2d[float]
    qfrc_applied: wp.array2d[float]
    dof_damping: wp.array2d[float]
    actuator_moment: wp.array2d[float]


@wp.func
def shown(followers: Followers, dof: int, u: float) -> wp.vec3:
    """Return the value of a hinge or slide, its slope and its second derivative by the coordinate u."""
    value, slope, bend = float(u), float(1.0), float(0.0)
    for curve in range(followers.first_curve[dof], followers.first_curve[dof + 1]):
        piece, end = int(followers.first_piece[curve]), followers.first_piece[curve + 1]
        while piece + 1 < end and value >= followers.breaks[piece + 1]:
            piece += 1
        d = value - followers.breaks[piece]
        f, df, half_ddf = float(0.0), float(0.0), float(0.0)
        for k in range(followers.coefficients.shape[1] - 1, -1, -1):
            half_ddf = half_ddf * d + df
            df = df * d + f
            f = f * d + followers.coefficients[piece, k]
        bend = 2.0 * half_ddf * slope * slope + df * bend
        slope = df * slope
        value = f
    return wp.vec3(value, slope, bend)


@wp.kernel(enable_backward=False)
def follow_coordinates(
    # Params:
    followers: Followers,
    # Data in:
    qacc_warmstart_in: wp.array2d[float],
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
    # Out:
    free: Coordinates,
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
):
    """u = q of the joints that show it; q = g(u), q' = J u'; slopes = J, excess = g'' u'^2."""
    worldid = wp.tid()
    for i in range(followers.place.shape[0]):
        free.qpos[worldid, i] = qpos_out[worldid, followers.place[i]]
    for i in range(followers.dof.shape[0]):
        free.qvel[worldid, i] = qvel_out[worldid, followers.dof[i]]
        free.qacc_warmstart[worldid, i] = qacc_warmstart_in[worldid, followers.dof[i]]
    for dof in range(followers.coordinate.shape[0]):
        speed, position = free.qvel[worldid, followers.coordinate[dof]], followers.position[dof]
        g = wp.vec3(0.0, 1.0, 0.0)
        if position >= 0:
            g = shown(followers, dof, free.qpos[worldid, position])
            qpos_out[worldid, followers.address[dof]] = g[0]
        qvel_out[worldid, dof] = g[1] * speed
        slopes[worldid, dof] = g[1]
        excess[worldid, dof] = g[2] * speed * speed


@wp.kernel(enable_backward=False)
def reduce_dynamics(
    # Params:
    followers: Followers,
    inertia: InertiaRows,
    damping: Damping,
    # In:
    acting: Acting,
    moments: Moments,
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
    # Out:
    reduced: Reduced,
):
    """M_r = J' M J, forces_r = J'(forces - M a), damping_r = J' dF/dv J, moment_r = moment J.

    Every dof has one entry in J. On the CPU, `reduction_lanes` does this.
    """
    worldid = wp.tid()
    for k in range(reduced.M.shape[1]):
        reduced.M[worldid, k] = 0.0
    for i in range(reduced.qfrc_applied.shape[1]):
        reduced.qfrc_applied[worldid, i] = 0.0
        reduced.dof_damping[worldid, i] = 0.0
    linear = batched(worldid, damping.dof_damping.shape[0])
    more = batched(worldid, damping.dof_dampingpoly.shape[0])
    for row in range(slopes.shape[1]):
        p, s, a = followers.coordinate[row], slopes[worldid, row], excess[worldid, row]
        force = acting.qfrc_applied[worldid, row] + acting.qfrc_passive[worldid, row]
        force += acting.qfrc_actuator[worldid, row] - acting.qfrc_bias[worldid, row]
        speed, rise = wp.abs(acting.qvel[worldid, row]), damping.dof_dampingpoly[more, row]
        drag = damping.dof_damping[linear, row] + speed * (2.0 * rise[0] + 3.0 * speed * rise[1])
        reduced.dof_damping[worldid, p] += s * s * drag
        first = inertia.M_rowadr[row]
        for k in range(inertia.M_rownnz[row]):
            column, m = inertia.M_colind[first + k], acting.M[worldid, first + k]
            o, t = followers.coordinate[column], slopes[worldid, column]
            high, low = wp.max(p, o), wp.min(p, o)
            # Below the diagonal of M stands one of two equal entries; on that of M_r both fall.
            both = wp.where(column != row and high == low, 2.0, 1.0)
            reduced.M[worldid, high * (high + 1) // 2 + low] += both * s * t * m
            force -= m * excess[worldid, column]
            if column != row:
                reduced.qfrc_applied[worldid, o] -= t * m * a
        reduced.qfrc_applied[worldid, p] += s * force
    for k in range(reduced.actuator_moment.shape[1]):
        reduced.actuator_moment[worldid, k] = 0.0
    for actuator in range(moments.moment_rownnz.shape[1]):
        begin = moments.moment_rowadr[worldid, actuator]
        for k in range(begin, begin + moments.moment_rownnz[worldid, actuator]):
            dof = moments.moment_colind[worldid, k]
            place = actuator * followers.dof.shape[0] + followers.coordinate[dof]
            reduced.actuator_moment[worldid, place] += (
                moments.actuator_moment[worldid, k] * slopes[worldid, dof]
            )


@wp.kernel(enable_backward=False)
def reduce_rows(
    # Params:
    followers: Followers,
    # Data in:
    nefc_in: wp.array[int],
    # In:
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
    rows: RowJacobian,
    # Out:
    free_rows: RowJacobian,
):
    """row_r = row J, aref_r = aref - row a."""
    worldid = wp.tid()
    number = followers.dof.shape[0]
    for row in range(wp.min(nefc_in[worldid], rows.aref.shape[1])):
        for i in range(number):
            free_rows.J[worldid, row, i] = 0.0
        target = rows.aref[worldid, row]
        count, sparse = slopes.shape[1], rows.J_rownnz.shape[1] > 0
        if sparse:
            count = rows.J_rownnz[worldid, row]
        for k in range(count):
            dof, entry = int(k), float(0.0)
            if sparse:
                dof = rows.J_colind[worldid, 0, rows.J_rowadr[worldid, row] + k]
                entry = rows.J[worldid, 0, rows.J_rowadr[worldid, row] + k]
            else:
                entry = rows.J[worldid, row, k]
            if entry != 0.0:
                free_rows.J[worldid, row, followers.coordinate[dof]] += entry * slopes[worldid, dof]
                target -= entry * excess[worldid, dof]
        free_rows.aref[worldid, row] = target


@wp.kernel(enable_backward=False)
def expand_coordinates(
    # Params:
    followers: Followers,
    # In:
    free: Coordinates,
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
    qacc_out: wp.array2d[float],
    qacc_warmstart_out: wp.array2d[float],
):
    """q = g(u), q' = J u' after the step; q'' = J u'' + a, of its beginning."""
    worldid = wp.tid()
    for i in range(followers.place.shape[0]):
        qpos_out[worldid, followers.place[i]] = free.qpos[worldid, i]
    for dof in range(followers.coordinate.shape[0]):
        coordinate, position, slope = followers.coordinate[dof], followers.position[dof], float(1.0)
        if position >= 0:
            g = shown(followers, dof, free.qpos[worldid, position])
            qpos_out[worldid, followers.address[dof]] = g[0]
            slope = g[1]
        qvel_out[worldid, dof] = slope * free.qvel[worldid, coordinate]
        acceleration = slopes[worldid, dof] * free.qacc[worldid, coordinate] + excess[worldid, dof]
        qacc_out[worldid, dof] = acceleration
        qacc_warmstart_out[worldid, dof] = acceleration
