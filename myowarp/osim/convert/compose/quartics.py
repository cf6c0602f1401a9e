"""Functions of a coordinate as quartics: what a MuJoCo joint equality can express.

A spline that one quartic misses becomes a quartic of a phantom joint u, itself a quartic of the coordinate
or of another phantom. The coefficients of u are found by variable projection (Golub, Pereyra 2003,
doi:10.1088/0266-5611/19/2/201): for given u the outer quartic is linear least squares, so that only three
numbers per phantom are left to Levenberg and Marquardt. Values and slopes are fitted together: an error
in the slope of a path point is an error in a moment arm. Phantoms are shared by all functions that they
serve well enough.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import Polynomial

from myowarp.osim.document.functions import Function

Array = np.ndarray

SAMPLES = 121
SLOPE_WEIGHT = 0.1  # rad: an error of 1 mm/rad counts as 0.1 mm
STARTS = 3
MAX_CHAIN = 2  # phantoms in series
VALUE_TOLERANCE = 1e-4  # m
SLOPE_TOLERANCE = 1e-3  # m/rad, root mean square


@dataclass(frozen=True)
class Quartic:
    """value = c[0] + c[1] x + ... + c[4] x^4 of the coordinate (`of` None) or of phantom number `of`."""

    of: int | None
    coefficients: tuple[float, ...]
    """Ascending powers, five."""
    error: float = 0.0
    """Greatest error of the value over the range, in the function's unit."""
    slope_error: float = 0.0
    """Root mean square error of the slope over the range, in the function's unit per coordinate."""


@dataclass(frozen=True)
class Fit:
    """Quartics of several functions of one coordinate, and the phantoms that they share."""

    phantoms: tuple[Quartic, ...]
    functions: tuple[Quartic, ...]


@dataclass(frozen=True, eq=False)
class _Argument:
    """Arguments in which quartics are fitted: u and du/dt at the samples, t in [-1, 1]."""

    value: Array
    slope: Array

    def powers(self) -> tuple[Array, Array]:
        """Return 1, u, ..., u^4 and their derivatives by t, shape `(samples, 5)`."""
        order = np.arange(5)
        values = self.value[:, None] ** order
        slopes = np.zeros_like(values)
        slopes[:, 1:] = order[1:] * values[:, :-1] * self.slope[:, None]
        return values, slopes

    def bent(self, bend: Array) -> "_Argument":
        """Return u + b[0] u^2 + b[1] u^3 + b[2] u^4."""
        values, slopes = self.powers()
        return _Argument(values[:, 1] + values[:, 2:] @ bend, slopes[:, 1] + slopes[:, 2:] @ bend)

    def fitted(self, target: Array, weight: float) -> tuple[Array, Array]:
        """Return the best quartics of targets (2 samples, k) and their residuals, slopes weighted."""
        values, slopes = self.powers()
        matrix = np.concatenate([values, weight * slopes])
        coefficients = np.linalg.lstsq(matrix, target, rcond=None)[0]
        return coefficients, matrix @ coefficients - target


def fit_all(functions: Sequence[Function], levers: Sequence[float], low: float, high: float) -> Fit:
    """Return quartics of functions of one coordinate.

    Args:
        functions: What is fitted.
        levers: What one unit of each function counts for [m], 1 for lengths, a radius for angles.
        low: Least value of the coordinate.
        high: Its greatest value.
    """
    if high - low < 1e-9:
        at = [float(function.value(low)) for function in functions]
        return Fit((), tuple(Quartic(None, (value, 0.0, 0.0, 0.0, 0.0)) for value in at))
    return _fit_all(tuple(functions), tuple(levers), float(low), float(high))


