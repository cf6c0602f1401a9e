"""Cholesky's factorisation L L^T of a small matrix for each world, in float64: what its users share."""

import warp as wp


@wp.func
def eliminated(worldid: int, i: int, j: int, entry: wp.float64, factor: wp.array3d[wp.float64]) -> wp.float64:
    """A_ij - sum_{k < j} L_ik L_jk: L_ij L_jj, and in the diagonal the square of L_jj."""
    total = entry
    for k in range(j):
        total -= factor[worldid, i, k] * factor[worldid, j, k]
    return total


@wp.func
def substitute(worldid: int, count: int, factor: wp.array3d[wp.float64], step: wp.array2d[wp.float64]):
    """step = (L L^T)^-1 step, in place."""
    for i in range(count):
        total = step[worldid, i]
        for k in range(i):
            total -= factor[worldid, i, k] * step[worldid, k]
        step[worldid, i] = total / factor[worldid, i, i]
    for r in range(count):
        i = count - 1 - r
        total = step[worldid, i]
        for k in range(i + 1, count):
            total -= factor[worldid, k, i] * step[worldid, k]
        step[worldid, i] = total / factor[worldid, i, i]
