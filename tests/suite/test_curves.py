"""Muscle curves and activation: device functions against float64 NumPy, and that against MuJoCo C."""

import mujoco
import numpy as np
import pytest
import warp as wp
from reference import mujoco_muscle as reference

from myowarp.laws.muscles.activation import activation_after, activation_rate
from myowarp.models.muscles import mujoco as law

FLOAT32 = 1e-6
"""Values of order one; four to eight roundings of 2^-24 = 6e-8, magnified by slopes of the curves."""

FLOAT64 = 1e-12
"""Reference and MuJoCo C run the same operations in double precision, in another order."""

DIFFERENCE_STEP = 1e-6  # of the float64 central differences; their error is below 1e-5

SLOPE = 2e-5
"""Rounding of the slope plus the error of the central difference where the second derivative jumps."""

# lmin, lmax, fvmax, fpmax: MuJoCo's defaults, MyoSuite's hand, an asymmetric narrow and a wide muscle.
SHAPES = ((0.5, 1.6, 1.2, 1.3), (0.0, 2.0, 1.4, 1.4), (0.8, 1.25, 1.05, 0.4), (0.2, 1.9, 1.8, 3.0))
LENGTHS = np.float32(np.linspace(-0.2, 2.7, 1201))
VELOCITIES = np.float32(np.linspace(-2.0, 2.0, 1201))
TIME_CONSTANTS = ((0.01, 0.04, 0.0), (0.01, 0.04, 0.3), (0.015, 0.05, 1.5), (0.08, 0.02, 0.05))


def on_device(function, *columns):
    """Evaluate a `wp.func` of floats over equally long columns; scalars repeat."""
    columns = [np.float32(column) for column in np.broadcast_arrays(*columns)]
    arrays = [wp.array(column, dtype=float, device="cpu") for column in columns]
    return wp.map(function, *arrays).numpy().astype(np.float64)


@pytest.mark.parametrize("shape", SHAPES)
def test_curves_equal_reference(shape):
    # Through float32, so that a parameter's rounding is not mistaken for the function's.
    lmin, lmax, fvmax, fpmax = np.float32(shape).astype(np.float64)
    for function, exact, grid, parameters in (
        (law.active_force_length_multiplier, reference.force_length, LENGTHS, (lmin, lmax)),
        (law.force_velocity_multiplier, reference.force_velocity, VELOCITIES, (fvmax,)),
        (law.passive_force_multiplier, reference.passive_force, LENGTHS, (lmax, fpmax)),
    ):
        expected = exact(grid.astype(np.float64), *parameters)
        got = on_device(function, grid, *parameters)
        scale = max(1.0, expected.max())
        assert np.abs(got - expected).max() <= FLOAT32 * scale, function.key
        assert np.ptp(expected) > 0.3, "the grid misses the curve"


@pytest.mark.parametrize("shape", SHAPES)
def test_slope_is_the_derivative(shape):
    fvmax = float(np.float32(shape[2]))
    grid = VELOCITIES.astype(np.float64)
    above = reference.force_velocity(grid + DIFFERENCE_STEP, fvmax)
    below = reference.force_velocity(grid - DIFFERENCE_STEP, fvmax)
    expected = (above - below) / (2.0 * DIFFERENCE_STEP)
    got = on_device(law.force_velocity_slope, grid, fvmax)
    # Within a step of saturation the second derivative jumps by 2 / (fvmax - 1).
    tolerance = SLOPE + 2.0 * DIFFERENCE_STEP / (fvmax - 1.0)
    assert np.abs(got - expected).max() <= tolerance
    assert got.min() >= 0.0
    assert got.max() == pytest.approx(2.0, abs=1e-2)


@pytest.mark.parametrize("shape", SHAPES)
def test_landmarks(shape):
    lmin, lmax, fvmax, fpmax = (float(x) for x in np.float32(shape))
    half_way = 0.5 * (1.0 + lmax)
    for function, arguments, value in (
        (law.active_force_length_multiplier, (1.0, lmin, lmax), 1.0),
        (law.active_force_length_multiplier, (lmin, lmin, lmax), 0.0),
        (law.active_force_length_multiplier, (lmax, lmin, lmax), 0.0),
        (law.active_force_length_multiplier, (0.5 * (lmin + 1.0), lmin, lmax), 0.5),
        (law.active_force_length_multiplier, (half_way, lmin, lmax), 0.5),
        (law.active_force_length_multiplier, (lmin - 0.1, lmin, lmax), 0.0),
        (law.active_force_length_multiplier, (lmax + 0.1, lmin, lmax), 0.0),
        (law.force_velocity_multiplier, (-1.0, fvmax), 0.0),
        (law.force_velocity_multiplier, (-5.0, fvmax), 0.0),
        (law.force_velocity_multiplier, (-0.5, fvmax), 0.25),
        (law.force_velocity_multiplier, (0.0, fvmax), 1.0),
        (law.force_velocity_multiplier, (fvmax - 1.0, fvmax), fvmax),
        (law.force_velocity_multiplier, (9.0, fvmax), fvmax),
        (law.passive_force_multiplier, (0.3, lmax, fpmax), 0.0),
        (law.passive_force_multiplier, (1.0, lmax, fpmax), 0.0),
        (law.passive_force_multiplier, (half_way, lmax, fpmax), 0.5 * fpmax),
        (law.passive_force_multiplier, (lmax, lmax, fpmax), 1.5 * fpmax),
    ):
        got = on_device(function, *(np.full(1, argument) for argument in arguments))
        assert got[0] == pytest.approx(value, abs=FLOAT32 * max(1.0, fpmax)), (
            function.key,
            arguments,
        )


