"""Excitation to activation: first-order dynamics, faster up than down.

Source: Millard, Uchida, Seth, Delp (2013), doi:10.1115/1.4023390, eq. 1-2, in MuJoCo's form (MuJoCo
documentation, *Modeling, Actuators, Muscles*), which adds an optional smooth switch between the two
time constants.
"""

import warp as wp

HALLEY_STEPS = wp.constant(2)  # leave 4e-9 of activation, after 20 ms with a time constant of 10 ms


@wp.func
def activation_rate(
    excitation: float,
    activation: float,
    activation_time_constant: float,
    deactivation_time_constant: float,
    smoothing_width: float,
) -> float:
    """Return da/dt = (u - a) / tau(u, a) [1/s].

    tau = tau_act (0.5 + 1.5 a) where u > a, tau_deact / (0.5 + 1.5 a) otherwise [s]; over
    `smoothing_width` of u - a the switch is a smooth quintic step, 0 switches hard.
    """
    scale = 0.5 + 1.5 * wp.clamp(activation, 0.0, 1.0)
    rise = activation_time_constant * scale
    decay = deactivation_time_constant / scale
    difference = excitation - activation
    if smoothing_width < 1.0e-15:
        time_constant = wp.where(difference > 0.0, rise, decay)
    else:
        x = wp.clamp(difference / smoothing_width + 0.5, 0.0, 1.0)
        step = x * x * x * (x * (6.0 * x - 15.0) + 10.0)
        time_constant = decay + (rise - decay) * step
    return difference / wp.max(time_constant, 1.0e-15)


@wp.func
def activation_after(
    time: float,
    excitation: float,
    activation: float,
    activation_time_constant: float,
    deactivation_time_constant: float,
) -> float:
    """Return a(t) where the excitation is constant: `activation_rate` solved, with the hard switch.

    The switch never turns, since a approaches u from one side. With c = 0.5 + 1.5 u and w = |u - a|, rising:
    c ln(w / w_0) - 1.5 (w - w_0) = -t / tau_act, solved by Halley's method from the rate half way on;
    falling: w / (c + 1.5 w) = w_0 / (c + 1.5 w_0) exp(-c t / tau_deact).
    """
    c = 0.5 + 1.5 * excitation
    gap = excitation - activation
    if gap > 0.0:
        duration = time / activation_time_constant
        start = 1.5 * gap
        half = 0.5 * duration / (c - start)
        x = -duration / (c - start / (1.0 + half + 0.5 * half * half))
        part = float(0.0)
        step = float(0.0)
        for _ in range(HALLEY_STEPS):
            part = start * wp.exp(x)
            slope = c - part
            excess = c * x - part + start + duration
            step = -excess * slope / (slope * slope + 0.5 * excess * part)
            x += step
        return excitation - part * (1.0 + step + 0.5 * step * step) / 1.5
    part = -gap / (c - 1.5 * gap) * wp.exp(-c * time / deactivation_time_constant)
    return excitation + c * part / (1.0 - 1.5 * part)
