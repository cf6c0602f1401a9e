"""A path over its points and wrap objects in many poses, as OpenSim 4.6 reports it, by the device's kernel.

What follows is what OpenSim reports, not the shortest path: it caches where a wrap point is in ground when it
first asks, so lengths and directions keep the wrap points of the first round, while arcs are those of the
last (`laws.paths.path`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import warp as wp

from myowarp.laws.paths.tables import PathMemory
from myowarp.osim.body.described import RANGE_SLACK, described
from myowarp.osim.document.elements import ConditionalPathPoint, MovingPathPoint, Path
from myowarp.osim.document.kinematics import Frames
from myowarp.osim.document.model import Model
from myowarp.process import start_warp


@dataclass(frozen=True, eq=False)
class Solution:
    """A path in n poses.

    Attributes:
        length: [m], shape `(n,)`.
        order: what the path consists of, shape `(n, points + 2 wraps)`: numbers of points, then
            `points + 2 w` and `points + 2 w + 1` where it arrives at and leaves wrap `w`; -1 fills up.
        location: of points and wrap points in ground [m], shape `(n, points + 2 wraps, 3)`.
        cached: the same as OpenSim remembers them; lengths and directions come from these.
        arc: length over each wrap object [m], 0 where it does not touch, shape `(n, wraps)`.
    """

    length: np.ndarray
    order: np.ndarray
    location: np.ndarray
    cached: np.ndarray
    arc: np.ndarray

    def wrapped(self, wrap: int) -> np.ndarray:
        """Whether the path wraps over wrap number `wrap`, shape `(n,)`."""
        points = self.order.shape[1] - 2 * self.arc.shape[1]
        return (self.order == points + 2 * wrap).any(axis=1)

    def before(self, wrap: int) -> np.ndarray:
        """Number of the path point before wrap number `wrap`, -1 where it does not wrap, shape `(n,)`."""
        points = self.order.shape[1] - 2 * self.arc.shape[1]
        at = np.argmax(self.order == points + 2 * wrap, axis=1)
        earlier = np.arange(self.order.shape[1]) < at[:, None]
        last = np.where(earlier & (self.order < points), self.order, -1).max(axis=1)
        return np.where(self.wrapped(wrap), last, -1)


def solve(model: Model, path: Path, frames: Frames, coordinates: Mapping[str, np.ndarray]) -> Solution:
    """Return a path in many poses.

    Args:
        model: To which the path belongs.
        path: Of a muscle.
        frames: Of the bodies, from the forward kinematics.
        coordinates: Values of all coordinates [rad] or [m], each of shape `(n,)`.
    """
    paths, needed = described(model, {"": path})
    points, wraps = len(path.points), len(path.wraps)
    rotations, origins = zip(*(frames[name] for name in paths.bodies), strict=True)
    count = len(origins[0])
    start_warp()
    with wp.ScopedDevice("cpu"):
        memory = PathMemory(paths, count, len(needed), guard=0.0)
        memory.frames.rotation.assign(np.stack(rotations, axis=1))
        memory.frames.origin.assign(np.stack(origins, axis=1))
        if needed:
            values = [function.value(coordinates[name]) for function, name in needed]
            memory.frames.value.assign(np.stack(values, axis=1))
        memory.launch()
        place, size = np.arange(points + 2 * wraps), memory.pulls.size.numpy()
        order = np.where(place < size, memory.memory.order.numpy(), -1)
        there = (order[:, :, None] == points + 2 * np.arange(wraps)).any(axis=1)
        return Solution(
            memory.pulls.length.numpy()[:, 0],
            order,
            memory.memory.location.numpy(),
            memory.memory.cached.numpy(),
            np.where(there, memory.memory.arc.numpy()[:, :wraps], 0.0),
        )


def load_kernel() -> None:
    """Load the kernel of `solve`, which processes that are forked afterwards then have."""
    start_warp()
    wp.load_module("myowarp.laws.paths.path", device="cpu")


def locations(path: Path, frames: Frames, coordinates: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the points of a path in ground, active or not [m], shape `(n, points, 3)`."""
    placed = []
    for point in path.points:
        rotation, origin = frames[point.body]
        if isinstance(point, MovingPathPoint):
            axes = [
                function.value(coordinates[name] if name is not None else np.zeros(len(origin)))
                for function, name in zip(point.functions, point.coordinates, strict=True)
            ]
            local = point.frame.position + np.stack(axes, axis=1) @ point.frame.rotation.T
            placed.append(origin + np.einsum("nij,nj->ni", rotation, local))
        else:
            placed.append(origin + rotation @ point.location)
    return np.stack(placed, axis=1)


def activity(path: Path, coordinates: Mapping[str, np.ndarray], count: int) -> np.ndarray:
    """Return which points are part of the path, shape `(n, points)`."""
    active = np.ones((count, len(path.points)), bool)
    for number, point in enumerate(path.points):
        if isinstance(point, ConditionalPathPoint):
            value = coordinates[point.coordinate]
            low, high = point.range[0] - RANGE_SLACK, point.range[1] + RANGE_SLACK
            active[:, number] = (value >= low) & (value <= high)
    return active
