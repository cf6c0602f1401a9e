"""Moment arms of muscle paths, in both of OpenSim's senses, over many poses.

`computeMomentArm` pulls with unit tension along the straight pieces of the path, the wrap points being
fixed in the bodies of their objects, and multiplies with the velocities that follow from the coordinate,
couplers included (Sherman, Seth, Delp 2013, doi:10.1115/DETC2013-13633). The other sense is minus the
derivative of the length. Both agree only where the path that OpenSim reports has stationary length.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from myowarp.osim.body.path_solution import Solution, locations, solve
from myowarp.osim.document.elements import ConditionalPathPoint, MovingPathPoint, Path
from myowarp.osim.document.kinematics import Frames, complete, forward
from myowarp.osim.document.model import GROUND, Model

STEP = 1e-5
"""[rad] or [m] of the central differences."""
CONSISTENT = 1e-4
"""[m] by which both senses of a moment arm may differ in a sample that is worth fitting."""
PRESENT = 1e-7
"""[m] that a moment arm must reach in some pose for its pair of muscle and coordinate to count."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a model, with those to both sides of each along coordinates.

    Attributes:
        coordinates: values of all coordinates [rad] or [m], each of shape `(n,)`.
        frames: of all bodies.
        beside: for a coordinate the same two things, a step below and a step above.
    """

    coordinates: Mapping[str, np.ndarray]
    frames: Frames
    beside: Mapping[str, tuple[tuple[Mapping[str, np.ndarray], Frames], ...]]


@dataclass(frozen=True, eq=False)
class Reference:
    """OpenSim's values of one muscle in n poses.

    Attributes:
        length: of the path [m], shape `(n,)`.
        moment_arm: by coordinate, OpenSim's `computeMomentArm` [m], each of shape `(n,)`.
        slope: by coordinate, minus the derivative of the length [m], each of shape `(n,)`.
    """

    length: np.ndarray
    moment_arm: Mapping[str, np.ndarray]
    slope: Mapping[str, np.ndarray]

    def consistent(self, coordinate: str) -> np.ndarray:
        """Whether both senses of a moment arm agree, shape `(n,)`."""
        return np.abs(self.moment_arm[coordinate] - self.slope[coordinate]) <= CONSISTENT


def poses_of(model: Model, coordinates: Mapping[str, np.ndarray], along: list[str]) -> Poses:
    """Return poses, and their neighbours along coordinates [rad] or [m], each of shape `(n,)`."""
    count = len(next(iter(coordinates.values())))

    def at(
        values: Mapping[str, np.ndarray], *known: tuple[Mapping[str, np.ndarray], Frames]
    ) -> tuple[Mapping[str, np.ndarray], Frames]:
        values = complete(model, {k: v for k, v in values.items() if k not in model.couplers}, count)
        return values, forward(model, values, *known)

    here = values, frames = at(coordinates)
    beside = {
        name: tuple(at({**values, name: values[name] + step}, here) for step in (-STEP, STEP))
        for name in along
    }
    return Poses(values, frames, beside)


def crossed(model: Model, path: Path) -> list[str]:
    """Return the free coordinates on which the length of a path can depend."""
    if path.function is not None:
        return leading(model, path.function.coordinates)
    bodies = [point.body for point in path.points]
    bodies += [model.wraps[wrap.object].body for wrap in path.wraps]
    moved = coordinates_between(model, bodies)
    for point in path.points:
        if isinstance(point, MovingPathPoint):
            moved |= set(point.coordinates)
    return leading(model, moved)


def coordinates_between(model: Model, bodies: Sequence[str]) -> set[str | None]:
    """Return the coordinates that move some bodies against each other; None of moves without one."""
    chains = [_chain(model, body) for body in bodies]
    joints = set().union(*chains) - set(chains[0]).intersection(*chains)
    return {move.coordinate for joint in joints for move in model.joints[joint].moves}


def leading(model: Model, moved: Iterable[str | None]) -> list[str]:
    """Return the free coordinates that some coordinates are, or follow, in the order of the model."""
    names = {name for name in moved if name is not None}
    while driven := names & set(model.couplers):
        names = names - driven | {model.couplers[name].independent for name in driven}
    return [name for name in model.coordinates if name in names and not model.coordinates[name].locked]


def _chain(model: Model, body: str) -> list[str]:
    """Return the joints between ground and a body."""
    by_child = {joint.child: joint for joint in model.joints.values()}
    chain = []
    while body != GROUND:
        chain.append(by_child[body].name)
        body = by_child[body].parent
    return chain


def own_reference(model: Model, path: Path, poses: Poses, along: list[str]) -> Reference:
    """Return length and moment arms of a path by our own path code."""
    count = len(next(iter(poses.coordinates.values())))
    if path.function is not None:
        length = path.function.at(poses.coordinates)[0]
        beside = {name: [path.function.at(values)[0] for values, _ in poses.beside[name]] for name in along}
        slopes = {name: (low - high) / (2 * STEP) for name, (low, high) in beside.items()}
        return Reference(length, slopes, slopes)
    solution = solve(model, path, *stacked(model, path, poses, along))
    lengths = solution.length.reshape(-1, count)
    slopes = {
        name: -(lengths[2 + 2 * number] - lengths[1 + 2 * number]) / (2 * STEP)
        for number, name in enumerate(along)
    }
    here = Solution(*(getattr(solution, field.name)[:count] for field in fields(Solution)))
    return Reference(lengths[0], moment_arms(model, path, poses, here, along), slopes)


def moment_arms(
    model: Model, path: Path, poses: Poses, solution: Solution, along: list[str]
) -> dict[str, np.ndarray]:
    """Return `computeMomentArm` of a path that was solved [m], by coordinate, each of shape `(n,)`."""
    return {name: _moment_arm(model, path, poses, solution, poses.beside[name]) for name in along}


def stacked(
    model: Model, path: Path, poses: Poses, along: list[str]
) -> tuple[Frames, Mapping[str, np.ndarray]]:
    """Return frames and coordinates of n poses, then of those below and above along each coordinate.

    Only bodies of the path and coordinates of its points are in it; n poses follow n poses.
    """
    sets = [(poses.coordinates, poses.frames)]
    sets += [side for name in along for side in poses.beside[name]]
    bodies = {point.body for point in path.points} | {model.wraps[wrap.object].body for wrap in path.wraps}
    frames = {
        body: (
            np.concatenate([frames[body][0] for _, frames in sets]),
            np.concatenate([frames[body][1] for _, frames in sets]),
        )
        for body in bodies
    }
    names: set[str] = set()
    for point in path.points:
        if isinstance(point, MovingPathPoint):
            names |= {name for name in point.coordinates if name is not None}
        elif isinstance(point, ConditionalPathPoint):
            names.add(point.coordinate)
    return frames, {name: np.concatenate([values[name] for values, _ in sets]) for name in names}


def _moment_arm(model: Model, path: Path, poses: Poses, solution: Solution, beside: tuple) -> np.ndarray:
    """Return `computeMomentArm` along one coordinate [m], shape `(n,)`."""
    moved = [_attached(model, path, poses.frames, solution, frames, values) for values, frames in beside]
    velocity = (moved[1] - moved[0]) / (2 * STEP)
    bodies = [point.body for point in path.points]
    for wrap in path.wraps:
        bodies += [model.wraps[wrap.object].body] * 2
    number = np.array([list(dict.fromkeys(bodies)).index(body) for body in bodies])
    total = np.zeros(len(solution.length))
    rows = np.arange(len(total))
    for piece in range(solution.order.shape[1] - 1):
        one, other = solution.order[:, piece], solution.order[:, piece + 1]
        along = solution.cached[rows, other] - solution.cached[rows, one]
        norm = np.linalg.norm(along, axis=1)
        direction = along / np.where(norm > 0, norm, 1.0)[:, None]
        opening = np.einsum("ni,ni->n", direction, velocity[rows, other] - velocity[rows, one])
        total += np.where((other >= 0) & (number[one] != number[other]), opening, 0.0)
    return -total


def _attached(
    model: Model,
    path: Path,
    frames: Frames,
    solution: Solution,
    moved: Frames,
    coordinates: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Return where points and wrap points are in ground after their bodies moved [m]."""
    placed = solution.location.copy()
    count = len(path.points)
    placed[:, :count] = locations(path, moved, coordinates)
    for number, wrap in enumerate(path.wraps):
        body = model.wraps[wrap.object].body
        (rotation, origin), (new_rotation, new_origin) = frames[body], moved[body]
        for point in (count + 2 * number, count + 2 * number + 1):
            local = np.einsum("nji,nj->ni", rotation, placed[:, point] - origin)
            placed[:, point] = new_origin + np.einsum("nij,nj->ni", new_rotation, local)
    return placed
