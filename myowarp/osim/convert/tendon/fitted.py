"""Results of a conversion's fits: paths and forces, and OpenSim's values for them.

Apart from the fits themselves, which need SciPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from myowarp.osim.body.moment_arm import Reference

if TYPE_CHECKING:
    from myowarp.osim.convert.tendon.choice import PathFit
    from myowarp.osim.convert.tendon.force import ForceFit

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Expected:
    """OpenSim's values for a muscle.

    Attributes:
        random: In the random poses of the check.
        sweeps: By coordinate that it depends on, over the range of this coordinate.
        forces: At the lengths of the random poses [max_isometric_force], shape (poses, activations).
        grid: Lengths of the force map [m], shape (GRID,).
        map: Forces there [max_isometric_force], shape (GRID, activations).
    """

    random: Reference
    sweeps: Mapping[str, Reference]
    forces: Array
    grid: Array
    map: Array


@dataclass(frozen=True, eq=False)
class MuscleFit:
    """A converted muscle, and what it should be."""

    name: str
    max_isometric_force: float
    """[N]."""
    path: PathFit
    force: ForceFit
    expected: Expected


@dataclass(frozen=True, eq=False)
class PathOnly:
    """The converted path of a ligament or path actuator, and what it should be."""

    name: str
    path: PathFit
    expected: Reference
    """In the random poses of the check."""


@dataclass(frozen=True, eq=False)
class Fits:
    """All converted paths of a model; none without SciPy."""

    muscles: list[MuscleFit] = field(default_factory=list)
    others: list[PathOnly] = field(default_factory=list)
    """Of ligaments and path actuators."""

    def paths(self) -> dict[str, PathFit]:
        """Return the path of everything that pulls, by name."""
        return {
            **{fit.name: fit.path for fit in self.muscles},
            **{fit.name: fit.path for fit in self.others},
        }

    def references(self) -> dict[str, Reference]:
        """Return what OpenSim says about each in the random poses of the check."""
        muscles = {fit.name: fit.expected.random for fit in self.muscles}
        return {**muscles, **{fit.name: fit.expected for fit in self.others}}
