"""Dynamics of a converted model against the document's: our step, model.mjb and model.xml in plain MuJoCo.

Each coordinate is on its own over its full range. What is compared, as shares of what the reference has:

- inertia: the mass matrix along the independent coordinates, couplers included; of MuJoCo's springs the
  inverse of what unit forces do;
- response: a coordinate's acceleration under a unit force on it, at rest without gravity;
- gravity: forces that stand for the difference of accelerations at rest;
- acceleration: in states with velocities, gravity and forces;
- torque: inverse dynamics of a smooth motion. Forces of the reference move the model; the error of its
  acceleration, times the mass matrix, is the error of force.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from myowarp.osim.bundle.couplings import regularity
from myowarp.osim.convert.check.engines import Engine, States
from myowarp.osim.convert.check.oracle import opensim_equations, speaks_of_dynamics
from myowarp.osim.document.dynamics import equations
from myowarp.osim.document.model import Model

Array = np.ndarray
Equations = Callable[[Array, Array], tuple[Array, Array]]
"""M and c at values and speeds (n, k)."""

OWN, OPENSIM = "equations of motion of the document, own code tested against OpenSim 4.6", "OpenSim"
REST, STATES, TIMES = 30, 100, 100
"""Poses at rest, states with velocities and forces, and times of the smooth motion."""
SPEED = {True: 3.0, False: 0.5}
"""Greatest speed of a state [rad/s, m/s]; by `rotational`."""
ACCELERATION = 20.0
"""[rad/s^2, m/s^2] that a state's force gives a coordinate that is alone, at most."""
DURATION, FREQUENCIES = 2.0, (0.3, 1.0)
"""[s] and [Hz] of the smooth motion, a sine over the range of each coordinate."""
REACH = 0.98
"""Share of the range that it takes."""
REGULAR = 1e-12
"""Least eigenvalue of the mass matrix, its diagonal scaled to 1, that leaves accelerations determined."""
QUIET = 1e-3
"""Share of the force that gives a coordinate `ACCELERATION`; lesser forces are compared with that."""

QUANTITIES = ("inertia", "response", "gravity", "acceleration", "torque")


@dataclass(frozen=True, eq=False)
class Samples:
    """States of the check, and what the reference has there; k coordinates.

    Attributes:
        rest: Poses at rest; M there, and forces that hold it against gravity.
        states: With velocities and forces; M, and accelerations.
        motion: Of the smooth motion, with the reference's forces; M, and accelerations.
        undetermined: Share of all that was drawn in which the document determines no accelerations.
        disagreement: How far OpenSim is from our equations in the states: shares of the acceleration, (n,).
    """

    rest: tuple[States, Array, Array]
    states: tuple[States, Array, Array]
    motion: tuple[States, Array, Array]
    undetermined: float
    disagreement: Array


