"""Loops that equalities close, held exactly: the force of each row is known before the solver runs.

The rows of a weld or a connection give way by R, a share of what a unit force does in MuJoCo's default pose,
G u'' = aref - R f: over light segments by percents. Here R is `SOFT` of what it does now, and

    A f = aref - G M^-1 forces,    A = G M^-1 G',    aref += R f,

so that G u'' = aref wherever no contact or limit acts on the loop; where one does, the row gives way by
`SOFT` of what that adds. (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 8.) A row that others
imply, as out of the plane of a linkage, has no force.
"""

import warp as wp

from myowarp.coordinates.reduction import RowJacobian
from myowarp.kernels.cholesky import eliminated, substitute
from myowarp.kernels.structs import zeros_of

SOFT = wp.constant(wp.float64(1e-3))
IMPLIED = wp.constant(wp.float64(1e-10))
"""Share of the greatest A of three rows that is left of one where those before imply it."""
NOTHING = wp.constant(wp.float64(1e30))
THREE = wp.constant(3)
"""Rows of a connection, and of the places or the turns of a weld."""


@wp.struct
class LoopFactors:
    """Scratch of all worlds.

    Attributes:
        inertia: L of M = L L', shape (num_worlds, n, n).
        turned: L^-1 of each row of G, and of the forces last, shape (num_worlds, num_rows + 1, n).
        closing: Cholesky factor of A, shape (num_worlds, num_rows, num_rows).
        force: Of each row, shape (num_worlds, num_rows).
    """

    inertia: wp.array3d[wp.float64]
    turned: wp.array3d[wp.float64]
    closing: wp.array3d[wp.float64]
    force: wp.array2d[wp.float64]


def loop_factors(worlds: int, rows: int, number: int) -> LoopFactors:
    """Return scratch on the current device."""
    turned, closing = (worlds, rows + 1, number), (worlds, rows, rows)
    shapes = {"inertia": (worlds, number, number), "turned": turned, "closing": closing}
    return zeros_of(LoopFactors, **shapes, force=(worlds, rows))


@wp.kernel(enable_backward=False)
def close_loops(
    # Data in:
    M_in: wp.array2d[float],
    qfrc_applied_in: wp.array2d[float],
    nefc_in: wp.array[int],
    # In:
    factors: LoopFactors,
    # Data out:
    qacc_warmstart_out: wp.array2d[float],
    # Out:
    free_rows: RowJacobian,
    D: wp.array2d[float],
):
    """A f = aref - G M^-1 forces; R = SOFT A, D = 1 / R, aref += R f. Rows of loops come first.

    The solver starts at u'' = M^-1 (forces + G' f), the solution where nothing else acts: with light segments
    M may be too near to singular to find it in float32.
    """
    worldid = wp.tid()
    number, rows = factors.inertia.shape[1], factors.force.shape[1]
    if nefc_in[worldid] < rows:  # there was no place for all
        return
    inertia = factors.inertia
    for i in range(number):
        for j in range(i + 1):
            entry = wp.float64(M_in[worldid, i * (i + 1) // 2 + j])
            left = eliminated(worldid, i, j, entry, inertia)
            if i == j:
                inertia[worldid, i, i] = wp.sqrt(wp.max(left, IMPLIED * entry))
            else:
                inertia[worldid, i, j] = left / inertia[worldid, j, j]
    turned = factors.turned
    for r in range(rows + 1):
        for i in range(number):
            total = wp.float64(qfrc_applied_in[worldid, i])
            if r < rows:
                total = wp.float64(free_rows.J[worldid, r, i])
            for k in range(i):
                total -= inertia[worldid, i, k] * turned[worldid, r, k]
            turned[worldid, r, i] = total / inertia[worldid, i, i]
    closing, force = factors.closing, factors.force
    for first in range(0, rows, THREE):
        most = wp.float64(0.0)
        for r in range(first, first + THREE):
            own = wp.float64(0.0)
            for i in range(number):
                own += turned[worldid, r, i] * turned[worldid, r, i]
            most = wp.max(most, own)
        for r in range(first, first + THREE):
            D[worldid, r] = float(wp.float64(1.0) / (SOFT * most))
    for r in range(rows):
        R = wp.float64(1.0) / wp.float64(D[worldid, r])
        for o in range(r + 1):
            entry = wp.float64(0.0)
            for i in range(number):
                entry += turned[worldid, r, i] * turned[worldid, o, i]
            left = eliminated(worldid, r, o, entry, closing)
            if r == o:
                closing[worldid, r, r] = wp.where(left > IMPLIED * R / SOFT, wp.sqrt(left), NOTHING)
            else:
                closing[worldid, r, o] = left / closing[worldid, o, o]
        missing = wp.float64(free_rows.aref[worldid, r])
        for i in range(number):
            missing -= turned[worldid, r, i] * turned[worldid, rows, i]
        force[worldid, r] = missing
    substitute(worldid, rows, closing, force)
    for r in range(rows):
        free_rows.aref[worldid, r] += float(force[worldid, r] / wp.float64(D[worldid, r]))
        for i in range(number):
            turned[worldid, rows, i] += turned[worldid, r, i] * force[worldid, r]
    for back in range(number):
        i = number - 1 - back
        total = turned[worldid, rows, i]
        for k in range(i + 1, number):
            total -= inertia[worldid, k, i] * turned[worldid, rows, k]
        turned[worldid, rows, i] = total / inertia[worldid, i, i]
        qacc_warmstart_out[worldid, i] = float(turned[worldid, rows, i])
