"""Accelerations from an inertia matrix: M = L' D L along the kinematic tree, one thread a world.

A dof's row of M holds nothing but the dofs that carry it, and elimination from the tips on fills in nothing
more (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.5): for a hand a tenth of the operations
of a dense Cholesky factorisation.
"""

import warp as wp

from myowarp.kernels.engine_arrays import InertiaRows


@wp.func
def factorize(inertia: InertiaRows, M: wp.array[float], factor: wp.array[float]):
    """Write D on the diagonal of `factor`, and L, whose diagonal is 1, beside it."""
    nv = inertia.M_rowadr.shape[0]
    for i in range(M.shape[0]):
        factor[i] = M[i]
    for reverse in range(nv):
        row = inertia.M_rowadr[nv - 1 - reverse]
        diagonal = row + inertia.M_rownnz[nv - 1 - reverse] - 1
        inverse = 1.0 / factor[diagonal]
        for above in range(diagonal - row):
            entry = diagonal - 1 - above
            ratio = factor[entry] * inverse
            carrier = inertia.M_rowadr[inertia.M_colind[entry]]
            for i in range(entry - row + 1):  # the carrier's row is the beginning of this one
                factor[carrier + i] -= ratio * factor[row + i]
            factor[entry] = ratio


@wp.func
def substitute(inertia: InertiaRows, factor: wp.array[float], x: wp.array[float]):
    """x = L^-1 D^-1 L'^-1 x."""
    nv = inertia.M_rowadr.shape[0]
    for reverse in range(nv):
        dof = nv - 1 - reverse
        row = inertia.M_rowadr[dof]
        diagonal = row + inertia.M_rownnz[dof] - 1
        for entry in range(row, diagonal):
            x[inertia.M_colind[entry]] -= factor[entry] * x[dof]
    for dof in range(nv):
        row = inertia.M_rowadr[dof]
        diagonal = row + inertia.M_rownnz[dof] - 1
        value = x[dof] / factor[diagonal]
        for entry in range(row, diagonal):
            value -= factor[entry] * x[inertia.M_colind[entry]]
        x[dof] = value


@wp.kernel(enable_backward=False)
def solve_inertia(
    # Model:
    inertia: InertiaRows,
    # In:
    M: wp.array2d[float],
    y: wp.array2d[float],
    # Out:
    factor: wp.array2d[float],
    x: wp.array2d[float],
):
    """M x = y."""
    worldid = wp.tid()
    for dof in range(y.shape[1]):
        x[worldid, dof] = y[worldid, dof]
    factorize(inertia, M[worldid], factor[worldid])
    substitute(inertia, factor[worldid], x[worldid])
