"""Bounded least squares, one problem for each world: which activations give the wanted forces?

    minimize  |A x - b|^2 / 2 + ridge |x|^2 / 2    over    lower <= x <= upper

A round is a sweep over the unknowns, which sets each to its best value within the bounds (projected
Gauss-Seidel), and then Newton steps of those that are free, each up to the first bound. Both only improve.
Sweeps alone converge, since the problem is strictly convex; a Newton step ends it once the right bounds are
found. In float64, as a small ridge makes the problem stiff.

Source: the two phases are those of Moré, Toraldo (1991), doi:10.1137/0801008, with sweeps in place of their
gradient projection.
"""

from __future__ import annotations

import warp as wp

from myowarp.kernels.cholesky import eliminated, substitute
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import zeros_of

ROUNDS = 100
TOLERANCE = 1e-10


@wp.struct
class Workspace:
    """Arrays of the solver, of all worlds.

    Attributes:
        hessian: H = A^T A + ridge, (num_worlds, num_unknowns, num_unknowns).
        linear: A^T b, (num_worlds, num_unknowns).
        factor: Cholesky factor of H for the free unknowns, as the Hessian.
        step: Their Newton step, (num_worlds, num_unknowns).
        free: Which they are, (num_worlds, num_unknowns).
    """

    hessian: wp.array3d[wp.float64]
    linear: wp.array2d[wp.float64]
    factor: wp.array3d[wp.float64]
    step: wp.array2d[wp.float64]
    free: wp.array2d[int]


@wp.func
def normal_equations(
    worldid: int,
    matrix: wp.array3d[wp.float64],
    right: wp.array2d[wp.float64],
    ridge: wp.float64,
    work: Workspace,
) -> bool:
    """H = A^T A + ridge, A^T b; returns whether all are finite."""
    good = bool(True)
    for i in range(matrix.shape[2]):
        total = wp.float64(0.0)
        for r in range(matrix.shape[1]):
            total += matrix[worldid, r, i] * right[worldid, r]
        work.linear[worldid, i] = total
        good = good and wp.isfinite(total)
        for j in range(i + 1):
            product = wp.where(i == j, ridge, wp.float64(0.0))
            for r in range(matrix.shape[1]):
                product += matrix[worldid, r, i] * matrix[worldid, r, j]
            work.hessian[worldid, i, j] = product
            work.hessian[worldid, j, i] = product
            good = good and wp.isfinite(product)
    return good


@wp.func
def slope(worldid: int, i: int, work: Workspace, x: wp.array2d[wp.float64]) -> wp.float64:
    """(H x - A^T b)_i."""
    total = -work.linear[worldid, i]
    for j in range(x.shape[1]):
        total += work.hessian[worldid, i, j] * x[worldid, j]
    return total


@wp.func
def best_alone(
    worldid: int,
    i: int,
    work: Workspace,
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    x: wp.array2d[wp.float64],
) -> wp.float64:
    """Return the best value of an unknown while the others stay."""
    value = x[worldid, i] - slope(worldid, i, work, x) / work.hessian[worldid, i, i]
    return wp.clamp(value, lower[worldid, i], upper[worldid, i])


@wp.func
def factorize(worldid: int, count: int, work: Workspace) -> bool:
    """Factorise H of the free unknowns, lower triangle; returns whether it is positive definite."""
    for i in range(count):
        for j in range(i + 1):
            entry = work.hessian[worldid, work.free[worldid, i], work.free[worldid, j]]
            total = eliminated(worldid, i, j, entry, work.factor)
            if i > j:
                work.factor[worldid, i, j] = total / work.factor[worldid, j, j]
            elif total > wp.float64(0.0):
                work.factor[worldid, i, i] = wp.sqrt(total)
            else:
                return False
    return True


@wp.func
def share(
    worldid: int,
    k: int,
    work: Workspace,
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    x: wp.array2d[wp.float64],
) -> wp.float64:
    """Return which share of its step a free unknown can go before it meets a bound; above 1: all of it."""
    f = work.free[worldid, k]
    way = work.step[worldid, k]
    bound = wp.where(way > wp.float64(0.0), upper[worldid, f], lower[worldid, f])
    return wp.where(way == wp.float64(0.0), wp.float64(2.0), (bound - x[worldid, f]) / way)


