"""Cvt3: the parameters of MuJoCo's muscle that come closest to a Hill muscle.

MuJoCo's muscle has a rigid tendon and no pennation. Over the length of muscle and tendon its force is

    a height f_L f_V + passive_height f_P
    f_L = 1 - 2 r^2 (r < 1/2), 2 (1 - r)^2 (r < 1), 0,    r = |length - peak| / (rise or fall)
    f_P = x^2 / 2 (x < 1), x - 1/2,                       x = (length - passive_start) / passive_width

with separate gain and bias: seven numbers, from which `gainprm` and `biasprm` follow. They start where
curves, pennation and tendon stretch put them (exact bookkeeping for peak, half force and the slope of
f_P at half force) and are fitted to the force map by bounded least squares with analytic derivatives:
lengths at the quantiles of those that random poses reach, times five activations. A weak pull to the
start decides what no length shows. The two numbers of f_V follow in a second fit over lengths and
velocities; since f_V(0) = 1 they leave the map alone.

The published pipeline (MyoSim and MyoConverter, Cvt3) searches lmin, lmax, fpmax and the peak force, gain
and bias tied, by differential evolution: `method="differential_evolution"`, for comparison.
Source of MuJoCo's curves: MuJoCo documentation, *Modeling, Actuators, Muscles*.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import optimize

from myowarp.osim.body.activation import activation_dynamics
from myowarp.osim.body.hill_muscle import ACTIVATIONS, HillMuscle, known
from myowarp.osim.document.model import Note

Array = np.ndarray
Method = Literal["least_squares", "differential_evolution"]

SPEEDS = np.array([-1.0, -0.75, -0.5, -0.25, -0.1, 0.1, 0.25, 0.5, 0.75, 1.0])
"""Velocities of the second fit [max_contraction_velocity]."""

NUM_LENGTHS = 64
"""Quantiles of the length that are fitted; the errors are measured at the quantiles between them."""

PRIOR = 0.005
"""Pull to the start per optimal fiber length [max_isometric_force]: moves a map by far less than 0.1 %."""

LEAST = 1e-9
"""Passive force [max_isometric_force] of a muscle that has none: MuJoCo asks for a positive one."""

UNUSED_SCALE = 200.0
"""MuJoCo's default of `scale`, which counts only for a negative force but has to be positive [N]."""

HIGH_FORCE = 3.0
"""Passive force from which a length is reported as beyond what muscles do [max_isometric_force]."""


@dataclass(frozen=True)
class ForceFit:
    """MuJoCo's parameters of one muscle; errors in shares of the maximum isometric force.

    Attributes:
        name: Of the muscle.
        length_range: `lengthrange`: shortest and longest length that was given [m].
        gainprm: MuJoCo's nine parameters of the active force, and 0.
        biasprm: The same of the passive force.
        dynprm: Time constants of rise and fall [s] and smoothing; None: activation is excitation.
        rms: Error of the map, over lengths of equal share and five activations.
        max_error: Largest error in the map.
        full_activation_rms: Error at activation 1.
        start_rms: Error of the map before fitting.
        velocity_rms: Error over lengths, velocities and activations.
        num_samples: Lengths used.
        num_masked: Lengths left out because they are not finite.
        notes: What is not exact.
    """

    name: str
    length_range: tuple[float, float]
    gainprm: tuple[float, ...]
    biasprm: tuple[float, ...]
    dynprm: tuple[float, float, float] | None
    rms: float
    max_error: float
    full_activation_rms: float
    start_rms: float
    velocity_rms: float
    num_samples: int
    num_masked: int
    notes: tuple[Note, ...]


@dataclass(frozen=True)
class _Samples:
    """Points of a force map; lengths in optimal fiber lengths beyond the slack tendon."""

    length: Array
    activation: Array
    force: Array


def bump(length: Array, peak: float, rise: float, fall: float) -> tuple[Array, Array]:
    """Return f_L and its derivatives by (peak, rise, fall), shape (3, ...)."""
    side = np.where(length < peak, -1.0, 1.0)
    width = np.where(side < 0.0, rise, fall)
    r = side * (length - peak) / width
    value = np.where(r < 0.5, 1.0 - 2.0 * r**2, np.where(r < 1.0, 2.0 * (1.0 - r) ** 2, 0.0))
    slope = np.where(r < 0.5, -4.0 * r, np.where(r < 1.0, -4.0 * (1.0 - r), 0.0)) / width
    by_width = -slope * r
    return value, np.array([-side * slope, by_width * (side < 0.0), by_width * (side > 0.0)])


def toe(length: Array, start: float, width: float) -> tuple[Array, Array]:
    """Return f_P and its derivatives by (start, width), shape (2, ...)."""
    x = np.maximum(length - start, 0.0) / width
    slope = np.minimum(x, 1.0)
    return np.where(x < 1.0, 0.5 * x**2, x - 0.5), np.array([-slope, -slope * x]) / width


