"""Paths and bushings of a `Model` as the device's tables take them."""

from collections.abc import Callable, Mapping

import numpy as np

from myowarp.laws.paths.tables import OsimPath, OsimPaths, Over, Polynomial, Rows, Vector, Via, WrapSurface
from myowarp.osim.bundle.forces import BodyBushing
from myowarp.osim.document.elements import (
    Bushing,
    ConditionalPathPoint,
    MovingPathPoint,
    Path,
    PathWrap,
    Point,
    Pose,
)
from myowarp.osim.document.functions import IDENTITY, Function, Held
from myowarp.osim.document.model import Model, WrapObject

RANGE_SLACK = 1e-5
"""[rad] or [m] beyond the ends of its range in which OpenSim still counts a conditional point."""
Value = tuple[Function, str]
"""A value that a path depends on: a function, and the coordinate that is its argument."""


def described(
    model: Model, paths: Mapping[str, Path], body: Callable[[str], str] = lambda name: name
) -> tuple[OsimPaths, list[Value]]:
    """Return paths of a model, on bodies of other names, and the values that they depend on."""
    values: list[Value] = []
    objects = dict.fromkeys(wrap.object for path in paths.values() for wrap in path.wraps)
    found = {name: _path(model, path, values, body) for name, path in paths.items()}
    return OsimPaths(found, {name: _surface(model.wraps[name], body) for name in objects}), values


def _path(model: Model, path: Path, values: list[Value], body: Callable[[str], str]) -> OsimPath:
    if (function := path.function) is not None:
        pairs = zip(function.functions, function.coordinates, strict=True)
        numbers = tuple(_number(pair, values) for pair in pairs)
        return OsimPath((), (), Polynomial(numbers, function.coefficients, function.powers))
    over = [Over(wrap.object, wrap.method, *path_range(wrap, len(path.points))) for wrap in path.wraps]
    return OsimPath(
        tuple(_point(model, point, values, body(point.body)) for point in path.points), tuple(over)
    )


def _point(model: Model, point: Point, values: list[Value], body: str) -> Via:
    if isinstance(point, MovingPathPoint):
        numbers, rest = [-1, -1, -1], [0.0, 0.0, 0.0]
        for axis, (function, coordinate) in enumerate(zip(point.functions, point.coordinates, strict=True)):
            if coordinate is None:
                rest[axis] = float(function.value(0.0))
            else:
                held = Held(function, *model.coordinates[coordinate].range)
                numbers[axis] = _number((held, coordinate), values)
        rotation = tuple(vector(row) for row in point.frame.rotation)
        x, y, z = numbers
        return Via(body, vector(point.frame.position), rotation, (x, y, z), vector(rest))  # type: ignore[arg-type]
    if isinstance(point, ConditionalPathPoint):
        condition = _number((IDENTITY, point.coordinate), values)
        low, high = point.range[0] - RANGE_SLACK, point.range[1] + RANGE_SLACK
        return Via(body, vector(point.location), condition=condition, range=(low, high))
    return Via(body, vector(point.location))


def _number(value: Value, values: list[Value]) -> int:
    """Return the number of a value, which is added if it is new."""
    if value not in values:
        values.append(value)
    return values.index(value)


def _surface(wrap: WrapObject, body: Callable[[str], str]) -> WrapSurface:
    axis, sign = quadrant(wrap.quadrant)
    rotation = tuple(vector(row) for row in wrap.frame.rotation)
    size = vector([*wrap.size, 0.0, 0.0][:3])
    position = vector(wrap.frame.position)
    return WrapSurface(wrap.kind, body(wrap.body), position, rotation, size, axis, sign, wrap.active)  # type: ignore[arg-type]


def bushing_of(item: Bushing, body: Callable[[str], str] = lambda name: name) -> BodyBushing:
    """Return a bushing on bodies of other names."""
    one, other = map(body, item.bodies)
    (first_turn, first), (second_turn, second) = map(axes_and_origin, item.frames)
    return BodyBushing(
        bodies=(one, other),
        rotations=(first_turn, second_turn),
        origins=(first, second),
        turn_stiffness=vector(item.rotational_stiffness),
        shift_stiffness=vector(item.translational_stiffness),
        turn_damping=vector(item.rotational_damping),
        shift_damping=vector(item.translational_damping),
        formulas=item.formulas,
    )


def axes_and_origin(frame: Pose) -> tuple[Rows, Vector]:
    """Return axes by rows and origin of a frame."""
    return tuple(vector(row) for row in frame.rotation), vector(frame.position)  # type: ignore[return-value]


def vector(values: np.ndarray | list[float]) -> Vector:
    """Return three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def quadrant(name: str) -> tuple[int, int]:
    """Return axis and sign that a quadrant's name stands for; sign 0 for `all`."""
    letter = name.strip().lower().lstrip("+-")
    if letter not in ("x", "y", "z"):
        return 0, 0
    return "xyz".index(letter), -1 if name.strip().startswith("-") else 1


def path_range(wrap: PathWrap, points: int) -> tuple[int, int]:
    """Return the first and last path point between which a path may wrap, counted from 0."""
    first, last = wrap.range
    return (0 if first < 1 else first - 1), (points if last < 1 else min(last, points)) - 1
