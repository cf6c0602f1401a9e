"""The cubic spline of SIMM and OpenSim; end third derivatives are those of a cubic through four knots.

Source: Forsythe, Malcolm, Moler, *Computer Methods for Mathematical Computations* (1977), chapter 4.
"""

import numpy as np

LEAST_STEP = 1e-7
"""Between knots, in OpenSim; they may repeat."""


def simm_coefficients(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return value, slope, quadratic and cubic coefficient at every knot, shape (4, n), n >= 2.

    Before the first knot and from the last one on, the spline is a line.
    """
    step, n = np.maximum(np.diff(x), LEAST_STEP), len(x)
    slope = np.diff(y) / step
    if n == 2:
        return np.array([y, [slope[0]] * 2, [0.0] * 2, [0.0] * 2])
    matrix, right = np.zeros((n, n)), np.zeros(n)
    rows = np.arange(1, n - 1)
    matrix[rows, rows - 1], matrix[rows, rows + 1] = step[:-1], step[1:]
    matrix[rows, rows] = 2 * (step[:-1] + step[1:])
    right[1:-1] = np.diff(slope)
    matrix[0, :2] = -step[0], step[0]
    matrix[-1, -2:] = step[-1], -step[-1]
    if n > 3:
        second = np.diff(slope) / np.maximum(x[2:] - x[:-2], LEAST_STEP)
        third = np.diff(second) / np.maximum(x[3:] - x[:-3], LEAST_STEP)
        right[0] = step[0] ** 2 * third[0]
        right[-1] = -(step[-1] ** 2) * third[-1]
    sigma = np.linalg.solve(matrix, right)
    linear = np.append(slope - step * (sigma[1:] + 2 * sigma[:-1]), 0.0)
    linear[-1] = slope[-1] + step[-1] * (sigma[-2] + 2 * sigma[-1])
    cubic = np.append(np.diff(sigma) / step, 0.0)
    return np.array([y, linear, 3 * sigma, cubic])


def simm_spline(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a spline and its slope, in the shape of `at`."""
    value, slope, square, cube = simm_coefficients(x, y)
    knot = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 1)
    d = at - x[knot]
    bends = (d >= 0.0) & (knot < len(x) - 1)
    square, cube = np.where(bends, square[knot], 0.0), np.where(bends, cube[knot], 0.0)
    return (
        value[knot] + d * (slope[knot] + d * (square + d * cube)),
        slope[knot] + d * (2.0 * square + 3.0 * d * cube),
    )