def hill_curve(velocity: Array, eccentric: float) -> Array:
    """Return MuJoCo's f_V: parabolas through 0 at -1, 1 at 0, `eccentric` from eccentric - 1 on."""
    rest = eccentric - 1.0
    v = np.clip(velocity, -1.0, rest)
    return np.where(v < 0.0, (v + 1.0) ** 2, eccentric - (rest - v) ** 2 / rest)


def static_force(p: Array, length: Array, activation: Array) -> tuple[Array, Array]:
    """Return the force of the seven numbers and its derivatives by them, shape (7, ...)."""
    active, by_active = bump(length, *p[:3])
    passive, by_passive = toe(length, *p[4:6])
    force = activation * p[3] * active + p[6] * passive
    rows = [activation * p[3] * by_active, [activation * active], p[6] * by_passive, [passive]]
    return force, np.concatenate(rows)


def analytic_start(muscle: HillMuscle) -> Array:
    """Return the seven numbers from curves, pennation and tendon stretch, without any fit."""
    grid = np.linspace(0.05, 3.0, 1181)
    width = muscle.fiber_width / muscle.values["optimal_fiber_length"]
    along = np.sqrt(np.maximum(grid**2 - width**2, 0.0))
    cosine = np.sqrt(1.0 - width**2)
    half = along[muscle.curves.active_force_length(grid)[0] >= 0.5]
    rise, fall = 2.0 * (cosine - half[0]), 2.0 * (half[-1] - cosine)

    passive, slope = muscle.curves.passive_force(grid)
    at = int(np.searchsorted(passive, 0.5))
    passive_width, height = (1.0 / slope[at], 1.0) if at < len(grid) else (0.5, 0.0)
    passive_start = along[min(at, len(grid) - 1)] - passive_width

    def stretch(force: float) -> float:
        if muscle.rigid_tendon:
            return 0.0
        strain = np.linspace(0.0, 0.2, 401)
        tension = muscle.curves.tendon_force(1.0 + strain)[0]
        per_fiber = muscle.values["tendon_slack_length"] / muscle.values["optimal_fiber_length"]
        return float(np.interp(force, tension, strain)) * per_fiber

    return np.array(
        [
            cosine + stretch(cosine),
            max(rise, 0.1),
            max(fall, 0.1),
            cosine,
            passive_start + stretch(0.25),
            passive_width + stretch(0.5) - stretch(0.25),
            height * cosine,
        ]
    )


def bounds(start: Array) -> tuple[Array, Array]:
    """Return the least and greatest seven numbers."""
    low = np.array([start[0] - 1.5, 0.05, 0.05, 0.05, start[4] - 1.5, 0.02, 0.0])
    return low, np.array([start[0] + 1.5, 4.0, 4.0, 3.0, start[4] + 1.5, 5.0, 100.0])


def _least_squares(start: Array, samples: _Samples) -> Array:
    """Return the seven numbers closest to the samples."""
    low, high = bounds(start)
    pull = PRIOR * np.sqrt(len(samples.force)) / np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 10.0])

    def residual(p: Array) -> Array:
        force, _ = static_force(p, samples.length, samples.activation)
        return np.concatenate([force - samples.force, pull * (p - start)])

    def jacobian(p: Array) -> Array:
        _, derivatives = static_force(p, samples.length, samples.activation)
        return np.concatenate([derivatives.T, np.diag(pull)])

    first = np.clip(start, low + 1e-9, high - 1e-9)
    return optimize.least_squares(residual, first, jacobian, bounds=(low, high), x_scale="jac").x


def _differential_evolution(start: Array, samples: _Samples) -> Array:
    """Return the seven numbers of the best lmin, lmax, fpmax and peak force with gain and bias tied."""
    peak, cosine = start[0], start[3]

    def numbers(q: Array) -> Array:
        lmin, lmax, fpmax, force = q
        rise, fall = cosine * (1.0 - lmin), cosine * (lmax - 1.0)
        return np.array([peak, rise, fall, force, peak, fall / 2.0, fpmax * force])

    def cost(q: Array) -> float:
        force, _ = static_force(numbers(q), samples.length, samples.activation)
        return float(np.mean((force - samples.force) ** 2))

    # Limits as in MyoConverter; lmin and lmax where MuJoCo allows them.
    limits = [(0.0, 0.99), (1.01, 3.0), (0.01, 5.0), (0.5, 2.0)]
    return numbers(optimize.differential_evolution(cost, limits, rng=0).x)


SEARCHES: dict[Method, Callable[[Array, _Samples], Array]] = {
    "least_squares": _least_squares,
    "differential_evolution": _differential_evolution,
}


def _map(muscle: HillMuscle, lengths: Array) -> _Samples:
    """Return the static force map of a muscle over lengths [m]."""
    activation, length = np.repeat(ACTIVATIONS, len(lengths)), np.tile(lengths, len(ACTIVATIONS))
    force = muscle.tendon_force(activation, length)
    return _Samples(_normalized(muscle, length), activation, force)


def _normalized(muscle: HillMuscle, length: Array) -> Array:
    """Return lengths [m] in optimal fiber lengths beyond the slack tendon."""
    return (length - muscle.values["tendon_slack_length"]) / muscle.values["optimal_fiber_length"]


