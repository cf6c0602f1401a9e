"""Cvt2: the path of every muscle as a MuJoCo tendon, fitted to OpenSim's moment arms and lengths.

What stands between which points is enumerated with the objects as they are, see `placement`; the best
few rows of elements then have centre, radius and orientation of their surfaces fitted by bounded least
squares on moment arms and twice the lengths, with analytic gradients, and the best result is kept.
Samples where OpenSim's two senses of a moment arm disagree are left out of the fit. The paper searched
the same parameters by simulated annealing (MyoConverter; Wang et al. 2022,
doi:10.1109/TNSRE.2022.3213618), which is here for comparison.
"""

import itertools
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from myowarp.models.opensim.kinematics import Frames, independent, random_poses
from myowarp.models.opensim.model import Model
from myowarp.models.opensim.moment_arm import STEP, Poses, Reference, crossed, own_reference, poses_of, stacked
from myowarp.models.opensim.path import activity, locations, solve
from myowarp.models.opensim.placement import TINY, Elements, Observed, fillings, gaps
from myowarp.models.opensim.tendon import TendonPath, Via, lengths
from myowarp.models.opensim.wrap_cylinder import unit
from myowarp.models.opensim.wrap_mujoco import Surface

POSES = 300
"""Random poses that a muscle is fitted in."""
LENGTH_WEIGHT = 2.0
"""Of a length against a moment arm."""
GOOD = 1e-5
"""[m] RMS error below which nothing is fitted."""
CANDIDATES = 6
"""Rows of elements whose surfaces are fitted."""
SAME = 1e-9
"""Relative difference of errors below which two rows make the same path."""
ROWS = 3000
"""Combinations of gap fillings that are compared one by one."""
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


@dataclass(frozen=True, eq=False)
class MuscleFit:
    """The converted path of one muscle.

    Attributes:
        tendon: the path.
        coordinates: on which its length depends.
        moment_arm_error: by coordinate, root mean square over consistent samples [m].
        inconsistent: by coordinate, share of the samples that were left out.
        length_error: root mean square [m].
    """

    tendon: TendonPath
    coordinates: tuple[str, ...]
    moment_arm_error: dict[str, float]
    inconsistent: dict[str, float]
    length_error: float


class _Target:
    """Residuals of a muscle: what a tendon's lengths in stacked poses differ from the reference."""

    def __init__(self, reference: Reference, along: list[str]) -> None:
        self.count, self.along = len(reference.length), along
        self.mask = np.array([reference.consistent(name) for name in along]).reshape(-1, self.count)
        whole = self.mask.all(axis=0)
        share = np.sqrt(np.maximum(self.mask.sum(axis=1, keepdims=True), 1))
        self.weights = self.mask / share
        self.length_weights = LENGTH_WEIGHT * whole / np.sqrt(max(whole.sum(), 1))
        arms = np.array([reference.moment_arm[name] for name in along]).reshape(-1, self.count)
        self.value = np.concatenate(
            [(self.weights * arms).ravel(), self.length_weights * reference.length]
        )

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


class _Muscle:
    """What does not change while a muscle's path is being chosen and fitted."""

    def __init__(self, model: Model, name: str, poses: Poses, reference: Reference | None) -> None:
        path = model.muscles[name].path
        self.name, self.along = name, crossed(model, path)
        self.reference = reference or own_reference(model, path, poses, self.along)
        self.target = _Target(self.reference, self.along)
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


def fit_muscle(
    model: Model,
    name: str,
    poses: Poses,
    reference: Reference | None = None,
    method: Method = "least_squares",
) -> MuscleFit:
    """Return the path of one muscle for MuJoCo.

    Args:
        model: the model.
        name: of the muscle.
        poses: random poses with neighbours along all free coordinates.
        reference: what OpenSim says in these poses; None: what our own path code says.
        method: of the fit.
    """
    muscle = _Muscle(model, name, poses, reference)
    candidates = _rows(muscle)
    best = candidates[0]
    residual = muscle.residual(best)
    if _worst(muscle, residual) > GOOD:
        for candidate in [row for row in candidates if row.surfaces]:
            fitted = fit_surfaces(muscle, candidate, method)
            error = muscle.residual(fitted)
            if error @ error < residual @ residual:
                best, residual = fitted, error
            if _worst(muscle, residual) < GOOD:
                break
        if any(over.surface.side is not None for over in best.surfaces):
            fitted = fit_surfaces(muscle, _turn_sides(muscle, best), method)
            error = muscle.residual(fitted)
            best, residual = (fitted, error) if error @ error < residual @ residual else (best, residual)
    arms, length = muscle.target.errors(residual)
    masked = 1 - muscle.target.mask.mean(axis=1)
    along = muscle.along
    return MuscleFit(
        best,
        tuple(along),
        dict(zip(along, arms.tolist(), strict=True)),
        dict(zip(along, masked.tolist(), strict=True)),
        length,
    )


def _worst(muscle: _Muscle, residual: np.ndarray) -> float:
    arms, length = muscle.target.errors(residual)
    return max([*arms.tolist(), length])


