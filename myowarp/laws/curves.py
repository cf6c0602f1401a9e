"""Pieces of muscles' curves: tables with cubics between equally spaced knots, and a tame exponential.

A quintic Bezier corner gives y(x) only through the root of a polynomial; a cubic Hermite table with the
exact values and slopes at 1,024 knots is off by 1e-6 of the largest value at most for the curves of
Millard's muscle with any parameters that OpenSim's models have (tests/suite/test_hill.py).

All functions take float32 and float64.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

KNOTS = 1024


@wp.struct
class CurveTables:
    """Curves for `tabulated`.

    Attributes:
        values: y and spacing dy/dx at the knots of each, (curves, KNOTS).
        spans: First x and 1 / spacing of each.
    """

    values: wp.array2d[wp.vec2]
    spans: wp.array[wp.vec2]


@wp.struct
class CurveTables64:
    """The same in float64."""

    values: wp.array2d[wp.vec2d]
    spans: wp.array[wp.vec2d]


@wp.func
def tabulated(tables: Any, curve: int, x: Any):
    """(y, dy/dx) of a curve: with t the place between two knots and m = spacing dy/dx there,

    y = y0 + t (m0 + t (3 (y1 - y0) - 2 m0 - m1 + t (m0 + m1 - 2 (y1 - y0)))), beyond the ends y + t m.
    """
    zero, one, two, three = type(x)(0.0), type(x)(1.0), type(x)(2.0), type(x)(3.0)
    span = tables.spans[curve]
    last = tables.values.shape[1] - 2
    place = (x - span[0]) * span[1]
    knot = int(wp.clamp(place, zero, type(x)(last)))
    t = place - type(x)(knot)
    left, right = tables.values[curve, knot], tables.values[curve, knot + 1]
    if t < zero:
        return wp.vector(left[0] + t * left[1], left[1] * span[1])
    if t > one:
        return wp.vector(right[0] + (t - one) * right[1], right[1] * span[1])
    rise = right[0] - left[0]
    square = three * rise - two * left[1] - right[1]
    cube = left[1] + right[1] - two * rise
    return wp.vector(
        left[0] + t * (left[1] + t * (square + t * cube)),
        span[1] * (left[1] + t * (two * square + three * t * cube)),
    )


@wp.func
def growth(x: Any):
    """(e^x, e^x), a tangent from x = 25 on: 7e10 times the force at 0, far beyond any muscle, and finite."""
    end = type(x)(25.0)
    value = wp.exp(wp.min(x, end))
    return wp.vector(value * (type(x)(1.0) + wp.max(x - end, type(x)(0.0))), value)


def tabulate(
    curves: Sequence[tuple[Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], float, float]],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the tables of curves for `tabulated`.

    Args:
        curves: y(x) with its slope, and the first and last x, beyond which it is a line.

    Returns:
        (y, spacing dy/dx), shape (curves, KNOTS, 2), and (first x, 1 / spacing), shape (curves, 2).
    """
    values, spans = [], []
    for curve, first, last in curves:
        x = np.linspace(first, last, KNOTS)
        spacing = (last - first) / (KNOTS - 1)
        y, slope = curve(x)
        values.append(np.stack([y, spacing * slope], axis=-1))
        spans.append((first, 1.0 / spacing))
    return np.array(values), np.array(spans)
