"""The path of a muscle over its points and wrap objects, as OpenSim 4.6 computes it, over many poses.

Active points come first: conditional ones only while their coordinate is in range. Then every wrap object
in turn takes the first straight piece that intersects it, else the one that it lengthens least; with
several objects that repeats, up to eight times, until the length changes by less than 0.5 mm. What follows
is what OpenSim reports, not the shortest path: it caches where a wrap point is in ground when it first asks,
so lengths and directions keep the wrap points of the first round, while arcs are those of the last.
Source of the rules: `GeometryPath.cpp` of opensim-core, and what 4.6 returns.
"""

from collections.abc import Mapping

import numpy as np
from reference.osim_paths.cylinder import INSIDE, MANDATORY, NONE, WRAPPED, Wrap, wrap_cylinder
from reference.osim_paths.ellipsoid import wrap_ellipsoid
from reference.osim_paths.sphere import wrap_sphere, wrap_torus

from myowarp.osim.body.described import path_range, quadrant
from myowarp.osim.body.path_solution import Solution, activity, locations
from myowarp.osim.document.elements import Path
from myowarp.osim.document.kinematics import Frames
from myowarp.osim.document.model import Model, WrapObject

SWEEPS = 8
"""Rounds over several wrap objects."""
SETTLED = 0.0005
"""[m] of change in length after which no further round follows."""


def solve(model: Model, path: Path, frames: Frames, coordinates: Mapping[str, np.ndarray]) -> Solution:
    """Return a path in many poses.

    Args:
        model: to which the path belongs.
        path: of a muscle.
        frames: of the bodies, from the forward kinematics.
        coordinates: values of all coordinates [rad] or [m], each of shape `(n,)`.
    """
    # OpenSim places moving points as if their coordinates did not leave their ranges.
    within = {name: np.clip(value, *model.coordinates[name].range) for name, value in coordinates.items()}
    points = locations(path, frames, within)
    active = activity(path, coordinates, len(points))
    return _Solver(model, path, points, active, frames).solution()


def wrap_lines(wrap: WrapObject, method: str, start: np.ndarray, end: np.ndarray, adjust: bool) -> Wrap:
    """Wrap lines given in the frame of a wrap object [m], shape `(n, 3)`."""
    axis, sign = quadrant(wrap.quadrant)
    if wrap.kind == "cylinder":
        return wrap_cylinder(start, end, wrap.size[0], wrap.size[1], axis, sign, adjust)
    if wrap.kind == "sphere":
        return wrap_sphere(start, end, wrap.size[0], axis, sign)
    if wrap.kind == "torus":
        return wrap_torus(start, end, wrap.size[0], wrap.size[1], axis, sign, adjust)
    return wrap_ellipsoid(start, end, wrap.size, axis, sign, method)


