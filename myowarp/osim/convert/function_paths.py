"""Lengths of muscle paths as polynomials of coordinates, fitted to paths with points and wrap objects.

OpenSim 4.6 and MyoWarp both read the set that is written (`FunctionBasedPath`), and follow such a path faster
than one that wraps. A polynomial has all terms up to an order; it is fitted by least squares to lengths and
moment arms in random poses of the coordinates that the path crosses, in products of Chebyshev's polynomials,
and the least order is taken whose errors in other poses are within `LENGTH` and `ARM`. The length of a path
that crosses one coordinate is a spline, which bends where a wrap begins. No function follows a path that
jumps, as some of OpenSim's do where a wrap lets go or a point comes in: in paths beyond the bounds, jumps are
sought.

Source: van den Bogert et al. (2013), doi:10.1007/s11517-013-1076-z; the classes are OpenSim 4.6's
`FunctionBasedPath` and `MultivariatePolynomialFunction`.
"""

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.polynomial import chebyshev

from myowarp.disk import in_place
from myowarp.laws.paths.path import MOST_VARIABLES
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.elements import LengthFunction
from myowarp.osim.document.functions import IDENTITY, SimmSpline
from myowarp.osim.document.model import Model
from myowarp.osim.document.read.element import Element, write
from myowarp.osim.document.read.functions import exponents

FILES = "function_paths.xml", "function_paths.csv"
LENGTH, ARM = 0.0005, 0.001
"""Errors within which a polynomial is good enough, at worst over the held-out poses [m]."""
POSES, HELD_OUT = 6000, 2000
"""Random poses of a fit, half of them nearer the ends of the ranges, and of its check."""
MOST_TERMS = 500
MOST_ORDER = 12
JUMP = 1e-5
"""m: lesser steps are rounding."""
KNOTS = (9, 17, 33, 65, 129)
SEED = 0
LINES, MARKS, KEPT_LINES, HALVINGS = 200, 33, 20, 12
"""Lines on which jumps are sought, poses on each, lines that are followed, and how often these are halved."""


@dataclasses.dataclass(frozen=True, eq=False)
class FittedPath:
    """The length of a path as a polynomial.

    Attributes:
        name: Of the muscle, ligament or path actuator.
        function: The polynomial.
        order: Of it; of a spline the number of knots.
        length_rms: Error over the held-out poses, root mean square [m].
        length_worst: The same at worst.
        arm_rms: The same of moment arms, over all coordinates that it crosses [m] or [1].
        arm_worst: The same at worst.
    """

    name: str
    function: LengthFunction
    order: int
    length_rms: float
    length_worst: float
    arm_rms: float
    arm_worst: float
    jump: float = 0.0
    """Greatest step of the path's own length between two poses that are one [m]; sought if not good."""

    @property
    def good(self) -> bool:
        """Whether it is within the bounds."""
        return self.badness <= 1.0

    @property
    def badness(self) -> float:
        """Return its worst error as a share of the bound."""
        return max(self.length_worst / LENGTH, self.arm_worst / ARM)