@pytest.mark.parametrize("shape", SHAPES)
def test_curves_are_smooth_at_breakpoints(shape):
    """One-sided slopes differ by at most step x second derivatives; a kink would not shrink so."""
    lmin, lmax, fvmax, fpmax = shape
    rise, fall, c = 0.5 * (lmin + 1.0), 0.5 * (1.0 + lmax), fvmax - 1.0
    step = 1e-3
    for function, parameters, points, curvature in (
        (
            law.active_force_length_multiplier,
            (lmin, lmax),
            (lmin, rise, 1.0, fall, lmax),
            max((rise - lmin) ** -2, (lmax - fall) ** -2),
        ),
        (law.force_velocity_multiplier, (fvmax,), (-1.0, 0.0, c), max(2.0, 2.0 / c)),
        (
            law.passive_force_multiplier,
            (lmax, fpmax),
            (1.0, fall),
            fpmax / (fall - 1.0) ** 2,
        ),
    ):
        points = np.asarray(points)
        left, at, right = (on_device(function, points + offset, *parameters) for offset in (-step, 0.0, step))
        rounding = 8.0 * max(1.0, fpmax) * 2.0**-23 / step
        jump = np.abs((right - at) - (at - left)) / step
        assert np.all(jump <= step * curvature + rounding), function.key


@pytest.mark.parametrize("constants", TIME_CONSTANTS)
def test_activation_rate_equals_reference(constants):
    levels = np.float32(np.linspace(0.0, 1.0, 61))
    ctrl, act = (grid.ravel() for grid in np.meshgrid(levels, np.float32(np.linspace(0, 1.1, 45))))
    tau_act, tau_deact, width = np.float32(constants).astype(np.float64)
    expected = reference.activation_rate(ctrl, act, tau_act, tau_deact, width)
    got = on_device(activation_rate, ctrl, act, tau_act, tau_deact, width)
    # A difference of order one over a time constant; the smooth switch takes the difference of the
    # slow and the fast one, which magnifies the rounding by their ratio.
    fastest, slowest = 0.5 * min(tau_act, tau_deact), 2.0 * max(tau_act, tau_deact)
    magnification = slowest / fastest if width > 0.0 else 1.0
    assert np.abs(got - expected).max() <= FLOAT32 * magnification / fastest
    assert got.max() > 10.0
    assert got.min() < -10.0


STEPS = (0.0, 0.001, 0.005, 0.01)  # s; half of and all of a physics step
HARD = [constants[:2] for constants in TIME_CONSTANTS if constants[2] == 0.0]


@pytest.mark.parametrize("constants", [*HARD, (0.015, 0.05)])
def test_activation_after_equals_reference(constants):
    tau_act, tau_deact = np.float32(constants).astype(np.float64)
    level = np.float32(np.linspace(0.0, 1.0, 41)).astype(np.float64)
    time, ctrl, act = np.meshgrid(np.float32(STEPS).astype(np.float64), level, level)
    expected = reference.activation_after(time, ctrl, act, tau_act, tau_deact)
    got = on_device(activation_after, time, ctrl, act, tau_act, tau_deact)
    assert np.abs(got - expected).max() <= FLOAT32
    assert np.abs(expected - act)[time > 0.0].max() > 10.0 * FLOAT32


@pytest.mark.parametrize("constant", [0.0, 1e-9, 1e-5])
def test_activation_after_vanishing_time_constants(constant):
    """The excitation, at once; MuJoCo accepts a time constant of 0."""
    level = np.linspace(0.0, 1.0, 21)
    ctrl, act = np.meshgrid(level, level)
    got = on_device(activation_after, 0.005, ctrl, act, constant, constant)
    assert np.abs(got - np.float32(ctrl)).max() <= FLOAT32


