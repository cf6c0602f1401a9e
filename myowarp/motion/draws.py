"""Draws of what is uncertain in a trial: many solutions of one recording, from kinematics to muscle forces.

Factors are log-normal, exp(s z) with a standard normal z, one for each muscle, body or marker; noise of
markers is normal, in every frame and along every axis by itself. Draw 0 is the trial as it is. A draw depends
on the seed, its number and on what is drawn: not on other draws, on the trial, or on what else is uncertain.
So draw 17 has the same strong soleus in each trial of a model: trials are compared under equal circumstances.

Source of the method: Monte Carlo analysis of musculoskeletal models, Hannah et al. (2017),
doi:10.1115/1.4035481.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any
from zlib import crc32

import numpy as np

from myowarp.motion.actuators import actuators_of
from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.motion.inverse_kinematics import Fitted, inverse_kinematics
from myowarp.motion.markers import Markers
from myowarp.motion.muscle_forces import MuscleForces
from myowarp.motion.setup import TrialSetup
from myowarp.motion.smooth import derivatives
from myowarp.motion.steps import least_forces
from myowarp.osim.body.muscle_paths import MusclePaths, muscle_paths
from myowarp.osim.body.skeleton import Bones


@dataclass(frozen=True)
class Uncertainty:
    """Spreads of a trial's draws.

    Attributes:
        max_isometric_force: s of the factor on that of each muscle [1].
        tendon_slack_length: The same.
        mass: s of the factor on mass and inertia of each body [1].
        marker_weight: s of the factor on the weight of each marker [1].
        marker_noise: Standard deviation of recorded places [m].
    """

    max_isometric_force: float = 0.0
    tendon_slack_length: float = 0.0
    mass: float = 0.0
    marker_weight: float = 0.0
    marker_noise: float = 0.0

    def __post_init__(self) -> None:
        """Check the spreads.

        Raises:
            ValueError: One is below 0 or not finite.
        """
        for one in fields(self):
            width = getattr(self, one.name)
            if not 0.0 <= width < np.inf:
                raise ValueError(f"the spread of {one.name} must be at least 0 and finite, got {width:g}")

    @property
    def moves(self) -> bool:
        """Whether joint angles differ between draws."""
        return self.marker_noise > 0.0 or self.marker_weight > 0.0


@dataclass(frozen=True, eq=False)
class Recording:
    """A trial that can be drawn.

    Attributes:
        bones: The model.
        time: Of what is solved [s], shape (frames,).
        values: Of the independent coordinates, before the filter [rad] or [m], shape (rows, coordinates).
        setup: With filter, mode, exponent and reserves.
        markers: Source of the values; None: a file of angles.
        targets: Weights and wanted values of their pose, as `inverse_kinematics` takes them.
        loads: From outside.
        factors: On `max_isometric_force`, `tendon_slack_length` and `mass`, by name; with a colon and the
            name of a muscle or body behind, on its alone.
        known: Times of the values [s], shape (rows,), where there are more of them; None: those of `time`.
    """

    bones: Bones
    time: np.ndarray
    values: np.ndarray
    setup: TrialSetup = field(default_factory=TrialSetup)
    markers: Markers | None = None
    targets: Mapping[str, Any] = field(default_factory=dict)
    loads: Sequence[Load] = ()
    factors: Mapping[str, float] = field(default_factory=dict)
    known: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Drawn:
    """Draws of a trial, one after the other.

    Attributes:
        draws: Their numbers, shape (draws,).
        values: Joint angles [rad] or [m], filtered, shape (draws, frames, coordinates).
        joint_moment: [N m] or [N], likewise.
        muscles: Names of muscles.
        forces: Of all frames of all draws, shape (draws * frames, ...).
        marker_rms: Root mean square distance of markers [m], shape (draws,); NaN without markers.
    """

    draws: np.ndarray
    values: np.ndarray
    joint_moment: np.ndarray
    muscles: tuple[str, ...]
    forces: MuscleForces
    marker_rms: np.ndarray


def normal(seed: int, draw: int, what: str, *shape: int) -> np.ndarray:
    """Return standard normal numbers of a draw; none for draw 0."""
    if draw == 0:
        return np.zeros(shape)
    return np.random.default_rng([seed, draw, crc32(what.encode())]).normal(size=shape)


def check_factors(factors: Mapping[str, float]) -> None:
    """Raise ValueError if a factor is not above 0 and finite."""
    for key, factor in factors.items():
        if not 0.0 < factor < np.inf:
            raise ValueError(f"factor {key} must be above 0 and finite, got {factor:g}")


def named_factors(recording: Recording, what: str, names: Sequence[str]) -> np.ndarray:
    """Return the factors that a trial states on something, one for each name.

    Raises:
        ValueError: A factor is on a name that is not there, or not above 0 and finite.
    """
    found = np.full(len(names), recording.factors.get(what, 1.0))
    check_factors(recording.factors)
    for key, factor in recording.factors.items():
        kind, _, name = key.partition(":")
        if kind == what and name:
            if name not in names:
                raise ValueError(f"factor {key}: {name!r} unknown; available: {', '.join(names)}")
            found[list(names).index(name)] *= factor
    return found


def draw_trial(recording: Recording, uncertain: Uncertainty, draws: Sequence[int], seed: int = 0) -> Drawn:
    """Solve draws of a trial, all frames of all draws together.

    Args:
        recording: The trial.
        uncertain: How far draws spread.
        draws: Their numbers; 0 is the trial as it is.
        seed: Of all draws.

    Raises:
        ValueError: A spread is below 0, or the trial is not what it should be.
    """
    bones, count, frames = recording.bones, len(draws), len(recording.time)
    muscles = tuple(name for name, muscle in bones.model.muscles.items() if muscle.applies_force)
    if not muscles:
        raise ValueError(f"model {bones.model.name!r} has no muscle")

    def spread(what: str, names: Sequence[str]) -> np.ndarray:
        """Return factors, each frame's own, shape (count * frames, names)."""
        scale = getattr(uncertain, what)
        with np.errstate(over="ignore", under="ignore"):
            rows = [np.exp(scale * normal(seed, draw, what, len(names))) for draw in draws]
            found = named_factors(recording, what, names) * rows
        if not ((found > 0.0) & (found < np.inf)).all():
            raise ValueError(
                f"a spread of {scale:g} gives factors on {what} that no number holds; it is the standard "
                "deviation of a logarithm, such as 0.1"
            )
        return np.repeat(found, frames, axis=0)

    def tiled(array: np.ndarray) -> np.ndarray:
        """Return rows of the trial once for each draw."""
        return np.tile(array, (count, *[1] * (array.ndim - 1)))

    def finite(name: str, values: np.ndarray) -> None:
        """Raise ValueError if a result of a draw is not finite."""
        if not np.isfinite(values).all():
            draw = draws[int(np.argmin(np.isfinite(values.reshape(count, -1)).all(axis=1)))]
            raise ValueError(
                f"{name} of draw {draw} are not finite; its motion, factors or loads are too large"
            )

    fitted = _fitted(recording, uncertain, draws, seed) if uncertain.moves else None
    if fitted is None:
        known = recording.time if recording.known is None else recording.known
        found = derivatives(known, recording.values, recording.time, recording.setup.cutoff)
        once = muscle_paths(bones, found[0], found[1])
        whole = tiled(once.length), tiled(once.velocity), tiled(once.moment_arm)
        paths, motion = MusclePaths(muscles, *whole, once.crossed), [tiled(part) for part in found]
    else:
        beside = np.concatenate(np.split(fitted.values, count), axis=1)
        found = derivatives(recording.time, beside, recording.time, recording.setup.cutoff)
        motion = [np.concatenate(np.split(part, count, axis=1)) for part in found]
        paths = muscle_paths(bones, motion[0], motion[1])
    loads = [
        replace(x, force=tiled(x.force), point=tiled(x.point), torque=tiled(x.torque))
        for x in recording.loads
    ]
    bodies = [name for name, number in bones.bodies.items() if number >= 0]
    needed = inverse_dynamics(bones, motion[0], motion[1], motion[2], loads, spread("mass", bodies))
    finite("joint angles", motion[0])
    finite("joint moments", needed.joint_moment)
    forces = least_forces(
        bones,
        recording.setup,
        paths,
        needed,
        actuators_of(bones, motion[0]),
        strength=spread("max_isometric_force", muscles),
        slack=spread("tendon_slack_length", muscles),
        sequence=frames,
    )
    shape = count, frames, -1
    rms = np.full(count, np.nan)
    if fitted is not None:
        rms = np.sqrt(np.nanmean(fitted.error.reshape(shape) ** 2, axis=(1, 2)))
    finite("forces of muscles", forces.force)
    finite("activations", forces.activation)
    finite("reserves", forces.reserve)
    finite("missing moments", forces.missing)
    return Drawn(
        np.array(draws), motion[0].reshape(shape), needed.joint_moment.reshape(shape), muscles, forces, rms
    )


def _fitted(recording: Recording, uncertain: Uncertainty, draws: Sequence[int], seed: int) -> Fitted:
    """Return the joint angles of draws, each frame from where the trial itself has it."""
    markers = recording.markers
    if markers is None:
        raise ValueError("noise and weights of markers need markers; this trial is a file of joint angles")
    targets = dict(recording.targets)
    shape, used = markers.positions.shape, list(targets.get("marker_weights") or ())
    noise = [normal(seed, draw, "marker_noise", *shape) for draw in draws]
    places = markers.positions + uncertain.marker_noise * np.array(noise)
    factors = [
        np.exp(uncertain.marker_weight * normal(seed, draw, "marker_weight", len(used))) for draw in draws
    ]
    many = Markers(markers.names, np.tile(markers.time, len(draws)), places.reshape(-1, *shape[1:]))
    wanted = targets.get("coordinate_values", {}).items()
    targets["coordinate_values"] = {
        name: np.tile(value, len(draws)) if np.ndim(value) else value for name, value in wanted
    }
    return inverse_kinematics(
        recording.bones,
        many,
        **targets,
        near=np.tile(recording.values, (len(draws), 1)),
        weight_factors=np.repeat(factors, shape[0], axis=0) if used else 1.0,
    )