@lru_cache(maxsize=256)
def _fit_all(functions: tuple[Function, ...], levers: tuple[float, ...], low: float, high: float) -> Fit:
    """Fit directly where that is good enough; else with phantoms, the worst function first."""
    half = (high - low) / 2
    time = np.linspace(-1, 1, SAMPLES)
    grid = low + half * (time + 1)
    weight = SLOPE_WEIGHT / half
    targets = np.stack(
        [
            lever * np.concatenate([function.value(grid), weight * half * function.derivative(grid)])
            for function, lever in zip(functions, levers, strict=True)
        ],
        axis=1,
    )
    to_unit = Polynomial([-low / half - 1, 1 / half])
    straight = _Argument(time, np.ones(SAMPLES))
    phantoms: list[Quartic] = []
    found: dict[int, Quartic] = {}

    def settle(argument: _Argument, of: int | None, final: int | None) -> None:
        """Take the functions that this argument serves well enough, and the one it was made for."""
        for index in range(len(functions)):
            if index in found:
                continue
            coefficients, residual = argument.fitted(targets[:, [index]], weight)
            if index == final or _served(residual):
                value = np.abs(residual[:SAMPLES]).max()
                slope = np.sqrt(np.mean(residual[SAMPLES:] ** 2)) / SLOPE_WEIGHT
                inner = Polynomial(coefficients[:, 0])
                raw = inner(to_unit) if of is None else inner
                lever = levers[index]
                found[index] = Quartic(of, _five(raw.coef, lever), float(value / lever), float(slope / lever))

    settle(straight, None, None)
    while len(found) < len(functions):
        missing = [index for index in range(len(functions)) if index not in found]
        worst = max(
            missing, key=lambda index: np.linalg.norm(straight.fitted(targets[:, [index]], weight)[1])
        )
        others = targets[:, [index for index in missing if index != worst]]
        bends = _shared(
            _bends(targets[:, [worst]], straight, weight), targets[:, [worst]], others, straight, weight
        )
        argument, of = straight, None
        for bend in bends:
            inner = Polynomial([0.0, 1.0, *bend])
            phantoms.append(Quartic(of, _five((inner(to_unit) if of is None else inner).coef, 1.0)))
            of = len(phantoms) - 1
            argument = argument.bent(bend)
        settle(argument, of, worst)
    return Fit(tuple(phantoms), tuple(found[index] for index in range(len(functions))))


def _five(coefficients: Array, lever: float) -> tuple[float, ...]:
    """Return five coefficients in the function's unit, zeros added."""
    return tuple(float(c) / lever for c in np.pad(coefficients, (0, 5 - len(coefficients))))


def _served(residual: Array) -> bool:
    """Return whether residuals (2 samples, k) are within the tolerances."""
    slope = np.sqrt(np.mean(residual[SAMPLES:] ** 2, axis=0)) / SLOPE_WEIGHT
    return bool((np.abs(residual[:SAMPLES]) <= VALUE_TOLERANCE).all() and (slope <= SLOPE_TOLERANCE).all())


def _bent(straight: _Argument, bends: Array) -> _Argument:
    """Return the last argument of a chain of phantoms, bends (length, 3)."""
    for bend in bends:
        straight = straight.bent(bend)
    return straight


def _optimised(start: Array, target: Array, straight: _Argument, weight: float) -> tuple[Array, float]:
    """Return the best bends near `start`, shape (length, 3), and their sum of squared residuals."""

    def residual(bends: Array) -> Array:
        return _bent(straight, bends.reshape(start.shape)).fitted(target, weight)[1].ravel()

    bends, cost = _levenberg(residual, start.ravel())
    return bends.reshape(start.shape), cost


def _bends(target: Array, straight: _Argument, weight: float) -> Array:
    """Return the bends of the shortest chain of phantoms that serves one function, from several starts."""
    best = np.zeros((1, 3))
    for length in range(1, MAX_CHAIN + 1):
        random = np.random.default_rng(0)
        starts = [np.zeros((length, 3)), *random.normal(0.0, 0.5, (STARTS - 1, length, 3))]
        results = [_optimised(start, target, straight, weight) for start in starts]
        best = min(results, key=lambda result: result[1])[0]
        if _served(_bent(straight, best).fitted(target, weight)[1]):
            break
    return best


def _shared(bends: Array, served: Array, others: Array, straight: _Argument, weight: float) -> Array:
    """Return bends that still serve what they did, and as many of the other functions as they can."""
    residuals = _bent(straight, bends).fitted(others, weight)[1]
    for index in np.argsort(np.linalg.norm(residuals, axis=0)):
        more = np.concatenate([served, others[:, [index]]], axis=1)
        trial, _ = _optimised(bends, more, straight, weight)
        if _served(_bent(straight, trial).fitted(more, weight)[1]):
            bends, served = trial, more
    return bends


def _levenberg(residual: Callable[[Array], Array], start: Array) -> tuple[Array, float]:
    """Return a minimum of a sum of squares near `start`, and that sum (Marquardt 1963)."""
    point, damping, size = start, 1e-3, len(start)
    values = residual(point)
    cost = float(values @ values)
    for _ in range(60):
        slopes = [(residual(point + step) - values) / 1e-6 for step in 1e-6 * np.eye(size)]
        jacobian = np.stack(slopes, axis=1)
        hessian, gradient = jacobian.T @ jacobian, jacobian.T @ values
        before = cost
        for _ in range(8):
            scaled = hessian + np.diag(damping * np.diag(hessian) + 1e-18)
            trial = point - np.linalg.solve(scaled, gradient)
            new = residual(trial)
            if float(new @ new) < cost:
                point, values, cost, damping = trial, new, float(new @ new), damping / 3
                break
            damping *= 4
        if before - cost <= 1e-6 * before:
            break
    return point, cost
