"""Scalar functions of an OpenSim model: joint axes, couplers, moving points, force curves.

Each function is a frozen dataclass with `value(x)` and `derivative(x)`, both vectorised over NumPy
arrays of any shape, in float64, and `knots`: the places where a fit should look closer.

Source: OpenSim's documentation of its Function classes. `SimmSpline` is the cubic spline of
Forsythe, Malcolm, Moler, *Computer Methods for Mathematical Computations* (1977), chapter 4, with
straight lines outside its knots; `GCVSpline` without error variance is the natural interpolating
spline of degree 2 m - 1 (Woltring 1986, doi:10.1016/0141-1195(86)90098-7), written here with the
basis |x - x_i|^(2m-1), which continues as a polynomial of degree m - 1 outside.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

Array = np.ndarray

NO_KNOTS = np.empty(0)


class Function(Protocol):
    """A scalar function of one variable."""

    @property
    def knots(self) -> Array:
        """Where its pieces meet, shape `(n,)`, ascending; empty for a smooth function."""

    def value(self, x: ArrayLike) -> Array:
        """Return f(x), in the shape of `x`."""

    def derivative(self, x: ArrayLike) -> Array:
        """Return df/dx, in the shape of `x`."""


@dataclass(frozen=True)
class Constant:
    """f(x) = value."""

    level: float
    """The value."""
    knots = NO_KNOTS

    def value(self, x: ArrayLike) -> Array:
        """Return the level."""
        return np.full(np.shape(x), self.level)

    def derivative(self, x: ArrayLike) -> Array:
        """Return 0."""
        return np.zeros(np.shape(x))


@dataclass(frozen=True)
class Polynomial:
    """f(x) = c[0] x^n + ... + c[n]: descending powers, as OpenSim writes them."""

    coefficients: tuple[float, ...]
    knots = NO_KNOTS

    def value(self, x: ArrayLike) -> Array:
        """Return the polynomial."""
        return np.polyval(self.coefficients, np.asarray(x, float))

    def derivative(self, x: ArrayLike) -> Array:
        """Return its slope."""
        return np.polyval(np.polyder(np.asarray(self.coefficients)), np.asarray(x, float))


@dataclass(frozen=True)
class Linear:
    """f(x) = slope x + offset."""

    slope: float
    offset: float = 0.0
    knots = NO_KNOTS

    def value(self, x: ArrayLike) -> Array:
        """Return the line."""
        return self.slope * np.asarray(x, float) + self.offset

    def derivative(self, x: ArrayLike) -> Array:
        """Return the slope."""
        return np.full(np.shape(x), self.slope)


@dataclass(frozen=True)
class Multiplier:
    """f(x) = scale g(x)."""

    function: Function
    scale: float

    @property
    def knots(self) -> Array:
        """Knots of g."""
        return self.function.knots

    def value(self, x: ArrayLike) -> Array:
        """Return scale g(x)."""
        return self.scale * self.function.value(x)

    def derivative(self, x: ArrayLike) -> Array:
        """Return scale dg/dx."""
        return self.scale * self.function.derivative(x)


@dataclass(frozen=True)
class Composed:
    """f(x) = outer(inner(x))."""

    outer: Function
    inner: Function

    @property
    def knots(self) -> Array:
        """Knots of the inner function; those of the outer one are not traced back."""
        return self.inner.knots

    def value(self, x: ArrayLike) -> Array:
        """Return outer(inner(x))."""
        return self.outer.value(self.inner.value(x))

    def derivative(self, x: ArrayLike) -> Array:
        """Return the product of the slopes."""
        return self.outer.derivative(self.inner.value(x)) * self.inner.derivative(x)


@dataclass(frozen=True)
class Sine:
    """f(x) = amplitude sin(omega x + phase) + offset."""

    amplitude: float
    omega: float
    phase: float
    offset: float = 0.0
    knots = NO_KNOTS

    def value(self, x: ArrayLike) -> Array:
        """Return the sine."""
        return self.amplitude * np.sin(self.omega * np.asarray(x, float) + self.phase) + self.offset

    def derivative(self, x: ArrayLike) -> Array:
        """Return its slope."""
        return self.amplitude * self.omega * np.cos(self.omega * np.asarray(x, float) + self.phase)


@dataclass(frozen=True)
class Step:
    """A quintic S-curve from one level to another, constant outside (Simbody's stepAny)."""

    start: float
    end: float
    start_value: float
    end_value: float

    @property
    def knots(self) -> Array:
        """Start and end."""
        return np.array([self.start, self.end])

    def value(self, x: ArrayLike) -> Array:
        """Return the step."""
        t = np.clip((np.asarray(x, float) - self.start) / (self.end - self.start), 0.0, 1.0)
        return self.start_value + (self.end_value - self.start_value) * t**3 * (10 + t * (6 * t - 15))

    def derivative(self, x: ArrayLike) -> Array:
        """Return its slope."""
        width = self.end - self.start
        t = np.clip((np.asarray(x, float) - self.start) / width, 0.0, 1.0)
        return (self.end_value - self.start_value) / width * 30 * (t * (1 - t)) ** 2


@dataclass(frozen=True)
class PiecewiseLinear:
    """Straight lines between knots, the first and the last one continued outside."""

    x: tuple[float, ...]
    y: tuple[float, ...]

    @cached_property
    def knots(self) -> Array:
        """The x of the knots."""
        return np.array(self.x)

    def _slope(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return the index of the piece and its slope."""
        knots, y = self.knots, np.array(self.y)
        piece = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
        return piece, (np.diff(y) / np.diff(knots))[piece]

    def value(self, x: ArrayLike) -> Array:
        """Return the line at x."""
        piece, slope = self._slope(x)
        return np.array(self.y)[piece] + slope * (np.asarray(x, float) - self.knots[piece])

    def derivative(self, x: ArrayLike) -> Array:
        """Return the slope of the piece."""
        return self._slope(x)[1]


@dataclass(frozen=True)
class PiecewiseConstant:
    """The value of the last knot that is not above x; the first value below all knots."""

    x: tuple[float, ...]
    y: tuple[float, ...]

    @cached_property
    def knots(self) -> Array:
        """The x of the knots."""
        return np.array(self.x)

    def value(self, x: ArrayLike) -> Array:
        """Return the level at x."""
        return np.array(self.y)[np.maximum(np.searchsorted(self.knots, x, side="right") - 1, 0)]

    def derivative(self, x: ArrayLike) -> Array:
        """Return 0."""
        return np.zeros(np.shape(x))


@dataclass(frozen=True)
class SimmSpline:
    """Cubic spline; end third derivatives from the cubic through the four nearest knots."""

    x: tuple[float, ...]
    y: tuple[float, ...]

    @cached_property
    def knots(self) -> Array:
        """The x of the knots."""
        return np.array(self.x)

    @cached_property
    def _coefficients(self) -> Array:
        """Slope, quadratic and cubic coefficient at every knot, shape `(3, n)`."""
        x, y = self.knots, np.array(self.y)
        step, n = np.diff(x), len(x)
        slope = np.diff(y) / step
        if n == 2:
            return np.array([[slope[0]] * 2, [0.0] * 2, [0.0] * 2])
        matrix, right = np.zeros((n, n)), np.zeros(n)
        rows = np.arange(1, n - 1)
        matrix[rows, rows - 1], matrix[rows, rows + 1] = step[:-1], step[1:]
        matrix[rows, rows] = 2 * (step[:-1] + step[1:])
        right[1:-1] = np.diff(slope)
        matrix[0, :2] = -step[0], step[0]
        matrix[-1, -2:] = step[-1], -step[-1]
        if n > 3:
            second = np.diff(slope) / (x[2:] - x[:-2])
            third = np.diff(second) / (x[3:] - x[:-3])
            right[0] = step[0] ** 2 * third[0]
            right[-1] = -(step[-1] ** 2) * third[-1]
        sigma = np.linalg.solve(matrix, right)
        linear = np.append(slope - step * (sigma[1:] + 2 * sigma[:-1]), 0.0)
        linear[-1] = slope[-1] + step[-1] * (sigma[-2] + 2 * sigma[-1])
        cubic = np.append(np.diff(sigma) / step, 0.0)
        return np.array([linear, 3 * sigma, cubic])

    def _locate(self, x: ArrayLike) -> tuple[Array, Array, Array, Array, Array]:
        """Return knot index, distance from it, and the coefficients there, flat outside."""
        x = np.asarray(x, float)
        index = np.clip(np.searchsorted(self.knots, x, side="right") - 1, 0, len(self.knots) - 1)
        linear, square, cubic = self._coefficients[:, index]
        outside = (x < self.knots[0]) | (x >= self.knots[-1])
        return index, x - self.knots[index], linear, np.where(outside, 0, square), np.where(outside, 0, cubic)

    def value(self, x: ArrayLike) -> Array:
        """Return the spline."""
        index, d, linear, square, cubic = self._locate(x)
        return np.array(self.y)[index] + d * (linear + d * (square + d * cubic))

    def derivative(self, x: ArrayLike) -> Array:
        """Return its slope."""
        _, d, linear, square, cubic = self._locate(x)
        return linear + d * (2 * square + 3 * d * cubic)


@dataclass(frozen=True)
class GCVSpline:
    """Natural interpolating spline of degree 2 half_order - 1."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    half_order: int = 3

    @cached_property
    def knots(self) -> Array:
        """The x of the knots."""
        return np.array(self.x)

    @cached_property
    def _weights(self) -> Array:
        """Weights of |t - t_i|^(2m-1), then of 1, t, ..., t^(m-1); t = x over [-1, 1]."""
        t, n, m = self._scaled(self.knots), len(self.x), self.half_order
        powers = t[:, None] ** np.arange(m)
        matrix = np.zeros((n + m, n + m))
        matrix[:n, :n] = np.abs(t[:, None] - t) ** (2 * m - 1)
        matrix[:n, n:], matrix[n:, :n] = powers, powers.T
        return np.linalg.solve(matrix, np.append(self.y, np.zeros(m)))

    @property
    def _half_width(self) -> float:
        return (self.x[-1] - self.x[0]) / 2

    def _scaled(self, x: ArrayLike) -> Array:
        return (np.asarray(x, float) - (self.x[-1] + self.x[0]) / 2) / self._half_width

    def value(self, x: ArrayLike) -> Array:
        """Return the spline."""
        t, n, m = self._scaled(x), len(self.x), self.half_order
        distance = np.abs(t[..., None] - self._scaled(self.knots))
        powers = t[..., None] ** np.arange(m)
        return distance ** (2 * m - 1) @ self._weights[:n] + powers @ self._weights[n:]

    def derivative(self, x: ArrayLike) -> Array:
        """Return its slope."""
        t, n, m = self._scaled(x), len(self.x), self.half_order
        away = t[..., None] - self._scaled(self.knots)
        basis = (2 * m - 1) * np.sign(away) * np.abs(away) ** (2 * m - 2)
        order = np.arange(1, m)
        powers = order * t[..., None] ** (order - 1)
        return (basis @ self._weights[:n] + powers @ self._weights[n + 1 :]) / self._half_width


@dataclass(frozen=True)
class ToeThenLine:
    """0 up to x = 1, a parabola over the strain `toe`, then a line of slope `stiffness`.

    Source: Blankevoort, Huiskes 1991, doi:10.1115/1.2894883: force of a ligament over l / l0.
    """

    stiffness: float
    toe: float

    @property
    def knots(self) -> Array:
        """Where the parabola begins and ends."""
        return np.array([1.0, 1.0 + self.toe])

    def value(self, x: ArrayLike) -> Array:
        """Return the force."""
        strain = np.maximum(np.asarray(x, float) - 1, 0.0)
        bent = np.minimum(strain, self.toe)
        parabola = bent**2 / (2 * self.toe) if self.toe > 0 else 0.0 * bent
        return self.stiffness * (parabola + strain - bent)

    def derivative(self, x: ArrayLike) -> Array:
        """Return its slope."""
        strain = np.maximum(np.asarray(x, float) - 1, 0.0)
        return self.stiffness * np.clip(strain / max(self.toe, 1e-12), 0.0, 1.0)


IDENTITY = Linear(1.0)


def affine(function: Function) -> tuple[float, float] | None:
    """Return (slope, offset) where a function is a straight line everywhere, else None."""
    match function:
        case Constant(level):
            return 0.0, level
        case Linear(slope, offset):
            return slope, offset
        case Polynomial(coefficients) if not any(coefficients[:-2]):
            return (0.0, 0.0, *coefficients)[-2], coefficients[-1]
        case Multiplier(inner, scale) if (line := affine(inner)) is not None:
            return scale * line[0], scale * line[1]
        case Composed(outer, inner):
            first, last = affine(inner), affine(outer)
            if first is not None and last is not None:
                return last[0] * first[0], last[0] * first[1] + last[1]
        case SimmSpline(x, y) | PiecewiseLinear(x, y):
            slope = (y[-1] - y[0]) / (x[-1] - x[0])
            bend = np.array(y) - y[0] - slope * (np.array(x) - x[0])
            # Rounding of the file's digits: such a bend moves no one.
            if np.abs(bend).max() <= 1e-12 * max(1.0, np.abs(y).max()):
                return slope, y[0] - slope * x[0]
    return None