def test_reference_solves_the_activation_equation():
    """The closed form against the differential equation, in 4,000 classical Runge-Kutta steps."""
    ctrl, act = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 21))
    tau_act, tau_deact, duration, count = 0.01, 0.04, 0.01, 4000
    dt, value = duration / count, act.copy()

    def rate(a):
        return reference.activation_rate(ctrl, a, tau_act, tau_deact)

    for _ in range(count):
        k1 = rate(value)
        k2 = rate(value + 0.5 * dt * k1)
        k3 = rate(value + 0.5 * dt * k2)
        value = value + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(value + dt * k3))
    expected = reference.activation_after(duration, ctrl, act, tau_act, tau_deact)
    assert np.abs(expected - value).max() <= 1e-11  # rounding of 4,000 additions
    assert np.abs(expected - act).max() > 0.5


def test_activation_landmarks():
    tau_act, tau_deact = 0.01, 0.04
    rate = on_device(
        activation_rate,
        np.array([1.0, 0.0, 0.4, 1.0]),
        np.array([0.0, 1.0, 0.4, 0.5]),
        tau_act,
        tau_deact,
        0.0,
    )
    expected = (1.0 / (0.5 * tau_act), -2.0 / tau_deact, 0.0, 0.5 / (1.25 * tau_act))
    assert rate == pytest.approx(expected, rel=FLOAT32, abs=FLOAT32)


def test_smooth_switch_meets_hard_switch_outside_its_width():
    act = np.full(101, 0.5)
    ctrl = np.linspace(0.0, 1.0, 101)
    hard, smooth = (on_device(activation_rate, ctrl, act, 0.01, 0.04, width) for width in (0.0, 0.4))
    outside = np.abs(ctrl - act) > 0.2 + 1e-6
    assert smooth[outside] == pytest.approx(hard[outside], rel=FLOAT32)
    inside = (np.abs(ctrl - act) < 0.19) & (np.abs(ctrl - act) > 0.01)
    assert np.all(np.abs(smooth - hard)[inside] > 100 * FLOAT32)


def random_parameters(rng):
    """Return length range, acc0 and a parameter row of a random muscle, half of them sized by scale."""
    low = rng.uniform(0.05, 0.3)
    lengthrange = np.array([low, low + rng.uniform(0.02, 0.2)])
    prm = np.array(
        [
            rng.uniform(0.5, 0.9),  # range
            rng.uniform(1.0, 1.3),
            rng.choice([-1.0, rng.uniform(10.0, 900.0)]),  # force
            200.0,  # scale
            rng.uniform(0.1, 0.7),  # lmin
            rng.uniform(1.2, 1.9),  # lmax
            rng.uniform(1.0, 9.0),  # vmax
            rng.uniform(0.2, 2.0),  # fpmax
            rng.uniform(1.05, 1.9),  # fvmax
        ]
    )
    return lengthrange, rng.uniform(0.5, 20.0), prm


def test_reference_force_equals_mujoco():
    rng = np.random.default_rng(0)
    active = passive = 0.0
    for _ in range(2000):
        lengthrange, acc0, prm = random_parameters(rng)
        length = lengthrange @ (0.5, 0.5) + np.ptp(lengthrange) * rng.uniform(-1.5, 1.5)
        velocity = rng.normal(scale=0.3)
        peak = reference.peak_force(acc0, prm)
        gain = mujoco.mju_muscleGain(length, velocity, lengthrange, acc0, prm)
        bias = mujoco.mju_muscleBias(length, lengthrange, acc0, prm)
        assert reference.gain(length, velocity, lengthrange, acc0, prm) == pytest.approx(
            gain, abs=FLOAT64 * peak
        )
        assert reference.bias(length, lengthrange, acc0, prm) == pytest.approx(
            bias, rel=FLOAT64, abs=FLOAT64 * peak
        )
        active, passive = max(active, -gain / peak), max(passive, -bias / peak)
    assert active > 0.5, "no active muscle among the samples"
    assert passive > 0.5, "no stretched muscle among the samples"


def test_reference_dynamics_equals_mujoco():
    rng = np.random.default_rng(1)
    for _ in range(2000):
        tau_act, tau_deact = rng.uniform(0.005, 0.1, 2)
        width = rng.choice([0.0, rng.uniform(0.05, 2.0)])
        ctrl, act = rng.uniform(-0.3, 1.3), rng.uniform(0.0, 1.0)
        expected = mujoco.mju_muscleDynamics(ctrl, act, np.array([tau_act, tau_deact, width]))
        got = reference.activation_rate(ctrl, act, tau_act, tau_deact, width)
        assert got == pytest.approx(expected, rel=1e-10, abs=1e-10)
