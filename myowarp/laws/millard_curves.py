"""The curves of Millard's muscle: chains of quintic Bezier corners, straight lines outside.

A corner runs from one point with slope to the next; its control points lie on the two tangents, at a
share c = 0.1 + 0.8 curviness of the way to where they cross, so that the chain is C2.

Source: Millard, Uchida, Seth, Delp 2013 (doi:10.1115/1.4023390), appendix, with the knots of OpenSim's
SmoothSegmentedFunctionFactory. All curves agree with OpenSim 4.6 to 1e-13
(tests/converter/test_opensim_hill.py).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

Curve = tuple[np.ndarray, np.ndarray]

Array = np.ndarray
Knot = tuple[float, float, float]

# Coefficients of 1, u, ..., u^5 from six control points.
BERNSTEIN = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [-5, 5, 0, 0, 0, 0],
        [10, -20, 10, 0, 0, 0],
        [-10, 30, -30, 10, 0, 0],
        [5, -20, 30, -20, 5, 0],
        [-1, 5, -10, 10, -5, 1],
    ],
    dtype=float,
)

GUESSES = 64
"""Intervals per corner of the table that starts Newton's method at about 1e-3."""

NEWTON_STEPS = 3
"""From 1e-3 to rounding: 1e-6, 1e-12, 1e-24."""


@dataclass(frozen=True)
class BezierChain:
    """y(x) through knots (x, y, slope); one curviness for each corner between two knots."""

    knots: tuple[Knot, ...]
    curviness: tuple[float, ...]

    @cached_property
    def _corners(self) -> Array:
        """Polynomial coefficients of x(u) and y(u), shape (2, 6, number of corners)."""
        corners = []
        for (start, end), curviness in zip(pairwise(self.knots), self.curviness, strict=True):
            first, last = np.array(start[:2]), np.array(end[:2])
            bend = start[2] - end[2]
            if abs(bend) > 1e-9:
                x = (end[1] - start[1] - end[0] * end[2] + start[0] * start[2]) / bend
            else:
                x = (start[0] + end[0]) / 2.0
            crossing = np.array([x, start[1] + start[2] * (x - start[0])])
            share = 0.1 + 0.8 * curviness
            near_first, near_last = first + share * (crossing - first), last + share * (crossing - last)
            points = np.array([first, near_first, near_first, near_last, near_last, last])
            corners.append(BERNSTEIN @ points)
        return np.transpose(corners, (2, 1, 0))

    @cached_property
    def _guess(self) -> tuple[Array, Array]:
        """Table of x against corner index + u."""
        u = np.linspace(0.0, 1.0, GUESSES, endpoint=False)
        x = (u[:, None] ** np.arange(6)) @ self._corners[0]
        index = np.arange(len(self.curviness)) + u[:, None]
        return np.append(x.T, self.knots[-1][0]), np.append(index.T, float(len(self.curviness)))

    def __call__(self, x: Array) -> Curve:
        """Return (y, dy/dx) at x, each in the shape of x."""
        x = np.asarray(x, float)
        low, high = self.knots[0], self.knots[-1]
        inside = np.clip(x, low[0], high[0])
        index = np.interp(inside, *self._guess)
        corner = np.clip(index.astype(int), 0, len(self.curviness) - 1)
        u = index - corner
        along, across = self._corners[0][:, corner], self._corners[1][:, corner]
        for _ in range(NEWTON_STEPS):
            u = np.clip(u - (_value(along, u) - inside) / _slope(along, u), 0.0, 1.0)
        value, slope = _value(across, u), _slope(across, u) / _slope(along, u)
        below, above = x < low[0], x > high[0]
        value = np.where(below, low[1] + low[2] * (x - low[0]), value)
        value = np.where(above, high[1] + high[2] * (x - high[0]), value)
        return value, np.where(below, low[2], np.where(above, high[2], slope))


def _value(c: Array, u: Array) -> Array:
    """Return c[0] + c[1] u + ... + c[5] u^5."""
    return c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))


def _slope(c: Array, u: Array) -> Array:
    """Return its derivative by u."""
    return c[1] + u * (2.0 * c[2] + u * (3.0 * c[3] + u * (4.0 * c[4] + u * 5.0 * c[5])))


@dataclass(frozen=True)
class MillardCurves:
    """The four curves; f_V does not depend on the activation."""

    active: BezierChain
    passive: BezierChain
    tendon: BezierChain
    velocity: BezierChain

    def active_force_length(self, length: Array) -> Curve:
        """Return f_L."""
        return self.active(length)

    def passive_force(self, length: Array) -> Curve:
        """Return f_P."""
        return self.passive(length)

    def tendon_force(self, length: Array) -> Curve:
        """Return f_T."""
        return self.tendon(length)

    def force_velocity(self, velocity: Array, activation: Array) -> Curve:
        """Return f_V."""
        return self.velocity(velocity)