class _Solver:
    """The state of OpenSim's iteration over wrap objects, in all poses at once."""

    def __init__(
        self, model: Model, path: Path, points: np.ndarray, active: np.ndarray, frames: Frames
    ) -> None:
        count, self.points = points.shape[:2]
        self.path, self.active = path, active
        self.wraps = [model.wraps[wrap.object] for wrap in path.wraps]
        width = self.points + 2 * len(self.wraps)
        self.location = np.zeros((count, width, 3))
        self.location[:, : self.points] = points
        self.cached = np.full_like(self.location, np.nan)
        self.order = np.full((count, width), -1)
        self.order[:, : self.points] = np.where(active, np.arange(self.points), -1)
        self._pack(np.arange(count))
        self.arc = np.zeros((count, len(self.wraps)))
        self.frames = []
        for wrap in self.wraps:
            rotation, origin = frames[wrap.body]
            self.frames.append((rotation @ wrap.frame.rotation, origin + rotation @ wrap.frame.position))

    def solution(self) -> Solution:
        """Iterate, and return what results."""
        count, wraps = len(self.order), len(self.wraps)
        turn = np.tile(np.arange(wraps), (count, 1))
        busy = np.arange(count if wraps else 0)
        last = np.full(count, np.inf)
        for sweep in range(1 if wraps < 2 else SWEEPS):
            status = np.full((count, wraps), NONE)
            for place in range(wraps):
                for wrap in range(wraps):
                    rows = busy[turn[busy, place] == wrap]
                    self._remove(rows, wrap)
                    if self.wraps[wrap].active:
                        rows, found = self._apply(rows, wrap)
                        status[rows, place] = found
            length = self._length()
            busy = busy[~(np.abs(length[busy] - last[busy]) < SETTLED)]
            last = length
            if sweep == 0 and wraps > 1:
                swap = busy[(status[busy, 0] == NONE) & (status[busy, 1] == INSIDE)]
                turn[swap[:, None], [0, 1]] = [1, 0]
                self._remove(swap, 0)
        arc = (
            np.where(np.stack([self._has(w) for w in range(wraps)], 1), self.arc, 0.0) if wraps else self.arc
        )
        return Solution(self._length(), self.order, self.location, self.cached, arc)

    def _has(self, wrap: int) -> np.ndarray:
        return (self.order == self.points + 2 * wrap).any(axis=1)

    def _pack(self, rows: np.ndarray) -> None:
        """Move what the path consists of to the front."""
        order = self.order[rows]
        front = np.argsort(order < 0, axis=1, kind="stable")
        self.order[rows] = np.take_along_axis(order, front, axis=1)

    def _remove(self, rows: np.ndarray, wrap: int) -> None:
        """Take the two points of a wrap out of the path."""
        first = self.points + 2 * wrap
        order = self.order[rows]
        order[(order == first) | (order == first + 1)] = -1
        self.order[rows] = order
        self._pack(rows)

    def _apply(self, rows: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Wrap the best piece of the paths over one object; return the poses tried and the last status."""
        first, last = path_range(self.path.wraps[number], self.points)
        if last <= first:
            return rows[:0], np.zeros(0, int)
        allowed = self.active[rows, first : last + 1]
        rows, allowed = rows[allowed.any(axis=1)], allowed[allowed.any(axis=1)]
        begin = first + np.argmax(allowed, axis=1)
        end = last - np.argmax(allowed[:, ::-1], axis=1)
        order = self.order[rows]
        begin, end = (np.argmax(order == point[:, None], axis=1) for point in (begin, end))
        status = np.full(len(rows), NONE)
        best = _Best(len(rows))
        for piece in range(self.order.shape[1] - 1):
            one, other = order[:, piece], order[:, piece + 1]
            free = ~self._on_one_object(one, other) & ~best.final
            tried = np.flatnonzero((piece >= begin) & (piece < end) & free)
            if not len(tried):
                continue
            ends = [self.location[rows[tried], points[tried]] for points in (one, other)]
            rotation, origin = (values[rows[tried]] for values in self.frames[number])
            local = [np.einsum("nji,nj->ni", rotation, points - origin) for points in ends]
            method = self.path.wraps[number].method
            wrap = wrap_lines(self.wraps[number], method, local[0], local[1], len(self.wraps) > 1)
            status[tried] = wrap.status
            placed = [
                origin + np.einsum("nij,nj->ni", rotation, points) for points in (wrap.first, wrap.last)
            ]
            possible = np.flatnonzero(wrap.status == WRAPPED)
            for index, points in enumerate((one, other)):
                known = self._remembered(rows[tried][possible], points[tried][possible])
                ends[index][possible] = known
            best.offer(tried, piece, wrap, ends, placed)
        self._insert(rows, number, best)
        return rows, status

    def _remembered(self, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return where points are in ground [m]: where they were when this was first asked."""
        new = np.isnan(self.cached[rows, points, 0])
        self.cached[rows[new], points[new]] = self.location[rows[new], points[new]]
        return self.cached[rows, points]

    def _on_one_object(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Whether pairs of points are wrap points on the same object."""
        if not self.wraps:
            return np.zeros(len(one), bool)
        objects = [wrap.object for wrap in self.path.wraps]
        unique = np.array([objects.index(name) for name in objects])
        wraps = [unique[np.maximum(points - self.points, 0) // 2] for points in (one, other)]
        return (one >= self.points) & (other >= self.points) & (wraps[0] == wraps[1])

    def _insert(self, rows: np.ndarray, number: int, best: "_Best") -> None:
        """Put the two points of a wrap into the path."""
        found = best.piece >= 0
        rows, piece = rows[found], best.piece[found]
        place = np.arange(self.order.shape[1])
        source = np.where(place <= piece[:, None], place, np.maximum(place - 2, 0))
        order = np.take_along_axis(self.order[rows], source, axis=1)
        first = self.points + 2 * number
        order[np.arange(len(rows)), piece + 1] = first
        order[np.arange(len(rows)), piece + 2] = first + 1
        self.order[rows] = order
        self.location[rows, first], self.location[rows, first + 1] = best.first[found], best.last[found]
        self.arc[rows, number] = best.length[found]

    def _length(self) -> np.ndarray:
        """Return the lengths of the paths as they stand [m]."""
        total = np.zeros(len(self.order))
        for piece in range(self.order.shape[1] - 1):
            one, other = self.order[:, piece], self.order[:, piece + 1]
            rows = np.flatnonzero(other >= 0)
            one, other = one[rows], other[rows]
            straight = np.linalg.norm(self._remembered(rows, one) - self._remembered(rows, other), axis=1)
            over = self._on_one_object(one, other)
            if over.any():
                arc = self.arc[rows, np.maximum(other - self.points, 0) // 2]
                arrives = (other - self.points) % 2 == 0
                straight = np.where(over, np.where(arrives, 0.0, arc), straight)
            total[rows] += straight
        return total


class _Best:
    """The piece of each path that an object takes so far."""

    def __init__(self, count: int) -> None:
        self.piece = np.full(count, -1)
        self.final = np.zeros(count, bool)
        self.change = np.full(count, np.inf)
        self.first, self.last = np.zeros((count, 3)), np.zeros((count, 3))
        self.length = np.zeros(count)

    def offer(self, tried: np.ndarray, piece: int, wrap: Wrap, ends: list, placed: list) -> None:
        """Take a wrapped piece where it is the first that intersects, or the least longer one."""
        straight = np.linalg.norm(ends[0] - ends[1], axis=1)
        detour = np.linalg.norm(ends[0] - placed[0], axis=1) + np.linalg.norm(ends[1] - placed[1], axis=1)
        change = detour + wrap.length - straight
        mandatory = wrap.status == MANDATORY
        better = mandatory | ((wrap.status == WRAPPED) & (change < self.change[tried]))
        rows = tried[better]
        self.piece[rows] = piece
        self.change[rows] = change[better]
        self.first[rows], self.last[rows] = placed[0][better], placed[1][better]
        self.length[rows] = wrap.length[better]
        self.final[tried] = mandatory
