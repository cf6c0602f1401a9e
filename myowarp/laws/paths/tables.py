"""OpenSim's paths as tables for the kernel of `path`, and the memory that it works in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.lanes import WIDEST
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of, zeros_of
from myowarp.laws.paths.ellipsoid import AXIAL, HYBRID, MIDPOINT, SAMPLED
from myowarp.laws.paths.path import (
    CYLINDER,
    ELLIPSOID,
    MOST_VARIABLES,
    SPHERE,
    TORUS,
    Followed,
    Frames,
    PathTables,
    Pulls,
    follow_paths,
)
from myowarp.laws.paths.polynomials import follow_polynomials

KINDS = {"cylinder": int(CYLINDER), "sphere": int(SPHERE), "ellipsoid": int(ELLIPSOID), "torus": int(TORUS)}
METHODS = {"hybrid": int(HYBRID), "midpoint": int(MIDPOINT), "axial": int(AXIAL)}

TURNS = 2.0
"""Times once round all surfaces of a path, by which one wrap may make it longer; more is a jump of OpenSim's.

In 500 random poses of MoBL-ARMS 17 of 25,000 paths are beyond, 0.84 m long in the median, and one of the
others is beyond 1.5; of four other models none is beyond 0.5.
"""

Vector = tuple[float, float, float]
Rows = tuple[Vector, Vector, Vector]


FOLLOW_ON_CUDA = wp.Kernel(
    follow_paths.func, module=wp.get_module(f"{__name__}.cuda"), options={"enable_backward": False}
)
"""At -O3 its machine code takes 110 s of a core and 2.2 MB, at -O1 26 s and 0.7 MB (sm_90, CUDA 13.4)."""
FOLLOW_ON_CUDA.module.options["optimization_level"] = 1


@dataclass(frozen=True)
class Via:
    """A point that a path goes through.

    Attributes:
        body: Whose frame it is in.
        location: In the body [m]; of a point that moves the origin of its frame.
        rotation: Of that frame in the body, by rows; None: it does not move.
        values: Numbers of the values that are its x, y, z [m] in the frame; -1: that one stays.
        rest: x, y, z that stay [m].
        condition: Number of the value that says whether it is part of the path; -1: it always is.
        range: Least and greatest such value.
    """

    body: str
    location: Vector
    rotation: Rows | None = None
    values: tuple[int, int, int] = (-1, -1, -1)
    rest: Vector = (0.0, 0.0, 0.0)
    condition: int = -1
    range: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Over:
    """A surface that a path may wrap over.

    Attributes:
        surface: Its name.
        method: Of an ellipsoid, a name in `METHODS`.
        first: First point between which it may, from 0.
        last: Last such point.
    """

    surface: str
    method: str
    first: int
    last: int


@dataclass(frozen=True)
class WrapSurface:
    """A surface that paths wrap over.

    Attributes:
        kind: A name in `KINDS`.
        body: In which it is fixed.
        position: Of its frame in the body [m].
        rotation: The same, by rows.
        size: [m]: radius and length of a cylinder, radius of a sphere, half axes of an ellipsoid, radii of
            the tube and of the centre line of a torus; 0 where there is none.
        axis: Coordinate that the quadrant looks at, 0 to 2.
        sign: Side of it that a path must take, -1 or 1; 0: any.
        active: Whether any path wraps over it.
    """

    kind: str
    body: str
    position: Vector
    rotation: Rows
    size: Vector
    axis: int = 0
    sign: int = 0
    active: bool = True

    @property
    def turn(self) -> float:
        """Once round it [m]."""
        radius = max(self.size) if self.kind == "ellipsoid" else self.size[0]
        return 2 * np.pi * radius


@dataclass(frozen=True)
class Polynomial:
    """A length that is a sum of c x_1^p_1 ... x_n^p_n.

    Attributes:
        values: Numbers of the values that are x_1 to x_n.
        coefficients: Of each term [m].
        powers: Of each term, one for each x.
    """

    values: tuple[int, ...]
    coefficients: tuple[float, ...]
    powers: tuple[tuple[int, ...], ...]

    @property
    def groups(self) -> list[tuple[tuple[int, ...], list[float]]]:
        """Powers of all variables but the last, falling, and coefficients of the last's powers from 0 on."""
        found: dict[tuple[int, ...], list[float]] = {}
        for coefficient, (*others, last) in zip(self.coefficients, self.powers, strict=True):
            row = found.setdefault(tuple(others), [])
            row += [0.0] * (last + 1 - len(row))
            row[last] += coefficient
        return sorted(found.items(), reverse=True)


