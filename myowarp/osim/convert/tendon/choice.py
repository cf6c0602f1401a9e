"""Cvt2: the path of every muscle as a MuJoCo tendon, fitted to OpenSim's moment arms and lengths.

What stands between which points is enumerated with the objects as they are, see `placement`; the best
few rows of elements then have centre, radius and orientation of their surfaces fitted by bounded least
squares on moment arms and twice the lengths, with analytic gradients, and the best result is kept.
Samples where OpenSim's two senses of a moment arm disagree are left out of the fit. The paper searched
the same parameters by simulated annealing (MyoConverter; Wang et al. 2022,
doi:10.1109/TNSRE.2022.3213618), which is here for comparison.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from myowarp.osim.body.moment_arm import Poses, Reference
from myowarp.osim.convert.tendon.candidates import always, sometimes, surfaces
from myowarp.osim.convert.tendon.fit import Method, PathProblem, fit_surfaces, turn_sides
from myowarp.osim.convert.tendon.path import Over, TendonPath, Via, lengths
from myowarp.osim.document.elements import Path
from myowarp.osim.document.model import Model

GOOD = 5e-5
"""[m] RMS error below which nothing is fitted: it is smaller than what OpenSim's senses may differ by."""
CANDIDATES = 6
"""Rows of elements whose surfaces are fitted."""
SAME = 1e-9
"""Relative difference of errors below which two rows make the same path."""
ROWS = 1000
"""Combinations of what may stand between sites that are compared one by one."""
ALL_SUBSETS = 4
"""Conditional points of which any may become sites; of more they do one by one, as long as that helps."""


@dataclass(frozen=True, eq=False)
class PathFit:
    """The converted path of one muscle.

    Attributes:
        tendon: the path.
        moment_arm_error: by coordinate that it depends on, root mean square over consistent samples [m].
        inconsistent: by coordinate, share of the samples that were left out.
        length_error: root mean square over poses without such samples [m].
    """

    tendon: TendonPath
    moment_arm_error: Mapping[str, float]
    inconsistent: Mapping[str, float]
    length_error: float


def fit_path(
    model: Model,
    name: str,
    path: Path,
    poses: Poses,
    reference: Reference | None = None,
    method: Method = "least_squares",
) -> PathFit:
    """Return a path for MuJoCo.

    Args:
        model: the model.
        name: of the tendon.
        path: of a muscle, or of anything else that pulls.
        poses: random poses with neighbours along all free coordinates.
        reference: what OpenSim says in these poses; None: what our own path code says.
        method: of the fit.
    """
    if path.function is not None:  # `compose.passive` puts its tangent there
        return PathFit(TendonPath(name, ()), {}, {}, float("nan"))
    problem = PathProblem(model, name, path, poses, reference)
    candidates = _rows(problem)
    best = candidates[0]
    residual = problem.residual(best)
    if _worst(problem, residual) > GOOD:
        for candidate in [row for row in candidates if row.surfaces]:
            fitted = fit_surfaces(problem, candidate, method)
            error = problem.residual(fitted)
            if error @ error < residual @ residual:
                best, residual = fitted, error
            if _worst(problem, residual) < GOOD:
                break
        if any(over.surface.side is not None for over in best.surfaces):
            fitted = fit_surfaces(problem, turn_sides(problem, best), method)
            error = problem.residual(fitted)
            best, residual = (fitted, error) if error @ error < residual @ residual else (best, residual)
    arms, length = problem.target.errors(residual)
    masked = 1 - problem.target.mask.mean(axis=1)
    return PathFit(
        best,
        dict(zip(problem.along, arms.tolist(), strict=True)),
        dict(zip(problem.along, masked.tolist(), strict=True)),
        length,
    )


def _worst(problem: PathProblem, residual: np.ndarray) -> float:
    arms, length = problem.target.errors(residual)
    return max([*arms.tolist(), length])