def _fit_velocity(muscle: HillMuscle, p: Array, lengths: Array) -> tuple[float, float, float]:
    """Return the speed at which f_V is 0 [m/s], its limit, and the RMS error.

    The speed counts on the length of muscle and tendon, so that pennation and damping are in it.
    """
    scale = muscle.velocity_scale
    grid = np.meshgrid(ACTIVATIONS[1:], lengths, SPEEDS * scale, indexing="ij")
    activation, length, velocity = (axis.ravel() for axis in grid)
    force = muscle.tendon_force(activation, length, velocity)
    length = _normalized(muscle, length)
    gain = activation * p[3] * bump(length, *p[:3])[0]
    passive = p[6] * toe(length, *p[4:6])[0]

    def residual(q: Array) -> Array:
        return gain * hill_curve(velocity / (q[0] * scale), q[1]) + passive - force

    fit = optimize.least_squares(residual, [0.75, 1.35], bounds=([0.05, 1.01], [5.0, 3.0]))
    return float(fit.x[0] * scale), float(fit.x[1]), float(np.sqrt(np.mean(fit.fun**2)))


def _engine_parameters(
    muscle: HillMuscle, p: Array, length_range: tuple[float, float], speed: float, eccentric: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return `gainprm` and `biasprm`; lmin is at least 0, which the length unit is stretched for."""
    optimal, slack = muscle.values["optimal_fiber_length"], muscle.values["tendon_slack_length"]
    peak, rise, fall, passive_start, passive_width = (optimal * p[i] for i in (0, 1, 2, 4, 5))
    unit = max(optimal * np.cos(muscle.values["pennation_angle_at_optimal"]), rise)
    force = p[3] * muscle.values["max_isometric_force"]

    def row(offset: float, lmax: float) -> tuple[float, ...]:
        ends = [(length - slack - offset) / unit for length in length_range]
        lmin, fpmax = 1.0 - rise / unit, max(p[6] / p[3], LEAST)
        numbers = (*ends, force, UNUSED_SCALE, lmin, lmax, speed / unit, fpmax, eccentric, 0.0)
        return tuple(float(number) for number in numbers)

    gain = row(peak - unit, 1.0 + fall / unit)
    return gain, row(passive_start - unit, 1.0 + 2.0 * passive_width / unit)


def fit_force(muscle: HillMuscle, lengths: Array, method: Method = "least_squares") -> ForceFit:
    """Return the parameters of MuJoCo's muscle closest to a Hill muscle.

    Args:
        muscle: The muscle, of any class (see `known`).
        lengths: Lengths of muscle and tendon in random poses [m], shape (num_samples,).
        method: How the force map is fitted.

    Raises:
        ValueError: If no length is finite.
    """
    lengths = np.asarray(lengths, float)
    used = lengths[np.isfinite(lengths)]
    if not used.size:
        raise ValueError(f"muscle '{muscle.name}' has no finite length among {lengths.size} poses")
    share = np.linspace(0.0, 1.0, 2 * NUM_LENGTHS + 1)
    fitted, between = np.quantile(used, share[1::2]), np.quantile(used, share[::2])

    muscle, replaced = known(muscle)
    start = analytic_start(muscle)
    p = SEARCHES[method](start, _map(muscle, fitted))
    speed, eccentric, velocity_rms = _fit_velocity(muscle, p, fitted[:: NUM_LENGTHS // 16])

    check = _map(muscle, between)
    error = static_force(p, check.length, check.activation)[0] - check.force
    start_error = static_force(start, check.length, check.activation)[0] - check.force
    # A length range of no width would leave MuJoCo without a unit of length.
    margin = max(0.0, 0.5 * (1e-3 - np.ptp(used)))
    length_range = (float(used.min() - margin), float(used.max() + margin))
    gainprm, biasprm = _engine_parameters(muscle, p, length_range, speed, eccentric)
    dynprm, notes = activation_dynamics(muscle)
    return ForceFit(
        muscle.name,
        length_range,
        gainprm,
        biasprm,
        dynprm,
        rms=float(np.sqrt(np.mean(error**2))),
        max_error=float(np.abs(error).max()),
        full_activation_rms=float(np.sqrt(np.mean(error[check.activation == 1.0] ** 2))),
        start_rms=float(np.sqrt(np.mean(start_error**2))),
        velocity_rms=velocity_rms,
        num_samples=used.size,
        num_masked=lengths.size - used.size,
        notes=(*replaced, *notes, *_stretched(muscle, check, error)),
    )


def _stretched(muscle: HillMuscle, check: _Samples, error: Array) -> tuple[Note, ...]:
    """Say where poses stretch a muscle beyond what it bears."""
    passive = check.activation == 0.0
    share = float(np.mean(check.force[passive] > HIGH_FORCE))
    if share == 0.0:
        return ()
    rule = (
        f"poses stretch it to more than {HIGH_FORCE:g} times its maximum isometric force, where MuJoCo's "
        f"passive force is a line: {100 * share:.0f} % of them"
    )
    return (Note(muscle.name, rule, f"{np.abs(error).max():.2g} times the maximum isometric force"),)
