"""Functions in an .osim file -> `functions`."""

from collections.abc import Callable

import numpy as np

from myowarp.osim.document.elements import LengthFunction
from myowarp.osim.document.functions import (
    IDENTITY,
    Constant,
    Function,
    GCVSpline,
    Linear,
    Multiplier,
    PiecewiseConstant,
    PiecewiseLinear,
    Polynomial,
    SimmSpline,
    Sine,
    Step,
)
from myowarp.osim.document.read.element import Element

MAX_KNOTS = 2000


def read_function(element: Element) -> Function:
    """Return the function that an element such as `<SimmSpline>` describes.

    Raises:
        NotImplementedError: Its class is unknown.
        ValueError: Its numbers make no function.
    """
    if element.tag not in READERS:
        raise element.unsupported(f"is no supported function; these are: {', '.join(sorted(READERS))}")
    return READERS[element.tag](element)


def function_in(owner: Element, *tags: str) -> Function | None:
    """Return the function that a property holds, None if the property is missing or empty.

    OpenSim writes `<tag><SimmSpline>...` or, for some classes, `<SimmSpline name="tag">...`; a tag "" is a
    function without a name.

    Raises:
        NotImplementedError: Its class is unknown.
        ValueError: Its numbers make no function.
    """
    for place in (owner, owner.fallback):
        for child in () if place is None else place.children:
            if child.tag in tags and child.children:
                return read_function(child.children[0])
            if child.name in tags and (child.name or child.tag in READERS):
                return read_function(child)
    return None


MOST_POWER = 20
"""Of a variable of a function of several."""


def function_of(element: Element, coordinates: tuple[str, ...]) -> LengthFunction:
    """Return the function of some coordinates that an element describes.

    Raises:
        NotImplementedError: Its class is unknown.
        ValueError: It has another number of arguments.
    """
    scale = 1.0
    while element.tag == "MultiplierFunction":
        scale *= element.number("scale", default=1.0)
        inner = element.find("function")
        if inner is None or not inner.children:
            raise element.error("has no <function>")
        element = inner.children[0]
    count = len(coordinates)
    functions: tuple[Function, ...] = (IDENTITY,) * count
    match element.tag:
        case "MultivariatePolynomialFunction":
            powers, numbers = _multivariate(element, count)
        case "LinearFunction":
            numbers = element.numbers("coefficients", default=(1.0,) * count + (0.0,), count=count + 1)
            powers = [tuple(row) for row in np.eye(count, dtype=int).tolist()] + [(0,) * count]
        case "Constant":
            numbers, powers = np.array([element.number("value", default=0.0)]), [(0,) * count]
        case _ if count == 1:
            functions, numbers, powers = (read_function(element),), np.ones(1), [(1,)]
        case _:
            raise element.unsupported(
                f"is no function of {count} coordinates; these are: MultivariatePolynomialFunction, "
                "LinearFunction, Constant, MultiplierFunction of these"
            )
    terms = [(scale * float(c), p) for c, p in zip(numbers, powers, strict=True) if c != 0]
    terms = terms or [(0.0, (0,) * count)]
    return LengthFunction(coordinates, functions, *(tuple(part) for part in zip(*terms, strict=True)))


def _multivariate(element: Element, count: int) -> tuple[list[tuple[int, ...]], np.ndarray]:
    """Return powers and coefficients of the terms: ascending powers, those of the last variable first."""
    dimension, order = (int(element.number(name, default=0.0)) for name in ("dimension", "order"))
    if dimension != count:
        raise element.error(f"must have as many dimensions as coordinates, {count}, got {dimension}")
    if not 0 <= order <= MOST_POWER:
        raise element.error(f"must have an order of 0 to {MOST_POWER}, got {order}")
    powers = exponents(dimension, order)
    return powers, element.numbers("coefficients", count=len(powers))


def exponents(dimension: int, order: int) -> list[tuple[int, ...]]:
    """Return the powers of all terms of a polynomial in OpenSim's order of coefficients."""
    found: list[tuple[int, ...]] = [()]
    for _ in range(dimension):
        found = [(*powers, power) for powers in found for power in range(order - sum(powers) + 1)]
    return found


def _knots(element: Element, least: int, repeat: bool = False) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return x and y; x ascends, and may repeat where OpenSim has a rule for it."""
    x, y = element.numbers("x"), element.numbers("y")
    if len(x) != len(y) or len(x) < least:
        raise element.error(f"must have at least {least} knots, as many x as y, got {len(x)} and {len(y)}")
    if len(x) > MAX_KNOTS:
        raise element.unsupported(f"has {len(x)} knots; at most {MAX_KNOTS} are supported")
    if (np.diff(x) < 0).any() or not (repeat or np.diff(x).all()):
        raise element.error("must have knots with ascending x")
    return tuple(x.tolist()), tuple(y.tolist())


def _linear(element: Element) -> Function:
    slope, offset = element.numbers("coefficients", default=(1.0, 0.0), count=2)
    return Linear(float(slope), float(offset))


def _polynomial(element: Element) -> Function:
    coefficients = element.numbers("coefficients", default=(1.0,))
    if len(coefficients) > 64:
        raise element.error(f"has {len(coefficients)} coefficients; at most 64 are supported")
    return Polynomial(tuple(coefficients.tolist()))


def _multiplier(element: Element) -> Function:
    inner = function_in(element, "function")
    if inner is None:
        raise element.error("has no <function>")
    return Multiplier(inner, element.number("scale", default=1.0))


def _step(element: Element) -> Function:
    start = element.number("transition_start_time", "start_time", default=0.99)
    end = element.number("transition_end_time", "end_time", default=1.01)
    if end <= start:
        raise element.error(f"must end after it starts, got {start} and {end}")
    return Step(
        start, end, element.number("start_value", default=0.0), element.number("end_value", default=1.0)
    )


def _gcv_spline(element: Element) -> Function:
    half_order = int(element.number("half_order", default=3.0))
    if not 1 <= half_order <= 4:
        raise element.error(f"must have a half_order of 1 to 4, got {half_order}")
    if element.number("error_variance", default=0.0) != 0:
        raise element.unsupported("smooths its knots; only error_variance 0 is supported")
    x, y = _knots(element, max(2, half_order))
    return GCVSpline(x, y, half_order)


def _sine(element: Element) -> Function:
    amplitude, omega = element.number("amplitude", default=1.0), element.number("omega", default=1.0)
    return Sine(amplitude, omega, element.number("phase", default=0.0), element.number("offset", default=0.0))


def _piecewise_constant(element: Element) -> Function:
    return PiecewiseConstant(*_knots(element, 1))


def _simm_spline(element: Element) -> Function:
    return SimmSpline(*_knots(element, 2, repeat=True))


READERS: dict[str, Callable[[Element], Function]] = {
    "Constant": lambda element: Constant(element.number("value", default=0.0)),
    "LinearFunction": _linear,
    "PolynomialFunction": _polynomial,
    "MultiplierFunction": _multiplier,
    "SimmSpline": _simm_spline,
    "NaturalCubicSpline": _simm_spline,
    "natCubicSpline": _simm_spline,
    "GCVSpline": _gcv_spline,
    "PiecewiseLinearFunction": lambda element: PiecewiseLinear(*_knots(element, 2)),
    "PiecewiseConstantFunction": _piecewise_constant,
    "StepFunction": _step,
    "Sine": _sine,
}
"""By OpenSim's class; the two natural splines are the older names of SimmSpline."""