def _rows(problem: PathProblem) -> list[TendonPath]:
    """Return the rows of elements that fit best before their surfaces are fitted, best first."""
    conditional = sometimes(problem.observed)
    rows = _Rows(problem)
    if len(conditional) <= ALL_SUBSETS:
        for count in range(len(conditional) + 1):
            for sites in itertools.combinations(conditional, count):
                rows.add(sites)
    else:
        sites, error = (), rows.add(())
        while len(sites) < len(conditional):
            tried = {(*sites, new): rows.add((*sites, new)) for new in conditional if new not in sites}
            if min(tried.values()) >= error:
                break
            sites, error = min(tried.items(), key=lambda item: item[1])
    return rows.best()


class _Rows:
    """Rows of elements and their errors, for choices of conditional points that become sites."""

    def __init__(self, problem: PathProblem) -> None:
        self.problem = problem
        self.found: list[tuple[float, TendonPath]] = []
        self.spans: dict[tuple[int, int], tuple[list[tuple[Over, ...]], np.ndarray]] = {}

    def add(self, sites: tuple[int, ...]) -> float:
        """Add the best rows in which conditional points are sites, and return the least squared error."""
        passed = sorted((*always(self.problem.observed), *sites))
        parts = [self._span(first, last) for first, last in itertools.pairwise(passed)]
        choices = _choices([vectors for _, vectors in parts], self.problem.target.value)[:CANDIDATES]
        for error, choice in choices:
            elements: tuple[Via | Over, ...] = (Via(passed[0]),)
            for (fillings, _), index, last in zip(parts, choice, passed[1:], strict=True):
                elements = (*elements, *fillings[index], Via(last))
            self.found.append((error, TendonPath(self.problem.name, elements)))
        return choices[0][0]

    def best(self) -> list[TendonPath]:
        """Return the best rows that make different paths, best first."""
        self.found.sort(key=lambda item: item[0])
        return [row for _, row in _different(self.found)][:CANDIDATES]

    def _span(self, first: int, last: int) -> tuple[list[tuple[Over, ...]], np.ndarray]:
        """Return what may stand between two sites, and what each contributes to moment arms and length."""
        if (first, last) not in self.spans:
            problem = self.problem
            fillings: list[tuple[Over, ...]] = [()]
            fillings += [(over,) for over in surfaces(problem.observed, first, last)]
            vectors = []
            for filling in fillings:
                piece = TendonPath(problem.name, (Via(first), *filling, Via(last)))
                vectors.append(problem.target.project(lengths(piece, problem.points, problem.frames).length))
            self.spans[first, last] = fillings, np.array(vectors)
        return self.spans[first, last]


def _different(found: list) -> list:
    """Return what differs in its error from what stands before it, in a sorted list of (error, ...)."""
    # Choices that make no difference to the path, such as the tilt of a side, count once.
    return [
        item
        for number, item in enumerate(found)
        if number == 0 or item[0] > found[number - 1][0] * (1 + SAME)
    ]


def _choices(vectors: list[np.ndarray], target: np.ndarray) -> list[tuple[float, tuple[int, ...]]]:
    """Return squared distances of sums of one vector per span from the target, and the choices, sorted."""
    current = [0] * len(vectors)
    order = [np.arange(len(values)) for values in vectors]
    for _ in range(3):
        for span, values in enumerate(vectors):
            chosen = zip(vectors, current, strict=True)
            rest = sum(other[index] for other, index in chosen) - values[current[span]]
            errors = ((rest + values - target) ** 2).sum(axis=1)
            ranked = np.argsort(errors, kind="stable")
            order[span] = np.array([index for _, index in _different([(errors[i], i) for i in ranked])])
            current[span] = int(order[span][0])
    several = sum(len(values) > 1 for values in order)
    keep = max(int(ROWS ** (1 / max(several, 1))), 2)
    found = []
    for choice in itertools.islice(itertools.product(*(values[:keep] for values in order)), ROWS):
        total = sum(values[index] for values, index in zip(vectors, choice, strict=True)) - target
        found.append((float(total @ total), tuple(int(index) for index in choice)))
    return _different(sorted(found))
