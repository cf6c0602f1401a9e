"""The curves of Schutte's muscle: splines of the file for f_L, f_P and f_T, two hyperbolas for f_V.

Source: Schutte, Rodgers, Zajac, Glaser 1993 (doi:10.1109/86.242425) in the form and with the constants of
OpenSim's Schutte1993Muscle_Deprecated. Where we differ: OpenSim lets no fiber pull less than its f_P, however
fast it shortens; here damping may take away from it. Each function returns the multiplier and its slope, of
float32 or float64; `m` is a `hill_muscle`, whose `curves` is the number of the first of three tables: f_L,
f_P, f_T over strain.
"""

from typing import Any

import numpy as np
import warp as wp

from myowarp.laws.curves import tabulate, tabulated
from myowarp.laws.simm_spline import simm_spline

SHORTENING, STEEPER, MOST = wp.constant(0.15), wp.constant(0.13), wp.constant(1.4)
"""Curvature of the hyperbola of shortening, ratio of slopes, and the greatest f_V."""


@wp.func
def schutte_fiber_force(tables: Any, curve: int, length: Any):
    """f_L or f_P, at least 0."""
    found = tabulated(tables, curve, length)
    if found[0] <= type(length)(0.0):
        return wp.vector(type(length)(0.0), type(length)(0.0))
    return found


@wp.func
def schutte_tendon_force(m: Any, tables: Any, strain: Any):
    """f_T, 0 when slack."""
    if strain <= type(strain)(0.0):
        return wp.vector(type(strain)(0.0), type(strain)(0.0))
    return tabulated(tables, m.curves + 2, strain)


@wp.func
def schutte_force_velocity(m: Any, velocity: Any):
    """k (1 + v) / (k - v) shortening, from v = -1 on; (q + 1.4 v) / (q + v) lengthening.

    k = 0.15, q = 0.13 k / (k + 1).
    """
    zero, one = type(velocity)(0.0), type(velocity)(1.0)
    k = type(velocity)(SHORTENING)
    if velocity <= -one:
        return wp.vector(zero, zero)
    if velocity <= zero:
        pole = k - velocity
        return wp.vector(k * (one + velocity) / pole, k * (one + k) / (pole * pole))
    q, most = type(velocity)(STEEPER) * k / (k + one), type(velocity)(MOST)
    pole = q + velocity
    return wp.vector((q + most * velocity) / pole, q * (most - one) / (pole * pole))


@wp.func
def schutte_activation_rate(excitation: float, activation: float, rise: float, fall: float) -> float:
    """k of da/dt = k (u - a): 1 / fall, while a rises (1 - u) / fall + u / rise [1/s].

    In OpenSim's properties rise = time_scale / (activation1 + activation2), fall = time_scale / activation2.
    """
    share = wp.where(excitation >= activation, excitation, 0.0)
    return (1.0 - share) / fall + share / rise


PARAMETERS: dict[str, tuple[str | None, float, float, float]] = {}
"""It has none but curves and what all have."""

CURVES = ("active_force_length_curve", "passive_force_length_curve", "tendon_force_length_curve")
"""OpenSim's properties that are splines, in the order of the tables."""

LONGEST = 2.5
"""Fiber lengths up to which f_L and f_P are tabulated [optimal fiber lengths]; lines beyond."""

STRETCHED = 0.1
"""Strain up to which f_T is tabulated; a line beyond."""


def schutte_tables(knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the three tables of a muscle, as `tabulate` does.

    Args:
        knots: x and y of each spline of `CURVES`, NaN from the last one on, shape (3, 2, most knots). Without
            knots f_P is exp(8 (l - 1) - 4), as OpenSim has it where the file states none.
    """
    curves = []
    for number, (x, y) in enumerate(knots):
        here = np.isfinite(x)
        x, y = x[here], y[here]
        last = STRETCHED if number == 2 else LONGEST
        first = 0.0
        if not len(x):
            curves.append((_exponential, first, last))
            continue
        changes = np.flatnonzero(np.diff(y))
        if len(changes):
            # Knots where it begins and ends to differ from the levels on both sides.
            first = float(np.clip(x[changes[0]], 0.0, 0.9 * last))
            last = float(np.clip(x[min(changes[-1] + 3, len(x) - 1)], first + 0.1 * last, last))
        curves.append((_spline(x, y), first, last))
    return tabulate(curves)


def _spline(x: np.ndarray, y: np.ndarray) -> Any:
    return lambda at: simm_spline(x, y, at)


def _exponential(length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    value = np.exp(8.0 * (length - 1.0) - 4.0)
    return value, 8.0 * value