@dataclass(frozen=True)
class OsimPath:
    """A path from origin to insertion, and what it may wrap over; or a length that is a polynomial."""

    points: tuple[Via, ...]
    wraps: tuple[Over, ...] = ()
    polynomial: Polynomial | None = None


@dataclass(frozen=True)
class OsimPaths:
    """The paths of a model, by name, and the surfaces that they wrap over."""

    paths: Mapping[str, OsimPath]
    surfaces: Mapping[str, WrapSurface]

    @cached_property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that paths are fixed to."""
        names = [point.body for path in self.paths.values() for point in path.points]
        names += [surface.body for surface in self.surfaces.values()]
        return tuple(dict.fromkeys(names))

    def handles(self, path: OsimPath) -> tuple[str, ...]:
        """Return the bodies that a path pulls on."""
        names = [point.body for point in path.points]
        names += [self.surfaces[wrap.surface].body for wrap in path.wraps]
        return tuple(dict.fromkeys(names))


class PathMemory:
    """Paths on the current Warp device, for a number of worlds.

    Attributes:
        tables: The paths.
        frames: Where bodies are, in the order of `OsimPaths.bodies`; to be written before `launch`.
        memory: What the kernel works in.
        pulls: What it writes.
        moving: Of each moving point the numbers of its values.
        path_variables: Of each path its variables, and of each of these the number of its value.
        handles: Of each path its first handle, and the number of all.
        places: Of each path its first place in `memory`.
    """

    def __init__(
        self, described: OsimPaths, worlds: int, values: int, guard: float = TURNS, exact: bool = True
    ) -> None:
        """Write the tables of paths that depend on a number of values.

        Args:
            described: The paths.
            worlds: Number of worlds.
            values: Number of values that paths depend on.
            guard: As `TURNS`; 0: no guard.
            exact: Whether the fan of an ellipsoid's hybrid method has all of OpenSim's rays; else most lie on
                cubics between a ninth of them, which takes a fifth of the time.
        """
        bodies = {name: number for number, name in enumerate(described.bodies)}
        numbers = {name: number for number, name in enumerate(described.surfaces)}
        surfaces = [
            (KINDS[s.kind], bodies[s.body], s.axis, s.sign, s.active, s.size, s.position, s.rotation)
            for s in described.surfaces.values()
        ]
        points: list[tuple[Any, ...]] = []
        moving: list[tuple[Any, ...]] = []
        wraps: list[tuple[Any, ...]] = []
        paths: list[tuple[Any, ...]] = []
        self.handles = [0]
        self.places: list[int] = []
        self.path_moving: list[range] = []
        variables: list[int] = []
        groups: list[tuple[tuple[int, ...], list[float]]] = []
        self.path_variables: list[dict[int, int]] = []
        place = 0
        for path in described.paths.values():
            own = {name: self.handles[-1] + number for number, name in enumerate(described.handles(path))}
            turns = sum(described.surfaces[wrap.surface].turn for wrap in path.wraps)
            spans = (len(points), len(path.points), len(wraps), len(path.wraps))
            self.places.append(place)
            longest = guard * turns if guard else np.inf
            sizes = [len(variables), 0, len(groups), 0]
            if path.polynomial is not None:
                groups += path.polynomial.groups
                variables += path.polynomial.values
                sizes[1::2] = len(path.polynomial.values), len(groups) - sizes[2]
            self.path_variables.append(dict(enumerate(variables[sizes[0] :], sizes[0])))
            paths.append((*spans, place, self.handles[-1], len(own), longest, *sizes))
            first_moving = len(moving)
            for point in path.points:
                number = -1
                if point.rotation is not None:
                    number = len(moving)
                    moving.append((point.values, point.rest, point.rotation))
                points.append(
                    (
                        bodies[point.body],
                        own[point.body],
                        number,
                        point.condition,
                        *point.range,
                        point.location,
                    )
                )
            self.path_moving.append(range(first_moving, len(moving)))
            over = [wrap.surface for wrap in path.wraps]
            for wrap in path.wraps:
                body = described.surfaces[wrap.surface].body
                like, method = over.index(wrap.surface), METHODS[wrap.method]
                if method == METHODS["hybrid"] and not exact:
                    method = int(SAMPLED)
                wraps.append((numbers[wrap.surface], like, own[body], method, wrap.first, wrap.last))
            place += len(path.points) + 2 * len(path.wraps)
            self.handles.append(self.handles[-1] + len(own))
        self.moving = [tuple(values) for values, _, _ in moving]
        powers, ends, coefficients = _packed(groups)
        self.tables = struct_of(
            PathTables,
            paths=paths,
            points=points,
            moving=moving,
            wraps=wraps,
            surfaces=surfaces,
            variable=variables or [0],
            power=powers,
            first_coefficient=ends,
            coefficient=coefficients,
        )
        self.worlds, self.number = worlds, len(paths)
        functions = [path.polynomial is not None for path in described.paths.values()]
        in_lanes = np.array(functions, bool) & wp.get_device().is_cpu
        self._polynomials = wp.array(np.flatnonzero(in_lanes), dtype=int)
        self._others = wp.array(np.flatnonzero(~in_lanes), dtype=int)
        self._scratch = wp.empty((max(values, 1) + 1) * WIDEST, dtype=wp.float64)
        self._allocate(len(bodies), values, place, len(wraps), len(moving), len(variables))

    def _allocate(
        self, bodies: int, values: int, places: int, wraps: int, moving: int, variables: int
    ) -> None:
        """Allocate what is read, worked in and written, as many of each in every world."""

        def each(*columns: int) -> list[tuple[int, int]]:
            return [(self.worlds, max(count, 1)) for count in columns]

        of_bodies, of_values, of_places, of_wraps = each(bodies, values, places, wraps)
        of_paths, of_handles, of_moving = each(self.number, self.handles[-1], moving)
        (of_variables,) = each(variables)
        self.frames = zeros_of(Frames, origin=of_bodies, rotation=of_bodies, value=of_values)
        self.memory = zeros_of(Followed, order=of_places, location=of_places, cached=of_places, arc=of_wraps)
        self.pulls = zeros_of(
            Pulls,
            **dict.fromkeys(("length", "size", "jumps"), of_paths),
            **dict.fromkeys(("force", "torque", "twist"), of_handles),
            **dict.fromkeys(("along", "within"), of_moving),
            by_variable=of_variables,
        )

    def points(self, world: int) -> list[np.ndarray]:
        """Return the points of every path as last followed in a world, wrap points too [m], (n, 3) each."""
        order, location = self.memory.order.numpy()[world], self.memory.location.numpy()[world]
        sizes = self.pulls.size.numpy()[world].tolist()
        spans = (order[place : place + size] + place for place, size in zip(self.places, sizes, strict=True))
        return [location[span].copy() for span in spans]

    def launch(self) -> None:
        """Follow all paths in the frames as they are."""
        if self._polynomials.size:
            launch(
                follow_polynomials,
                1,
                self.pulls,
                self.frames,
                tables=self.tables,
                numbers=self._polynomials,
                scratch=self._scratch,
            )
        shape = self.worlds, self._others.size
        if wp.get_device().is_cpu:
            if self._others.size:
                launch(follow_paths, shape, self, numbers=self._others)
        else:
            launch(FOLLOW_ON_CUDA, shape, self, numbers=self._others)


def _packed(
    groups: Sequence[tuple[tuple[int, ...], list[float]]],
) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return the groups of polynomials' terms as a kernel reads them; one entry of zero where there are none.

    Returns:
        Powers of each group, shape (num_groups, MOST_VARIABLES); where its coefficients begin and the last
        ones end, shape (num_groups + 1,); and all coefficients [m].
    """
    powers = np.zeros((max(len(groups), 1), MOST_VARIABLES), np.int32)
    for row, (one, _) in zip(powers, groups, strict=False):
        row[: len(one)] = one
    ends = np.cumsum([0, *(len(own) for _, own in groups)], dtype=np.int32)
    return powers, ends, [c for _, own in groups for c in own] or [0.0]
