"""Cvt2 and Cvt3 of all muscles over the cores, with what OpenSim says about each in poses of the check.

A muscle is one piece of work: its path is fitted, its forces are fitted over the lengths that its path
takes, and the reference is evaluated where the converted model will be checked. Finished muscles are kept
on disk, so that an interrupted conversion continues, and an edited model repeats what was edited.
"""

import dataclasses
import hashlib
import multiprocessing
import pickle
import signal
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from myowarp.cache import cached, files_digest, version
from myowarp.models.opensim.force import ACTIVATIONS, ForceFit, fit_force
from myowarp.models.opensim.force import Method as ForceMethod
from myowarp.models.opensim.hill import HillMuscle, known
from myowarp.models.opensim.kinematics import independent, random_poses, sampling_range
from myowarp.models.opensim.model import Model
from myowarp.models.opensim.moment_arm import Poses, Reference, crossed, own_reference, poses_of
from myowarp.models.opensim.opensim_reference import opensim_references
from myowarp.models.opensim.surface_fit import Method as PathMethod
from myowarp.models.opensim.wrapping import PathFit, fit_path

Array = np.ndarray

FIT_SEED, CHECK_SEED = 0, 1
POSES = 300
"""Random poses that a muscle is fitted in."""
CHECK_POSES = 200
"""Random poses of the check; no fit has seen them."""
SWEEP = 41
"""Points of a curve over the range of a coordinate, the others at their defaults."""
GRID = 33
"""Lengths of a force map."""


@dataclass(frozen=True)
class Methods:
    """How paths and forces are fitted."""

    path: PathMethod = "least_squares"
    force: ForceMethod = "least_squares"


PAPER = Methods("annealing", "differential_evolution")
"""As published; for comparison."""


@dataclass(frozen=True, eq=False)
class Expected:
    """What OpenSim says about a muscle.

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
    free = independent(model)
    fit, check = (
        poses_of(model, random_poses(model, count, seed), free)
        for count, seed in ((POSES, FIT_SEED), (CHECK_POSES, CHECK_SEED))
    )
    sweeps = {name: poses_of(model, sweep(model, name), [name]) for name in free}
    return Samples(fit, check, sweeps)


def sweep(model: Model, coordinate: str) -> dict[str, Array]:
    """Return values of one coordinate over its range, and of all others at their defaults."""
    values = {name: np.full(SWEEP, other.default) for name, other in model.coordinates.items()}
    return {**values, coordinate: np.linspace(*sampling_range(model, coordinate), SWEEP)}


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


def against_opensim(source: Path, model: Model, samples: Samples, fits: list[MuscleFit]) -> list[MuscleFit]:
    """Return the same fits with OpenSim's own lengths and moment arms in the random poses of the check.

    Raises:
        ValueError: OpenSim is not installed, or does not read the file.
    """
    along = {fit.name: list(fit.expected.random.moment_arm) for fit in fits}
    found = opensim_references(source, model, samples.check, along)
    renewed = []
    for fit in fits:
        hill, _ = known(HillMuscle.of(model.muscles[fit.name]))
        forces = hill.tendon_force(ACTIVATIONS, found[fit.name].length[:, None])
        expected = dataclasses.replace(fit.expected, random=found[fit.name], forces=forces)
        renewed.append(dataclasses.replace(fit, expected=expected))
    return renewed


def fit_muscles(
    model: Model, samples: Samples, digest: str, methods: Methods, workers: int
) -> Iterator[MuscleFit]:
    """Yield the fits of all muscles, each as soon as it is ready, in any order.

    Args:
        model: The model.
        samples: Its poses.
        digest: Of its file.
        methods: Of the fits.
        workers: Processes; 1 works in this one.
    """
    shared = (model, (digest, dataclasses.astuple(methods), _code_digest()), samples, methods)
    if workers == 1 or len(model.muscles) < 2:
        _share(*shared)
        yield from map(_work, model.muscles)
        return
    # Forked workers share the poses and need not import Warp again, which takes longer than the fits.
    fork = "fork" if "fork" in multiprocessing.get_all_start_methods() else None
    context = multiprocessing.get_context(fork)
    with ProcessPoolExecutor(min(workers, len(model.muscles)), context, _begin, shared) as pool:
        try:
            for future in as_completed([pool.submit(_work, name) for name in model.muscles]):
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


def _work(name: str) -> MuscleFit:
    """Return a muscle's fit, from the cache if it is there.

    Raises:
        ValueError: Its parameters leave it no force, or no length, that is a number.
    """
    model, key, samples, methods = _SHARED["now"]

    def make() -> MuscleFit:
        return fit_muscle(model, name, samples, methods)

    try:
        return cached(("opensim_muscle", name, *key), ".muscle", make, _save, _load)
    except (ValueError, ArithmeticError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{model.source}: muscle '{name}' cannot be fitted: {reason}") from error


def _save(fit: MuscleFit, path: str) -> None:
    content = pickle.dumps(fit)
    Path(path).write_bytes(hashlib.sha256(content).digest() + content)


def _load(path: str) -> MuscleFit:
    """Read a fit back; a damaged file never reaches pickle."""
    data = Path(path).read_bytes()
    if hashlib.sha256(data[32:]).digest() != data[:32]:
        raise ValueError(f"{path} is damaged")
    return pickle.loads(data[32:])


def _code_digest() -> str:
    """Return a digest of the code and packages that a fit depends on."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return f"{files_digest(files)} {version('numpy')} {version('scipy')}"
