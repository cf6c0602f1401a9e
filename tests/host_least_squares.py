"""Bounded least squares of host arrays, by the kernel."""

import numpy as np

from myowarp.kernels.bounded_least_squares import BoundedLeastSquares


def bounded_least_squares(matrix, right, lower, upper, ridge, **options):
    """Solve from host arrays.

    Args:
        matrix: A, shape (num_worlds, num_rows, num_unknowns).
        right: b, shape (num_worlds, num_rows).
        lower: Lower bounds, broadcast to (num_worlds, num_unknowns).
        upper: Upper bounds.
        ridge: Weight of |x|^2, > 0.
        **options: Of `BoundedLeastSquares`.

    Returns:
        x (num_worlds, num_unknowns) and the residual (num_worlds,).

    Raises:
        ValueError: The ridge is not above 0, or a lower bound is above its upper one.
    """
    problem = BoundedLeastSquares(*np.shape(matrix), ridge=ridge, **options)
    bounds = np.broadcast_to(lower, problem.x.shape), np.broadcast_to(upper, problem.x.shape)
    if not (bounds[0] <= bounds[1]).all():
        raise ValueError("lower bounds must be at most the upper ones")
    values = {"matrix": matrix, "right": right, "lower": bounds[0], "upper": bounds[1]}
    for name, value in values.items():
        getattr(problem, name).assign(np.ascontiguousarray(value, dtype=np.float64))
    problem.solve()
    return problem.x.numpy(), problem.residual.numpy()