@lru_cache(maxsize=1024)
def active_chain(start: float, shoulder: float, end: float, slope: float, floor: float) -> BezierChain:
    """Return f_L: steep rise from `start`, shallow rise from `shoulder` to 1 at 1, fall to `end`."""
    plateau = 0.05
    top = 1.0 - plateau
    y = 1.0 - slope * (top - shoulder)
    steep = 1.25 * y / (shoulder - start)
    fall = -1.0 / ((end - plateau) - (1.0 + plateau))
    knots = (
        (start, floor, 0.0),
        ((start + shoulder) / 2.0, y / 2.0, steep),
        ((shoulder + top) / 2.0, (1.0 + y) / 2.0, slope),
        (1.0, 1.0, 0.0),
        ((1.0 + plateau + end) / 2.0, 0.5, fall),
        (end, floor, 0.0),
    )
    return BezierChain(knots, (1.0,) * 5)


@lru_cache(maxsize=1024)
def passive_chain(
    zero_strain: float, one_strain: float, low_stiffness: float, stiffness: float, curviness: float
) -> BezierChain:
    """Return f_P: 0 at `zero_strain`, a foot of `low_stiffness`, 1 at `one_strain`."""
    start, end = 1.0 + zero_strain, 1.0 + one_strain
    foot = min(0.1 / stiffness, 0.1 * (end - start))
    knots = (
        (start, 0.0, 0.0),
        (start + foot, low_stiffness * foot / 2.0, low_stiffness),
        (end, 1.0, stiffness),
    )
    return BezierChain(knots, (curviness,) * 2)


@lru_cache(maxsize=1024)
def tendon_chain(strain: float, stiffness: float, toe_force: float, curviness: float) -> BezierChain:
    """Return f_T: 0 at slack length, a toe up to `toe_force`, a line through 1 at `strain`."""
    end = 1.0 + strain
    toe = (toe_force - 1.0) / stiffness + end
    foot = 1.0 + (toe - 1.0) / 10.0
    middle_force = toe_force / 2.0
    slope = middle_force / ((middle_force - 1.0) / stiffness + end - foot)
    middle = foot + ((middle_force - 1.0) / stiffness + end - foot) / 2.0
    knots = ((1.0, 0.0, 0.0), (middle, slope * (middle - foot), slope), (toe, toe_force, stiffness))
    return BezierChain(knots, (curviness,) * 2)


@lru_cache(maxsize=1024)
def velocity_chain(
    slopes: tuple[float, float, float, float, float], limit: float, curviness: tuple[float, float]
) -> BezierChain:
    """Return f_V through slopes at -1, near -1, at 0, near 1, at 1, up to `limit`."""
    near = 0.9
    first, before, middle, after, last = slopes
    knots = (
        (-1.0, 0.0, first),
        (-near, 0.5 * before * (1 - near) + 0.5 * first * (1 - near), before),
        (0.0, 1.0, middle),
        (near, limit - 0.5 * after * (1 - near) - 0.5 * last * (1 - near), after),
        (1.0, limit, last),
    )
    concentric, eccentric = curviness
    return BezierChain(knots, (concentric, concentric, eccentric, eccentric))


def millard_curves(values: Mapping[str, float]) -> MillardCurves:
    """Return the curves that OpenSim builds from the properties of a Millard2012EquilibriumMuscle.

    OpenSim lifts f_L to at least 0.1 and slants the ends of f_V where an elastic tendon meets an
    undamped fiber, and takes both to 0 otherwise, whatever the file says.
    """
    active, velocity = "ActiveForceLengthCurve.", "ForceVelocityCurve."
    fiber, tendon = "FiberForceLengthCurve.", "TendonForceLengthCurve."
    classic = values["fiber_damping"] < MIN_DAMPING and not values["ignore_tendon_compliance"]
    before = values[velocity + "concentric_slope_near_vmax"]
    after = values[velocity + "eccentric_slope_near_vmax"]
    ends = values[velocity + "concentric_slope_at_vmax"], values[velocity + "eccentric_slope_at_vmax"]
    first, last = (max(ends[0], before / 2), max(ends[1], after / 2)) if classic else (0.0, 0.0)
    zero, one = values[fiber + "strain_at_zero_force"], values[fiber + "strain_at_one_norm_force"]
    strain = values[tendon + "strain_at_one_norm_force"]
    return MillardCurves(
        active_chain(
            values[active + "min_norm_active_fiber_length"],
            values[active + "transition_norm_fiber_length"],
            values[active + "max_norm_active_fiber_length"],
            values[active + "shallow_ascending_slope"],
            max(values[active + "minimum_value"], 0.1) if classic else 0.0,
        ),
        passive_chain(
            zero,
            one,
            values.get(fiber + "stiffness_at_low_force", 0.2),
            values.get(fiber + "stiffness_at_one_norm_force", 2.0 / (one - zero)),
            values.get(fiber + "curviness", 0.75),
        ),
        tendon_chain(
            strain,
            values.get(tendon + "stiffness_at_one_norm_force", 1.375 / strain),
            values.get(tendon + "norm_force_at_toe_end", 2.0 / 3.0),
            values.get(tendon + "curviness", 0.5),
        ),
        velocity_chain(
            (first, before, values[velocity + "isometric_slope"], after, last),
            values[velocity + "max_eccentric_velocity_force_multiplier"],
            (values[velocity + "concentric_curviness"], values[velocity + "eccentric_curviness"]),
        ),
    )


MIN_DAMPING = 0.001
"""Fiber damping below this is none to OpenSim."""
