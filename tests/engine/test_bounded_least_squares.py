"""Bounded least squares against SciPy, the closed form and the conditions of optimality."""

import numpy as np
import pytest
from host_least_squares import bounded_least_squares
from scipy.optimize import lsq_linear

from myowarp.kernels.bounded_least_squares import BoundedLeastSquares

SAME = 1e-8


def problems(num_worlds=20, rows=23, unknowns=39, scale=1.0, seed=0):
    """Return random problems of the hand's size, in which many bounds are active."""
    rng = np.random.default_rng(seed)
    matrix = scale * rng.standard_normal((num_worlds, rows, unknowns))
    return matrix, 3.0 * scale * rng.standard_normal((num_worlds, rows))


def expected(matrix, right, lower, upper, ridge):
    """Return SciPy's solution of one problem, by its exact method."""
    n = matrix.shape[1]
    stacked = np.vstack([matrix, np.sqrt(ridge) * np.eye(n)])
    return lsq_linear(
        stacked, np.concatenate([right, np.zeros(n)]), (lower, upper), method="bvls", tol=1e-14
    ).x


@pytest.mark.parametrize("ridge", [1.0, 1e-3, 1e-5])
def test_it_finds_what_scipy_finds(ridge):
    matrix, right = problems()
    found, residual = bounded_least_squares(matrix, right, 0.1, 0.9, ridge)
    reference = np.array([expected(a, b, 0.1, 0.9, ridge) for a, b in zip(matrix, right, strict=True)])
    assert ((reference <= 0.1 + 1e-9) | (reference >= 0.9 - 1e-9)).mean() > 0.2  # bounds matter
    assert residual.max() < 1e-9
    np.testing.assert_allclose(found, reference, atol=SAME)


def test_without_active_bounds_it_is_the_closed_form():
    """x = (A^T A + ridge 1)^-1 A^T b."""
    matrix, right = problems(rows=30, unknowns=7)
    found, _ = bounded_least_squares(matrix, right, -100.0, 100.0, 0.3)
    for a, b, x in zip(matrix, right, found, strict=True):
        np.testing.assert_allclose(x, np.linalg.solve(a.T @ a + 0.3 * np.eye(7), a.T @ b), atol=1e-10)


@pytest.mark.parametrize("unknowns", [1, 5, 92])
def test_no_unknown_can_improve_alone_and_none_is_out_of_bounds(unknowns):
    """Karush-Kuhn-Tucker: the slope is 0 inside, >= 0 at the lower bound, <= 0 at the upper one."""
    matrix, right = problems(8, 11, unknowns)
    rng = np.random.default_rng(1)
    lower = rng.uniform(-0.3, 0.2, (8, unknowns))
    upper = lower + rng.uniform(0.0, 0.4, lower.shape)
    upper[:, 0] = lower[:, 0]  # no choice
    x, _ = bounded_least_squares(matrix, right, lower, upper, 1e-4)
    assert (x >= lower).all()
    assert (x <= upper).all()
    slope = np.einsum("wri,wr->wi", matrix, np.einsum("wri,wi->wr", matrix, x) - right) + 1e-4 * x
    free = (x > lower) & (x < upper)
    assert np.abs(slope[free]).max(initial=0.0) < 1e-6
    assert (slope[(x == lower) & (x < upper)] > -1e-6).all()
    assert (slope[(x == upper) & (x > lower)] < 1e-6).all()


def test_unknowns_that_nothing_tells_apart_share():
    """Twin columns: with a ridge each takes half."""
    matrix = np.ones((1, 1, 2))
    x, _ = bounded_least_squares(matrix, np.array([[1.0]]), 0.0, 1.0, 1e-9)
    np.testing.assert_allclose(x, 0.5, atol=1e-8)


def test_the_last_solution_is_where_the_next_starts():
    matrix, right = problems(4)
    problem = BoundedLeastSquares(*matrix.shape, ridge=1e-3, rounds=1)
    problem.matrix.assign(matrix)
    problem.right.assign(right)
    problem.solve()
    first = problem.residual.numpy().max()
    for _ in range(40):
        problem.solve()
    assert problem.residual.numpy().max() < 1e-9 < first


def test_a_problem_that_is_not_finite_is_marked_and_the_others_are_solved():
    matrix, right = problems(3)
    sound, _ = bounded_least_squares(matrix, right, 0.0, 1.0, 1e-3)
    matrix[1, 2, 3] = np.nan
    x, residual = bounded_least_squares(matrix, right, 0.0, 1.0, 1e-3)
    assert np.isinf(residual).tolist() == [False, True, False]
    assert (x[1] == 0.0).all()
    np.testing.assert_array_equal(x[[0, 2]], sound[[0, 2]])


def test_wrong_problems_are_refused():
    matrix, right = problems(2)
    with pytest.raises(ValueError, match="ridge must be above 0 and finite, else the solution is not unique"):
        bounded_least_squares(matrix, right, 0.0, 1.0, 0.0)
    with pytest.raises(ValueError, match="lower bounds must be at most the upper ones"):
        bounded_least_squares(matrix, right, 1.0, 0.0, 1.0)


def test_worlds_do_not_know_of_each_other():
    matrix, right = problems(5)
    together, _ = bounded_least_squares(matrix, right, 0.0, 1.0, 1e-3)
    for world in range(5):
        alone, _ = bounded_least_squares(matrix[[world]], right[[world]], 0.0, 1.0, 1e-3)
        np.testing.assert_array_equal(together[world], alone[0])
