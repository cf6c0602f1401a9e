"""Cvt2 and Cvt3 of all muscles over the cores, with what OpenSim says about each in poses of the check.

A muscle is one piece of work: its path is fitted, its forces are fitted over the lengths that its path
takes, and the reference is evaluated where the converted model will be checked. So is a ligament or path
actuator, whose path only is fitted. Finished pieces are kept on disk, so that an interrupted conversion
continues, and an edited model repeats what was edited.
"""

import dataclasses
import multiprocessing
import pickle
import platform
import signal
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from myowarp.disk import cached, files_digest, version
from myowarp.osim.body.hill_muscle import ACTIVATIONS, HillMuscle, known
from myowarp.osim.body.moment_arm import Poses, crossed, own_reference, poses_of
from myowarp.osim.body.path_solution import load_kernel
from myowarp.osim.convert.tendon.choice import fit_path
from myowarp.osim.convert.tendon.fit import Method as PathMethod
from myowarp.osim.convert.tendon.fitted import Expected, MuscleFit, PathOnly
from myowarp.osim.convert.tendon.force import Method as ForceMethod
from myowarp.osim.convert.tendon.force import fit_force
from myowarp.osim.document.kinematics import random_poses
from myowarp.osim.document.model import Model

Array = np.ndarray

FIT_SEED, CHECK_SEED = 0, 1
POSES = 300
"""Random poses that a muscle is fitted in."""
CHECK_POSES = 200
"""Held-out random poses of the check."""
SWEEP = 41
"""Points of a curve over the range of a coordinate, the others at their defaults."""
SOURCES = ("osim/document/**/*.py", "osim/body/**/*.py", "osim/convert/tendon/*.py", "laws/**/*.py")
"""Files of the package that a fit depends on."""
GRID = 33
"""Lengths of a force map."""


@dataclass(frozen=True)
class Methods:
    """Methods by which paths and forces are fitted."""

    path: PathMethod = "least_squares"
    force: ForceMethod = "least_squares"


PAPER = Methods("annealing", "differential_evolution")
"""As published; for comparison."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Poses that all muscles share.

    Attributes:
        fit: Random poses, with neighbours.
        check: Other random poses, with neighbours.
        sweeps: By free coordinate, poses over its range.
    """

    fit: Poses
    check: Poses
    sweeps: Mapping[str, Poses]


def sampled(model: Model) -> Samples:
    """Return the poses of a conversion."""
    free = model.independent
    fit, check = (
        poses_of(model, random_poses(model, count, seed), free)
        for count, seed in ((POSES, FIT_SEED), (CHECK_POSES, CHECK_SEED))
    )
    sweeps = {name: poses_of(model, sweep(model, name), [name]) for name in free}
    return Samples(fit, check, sweeps)


def sweep(model: Model, coordinate: str) -> dict[str, Array]:
    """Return values of one coordinate over its range, and of all others at their defaults."""
    values = {name: np.full(SWEEP, other.default) for name, other in model.coordinates.items()}
    return {**values, coordinate: np.linspace(*model.coordinates[coordinate].sampling_range, SWEEP)}


def fit_muscle(model: Model, name: str, samples: Samples, methods: Methods = Methods()) -> MuscleFit:
    """Fit path and forces of a muscle, and evaluate what it should do."""
    muscle = model.muscles[name]
    along = crossed(model, muscle.path)
    reference = own_reference(model, muscle.path, samples.fit, along)
    path = fit_path(model, name, muscle.path, samples.fit, reference, methods.path)
    random = own_reference(model, muscle.path, samples.check, along)
    sweeps = {
        coordinate: own_reference(model, muscle.path, samples.sweeps[coordinate], [coordinate])
        for coordinate in along
    }
    hill = HillMuscle.of(muscle)
    fitted = fit_force(hill, reference.length, methods.force)
    grid = np.linspace(reference.length.min(), reference.length.max(), GRID)
    hill, _ = known(hill)
    forces, map_ = (hill.tendon_force(ACTIVATIONS, lengths[:, None]) for lengths in (random.length, grid))
    return MuscleFit(
        name, muscle.max_isometric_force, path, fitted, Expected(random, sweeps, forces, grid, map_)
    )


def fit_passive(model: Model, name: str, samples: Samples, methods: Methods = Methods()) -> PathOnly:
    """Fit the path of a ligament or path actuator."""
    path = model.pulling[name]
    fitted = fit_path(model, name, path, samples.fit, None, methods.path)
    return PathOnly(name, fitted, own_reference(model, path, samples.check, crossed(model, path)))


def fit_muscles(
    model: Model, samples: Samples, digest: str, methods: Methods, workers: int
) -> Iterator[MuscleFit | PathOnly]:
    """Yield the fits of all muscles, ligaments and path actuators, each as soon as it is ready, in any order.

    Args:
        model: The model.
        samples: Its poses.
        digest: Of its file.
        methods: Of the fits.
        workers: Processes; 1 works in this one.
    """
    shared = (model, (digest, dataclasses.astuple(methods), _code_digest()), samples, methods)
    names = list(model.pulling)
    if workers == 1 or len(names) < 2:
        _share(*shared)
        yield from map(_work, names)
        return
    # Forked workers share poses and kernel, and need not import Warp again, which takes longer than the fits.
    # macOS may kill a process that forks with threads.
    load_kernel()
    context = multiprocessing.get_context("fork" if platform.system() == "Linux" else None)
    with ProcessPoolExecutor(min(workers, len(names)), context, _begin, shared) as pool:
        try:
            for future in as_completed([pool.submit(_work, name) for name in names]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


_SHARED: dict[str, tuple[Model, tuple[object, ...], Samples, Methods]] = {}
"""Of a worker process: what all its muscles have in common."""


def _share(model: Model, key: tuple[object, ...], samples: Samples, methods: Methods) -> None:
    _SHARED["now"] = (model, key, samples, methods)


def _begin(*shared: object) -> None:
    """Begin a worker; a keyboard interrupt is for the process that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _share(*shared)  # type: ignore[arg-type]


def _work(name: str) -> MuscleFit | PathOnly:
    """Return the fit of a muscle or another path, from the cache if it is there; pickle gets no damaged file.

    Raises:
        ValueError: Its parameters leave it no force, or no length, that is a number.
    """
    model, key, samples, methods = _SHARED["now"]

    def make() -> MuscleFit | PathOnly:
        if name in model.muscles:
            return fit_muscle(model, name, samples, methods)
        return fit_passive(model, name, samples, methods)

    try:
        return cached(("opensim_muscle", name, *key), make, pickle.dumps, pickle.loads)
    except (ValueError, ArithmeticError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{model.source}: '{name}' cannot be fitted: {reason}") from error


def _code_digest() -> str:
    """Return a digest of the code and packages that a fit depends on."""
    package = FilePath(__file__).parents[3]
    files = sorted(file for pattern in SOURCES for file in package.glob(pattern))
    return f"{files_digest(files)} {version('numpy')} {version('scipy')}"
