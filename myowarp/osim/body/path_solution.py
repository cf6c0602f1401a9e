"""Paths over points and wrap objects in many poses, as OpenSim 4.6 reports them, by the device's kernel.

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
from myowarp.osim.document.dynamics import moving_frames, rates
from myowarp.osim.document.elements import ConditionalPathPoint, MovingPathPoint, Path
from myowarp.osim.document.kinematics import Frames
from myowarp.osim.document.model import Model
from myowarp.process import start_warp

TOGETHER = 256  # poses in a launch: working memory is 0.1 MB for each


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


@dataclass(frozen=True, eq=False)
class PathsFound:
    """Paths in n poses.

    Attributes:
        length: [m], shape (n, paths).
        size: Number of points and wrap points, shape (n, paths).
        velocity: [m/s], lengthening > 0, shape (n, paths).
        moment_arm: OpenSim's `computeMomentArm` about the independent coordinates [m] or [1], in their order,
            shape (n, paths, independent).
        jumps: Where a wrap that OpenSim takes was refused by the guard, shape (n, paths).
    """

    length: np.ndarray
    size: np.ndarray
    velocity: np.ndarray
    moment_arm: np.ndarray
    jumps: np.ndarray


def lengths_and_moment_arms(
    model: Model,
    paths: Mapping[str, Path],
    values: Mapping[str, np.ndarray],
    speeds: np.ndarray,
    guard: float = 0.0,
) -> PathsFound:
    """Return lengths, speeds and moment arms of paths in many poses.

    The same numbers as `moment_arm.own_reference`: one launch for all paths, and partial velocities of bodies
    in place of poses beside each pose.

    Args:
        model: The model.
        paths: Paths of muscles, ligaments or actuators, by name.
        values: Of independent coordinates [rad] or [m], each of shape (n,); others stand at default.
        speeds: Of the independent coordinates in their order, shape (n, independent).
        guard: Times once round all surfaces of a path, by which one wrap may make it longer; 0: as OpenSim.
    """
    count = len(speeds)
    paths_of, needed = described(model, paths)
    found = PathsFound(
        np.zeros((count, len(paths))),
        np.zeros((count, len(paths)), int),
        np.zeros((count, len(paths))),
        np.zeros((count, len(paths), speeds.shape[1])),
        np.zeros((count, len(paths)), bool),
    )
    with wp.ScopedDevice("cpu"):
        memory = PathMemory(paths_of, min(count, TOGETHER), len(needed), guard)
        for first in range(0, count, TOGETHER):
            rows = np.arange(first, min(first + TOGETHER, count))
            padded = np.resize(rows, memory.worlds)
            coordinates = rates(model, {k: np.asarray(v)[padded] for k, v in values.items()}, speeds[padded])
            frames = moving_frames(model, coordinates)
            bodies = [frames[name] for name in paths_of.bodies]
            curves = [
                function.derivatives(coordinates.value[coordinate])[:2] for function, coordinate in needed
            ]
            memory.frames.origin.assign(np.stack([body.origin for body in bodies], axis=1))
            memory.frames.rotation.assign(np.stack([body.rotation for body in bodies], axis=1))
            if needed:
                memory.frames.value.assign(np.stack([value for value, _ in curves], axis=1))
            memory.launch()
            changing = [
                slope * coordinates.rate[name] for (_, slope), (_, name) in zip(curves, needed, strict=True)
            ]
            pulls = memory.pulls
            arrays = (pulls.force, pulls.torque, pulls.twist, pulls.along, pulls.within)
            force, torque, twist, along, within = (array.numpy() for array in arrays)
            found.length[rows] = pulls.length.numpy()[: len(rows)]
            found.size[rows] = pulls.size.numpy()[: len(rows)]
            found.jumps[rows] = pulls.jumps.numpy()[: len(rows)] > 0
            for number, path in enumerate(paths_of.paths.values()):
                rate = np.zeros((1 + speeds.shape[1], len(padded)))
                inner = np.zeros(len(padded))
                for handle, name in enumerate(paths_of.handles(path), memory.handles[number]):
                    body, pull = frames[name], force[:, handle]
                    about = torque[:, handle] - np.cross(body.origin, pull)
                    rate += np.einsum("lna,na->ln", body.velocity, pull)
                    rate += np.einsum("lna,na->ln", body.turn, about)
                    inner += np.einsum("na,na->n", body.turn[0], twist[:, handle])
                for moving in memory.path_moving[number]:
                    for axis, value in enumerate(memory.moving[moving]):
                        if value >= 0:
                            rate += along[:, moving, axis] * changing[value]
                            inner += within[:, moving, axis] * changing[value][0]
                found.velocity[rows, number] = (rate[0] + inner)[: len(rows)]
                found.moment_arm[rows, number] = -rate[1:, : len(rows)].T
    return found
