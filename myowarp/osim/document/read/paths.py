"""Wrap objects and paths of an .osim file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from myowarp.laws.paths.path import MOST_VARIABLES
from myowarp.osim.document.elements import (
    ConditionalPathPoint,
    MovingPathPoint,
    Path,
    PathPoint,
    PathWrap,
    Point,
)
from myowarp.osim.document.functions import Constant, Function, affine
from myowarp.osim.document.model import Coordinate, Note, WrapObject
from myowarp.osim.document.read.element import Element
from myowarp.osim.document.read.frames import Frames, pose_of, socket
from myowarp.osim.document.read.functions import function_in, function_of

WRAPS: dict[str, Any] = {
    "WrapCylinder": ("cylinder", ("radius", "length")),
    "WrapSphere": ("sphere", ("radius",)),
    "WrapEllipsoid": ("ellipsoid", ("dimensions",)),
    "WrapTorus": ("torus", ("inner_radius", "outer_radius")),
}
"""OpenSim's class: kind, and the properties that are its size."""

QUADRANTS = ("all", "x", "-x", "y", "-y", "z", "-z")

METHODS = ("hybrid", "midpoint", "axial")

MAX_POINTS = 1000  # of one path

FUNCTIONS = "FunctionBasedPath"

POSES, CONSISTENT = 64, 1e-6
"""Random poses in which its moment arms and speeds may differ from those of its length [m, m/s]."""


@dataclass(frozen=True)
class Scope:
    """Objects to which elements of a path refer."""

    frames: Frames
    coordinates: Mapping[str, Coordinate]
    wraps: dict[str, WrapObject]
    notes: list[Note]
    """Filled while reading."""

    def coordinate(self, element: Element, *sockets: str) -> str:
        """Return the coordinate that one of these sockets leads to."""
        target = socket(element, *sockets)
        *_, joint, name = "", *target.split("/")
        longer = f"{joint}_{name}"
        if longer in self.coordinates and name in self.coordinates and self.coordinates[name].joint != joint:
            name = longer  # as `read.model` calls a coordinate of a name that another joint has, too
        if name not in self.coordinates:
            raise element.error(f"refers to coordinate {target!r}, which the model does not have")
        return name


def read_wraps(model: Element, frames: Frames) -> tuple[dict[str, WrapObject], list[Note]]:
    """Return all wrap objects by name; a later one with the same name is called body/name."""
    wraps: dict[str, WrapObject] = {}
    notes: list[Note] = []
    for group in model.walk():
        if group.tag != "WrapObjectSet":
            continue
        for element in group.objects("objects"):
            if element.tag not in WRAPS:
                raise element.unsupported(f"is no supported wrap object; these are: {', '.join(WRAPS)}")
            wrap = _read_wrap(element, frames)
            key = wrap.name
            if key in wraps:
                key = f"{wrap.body}/{wrap.name}"
                if key in wraps:
                    raise element.error("has the name of another wrap object of the same body")
                notes.append(
                    Note(f"/bodyset/{key}", f"paths mean the wrap object {wrap.name!r} that comes first")
                )
                wrap = WrapObject(
                    key, wrap.kind, wrap.body, wrap.frame, wrap.size, wrap.quadrant, wrap.active
                )
            wraps[key] = wrap
    return wraps, notes


def _read_wrap(element: Element, frames: Frames) -> WrapObject:
    """Return a wrap object."""
    kind, properties = WRAPS[element.tag]
    body, base = frames.of_owner(element)
    frame = base @ pose_of(element, ("translation",), ("xyz_body_rotation",))
    size = tuple(float(value) for name in properties for value in element.numbers(name))
    expected = 3 if kind == "ellipsoid" else len(properties)
    if len(size) != expected or min(size) <= 0:
        raise element.error(
            f"must have {' and '.join(properties)} above 0, got {' '.join(f'{s:g}' for s in size)}"
        )
    if kind == "torus" and size[0] >= size[1]:
        raise element.error(f"must have an outer radius above the inner one, got {size[1]:g} and {size[0]:g}")
    quadrant = element.string("quadrant", default="all").lower().lstrip("+")
    if quadrant in ("unassigned", ""):
        quadrant = "all"
    if quadrant not in QUADRANTS:
        raise element.error(f"has quadrant {quadrant!r}; available: {', '.join(QUADRANTS)}")
    return WrapObject(element.name, kind, body, frame, size, quadrant, element.flag("active", default=True))


def read_path(owner: Element, scope: Scope) -> Path:
    """Return the path of a muscle, ligament or spring.

    Raises:
        NotImplementedError: A kind of path or point that is not supported.
        ValueError: Points, bodies or wrap objects are missing or wrong.
    """
    held = owner.find("path")
    element = None
    for place in (owner, held):
        if element is None and place is not None:
            element = place.find("GeometryPath", FUNCTIONS)
    if element is not None and element.tag == FUNCTIONS:
        return read_function_path(element, scope.coordinates)
    if element is None and owner.find("PathPointSet") is not None:
        element = owner  # as in documents before 20302
    if element is None:
        there = [child for place in (owner, held) if place is not None for child in place.children]
        other = next((child for child in there if "Path" in child.tag), owner)
        raise other.unsupported(f"is no supported kind of path; these are: GeometryPath, {FUNCTIONS}")
    points = element.objects("PathPointSet")
    if not 2 <= len(points) <= MAX_POINTS:
        raise element.error(f"must have 2 to {MAX_POINTS} path points, got {len(points)}")
    read = tuple(_read_point(point, scope) for point in points)
    wraps = [_read_path_wrap(wrap, scope, len(read)) for wrap in element.objects("PathWrapSet")]
    return Path(read, tuple(wrap for wrap in wraps if wrap is not None))


