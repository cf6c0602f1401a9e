"""Activation that follows excitation: the law of MuJoCo's muscles and, in a midstep form, of Hill muscles."""

import warp as wp

TINY = wp.constant(1e-15)
"""Instead of a zero that is divided by."""


LEAST_EXPONENT = wp.constant(-87.0)
"""Exponent below which e^x leaves float32."""


@wp.func
def activation_rate(
    excitation: float,
    activation: float,
    activation_time_constant: float,
    deactivation_time_constant: float,
    smoothing_width: float,
) -> float:
    """da/dt = (u - a) / tau [1/s], tau = tau_act (0.5 + 1.5 a) if u > a, else tau_deact / (0.5 + 1.5 a).

    Source: Millard, Uchida, Seth, Delp (2013), doi:10.1115/1.4023390, eq. 1-2. MuJoCo adds a quintic step
    from the one tau to the other over a width of u - a; width 0 is theirs.
    """
    scale = 0.5 + 1.5 * wp.clamp(activation, 0.0, 1.0)
    rise = activation_time_constant * scale
    fall = deactivation_time_constant / scale
    difference = excitation - activation
    time_constant = wp.where(difference > 0.0, rise, fall)
    if smoothing_width > 0.0:
        x = wp.clamp(difference / smoothing_width + 0.5, 0.0, 1.0)
        time_constant = fall + (rise - fall) * (x * x * x * (x * (6.0 * x - 15.0) + 10.0))
    return difference / wp.max(time_constant, TINY)


@wp.func
def activation_after(
    time: float,
    excitation: float,
    activation: float,
    activation_time_constant: float,
    deactivation_time_constant: float,
) -> float:
    """a(t) of `activation_rate` with constant u and smoothing width 0, solved exactly.

    u - a keeps its sign. With c = 0.5 + 1.5 u, w = 1.5 (u - a) and x = ln(w / w_0):

        rising:   c x - w_0 (e^x - 1) = -t / tau_act,
        falling:  w / (c - w) = w_0 / (c - w_0) exp(-c t / tau_deact).

    Two steps of Halley's method find x, from where the rate half way on leads; 4e-9 is left after t = 2 tau.
    """
    c = 0.5 + 1.5 * excitation
    w0 = 1.5 * (excitation - activation)
    if w0 <= 0.0:
        ratio = w0 / (c - w0) * wp.exp(-c * time / wp.max(deactivation_time_constant, TINY))
        return excitation - c * ratio / (1.5 * (1.0 + ratio))
    duration = time / wp.max(activation_time_constant, TINY)
    half = 0.5 * duration / (c - w0)
    x = wp.max(-duration / (c - w0 / (1.0 + half + 0.5 * half * half)), LEAST_EXPONENT)
    for _ in range(2):
        w = w0 * wp.exp(x)
        excess = c * x - w + w0 + duration
        slope = c - w
        x = wp.max(x - excess * slope / (slope * slope + 0.5 * excess * w), LEAST_EXPONENT)
    return excitation - w0 * wp.exp(x) / 1.5


@wp.func
def activation_step(
    dt: float,
    midstep: bool,
    excitation: float,
    activation: float,
    activation_time_constant: float,
    deactivation_time_constant: float,
    smoothing_width: float,
) -> wp.vec2:
    """(a that pulls, a after dt): a and a + dt da/dt, or a(t + dt/2) and a(t + dt) where they are known."""
    if midstep and smoothing_width == 0.0:
        tau_act, tau_deact = activation_time_constant, deactivation_time_constant
        return wp.vec2(
            activation_after(0.5 * dt, excitation, activation, tau_act, tau_deact),
            activation_after(dt, excitation, activation, tau_act, tau_deact),
        )
    rate = activation_rate(
        excitation, activation, activation_time_constant, deactivation_time_constant, smoothing_width
    )
    return wp.vec2(activation, activation + dt * rate)
