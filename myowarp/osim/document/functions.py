"""Scalar functions of an OpenSim model: joint axes, couplers, moving points, force curves.

Each function is a frozen dataclass with `value(x)`, `derivative(x)` and `derivatives(x)`, vectorised over
NumPy arrays of any shape, in float64. Most are piecewise polynomials and say only which ones (`Pieces`).

Source: OpenSim's documentation of its Function classes. `SimmSpline` is the cubic spline of
Forsythe, Malcolm, Moler, *Computer Methods for Mathematical Computations* (1977), chapter 4, with
straight lines outside its knots; `GCVSpline` without error variance is the natural interpolating
spline of degree 2 m - 1 (Woltring 1986, doi:10.1016/0141-1195(86)90098-7), written here with the
basis |x - x_i|^(2m-1), which continues as a polynomial of degree m - 1 outside.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import ArrayLike

from myowarp.laws.pieces import Pieces, line
from myowarp.laws.simm_spline import LEAST_STEP, simm_coefficients

Array = np.ndarray


class Function:
    """A scalar function of one variable."""

    @abstractmethod
    def derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return f(x), f'(x) and f''(x), each in the shape of `x`."""

    def value(self, x: ArrayLike) -> Array:
        """Return f(x), in the shape of `x`."""
        return self.derivatives(x)[0]

    def derivative(self, x: ArrayLike) -> Array:
        """Return df/dx, in the shape of `x`."""
        return self.derivatives(x)[1]


class Piecewise(Function):
    """A function that is a polynomial between breaks."""

    @property
    @abstractmethod
    def pieces(self) -> Pieces:
        """Return its polynomials."""

    def derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return f(x), f'(x) and f''(x), each in the shape of `x`."""
        return self.pieces.derivatives(x)


@dataclass(frozen=True)
class Constant(Piecewise):
    """f(x) = value."""

    level: float
    """The value."""

    @cached_property
    def pieces(self) -> Pieces:
        """Return one constant."""
        return line(0.0, self.level)


@dataclass(frozen=True)
class Polynomial(Piecewise):
    """f(x) = c[0] x^n + ... + c[n]: descending powers, as OpenSim writes them."""

    coefficients: tuple[float, ...]

    @cached_property
    def pieces(self) -> Pieces:
        """Return the polynomial."""
        return Pieces((0.0,), (self.coefficients[::-1],))


@dataclass(frozen=True)
class Linear(Piecewise):
    """f(x) = slope x + offset."""

    slope: float
    offset: float = 0.0

    @cached_property
    def pieces(self) -> Pieces:
        """Return the line."""
        return line(self.slope, self.offset)


@dataclass(frozen=True)
class Multiplier(Function):
    """f(x) = scale g(x)."""

    function: Function
    scale: float

    def derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return those of g, times the scale."""
        value, slope, bend = self.function.derivatives(x)
        return self.scale * value, self.scale * slope, self.scale * bend


@dataclass(frozen=True)
class Composed(Function):
    """f(x) = outer(inner(x))."""

    outer: Function
    inner: Function

    def derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return outer(inner(x)), and what follows by the chain rule."""
        between, first, first_bend = self.inner.derivatives(x)
        value, last, last_bend = self.outer.derivatives(between)
        return value, last * first, last_bend * first**2 + last * first_bend


@dataclass(frozen=True)
class Held(Function):
    """f(x) at the nearer end of a range for an x beyond it, but the slope of f at x itself.

    So OpenSim places moving points (`MovingPathPoint::getLocation` clamps, `getdPointdQ` does not).
    """

    function: Function
    low: float
    high: float

    def derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return f within the range, and its slopes at x."""
        value, *_ = self.function.derivatives(np.clip(x, self.low, self.high))
        return value, *self.function.derivatives(x)[1:]


@dataclass(frozen=True)
class Sine(Function):
    """f(x) = amplitude sin(omega x + phase) + offset."""

    amplitude: float
    omega: float
    phase: float
    offset: float = 0.0

    def derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the sine, and its slopes."""
        turned = self.omega * np.asarray(x, float) + self.phase
        value = self.amplitude * np.sin(turned) + self.offset
        slope = self.amplitude * self.omega * np.cos(turned)
        return value, slope, -(self.omega**2) * (value - self.offset)


@dataclass(frozen=True)
class Step(Piecewise):
    """A quintic S-curve from one level to another, constant outside (Simbody's stepAny)."""

    start: float
    end: float
    start_value: float
    end_value: float

    @cached_property
    def pieces(self) -> Pieces:
        """Return a level, the curve 10 t^3 - 15 t^4 + 6 t^5 and a level."""
        rise, width = self.end_value - self.start_value, self.end - self.start
        curve = (self.start_value, 0.0, 0.0, *(rise * c / width**n for n, c in ((3, 10), (4, -15), (5, 6))))
        return Pieces((self.start, self.start, self.end), ((self.start_value,), curve, (self.end_value,)))