def _rows(muscle: _Muscle) -> list[TendonPath]:
    """Return the rows of elements that fit best before their surfaces are fitted, best first."""
    spans = gaps(muscle.observed)
    options: list[list[Elements]] = []
    vectors: list[np.ndarray] = []
    for first, last in spans:
        found = fillings(muscle.observed, (first, last))
        values = []
        for filling in found:
            piece = TendonPath(muscle.name, (Via(first), *filling, Via(last)))
            values.append(muscle.target.project(lengths(piece, muscle.points, muscle.frames).length))
        options.append(found)
        vectors.append(np.array(values))
    choices = _choices(vectors, muscle.target.value)
    rows = []
    for choice in choices[:CANDIDATES]:
        elements: Elements = (Via(spans[0][0]),)
        for (_, last), found, index in zip(spans, options, choice, strict=True):
            elements = (*elements, *found[index], Via(last))
        rows.append(TendonPath(muscle.name, elements))
    return rows


def _choices(vectors: list[np.ndarray], target: np.ndarray) -> list[tuple[int, ...]]:
    """Return choices of one vector per gap by the distance of their sum from the target, nearest first."""
    current = [0] * len(vectors)
    order = [np.arange(len(values)) for values in vectors]
    for _ in range(3):
        for gap, values in enumerate(vectors):
            rest = sum(other[index] for other, index in zip(vectors, current, strict=True)) - values[current[gap]]
            order[gap] = np.argsort(((rest + values - target) ** 2).sum(axis=1), kind="stable")
            current[gap] = int(order[gap][0])
    several = [gap for gap in range(len(vectors)) if len(vectors[gap]) > 1]
    keep = max(int(ROWS ** (1 / max(len(several), 1))), 2)
    kept = [values[:keep] for values in order]
    found = []
    for choice in itertools.product(*kept):
        total = sum(values[index] for values, index in zip(vectors, choice, strict=True)) - target
        found.append((float(total @ total), tuple(int(index) for index in choice)))
        if len(found) >= 2 * ROWS:
            break
    found.sort()
    # Choices that make no difference to the path, such as the tilt of a side, count once.
    return [
        choice
        for number, (error, choice) in enumerate(found)
        if number == 0 or error > found[number - 1][0] * (1 + SAME)
    ]


def fit_surfaces(muscle: _Muscle, tendon: TendonPath, method: Method) -> TendonPath:
    """Return a tendon path with centre, radius and orientation of its surfaces fitted."""
    from scipy.optimize import dual_annealing, least_squares

    starts = [over.surface for over in tendon.surfaces]
    sizes = [4 if surface.kind == "sphere" else 7 for surface in starts]
    ends = np.cumsum(sizes)
    scale = np.concatenate([_scales(surface) for surface in starts])
    low, high = (np.concatenate(side) for side in zip(*(_bounds(surface) for surface in starts), strict=True))

    def at(x: np.ndarray) -> TendonPath:
        parts = np.split(x * scale, ends[:-1])
        return tendon.with_surfaces([_moved(s, part) for s, part in zip(starts, parts, strict=True)])

    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([muscle.residual(at(x)), HOLD * x])

    def jacobian(x: np.ndarray) -> np.ndarray:
        found = lengths(at(x), muscle.points, muscle.frames).gradients
        blocks = []
        for gradient, part in zip(found, np.split(x * scale, ends[:-1]), strict=True):
            if len(part) == 4:
                gradient = gradient[:, :4]
            else:
                gradient = np.concatenate([gradient[:, :4], gradient[:, 4:] @ _turning(part[4:])], axis=1)
            blocks.append(muscle.target.project(gradient))
        return np.concatenate([np.concatenate(blocks, axis=1) * scale, HOLD * np.eye(len(x))])

    if method == "annealing":
        bounds = list(zip(low / scale, high / scale, strict=True))
        found = dual_annealing(
            lambda x: float(np.sum(residual(x) ** 2)),
            bounds,
            maxiter=ANNEALING_ROUNDS,
            seed=0,
            no_local_search=True,
            x0=np.zeros(len(scale)),
        )
        return at(found.x)
    found = least_squares(
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


def _turn_sides(muscle: _Muscle, tendon: TendonPath) -> TendonPath:
    """Return a tendon path whose sides let go of bent paths in the poses where the reference does.

    The error is a step function of a side's direction, so this is a pattern search, coarse to fine.
    """
    residual = muscle.residual(tendon)
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
                    residual = muscle.residual(tried)
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
    return (
        ratio * np.eye(3)
        + (1 - ratio) * np.outer(axis, axis)
        + (1 - np.cos(angle)) / angle * _skew(axis)
    )


def fit_paths(
    model: Model, count: int = POSES, seed: int = 0, workers: int = 1, method: Method = "least_squares"
) -> Iterator[MuscleFit]:
    """Yield the path of every muscle, in the model's order, as each is ready.

    Args:
        model: the model.
        count: of random poses.
        seed: of the random poses.
        workers: processes; 1 works in this one.
        method: of the fit.
    """
    poses = poses_of(model, random_poses(model, count, seed), independent(model))
    if workers == 1:
        for name in model.muscles:
            yield fit_muscle(model, name, poses, None, method)
        return
    with ProcessPoolExecutor(workers, initializer=_set, initargs=(model, poses, method)) as pool:
        yield from pool.map(_fit, model.muscles)


_SHARED: dict[str, tuple[Model, Poses, Method]] = {}


def _set(model: Model, poses: Poses, method: Method) -> None:
    _SHARED["now"] = (model, poses, method)


def _fit(name: str) -> MuscleFit:
    model, poses, method = _SHARED["now"]
    return fit_muscle(model, name, poses, None, method)