@dataclass(frozen=True, eq=False)
class EngineErrors:
    """Errors of an engine's step of a model.

    Attributes:
        errors: By quantity, shares of the reference, shape (samples, k).
        states: Norm of the error over that of the accelerations, in each state.
        condition: Of the mass matrix, its diagonal scaled to 1, in the worst state.
        forces: Of the smooth motion as the engine would have them, shape (TIMES, k).
    """

    errors: Mapping[str, Array]
    states: Array
    condition: float
    forces: Array


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The check of dynamics.

    Attributes:
        reference: Who says what is right.
        coordinates: Names, and whether each is an angle.
        samples: Where it was asked; None: the document determines no accelerations anywhere.
        engines: Errors by name.
    """

    reference: str
    coordinates: Mapping[str, bool]
    samples: Samples | None
    engines: Mapping[str, EngineErrors]


@np.errstate(all="ignore")  # what overflows is no number, and counted
def dynamics(
    source: Path,
    model: Model,
    engines: Mapping[str, Engine],
    advance: Callable[[int], None] = lambda count: None,
    seed: int = 2,
) -> Dynamics:
    """Compare engines with OpenSim where it is installed, else with our equations of the document.

    Args:
        source: The .osim file.
        model: The same as read by us.
        engines: What steps the converted model, by name.
        advance: Is told when one more of the reference and the engines is done.
        seed: Of the states.
    """
    free = model.independent
    rotational = {name: model.coordinates[name].rotational for name in free}

    def own(values: Array, speeds: Array) -> tuple[Array, Array]:
        return equations(model, dict(zip(free, values.T, strict=True)), speeds)

    def theirs(values: Array, speeds: Array) -> tuple[Array, Array]:
        return opensim_equations(source, model, dict(zip(free, values.T, strict=True)), speeds)

    live, samples = speaks_of_dynamics(model), None
    if free and live:
        try:
            samples = _samples(model, own, theirs, seed)
        except (ValueError, RuntimeError):  # OpenSim does not load what we read, or cannot evaluate it
            live = False
    if free and not live:
        samples = _samples(model, own, own, seed)
    advance(1)
    found = {}
    if samples is not None:
        for name, engine in engines.items():
            found[name] = _errors(engine, samples)
            advance(1)
    return Dynamics(OPENSIM if live else OWN, rotational, samples, found)


def _samples(model: Model, own: Equations, reference: Equations, seed: int) -> Samples | None:
    """Draw states, and ask the reference; what it leaves undetermined goes."""
    random, free = np.random.default_rng(seed), model.independent
    low, high = np.array([model.coordinates[name].sampling_range for name in free]).T
    speed = np.array([SPEED[model.coordinates[name].rotational] for name in free])
    poses = random.uniform(low, high, (REST + STATES, len(free)))
    speeds = random.uniform(-speed, speed, poses.shape)
    speeds[:REST] = 0.0
    rate = 2 * np.pi * random.uniform(*FREQUENCIES, len(free))
    phase = np.linspace(0, DURATION, TIMES)[:, None] * rate + random.uniform(0, 2 * np.pi, len(free))
    half = REACH * (high - low) / 2
    values = np.concatenate([poses, (high + low) / 2 + half * np.sin(phase)])
    speeds = np.concatenate([speeds, half * rate * np.cos(phase)])
    M, c = reference(values, speeds)
    known = np.asarray(np.isfinite(M).all(axis=(1, 2)) & np.isfinite(c).all(axis=1))
    known[known] = [regularity(one) > REGULAR for one in M[known]]
    parts = np.split(np.arange(len(known)), [REST, REST + STATES])
    rest, moving, motion = (part[known[part]] for part in parts)
    if not (len(rest) and len(moving) and len(motion)):
        return None
    load = _rms(np.einsum("nii->ni", M[rest])) * ACCELERATION + _rms(c[rest])
    forces = random.uniform(-1, 1, (len(moving), len(free))) * load
    wanted = np.linalg.solve(M[moving], (forces - c[moving])[..., None])[..., 0]
    smooth = -half * rate**2 * np.sin(phase)[motion - REST - STATES]
    needed = np.einsum("njk,nk->nj", M[motion], smooth) + c[motion]
    disagreement = np.zeros(len(moving))
    if reference is not own:
        M_own, c_own = own(values[moving], speeds[moving])
        expected = np.linalg.solve(M_own, (forces - c_own)[..., None])[..., 0]
        disagreement = np.linalg.norm(wanted - expected, axis=1) / np.linalg.norm(wanted, axis=1)
    return Samples(
        (States(values[rest], speeds[rest], 0 * values[rest]), M[rest], c[rest]),
        (States(values[moving], speeds[moving], forces), M[moving], wanted),
        (States(values[motion], speeds[motion], needed), M[motion], smooth),
        float(1 - known.mean()),
        disagreement,
    )


def _errors(engine: Engine, samples: Samples) -> EngineErrors:
    """Compare an engine with the reference."""
    still, M, gravity = samples.rest
    count, k = still.values.shape
    unit = np.tile(np.eye(k), (count, 1))
    pushed = States(np.repeat(still.values, k, axis=0), 0 * unit, unit, gravity=False)
    # Rows are forces; a response to a force is a column of the inverse.
    responses = engine.accelerations(pushed).reshape(count, k, k).transpose(0, 2, 1)
    wanted = np.einsum("nii->ni", np.linalg.inv(M))
    found = engine.inertia(still.values)
    found = _inverted(responses) if found is None else found
    size = np.sqrt(np.einsum("nii->ni", M))
    fallen = engine.accelerations(still) + np.linalg.solve(M, gravity[..., None])[..., 0]
    states, M_states, accelerations = samples.states
    missed = engine.accelerations(states) - accelerations
    share = np.linalg.norm(missed, axis=1) / np.linalg.norm(accelerations, axis=1)
    motion, M_motion, smooth = samples.motion
    lacking = np.einsum("njk,nk->nj", M_motion, smooth - engine.accelerations(motion))
    errors = {
        "inertia": np.abs((found - M) / (size[:, :, None] * size[:, None, :])).max(axis=2),
        "response": np.abs(np.einsum("nii->ni", responses) - wanted) / wanted,
        "gravity": np.abs(np.einsum("njk,nk->nj", M, fallen)) / _scale(gravity, M),
        "acceleration": np.abs(missed) / _rms(accelerations),
        "torque": np.abs(lacking) / _scale(motion.forces, M_motion),
    }
    worst = M_states[np.nan_to_num(share, nan=np.inf).argmax()]
    errors = {name: np.nan_to_num(values, nan=np.inf) for name, values in errors.items()}
    share = np.nan_to_num(share, nan=np.inf)
    return EngineErrors(errors, share, 1 / regularity(worst), motion.forces + lacking)


def _inverted(responses: Array) -> Array:
    """Return inverses; of what is singular or no number, NaN."""
    known = np.isfinite(responses).all(axis=(1, 2))
    known[known] = np.linalg.cond(responses[known]) < 1 / np.finfo(float).eps
    inverses = np.full_like(responses, np.nan)
    inverses[known] = np.linalg.inv(responses[known])
    return inverses


def _rms(values: Array) -> Array:
    """Return root mean squares over samples, shape (k,)."""
    return np.sqrt(np.mean(values**2, axis=0))


def _scale(forces: Array, M: Array) -> Array:
    """Return what forces (n, k) are compared with, shape (k,)."""
    return np.maximum(_rms(forces), QUIET * ACCELERATION * _rms(np.einsum("nii->ni", M)))