@dataclass(frozen=True)
class PiecewiseLinear(Piecewise):
    """Straight lines between knots, the first and the last one continued outside."""

    x: tuple[float, ...]
    y: tuple[float, ...]

    @cached_property
    def pieces(self) -> Pieces:
        """Return a line from every knot but the last."""
        slopes = np.diff(self.y) / np.diff(self.x)
        return Pieces(self.x[:-1], tuple(zip(self.y[:-1], slopes.tolist(), strict=True)))


@dataclass(frozen=True)
class PiecewiseConstant(Piecewise):
    """The value of the last knot that is not above x; the first value below all knots."""

    x: tuple[float, ...]
    y: tuple[float, ...]

    @cached_property
    def pieces(self) -> Pieces:
        """Return a level from every knot."""
        return Pieces(self.x, tuple((y,) for y in self.y))


@dataclass(frozen=True)
class SimmSpline(Piecewise):
    """Cubic spline; end third derivatives from the cubic through the four nearest knots.

    Knots may repeat; as in OpenSim, whatever lies between two knots counts as at least `LEAST_STEP`.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]

    @cached_property
    def pieces(self) -> Pieces:
        """Return a line before the first knot, a cubic from every knot and a line from the last."""
        cubics = simm_coefficients(np.array(self.x), np.array(self.y)).T
        rows = [cubics[0, :2], *cubics[:-1], cubics[-1, :2]]
        return Pieces((self.x[0], *self.x), tuple(tuple(row.tolist()) for row in rows))


@dataclass(frozen=True)
class GCVSpline(Piecewise):
    """Natural interpolating spline of degree 2 half_order - 1."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    half_order: int = 3

    @cached_property
    def pieces(self) -> Pieces:
        """Return Taylor's polynomials at the knots: of degree m - 1 outside, of degree 2 m - 1 inside.

        To the right of a knot t, |t + d - t_i|^n = s (t - t_i + d)^n with n = 2 m - 1 odd and s the sign.
        """
        m, half = self.half_order, (self.x[-1] - self.x[0]) / 2
        t = (np.array(self.x) - (self.x[-1] + self.x[0]) / 2) / half
        degree, order = 2 * m - 1, np.arange(m)
        matrix = np.zeros((len(t) + m, len(t) + m))
        matrix[: len(t), : len(t)] = np.abs(t[:, None] - t) ** degree
        matrix[: len(t), len(t) :] = t[:, None] ** order
        matrix[len(t) :, : len(t)] = matrix[: len(t), len(t) :].T
        weights = np.linalg.solve(matrix, np.append(self.y, np.zeros(m)))

        def taylor(number: int, last: int, terms: int) -> tuple[float, ...]:
            """Coefficients at a knot, where the knots up to number `last` lie to the left."""
            signed = np.where(np.arange(len(t)) <= last, 1.0, -1.0) * weights[: len(t)]
            away, at = t[number] - t, t[number]
            sums = [
                comb(degree, k) * (signed @ away ** (degree - k))
                + sum(comb(p, k) * weights[len(t) + p] * at ** (p - k) for p in range(k, m))
                for k in range(terms)
            ]
            return tuple(float(c / half**k) for k, c in enumerate(sums))

        end = len(t) - 1
        inside = [taylor(number, number, degree + 1) for number in range(end)]
        return Pieces((self.x[0], *self.x), (taylor(0, -1, m), *inside, taylor(end, end, m)))


@dataclass(frozen=True)
class ToeThenLine(Piecewise):
    """0 up to x = 1, a parabola over the strain `toe`, then a line of slope `stiffness`.

    Source: Blankevoort, Huiskes 1991, doi:10.1115/1.2894883: force of a ligament over l / l0.
    """

    stiffness: float
    toe: float

    @cached_property
    def pieces(self) -> Pieces:
        """Return nothing, the parabola and the line; without a toe no parabola."""
        end = self.stiffness * self.toe / 2, self.stiffness
        if self.toe == 0:
            return Pieces((1.0, 1.0), ((0.0,), end))
        parabola = 0.0, 0.0, self.stiffness / (2 * self.toe)
        return Pieces((1.0, 1.0, 1.0 + self.toe), ((0.0,), parabola, end))


IDENTITY = Linear(1.0)


def curves(function: Function) -> tuple[Pieces, ...] | None:
    """Return a function as piecewise polynomials that are applied one after the other, None if it is none."""
    match function:
        case Piecewise():
            return (function.pieces,)
        case Held(inner, low, high) if (chain := curves(inner)) is not None:
            return replace(chain[0], held=(low, high)), *chain[1:]
        case Multiplier(inner, scale) if (chain := curves(inner)) is not None:
            return *chain[:-1], chain[-1].scaled(scale)
        case Composed(outer, inner) if (first := curves(inner)) is not None:
            last = curves(outer)
            return None if last is None else first + last
    return None


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
            slope = (y[-1] - y[0]) / max(x[-1] - x[0], LEAST_STEP)
            bend = np.array(y) - y[0] - slope * (np.array(x) - x[0])
            # Rounding of the file's digits: such a bend moves no one.
            if np.abs(bend).max() <= 1e-12 * max(1.0, np.abs(y).max()):
                return slope, y[0] - slope * x[0]
    return None