def read_function_path(element: Element, coordinates: Mapping[str, Coordinate]) -> Path:
    """Return a `FunctionBasedPath`.

    Raises:
        NotImplementedError: A class of function, or moment arms or speeds that are not those of the length.
        ValueError: It has no length, or not the functions and coordinates that it needs.
    """
    paths = element.string("coordinate_paths").split()
    names = tuple(path.rpartition("/")[2] for path in paths)
    for name, path in zip(names, paths, strict=True):
        if name not in coordinates:
            raise element.error(f"refers to coordinate {path!r}, which the model does not have")
    if not names or len(set(names)) < len(names):
        raise element.error(f"must have coordinates, each once, got {' '.join(paths) or 'none'}")
    if len(names) > MOST_VARIABLES:
        raise element.unsupported(
            f"depends on {len(names)} coordinates; at most {MOST_VARIABLES} are supported"
        )
    length, arms, speed = (
        element.objects(tag)
        for tag in ("length_function", "moment_arm_functions", "lengthening_speed_function")
    )
    if not length:
        raise element.error("has no <length_function>")
    if arms and len(arms) != len(names):
        raise element.error(f"must have a moment arm for each of {len(names)} coordinates, got {len(arms)}")
    function = function_of(length[0], names)
    low, high = np.array([coordinates[name].range for name in names]).clip(-np.pi, np.pi).T
    random = np.random.default_rng(0)
    at = random.uniform(low, np.maximum(high, low + 0.1), size=(POSES, len(names))).T
    values = dict(zip(names, at, strict=True))
    slopes = function.at(values)[1]
    rates = {f"speed of {name}": random.normal(size=POSES) for name in names}
    found = [(-function_of(arm, names).at(values)[0], one) for arm, one in zip(arms, slopes, strict=False)]
    if speed:
        along = (slopes * np.stack(list(rates.values()))).sum(axis=0)
        found.append((function_of(speed[0], (*names, *rates)).at(values | rates)[0], along))
    off = max((float(np.abs(stated - own).max()) for stated, own in found), default=0.0)
    if off > CONSISTENT:
        raise element.unsupported(
            f"states moment arms or speeds up to {off:.2g} m or m/s from those that follow from its length; "
            "only such are supported: take them out"
        )
    return Path((), (), function)


def _read_point(element: Element, scope: Scope) -> Point:
    """Return a path point."""
    body, frame = scope.frames.attached(element, "parent_frame", "body")
    if element.tag == "MovingPathPoint":
        return _read_moving_point(element, body, frame, scope)
    location = frame.point(element.numbers("location", default=(0.0, 0.0, 0.0), count=3))
    if element.tag == "PathPoint":
        return PathPoint(element.name, body, location)
    if element.tag == "ConditionalPathPoint":
        low, high = element.numbers("range", default=(0.0, 0.0), count=2)
        coordinate = scope.coordinate(element, "coordinate")
        return ConditionalPathPoint(element.name, body, location, coordinate, (float(low), float(high)))
    raise element.unsupported(
        "is no supported path point; these are: PathPoint, ConditionalPathPoint, MovingPathPoint"
    )


def _read_moving_point(element: Element, body: str, frame: Any, scope: Scope) -> Point:
    """Return a moving path point, or a fixed one if it does not move."""
    functions: list[Function] = []
    coordinates: list[str | None] = []
    for axis in "xyz":
        function = function_in(element, f"{axis}_location") or Constant(0.0)
        line = affine(function)
        has = socket(element, f"{axis}_coordinate")
        if line is not None and line[0] == 0:
            functions.append(Constant(line[1]))
            coordinates.append(None)
        elif has:
            functions.append(function)
            coordinates.append(scope.coordinate(element, f"{axis}_coordinate"))
        else:
            raise element.error(f"has no <socket_{axis}_coordinate>, but its {axis} moves")
    if coordinates == [None] * 3:
        return PathPoint(element.name, body, frame.point([float(f.value(0.0)) for f in functions]))
    x, y, z = functions
    a, b, c = coordinates
    return MovingPathPoint(element.name, body, frame, (x, y, z), (a, b, c))


def _read_path_wrap(element: Element, scope: Scope, points: int) -> PathWrap | None:
    """Return a path wrap; None if its object is switched off."""
    name = socket(element, "wrap_object")
    name = name.rsplit("/", 1)[-1]
    if name not in scope.wraps:
        raise element.error(f"refers to wrap object {name!r}, which the model does not have")
    method = element.string("method", default="hybrid").lower()
    if method in ("unassigned", ""):
        method = "hybrid"
    if method not in METHODS:
        raise element.error(f"has method {method!r}; available: {', '.join(METHODS)}")
    first, last = (int(value) for value in element.numbers("range", default=(-1.0, -1.0), count=2))
    # OpenSim lets a path wrap along its whole length where a bound makes no sense.
    first = first if 1 <= first <= points else -1
    last = last if 1 <= last <= points else -1
    if 1 <= last < first:
        raise element.error(
            f"has a range from point {first} back to {last}, on which OpenSim fails; swap them"
        )
    return PathWrap(name, method, (first, last))  # type: ignore[arg-type]
