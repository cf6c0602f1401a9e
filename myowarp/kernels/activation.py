"""Excitation to activation: first-order dynamics, faster up than down.

Source: Millard, Uchida, Seth, Delp (2013), doi:10.1115/1.4023390, eq. 1-2, in MuJoCo's form (MuJoCo
documentation, *Modeling, Actuators, Muscles*), which adds an optional smooth switch between the two
time constants.
"""

import warp as wp


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
