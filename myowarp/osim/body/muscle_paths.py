"""Lengths, velocities and moment arms of a model's muscles along a motion, on the device.

Paths are those of `laws.paths`, OpenSim's, in float64. At unit tension a path pulls with a force F and a
torque T about ground's origin on each body that it is fixed to, and on a moving point along its axes. Moment
arms are what these do at unit speed of a coordinate (`skeleton`: a move shifts with v and turns with w):

    r_k = -(sum over bodies, over the moves below them that k moves, of v . F + w . T
            + sum over moving points of dx/dq_k . F_x)

On the CPU paths that touch no wrap object are followed in SIMD lanes, see `straight_paths`.

Source: OpenSim's `computeMomentArm`; Sherman, Seth, Delp (2013), doi:10.1115/DETC2013-13633.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.laws.paths.path import Frames, PathTables, Pulls
from myowarp.laws.paths.tables import PathMemory
from myowarp.laws.pieces import evaluated
from myowarp.osim.body.described import described
from myowarp.osim.body.parts import in_parts, joined
from myowarp.osim.body.skeleton import Bones, Placement, Skeleton, place
from myowarp.osim.body.straight_paths import StraightPaths, acted_on

TOGETHER = 256
"""Frames whose paths are followed at once: working memory is 0.1 MB for each."""

wp.set_module_options({"enable_backward": False})


@dataclass(frozen=True, eq=False)
class MusclePaths:
    """Paths in all frames.

    Attributes:
        muscles: Names of muscles that apply force.
        length: [m], shape (frames, muscles).
        velocity: [m/s], lengthening > 0.
        moment_arm: About the independent coordinates [m] or [1], shape (frames, muscles, coordinates).
        crossed: For each muscle the numbers of coordinates that it can act on.
    """

    muscles: tuple[str, ...]
    length: np.ndarray
    velocity: np.ndarray
    moment_arm: np.ndarray
    crossed: tuple[tuple[int, ...], ...]

    def part(self, frames: slice) -> MusclePaths:
        """Return the paths of some frames."""
        rows = self.length[frames], self.velocity[frames], self.moment_arm[frames]
        return MusclePaths(self.muscles, *rows, self.crossed)


@wp.kernel(enable_backward=False)
def place_path_bodies(
    # Model:
    skeleton: Skeleton,
    needed: Skeleton,
    body: wp.array[int],
    # In:
    values: wp.array2d[wp.float64],
    # Out:
    placement: Placement,
    frames: Frames,
    slope: wp.array2d[wp.float64],
):
    """Frames of the bodies that paths are fixed to, and what their points depend on, with its slope."""
    worldid = wp.tid()
    one = wp.float64(1.0)
    if body.shape[0] > 0:
        place(worldid, skeleton, values, worldid, placement)
    for number in range(body.shape[0]):
        own = body[number]
        if own >= 0:
            frames.rotation[worldid, number] = placement.rotation[worldid, own]
            frames.origin[worldid, number] = placement.origin[worldid, own]
        else:
            frames.rotation[worldid, number] = wp.diag(wp.vec3d(one, one, one))
            frames.origin[worldid, number] = wp.vec3d()
    for number in range(needed.free.shape[0]):
        x = wp.float64(0.0)
        if needed.free[number] >= 0:
            x = values[worldid, needed.free[number]]
        curve = evaluated(needed.functions, number, x)
        frames.value[worldid, number] = curve[0]
        slope[worldid, number] = curve[1]


@wp.kernel(enable_backward=False)
def project_paths(
    # Model:
    skeleton: Skeleton,
    needed: Skeleton,
    handle_body: wp.array[int],
    # Params:
    tables: PathTables,
    # In:
    placement: Placement,
    slope: wp.array2d[wp.float64],
    pulls: Pulls,
    # Out:
    moment_arm: wp.array3d[wp.float64],
):
    """r_k = -(sum of v . F + w . T of the moves of k below each body, and dx/dq_k . F_x of moving points).

    Of a length that is a polynomial, r_k = -dl/dx dx/dq_k.
    """
    worldid, pathid = wp.tid()
    path = tables.paths[pathid]
    for k in range(moment_arm.shape[2]):
        moment_arm[worldid, pathid, k] = wp.float64(0.0)
    for handle in range(path.first_handle, path.first_handle + path.handles):
        force = pulls.force[worldid, handle]
        torque = pulls.torque[worldid, handle]
        body = handle_body[handle]
        while body >= 0:
            for move in range(skeleton.first[body], skeleton.first[body + 1]):
                k = skeleton.free[move]
                if k >= 0:
                    shift = wp.dot(placement.shift[worldid, move], force)
                    turn = wp.dot(placement.turn[worldid, move], torque)
                    moment_arm[worldid, pathid, k] -= shift + turn
            body = skeleton.parent[body]
    for point in range(path.first_point, path.first_point + path.points):
        moving = tables.points[point].moving
        if moving >= 0:
            for axis in range(3):
                number = tables.moving[moving].value[axis]
                if number >= 0 and needed.free[number] >= 0:
                    moved = pulls.along[worldid, moving][axis] * slope[worldid, number]
                    moment_arm[worldid, pathid, needed.free[number]] -= moved
    for variable in range(path.first_variable, path.first_variable + path.variables):
        number = tables.variable[variable]
        if needed.free[number] >= 0:
            changed = pulls.by_variable[worldid, variable] * slope[worldid, number]
            moment_arm[worldid, pathid, needed.free[number]] -= changed


def muscles_of(bones: Bones) -> tuple[str, ...]:
    """Return the names of muscles that apply force.

    Raises:
        ValueError: The model has none.
    """
    names = tuple(name for name, muscle in bones.model.muscles.items() if muscle.applies_force)
    if not names:
        raise ValueError(f"model {bones.model.name!r} has no muscle")
    return names


class PathsOfMuscles:
    """The muscles of a model, to be followed for a number of frames at once, by one thread.

    Attributes:
        muscles: Their names.
        crossed: For each the numbers of coordinates that it can act on.
        skeleton: Of the model.
        needed: What points depend on.
        body: Numbers of bodies that paths are fixed to; likewise `handle_body`.
        placement: Where bodies are, in as many frames as are followed at once; `slope`: of what is needed.
        moment_arm: Of these frames, shape (frames, muscles, coordinates).
    """

    def __init__(self, bones: Bones, together: int = TOGETHER, names: Sequence[str] | None = None) -> None:
        """Put paths on the bones' device.

        Args:
            bones: The model.
            together: Frames that are followed at once.
            names: Of muscles, ligaments and path actuators; None: of all muscles that apply force.

        Raises:
            ValueError: The model has no muscle.
            NotImplementedError: A point moves by a function that is no piecewise polynomial.
        """
        model, self._bones, self.skeleton = bones.model, bones, bones.skeleton
        self.muscles = muscles_of(bones) if names is None else tuple(names)
        every = model.pulling
        paths = {name: every[name] for name in self.muscles}
        self.crossed = tuple(acted_on(bones, path) for path in paths.values())
        paths_of, depends = described(model, paths)
        handles = [paths_of.handles(path) for path in paths_of.paths.values()]
        self._handles = [len(own) for own in handles]
        with wp.ScopedDevice(bones.device):
            self.needed = bones.values_of(depends)
            self.body = wp.array([bones.number(name) for name in paths_of.bodies], dtype=int)
            self.handle_body = wp.array([bones.number(name) for own in handles for name in own], dtype=int)
            self._memory = PathMemory(paths_of, together, len(depends), guard=0.0)
            self.placement = bones.placement(together)
            self.slope = wp.zeros((together, max(len(depends), 1)), dtype=wp.float64)
            shape = together, len(paths), len(bones.coordinates)
            self.moment_arm = wp.zeros(shape, dtype=wp.float64)

    def at(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return lengths [m], shape (frames, muscles), and moment arms, (frames, muscles, coordinates).

        Args:
            values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
        """
        found = []
        for rows in self._followed(values):
            arrays = self._memory.pulls.length, self.moment_arm
            count = rows.stop - rows.start
            found.append(tuple(array.numpy()[:count].copy() for array in arrays))
        length, arm = joined(found)
        return length, arm

    def _followed(self, values: np.ndarray) -> Iterator[slice]:
        """Follow the paths; yield the frames whose results are on the device now."""
        memory, together = self._memory, self._memory.worlds
        for begin in range(0, len(values), together):
            rows = values[begin : begin + together]
            whole = np.concatenate((rows, np.repeat(rows[-1:], together - len(rows), axis=0)))
            with wp.ScopedDevice(self._bones.device):
                given = wp.array(whole, dtype=wp.float64)
                launch(place_path_bodies, together, self, memory, values=given)
                memory.launch()
                launch(project_paths, (together, memory.number), self, memory)
            yield slice(begin, begin + len(rows))

    def wrenches(self, values: np.ndarray, tension: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return force [N] and torque about ground's origin [N m] of muscles on bodies, ground the last one.

        Args:
            values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
            tension: [N], shape (frames, muscles).

        Returns:
            Two arrays of shape (frames, bodies, 3).
        """
        found = np.zeros((2, len(values), len(self._bones.bodies), 3))
        for rows in self._followed(values):
            pulls = self._memory.pulls
            of = np.repeat(tension[rows], self._handles, axis=1)[:, :, None]
            count = len(of)
            for one, pull in zip(found[:, rows], (pulls.force, pulls.torque), strict=True):
                drawn = -of * pull.numpy()[:count]
                for handle, body in enumerate(self.handle_body.numpy()):
                    one[:, body] += drawn[:, handle]
        return found[0], found[1]

    def along(self, values: np.ndarray, speeds: np.ndarray) -> MusclePaths:
        """Return the paths of a motion; see `muscle_paths`."""
        length, arm = self.at(values)
        velocity = -np.einsum("nmk,nk->nm", arm, speeds)
        return MusclePaths(self.muscles, length, velocity, arm, self.crossed)


def muscle_paths(
    bones: Bones, values: np.ndarray, speeds: np.ndarray, names: Sequence[str] | None = None
) -> MusclePaths:
    """Return the paths of all muscles of a motion, on all cores.

    Args:
        bones: The model.
        values: Of its independent coordinates [rad] or [m], shape (frames, coordinates).
        speeds: Their derivatives by time.
        names: Of muscles, ligaments and path actuators; None: of all muscles that apply force.

    Raises:
        ValueError: The model has no muscle.
        NotImplementedError: A point moves by a function that is no piecewise polynomial.
    """
    values, speeds = (np.ascontiguousarray(array, float) for array in (values, speeds))
    names = muscles_of(bones) if names is None else tuple(names)
    every = bones.model.pulling
    crossed = {name: acted_on(bones, every[name]) for name in names}
    over = [name for name in names if every[name].wraps]
    straight = [name for name in names if name not in over]
    place = {name: (names.index(name), crossed[name]) for name in straight}
    in_lanes = StraightPaths(bones, place) if straight else None
    columns = [names.index(name) for name in over]
    length, velocity = np.empty((2, len(values), len(names)))
    arm = np.zeros((len(values), len(names), len(bones.coordinates)))

    def solve(part: slice) -> None:
        """Write the rows of some frames."""
        own = values[part]
        if in_lanes is not None:
            in_lanes.follow(own, speeds[part], length[part], velocity[part], arm[part])
        if over:
            found = PathsOfMuscles(bones, min(len(own), TOGETHER), over).along(own, speeds[part])
            length[part, columns], velocity[part, columns] = found.length, found.velocity
            arm[part, columns] = found.moment_arm

    in_parts(len(values), 16 * TOGETHER, solve)
    return MusclePaths(names, length, velocity, arm, tuple(crossed.values()))