def fit_function_paths(bones: Bones, most_order: int = MOST_ORDER) -> tuple[list[FittedPath], list[str]]:
    """Return polynomials up to an order for all paths of a model, and the names of those that have none.

    A path has none that crosses no coordinate, or more than `MOST_VARIABLES`, or is a function already.
    """
    model, random = bones.model, np.random.default_rng(SEED)
    low, high = (
        np.array([model.coordinates[name].sampling_range for name in bones.coordinates]).reshape(-1, 2).T
    )
    share = random.uniform(size=(POSES + HELD_OUT, len(low)))
    share[: POSES // 2] = (1 - np.cos(np.pi * share[: POSES // 2])) / 2
    values = low + (high - low) * share
    names = [name for name, path in model.pulling.items() if path.function is None]
    paths = muscle_paths(bones, values, np.zeros_like(values), names)
    groups: dict[tuple[int, ...], list[int]] = {}
    for number, crossed in enumerate(paths.crossed):
        groups.setdefault(crossed, []).append(number)
    found: dict[str, FittedPath] = {}
    for crossed, numbers in groups.items():
        if not 1 <= len(crossed) <= MOST_VARIABLES:
            continue
        if len(crossed) == 1:
            name, ends = bones.coordinates[crossed[0]], (low[crossed[0]], high[crossed[0]])
            for k in numbers:
                samples = values[:, crossed[0]], paths.length[:, k], paths.moment_arm[:, k, crossed[0]]
                found[names[k]] = fitted_spline(names[k], name, ends, *samples)
            continue
        columns, waiting = list(crossed), numbers
        problem = _Problem(values[:, columns], low[columns], high[columns])
        for order in problem.orders(most_order):
            wanted = paths.length[:, waiting], paths.moment_arm[:, waiting][:, :, columns]
            for number, fitted in zip(waiting, problem.fitted(order, *wanted), strict=True):
                coefficients, *errors = fitted
                function = LengthFunction(
                    tuple(bones.coordinates[k] for k in columns),
                    (IDENTITY,) * len(columns),
                    tuple(coefficients.tolist()),
                    tuple(exponents(len(columns), order)),
                )
                one = FittedPath(names[number], function, order, *errors)
                if names[number] not in found or one.badness < found[names[number]].badness:
                    found[names[number]] = one
            waiting = [number for number in waiting if not found[names[number]].good]
            if not waiting:
                break
    for name, one in found.items():
        if not one.good:
            found[name] = dataclasses.replace(one, jump=_jump(bones, name, low, high))
    kept = [found[name] for name in names if name in found]
    return kept, [name for name in names if name not in found]


def _jump(bones: Bones, name: str, low: np.ndarray, high: np.ndarray) -> float:
    """Return the greatest step that is found of a path's length along straight lines through the ranges [m].

    A step is what the length changes by beyond its moment arms, halved in until both ends are one pose.
    """

    def steps(values: np.ndarray) -> np.ndarray:
        found = muscle_paths(
            bones, values.reshape(-1, len(low)), np.zeros((values[..., 0].size, len(low))), [name]
        )
        length = found.length.reshape(values.shape[:-1])
        arm = found.moment_arm[:, 0].reshape(values.shape)
        turned = (arm[:, 1:] + arm[:, :-1]) / 2 * np.diff(values, axis=1)
        return np.abs(np.diff(length, axis=1) + turned.sum(axis=-1))

    ends = low + (high - low) * np.random.default_rng(SEED).uniform(size=(2, LINES, 1, len(low)))
    values = ends[0] + (ends[1] - ends[0]) * np.linspace(0.0, 1.0, MARKS)[:, None]
    apart = steps(values)
    rows, places = np.arange(LINES), apart.argmax(axis=1)
    chosen = np.argsort(-apart[rows, places])[:KEPT_LINES]
    pair = np.stack([values[chosen, places[chosen]], values[chosen, places[chosen] + 1]], axis=1)
    for _ in range(HALVINGS):
        values = np.stack([pair[:, 0], pair.mean(axis=1), pair[:, 1]], axis=1)
        apart = steps(values)
        later = apart.argmax(axis=1)
        rows = np.arange(len(pair))
        pair = np.stack([values[rows, later], values[rows, later + 1]], axis=1)
    return float(apart.max())


def fitted_spline(
    name: str,
    coordinate: str,
    ends: tuple[float, float],
    values: np.ndarray,
    length: np.ndarray,
    arm: np.ndarray,
) -> FittedPath:
    """Return the spline with the fewest knots whose errors are within the bounds, else the nearest one.

    Args:
        name: Of the path.
        coordinate: That it crosses.
        ends: Of the coordinate's range.
        values: Of the coordinate in random poses, the last `HELD_OUT` for the check.
        length: In these [m].
        arm: The same of moment arms.
    """
    order = np.argsort(values[:POSES])
    best: FittedPath | None = None
    for knots in KNOTS:
        x = np.linspace(*ends, knots)
        y = np.interp(x, values[:POSES][order], length[:POSES][order])
        function = LengthFunction(
            (coordinate,), (SimmSpline(tuple(x.tolist()), tuple(y.tolist())),), (1.0,), ((1,),)
        )
        found, slope = function.at({coordinate: values[POSES:]})
        off, turned = (found - length[POSES:])[:, None], (-slope[0] - arm[POSES:])[:, None]
        errors = [float(of(part)[0]) for part in (off, turned) for of in (_rms, _worst)]
        one = FittedPath(name, function, knots, *errors)
        best = one if best is None or one.badness < best.badness else best
        if one.good:
            break
    assert best is not None
    return best


class _Problem:
    """Poses of the coordinates that some paths cross."""

    def __init__(self, values: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
        self.values, self.middle, self.half = values, (low + high) / 2, np.maximum((high - low) / 2, 1e-6)

    def orders(self, most: int) -> Iterable[int]:
        """Return the orders to try."""
        dimension = self.values.shape[1]
        return [order for order in range(1, most + 1) if len(exponents(dimension, order)) <= MOST_TERMS]

    def fitted(
        self, order: int, length: np.ndarray, arm: np.ndarray
    ) -> list[tuple[np.ndarray, float, float, float, float]]:
        """Return coefficients and errors of polynomials of an order; see `FittedPath`.

        Args:
            order: The order.
            length: Of paths in all poses, shape (poses, paths).
            arm: Moment arms about the coordinates, shape (poses, paths, coordinates).
        """
        x = (self.values - self.middle) / self.half
        to_monomials = chebyshev_in(order)
        curves = [to_monomials @ _powers(column, order) for column in x[:POSES].T]
        slopes = [to_monomials @ _power_slopes(column, order) for column in x[:POSES].T]
        terms = exponents(x.shape[1], order)
        rows = [_products(curves, terms) / LENGTH]
        rows += [
            _products([*curves[:k], slope, *curves[k + 1 :]], terms) / (-ARM * self.half[k])
            for k, slope in enumerate(slopes)
        ]
        matrix = np.concatenate(rows)
        wanted = [length[:POSES] / LENGTH, *(arm[:POSES, :, k] / ARM for k in range(x.shape[1]))]
        solution = np.linalg.lstsq(matrix.T @ matrix, matrix.T @ np.concatenate(wanted), rcond=1e-14)[0]
        coefficients = self._in_coordinates(solution, order, terms)
        left = self.values[POSES:].T
        powers, steep = ([of(column, order) for column in left] for of in (_powers, _power_slopes))
        off = [_products(powers, terms) @ coefficients - length[POSES:]]
        off += [
            -_products([*powers[:k], slope, *powers[k + 1 :]], terms) @ coefficients - arm[POSES:, :, k]
            for k, slope in enumerate(steep)
        ]
        lengths, arms = off[0], np.concatenate(off[1:])
        errors = [of(part) for part in (lengths, arms) for of in (_rms, _worst)]
        return [(row, *map(float, one)) for row, *one in zip(coefficients.T, *errors, strict=True)]

    def _in_coordinates(self, solution: np.ndarray, order: int, terms: list[tuple[int, ...]]) -> np.ndarray:
        """Return coefficients of powers of coordinates, of those of Chebyshev's polynomials."""
        dimension = self.values.shape[1]
        tensor = np.zeros((*(order + 1,) * dimension, solution.shape[1]))
        places = tuple(np.array(terms).T)
        tensor[places] = solution
        for k, (middle, half) in enumerate(zip(self.middle, self.half, strict=True)):
            shift = np.zeros((order + 1, order + 1))  # ((q - middle) / half)^p in powers of q
            power = np.polynomial.Polynomial([1.0])
            for p in range(order + 1):
                shift[p, : p + 1] = power.coef
                power *= np.polynomial.Polynomial([-middle / half, 1 / half])
            tensor = np.moveaxis(np.tensordot(tensor, chebyshev_in(order) @ shift, (k, 0)), -1, k)
        return tensor[places]


def chebyshev_in(order: int) -> np.ndarray:
    """Return Chebyshev's polynomials up to an order, a row each, in ascending powers."""
    rows = np.zeros((order + 1, order + 1))
    for number, row in enumerate(rows):
        row[: number + 1] = chebyshev.cheb2poly(np.eye(number + 1)[number])
    return rows


def _powers(x: np.ndarray, order: int) -> np.ndarray:
    """Return x^0 to x^order, shape (order + 1, n)."""
    return x ** np.arange(order + 1)[:, None]


def _power_slopes(x: np.ndarray, order: int) -> np.ndarray:
    """Return their derivatives."""
    power = np.arange(order + 1)[:, None]
    return power * x ** np.maximum(power - 1, 0)


def _products(curves: list[np.ndarray], terms: list[tuple[int, ...]]) -> np.ndarray:
    """Return products of a row of each of some tables, shape (n, terms)."""
    found = np.ones((curves[0].shape[1], len(terms)))
    for curve, rows in zip(curves, np.array(terms).T, strict=True):
        found *= curve[rows].T
    return found


def _worst(error: np.ndarray) -> np.ndarray:
    return np.abs(error).max(axis=0)


def _rms(error: np.ndarray) -> np.ndarray:
    return np.sqrt((error**2).mean(axis=0))


def write_fitted(source: Path, output: Path, most_order: int = MOST_ORDER) -> str:
    """Fit the paths of a model up to an order, write `FILES` into a folder, and return what is to be said.

    Raises:
        ValueError: The file is not what it should be.
        OSError: A file cannot be read or written.
    """
    bones = Bones.read(source)
    fitted, without = fit_function_paths(bones, most_order)
    write_function_paths(output / FILES[0], bones.model, fitted)
    columns = (
        *("length rms [m]", "length worst [m]", "moment arm rms [m]", "moment arm worst [m]"),
        "jump of the path [m]",
    )
    rows = [",".join(("path", "coordinates", "order or knots", *columns))]
    for one in fitted:
        errors = one.length_rms, one.length_worst, one.arm_rms, one.arm_worst, one.jump
        cells = [one.name, " ".join(one.function.coordinates), str(one.order), *map("{:.3g}".format, errors)]
        rows.append(",".join(cells))
    with in_place(output / FILES[1]) as scratch:
        scratch.write_text("\n".join(rows) + "\n", encoding="utf-8")
    beyond = [one for one in fitted if not one.good]
    said = f"{len(fitted)} paths as functions in {output / FILES[0]}"
    if beyond:
        each = (
            f"{one.name} {1e3 * one.length_worst:.2g} and {1e3 * one.arm_worst:.2g} mm"
            + (f" (its own length jumps by {1e3 * one.jump:.2g} mm)" if one.jump > JUMP else "")
            for one in sorted(beyond, key=lambda one: -one.badness)
        )
        said += (
            f"; {len(beyond)} beyond {1e3 * LENGTH:g} mm of length or {1e3 * ARM:g} mm of arm at worst: "
            + ", ".join(each)
        )
    return said + (f"; none for {', '.join(without)}" if without else "")


def write_function_paths(path: Path, model: Model, fitted: Iterable[FittedPath]) -> None:
    """Write lengths as the set that OpenSim's `ModOpReplacePathsWithFunctionBasedPaths` reads.

    Raises:
        OSError: The file cannot be written.
    """
    root = Element(path, "OpenSimDocument", {"Version": "40600"}, 0)
    objects = root.put("Set_FunctionBasedPath_", "").put("objects", "")
    for one in fitted:
        element = Element(path, "FunctionBasedPath", {"name": f"/forceset/{one.name}"}, 0, parent=objects)
        objects.children.append(element)
        function = one.function
        joints = [f"/jointset/{model.coordinates[name].joint}/{name}" for name in function.coordinates]
        element.put("coordinate_paths", " ".join(joints))
        held = element.put("length_function", "")
        if isinstance(spline := function.functions[0], SimmSpline):
            inner = held.put("SimmSpline", "")
            inner.put_numbers("x", np.array(spline.x))
            inner.put_numbers("y", np.array(spline.y))
            continue
        inner = held.put("MultivariatePolynomialFunction", "")
        inner.put_numbers("coefficients", np.array(function.coefficients))
        inner.put("dimension", str(len(function.coordinates)))
        inner.put("order", str(one.order))
    write(path, root)
