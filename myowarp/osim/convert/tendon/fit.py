"""A tendon path against its reference, and least squares on its surfaces.

Residuals are moment arms and twice the lengths, each divided by the root of its number of samples. With
the gradients of the lengths, see `wrap_mujoco`, those of the moment arms are their differences between
neighbouring poses. A path that OpenSim lets go of a conditional point has a jump; MuJoCo's has one where
an end point crosses the ray opposite to a side site, so sides are searched for where it should be.
"""

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import optimize

from myowarp.osim.body.moment_arm import STEP, Poses, Reference, crossed, own_reference, stacked
from myowarp.osim.body.path_solution import activity, locations, solve
from myowarp.osim.convert.tendon.candidates import TINY, Observed
from myowarp.osim.convert.tendon.path import TendonPath, lengths
from myowarp.osim.convert.tendon.surface import Surface, unit
from myowarp.osim.document.elements import Path
from myowarp.osim.document.model import Model

LENGTH_WEIGHT = 2.0
"""Of a length against a moment arm."""
EVALUATIONS = 40
"""Of one fit."""
CENTRE_SCALE, RADIUS_SCALE, TURN_SCALE = 0.005, 0.2, 0.2
"""[m], 1, [rad]: what counts as a step of the same size."""
HOLD = 1e-6
"""[m] of residual for a parameter one such step away from its start: decides what the data leave open."""
SIDE_STEPS = np.deg2rad([40.0, 20.0, 10.0, 5.0, 2.5, 1.0])
"""[rad] of the search for the directions of sides."""
ANNEALING_ROUNDS = 100
"""Of SciPy's dual annealing."""

Method = Literal["least_squares", "annealing"]


class Target:
    """Target of lengths in stacked poses: moment arms and lengths of the reference, weighted."""

    def __init__(self, reference: Reference, along: list[str]) -> None:
        self.count, self.along = len(reference.length), along
        self.mask = np.array([reference.consistent(name) for name in along]).reshape(-1, self.count)
        whole = self.mask.all(axis=0)
        share = np.sqrt(np.maximum(self.mask.sum(axis=1, keepdims=True), 1))
        self.weights = self.mask / share
        self.length_weights = LENGTH_WEIGHT * whole / np.sqrt(max(whole.sum(), 1))
        arms = np.array([reference.moment_arm[name] for name in along]).reshape(-1, self.count)
        self.value = np.concatenate([(self.weights * arms).ravel(), self.length_weights * reference.length])

    def project(self, values: np.ndarray) -> np.ndarray:
        """Return weighted moment arms and lengths of lengths or their gradients, shape `(rows, ...)`."""
        blocks = values.reshape(-1, self.count, *values.shape[1:])
        extra = (...,) + (None,) * (values.ndim - 1)
        arms = -(blocks[2::2] - blocks[1::2]) / (2 * STEP) * self.weights[extra]
        return np.concatenate([arms.reshape(-1, *values.shape[1:]), blocks[0] * self.length_weights[extra]])

    def errors(self, residual: np.ndarray) -> tuple[np.ndarray, float]:
        """Return root mean squares of moment arms by coordinate, and of the length [m]."""
        squares = (residual**2).reshape(-1, self.count).sum(axis=1)
        return np.sqrt(squares[:-1]), float(np.sqrt(squares[-1]) / LENGTH_WEIGHT)


class PathProblem:
    """Constants of a path while it is being chosen and fitted."""

    def __init__(
        self, model: Model, name: str, path: Path, poses: Poses, reference: Reference | None
    ) -> None:
        self.name, self.along = name, crossed(model, path)
        self.reference = reference or own_reference(model, path, poses, self.along)
        self.target = Target(self.reference, self.along)
        self.frames, coordinates = stacked(model, path, poses, self.along)
        self.points = locations(path, self.frames, coordinates)
        count = self.target.count
        points = self.points[:count]
        active = activity(path, poses.coordinates, count)
        solution = solve(model, path, poses.frames, poses.coordinates)
        self.observed = Observed(model, path, poses.frames, points, active, solution)

    def residual(self, tendon: TendonPath) -> np.ndarray:
        """Return the weighted errors of a tendon path [m]."""
        length = lengths(tendon, self.points, self.frames).length
        return self.target.project(length) - self.target.value


