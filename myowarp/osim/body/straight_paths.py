"""Muscle paths that touch no wrap object, in SIMD lanes on the CPU: a frame in each lane.

The twin of the kernels of `muscle_paths` pays for itself: the 54 paths of a gait model take a tenth of the
time. What a muscle cannot act on keeps the moment arm 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import warp as wp

from myowarp.kernels.lanes import DOUBLES, WIDEST, at_namespace_level, native_kernel
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of
from myowarp.laws.paths.path import MOST_VARIABLES, PathTables
from myowarp.laws.paths.polynomials import SOURCE as POLYNOMIALS
from myowarp.laws.paths.tables import PathMemory
from myowarp.osim.body.described import described
from myowarp.osim.body.moment_arm import crossed
from myowarp.osim.body.skeleton import HINGE, Bones, Skeleton
from myowarp.osim.document import elements

wp.set_module_options({"enable_backward": False})


@wp.struct
class Fixed:
    """Bodies and points that paths are fixed to.

    Attributes:
        body: Numbers in the skeleton of bodies that points are fixed to, -1 for ground.
        handle_body: The same of handles.
        stop: For each path the body that carries all that it is fixed to.
        crossed: For each path the coordinates that it can act on, -1 behind them.
        column: Of each path in the results.
    """

    body: wp.array[int]
    handle_body: wp.array[int]
    stop: wp.array[int]
    crossed: wp.array2d[int]
    column: wp.array[int]


SOURCE = Path(__file__).with_suffix(".cpp")


@native_kernel(
    at_namespace_level(DOUBLES, POLYNOMIALS, SOURCE, HINGE=HINGE, MOST_VARIABLES=MOST_VARIABLES),
    does="""
    lanes::follow_straight(scratch.data, skeleton, needed, tables, fixed, values, speeds, length, velocity,
                           moment_arm);
    """,
)
def follow_straight_paths(
    # Model:
    skeleton: Skeleton,
    needed: Skeleton,
    # Params:
    tables: PathTables,
    fixed: Fixed,
    # In:
    values: wp.array2d[wp.float64],
    speeds: wp.array2d[wp.float64],
    scratch: wp.array[wp.float64],
    # Out:
    length: wp.array2d[wp.float64],
    velocity: wp.array2d[wp.float64],
    moment_arm: wp.array2d[wp.float64],
):
    """Lengths, velocities and moment arms, to rounding those of `follow_paths` and `project_paths`."""


def acted_on(bones: Bones, path: elements.Path) -> tuple[int, ...]:
    """Return the numbers of the coordinates that what pulls along a path can act on."""
    names = crossed(bones.model, path)
    return tuple(bones.coordinates.index(name) for name in names if name in bones.coordinates)


class StraightPaths:
    """Muscles of a model whose paths touch no wrap object.

    Attributes:
        skeleton: Of the model; `needed`: what points depend on.
        tables: The paths; `fixed`: bodies and points that they are fixed to.
    """

    def __init__(self, bones: Bones, place: Mapping[str, tuple[int, Sequence[int]]]) -> None:
        """Put paths on the bones' device, the CPU.

        Args:
            bones: The model.
            place: For each muscle its column in the results, and the coordinates that it can act on.

        Raises:
            NotImplementedError: A point moves by a function that is no piecewise polynomial.
        """
        every = bones.model.pulling
        paths = {name: every[name] for name in place}
        paths_of, depends = described(bones.model, paths)
        handles = [[bones.number(body) for body in paths_of.handles(one)] for one in paths_of.paths.values()]
        parent = bones.skeleton.parent.numpy()
        columns, acted = zip(*place.values(), strict=True)
        table = np.full((len(acted), max([1, *map(len, acted)])), -1)
        for row, own in zip(table, acted, strict=True):
            row[: len(own)] = own
        self.skeleton = bones.skeleton
        with wp.ScopedDevice(bones.device):
            self.needed = bones.values_of(depends)
            self.tables = PathMemory(paths_of, 1, len(depends), guard=0.0).tables
            self.fixed = struct_of(
                Fixed,
                body=[bones.number(body) for body in paths_of.bodies],
                handle_body=np.array([body for own in handles for body in own], int),
                stop=[_carrier(own, parent) for own in handles],
                crossed=table,
                column=columns,
            )
        points = max(1, *(len(path.points) for path in paths.values()))
        self._numbers = 12 * len(parent) + 6 * bones.skeleton.kind.shape[0] + 2 * len(depends)
        self._numbers += 3 * len(bones.coordinates) + 7 * points + 6 * max(1, *map(len, handles))

    def follow(
        self,
        values: np.ndarray,
        speeds: np.ndarray,
        length: np.ndarray,
        velocity: np.ndarray,
        moment_arm: np.ndarray,
    ) -> None:
        """Write lengths [m], velocities [m/s] and moment arms of some frames; see `MusclePaths`.

        Args:
            values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
            speeds: Their derivatives by time.
            length: To be written, shape (frames, muscles).
            velocity: The same.
            moment_arm: The same, all 0, shape (frames, muscles, coordinates).
        """
        with wp.ScopedDevice("cpu"):
            given = {"values": values, "speeds": speeds, "length": length, "velocity": velocity}
            given["moment_arm"] = moment_arm.reshape(len(values), -1)
            launch(
                follow_straight_paths,
                1,
                self,
                scratch=wp.empty((self._numbers + 1) * WIDEST, dtype=wp.float64),
                **{name: wp.array(array, dtype=wp.float64, copy=False) for name, array in given.items()},
            )


def _carrier(bodies: Sequence[int], parent: np.ndarray) -> int:
    """Return the last body that carries all of some, -1 for ground."""
    if not bodies:  # of a length that is a function
        return -1
    chains = []
    for body in bodies:
        chain = [body]
        while chain[-1] >= 0:
            chain.append(int(parent[chain[-1]]))
        chains.append(chain)
    return next(body for body in chains[0] if all(body in chain for chain in chains))