@wp.func
def newton_step(
    worldid: int,
    work: Workspace,
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    x: wp.array2d[wp.float64],
) -> bool:
    """Move the free unknowns towards where all their slopes are 0; returns whether a bound was in the way."""
    count = int(0)
    for i in range(x.shape[1]):
        if x[worldid, i] > lower[worldid, i] and x[worldid, i] < upper[worldid, i]:
            work.free[worldid, count] = i
            work.step[worldid, count] = -slope(worldid, i, work, x)
            count += 1
    if not factorize(worldid, count, work):
        return False
    substitute(worldid, count, work.factor, work.step)
    length = wp.float64(1.0)
    for k in range(count):
        length = wp.min(length, share(worldid, k, work, lower, upper, x))
    for k in range(count):
        f = work.free[worldid, k]
        value = x[worldid, f] + length * work.step[worldid, k]
        if length < wp.float64(1.0) and share(worldid, k, work, lower, upper, x) == length:
            value = wp.where(work.step[worldid, k] > wp.float64(0.0), upper[worldid, f], lower[worldid, f])
        x[worldid, f] = wp.clamp(value, lower[worldid, f], upper[worldid, f])
    return length < wp.float64(1.0)


@wp.kernel(enable_backward=False)
def solve_bounded_least_squares(
    # In:
    matrix: wp.array3d[wp.float64],
    right: wp.array2d[wp.float64],
    ridge: wp.float64,
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    rounds: int,
    tolerance: wp.float64,
    # Out:
    work: Workspace,
    x: wp.array2d[wp.float64],
    residual: wp.array[wp.float64],
):
    """x = argmin |A x - b|^2 / 2 + ridge |x|^2 / 2 within bounds, from the x that is there.

    The residual is how far an unknown alone still wants to go, at most. It is infinite, and x the lower
    bound, where a number of the problem is not finite.
    """
    worldid = wp.tid()
    good = normal_equations(worldid, matrix, right, ridge, work)
    for i in range(x.shape[1]):
        good = good and wp.isfinite(x[worldid, i])
    for i in range(x.shape[1]):
        start = wp.where(good, x[worldid, i], lower[worldid, i])
        x[worldid, i] = wp.clamp(start, lower[worldid, i], upper[worldid, i])
    residual[worldid] = wp.float64(wp.inf)
    if not good:
        return
    for _ in range(rounds):
        if residual[worldid] > tolerance:
            for i in range(x.shape[1]):
                x[worldid, i] = best_alone(worldid, i, work, lower, upper, x)
            for _ in range(x.shape[1]):  # each bound that is met takes an unknown away
                if not newton_step(worldid, work, lower, upper, x):
                    break
            change = wp.float64(0.0)
            for i in range(x.shape[1]):
                value = best_alone(worldid, i, work, lower, upper, x)
                change = wp.max(change, wp.abs(value - x[worldid, i]))
            residual[worldid] = change


class BoundedLeastSquares:
    """Problems of all worlds, on the CPU: fill all arrays, then `solve`.

    The last solution is where the next one starts.

    Attributes:
        matrix: A, shape (num_worlds, num_rows, num_unknowns), float64 as all others.
        right: b, shape (num_worlds, num_rows).
        lower: Lower bounds, shape (num_worlds, num_unknowns); 0 at first.
        upper: Upper bounds; 1 at first.
        x: Solution, shape (num_worlds, num_unknowns).
        residual: How far an unknown alone still wants to go, at most, shape (num_worlds,); infinite where a
            number of the problem was not finite.
        ridge: Weight of |x|^2, > 0.
        rounds: Most rounds.
        tolerance: Residual at which a world is done.
    """

    def __init__(
        self,
        num_worlds: int,
        num_rows: int,
        num_unknowns: int,
        *,
        ridge: float,
        rounds: int = ROUNDS,
        tolerance: float = TOLERANCE,
    ) -> None:
        """Allocate.

        Raises:
            ValueError: The ridge is not above 0.
        """
        if not 0.0 < ridge < float("inf"):
            raise ValueError(
                f"ridge must be above 0 and finite, else the solution is not unique, got {ridge}"
            )
        self.ridge, self.rounds, self.tolerance = ridge, rounds, tolerance
        rows, square = (num_worlds, num_unknowns), (num_worlds, num_unknowns, num_unknowns)
        with wp.ScopedDevice("cpu"):
            self.matrix = wp.zeros((num_worlds, num_rows, num_unknowns), dtype=wp.float64)
            self.right = wp.zeros((num_worlds, num_rows), dtype=wp.float64)
            self.lower, self.upper = wp.zeros(rows, dtype=wp.float64), wp.ones(rows, dtype=wp.float64)
            self.x, self.residual = wp.zeros(rows, dtype=wp.float64), wp.zeros(num_worlds, dtype=wp.float64)
            self.work = zeros_of(Workspace, rows, hessian=square, factor=square)

    def solve(self) -> None:
        """Launch the kernel."""
        with wp.ScopedDevice(self.x.device):
            launch(solve_bounded_least_squares, self.x.shape[0], self)