def fit_surfaces(problem: PathProblem, tendon: TendonPath, method: Method) -> TendonPath:
    """Return a tendon path with centre, radius and orientation of its surfaces fitted."""
    starts = [over.surface for over in tendon.surfaces]
    sizes = [4 if surface.kind == "sphere" else 7 for surface in starts]
    ends = np.cumsum(sizes)
    scale = np.concatenate([_scales(surface) for surface in starts])
    low, high = (np.concatenate(side) for side in zip(*(_bounds(surface) for surface in starts), strict=True))

    def at(x: np.ndarray) -> TendonPath:
        parts = np.split(x * scale, ends[:-1])
        return tendon.with_surfaces([_moved(s, part) for s, part in zip(starts, parts, strict=True)])

    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([problem.residual(at(x)), HOLD * x])

    def jacobian(x: np.ndarray) -> np.ndarray:
        found = lengths(at(x), problem.points, problem.frames).gradients
        blocks = []
        for gradient, part in zip(found, np.split(x * scale, ends[:-1]), strict=True):
            if len(part) == 4:
                gradient = gradient[:, :4]
            else:
                gradient = np.concatenate([gradient[:, :4], gradient[:, 4:] @ _turning(part[4:])], axis=1)
            blocks.append(problem.target.project(gradient))
        return np.concatenate([np.concatenate(blocks, axis=1) * scale, HOLD * np.eye(len(x))])

    if method == "annealing":
        bounds = list(zip(low / scale, high / scale, strict=True))
        found = optimize.dual_annealing(
            lambda x: float(np.sum(residual(x) ** 2)),
            bounds,
            maxiter=ANNEALING_ROUNDS,
            seed=0,
            no_local_search=True,
            x0=np.zeros(len(scale)),
        )
        return at(found.x)
    found = optimize.least_squares(
        residual,
        np.zeros(len(scale)),
        jacobian,
        bounds=(low / scale, high / scale),
        max_nfev=EVALUATIONS,
        xtol=1e-6,
        ftol=1e-6,
        gtol=1e-12,
    )
    return at(found.x)


def turn_sides(problem: PathProblem, tendon: TendonPath) -> TendonPath:
    """Return a tendon path whose sides let go of bent paths in the poses where the reference does.

    The error is a step function of a side's direction, so this is a pattern search, coarse to fine.
    """
    residual = problem.residual(tendon)
    best = float(residual @ residual)
    for step in SIDE_STEPS:
        for number, over in enumerate(tendon.surfaces):
            if over.surface.side is None or over.surface.inside:
                continue
            first = unit(np.cross(over.surface.side, np.eye(3)[np.argmin(np.abs(over.surface.side))]))
            for axis in (first, np.cross(over.surface.side, first)):
                for turn in (-step, step):
                    surfaces = [other.surface for other in tendon.surfaces]
                    side = _exponential(turn * axis) @ over.surface.side
                    surfaces[number] = replace(over.surface, side=side)
                    tried = tendon.with_surfaces(surfaces)
                    residual = problem.residual(tried)
                    if residual @ residual < best:
                        tendon, best = tried, float(residual @ residual)
    return tendon


def _scales(surface: Surface) -> np.ndarray:
    turn = [] if surface.kind == "sphere" else [TURN_SCALE] * 3
    return np.array([CENTRE_SCALE] * 3 + [RADIUS_SCALE] + turn)


def _bounds(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return how far the parameters of a surface may go."""
    reach = surface.radius + 0.01
    growth = (np.log(0.2), np.log(3.0)) if surface.radius > TINY else (np.log(0.2), np.log(30.0))
    turn = [] if surface.kind == "sphere" else [0.7] * 3
    low = [-reach] * 3 + [growth[0]] + [-angle for angle in turn]
    return np.array(low), np.array([reach] * 3 + [growth[1], *turn])


def _moved(surface: Surface, x: np.ndarray) -> Surface:
    """Return a surface with other centre, radius and orientation."""
    rotation = surface.rotation if len(x) == 4 else _exponential(x[4:]) @ surface.rotation
    return Surface(
        surface.kind,
        surface.centre + x[:3],
        rotation,
        float(surface.radius * np.exp(x[3])),
        surface.side,
        surface.inside,
    )


def _skew(x: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def _exponential(turn: np.ndarray) -> np.ndarray:
    """Return the rotation of a rotation vector [rad]."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return np.eye(3)
    cross = _skew(turn / angle)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _turning(turn: np.ndarray) -> np.ndarray:
    """Return the derivative of a small turn with respect to a rotation vector, shape `(3, 3)`."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-8:
        return np.eye(3)
    axis = turn / angle
    ratio = np.sin(angle) / angle
    return ratio * np.eye(3) + (1 - ratio) * np.outer(axis, axis) + (1 - np.cos(angle)) / angle * _skew(axis)
