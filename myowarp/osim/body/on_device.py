"""Lengths, speeds and moment arms of paths in many poses at once, by the device's kernel in float64.

The same numbers as `moment_arm.own_reference`: one launch for all paths, and partial velocities of bodies in
place of poses beside each pose.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import warp as wp

from myowarp.laws.paths.tables import PathMemory
from myowarp.osim.body.described import described
from myowarp.osim.document.dynamics import moving_frames, rates
from myowarp.osim.document.elements import Path
from myowarp.osim.document.model import Model

TOGETHER = 256  # poses in a launch: working memory is 0.1 MB for each


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
    """Return paths in many poses.

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
