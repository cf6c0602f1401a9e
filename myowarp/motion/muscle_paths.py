"""Lengths, velocities and moment arms of a model's muscles along a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from myowarp.opensim.model.model import Model
from myowarp.opensim.wrap.moment_arm import crossed, moment_arms, poses_of, stacked
from myowarp.opensim.wrap.path import solve


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


def muscle_paths(
    model: Model, coordinates: tuple[str, ...], values: np.ndarray, speeds: np.ndarray
) -> MusclePaths:
    """Return the paths of all muscles by the converter's path code, which is OpenSim's, in NumPy.

    Args:
        model: The model.
        coordinates: Names of its independent coordinates.
        values: [rad] or [m], shape (frames, coordinates).
        speeds: Their derivatives by time.
    """
    muscles = tuple(name for name, muscle in model.muscles.items() if muscle.applies_force)
    along = [[name for name in crossed(model, model.muscles[m].path) if name in coordinates] for m in muscles]
    used = [name for name in coordinates if any(name in names for names in along)]
    poses = poses_of(model, dict(zip(coordinates, values.T, strict=True)), used)
    length = np.zeros((len(values), len(muscles)))
    arm = np.zeros((*length.shape, len(coordinates)))
    for number, (name, names) in enumerate(zip(muscles, along, strict=True)):
        path = model.muscles[name].path
        solution = solve(model, path, *stacked(model, path, poses, []))
        length[:, number] = solution.length
        for coordinate, column in moment_arms(model, path, poses, solution, names).items():
            arm[:, number, coordinates.index(coordinate)] = column
    velocity = -np.einsum("nmk,nk->nm", arm, speeds)
    rows = tuple(tuple(coordinates.index(name) for name in names) for names in along)
    return MusclePaths(muscles, length, velocity, arm, rows)
