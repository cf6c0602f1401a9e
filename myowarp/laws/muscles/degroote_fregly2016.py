"""The curves of De Groote's muscle: smooth closed forms without cases.

The fiber is never slack and the tendon could push; `hill` cuts what pushes off. Source: De Groote, Kinney,
Rao, Fregly 2016 (doi:10.1007/s10439-016-1591-9), with OpenSim's shift of the tendon curve to f_T = 0 at slack
length and its constants, for which f_V(-1) = 0 and f_V(0) = 1. Each function returns the multiplier and its
slope, of float32 or float64; `m` is a `hill_muscle`.
"""

from typing import Any

import warp as wp

from myowarp.laws.curves import growth


@wp.func
def bell(x: Any, height: Any, centre: Any, width: Any, skew: Any):
    """height exp(-z^2 / 2), z = (x - centre) / (width + skew x), and its slope."""
    spread = wp.max(width + skew * x, type(x)(1e-3))  # 0 at x = 0.15, where the bell is 0 too
    z = (x - centre) / spread
    value = height * wp.exp(-type(x)(0.5) * z * z)
    return wp.vector(value, -value * z * (spread - skew * (x - centre)) / (spread * spread))


@wp.func
def degroote_active_force_length(m: Any, length: Any):
    """Sum of three bells (eq. S3) in x = 1 + (l - 1) / active_force_width_scale."""
    x = (length - type(length)(1.0)) / m.active_width + type(length)(1.0)
    bells = bell(
        x,
        type(length)(0.8150671134243542),
        type(length)(1.055033428970575),
        type(length)(0.162384573599574),
        type(length)(0.063303448465465),
    )
    bells += bell(
        x,
        type(length)(0.433004984392647),
        type(length)(0.716775413397760),
        type(length)(-0.029947116970696),
        type(length)(0.200356847296188),
    )
    bells += bell(x, type(length)(0.1), type(length)(1.0), type(length)(0.353553390593274), type(length)(0.0))
    return wp.vector(bells[0], bells[1] / m.active_width)


@wp.func
def degroote_passive_force(m: Any, length: Any):
    """f_P = (exp(4 (l - 1) / strain) - o) / (exp(4) - o), 0 at l = 0.2."""
    rate = type(length)(4.0) / m.passive_strain
    offset = wp.exp(-type(length)(0.8) * rate)
    scale = m.passive_scale / (wp.exp(type(length)(4.0)) - offset)
    rise = growth(rate * (length - type(length)(1.0)))
    return wp.vector(scale * (rise[0] - offset), scale * rate * rise[1])


@wp.func
def degroote_tendon_force(m: Any, strain: Any):
    """f_T = 0.2 (exp(k e) - 1), k = ln(1.2 / 0.2) / strain at f_T = 1."""
    rate = type(strain)(1.791759469228055) / m.tendon_strain
    rise = type(strain)(0.2) * growth(rate * strain)
    return wp.vector(rise[0] - type(strain)(0.2), rate * rise[1])


@wp.func
def degroote_force_velocity(m: Any, velocity: Any, activation: Any):
    """f_V = d1 asinh(d2 v + d3) + d4 (eq. S4)."""
    x = type(velocity)(-8.149) * velocity + type(velocity)(-0.374)
    root = wp.sqrt(type(velocity)(1.0) + x * x)
    asinh = wp.sign(x) * wp.log(wp.abs(x) + root)  # x + root would cancel for x < 0
    d1 = type(velocity)(-0.3211346127989808)
    return wp.vector(d1 * asinh + type(velocity)(0.8825327733249912), d1 * type(velocity)(-8.149) / root)


@wp.func
def degroote_activation_rate(excitation: Any, activation: Any, rise: Any, fall: Any):
    """da/dt = ((1/2 + f) / (tau_act z) + (1/2 - f) z / tau_deact) (u - a), z = 1/2 + 3/2 a (eq. 1 and 2).

    f = tanh(0.1 (u - a)) / 2.
    """
    z = type(activation)(0.5) + type(activation)(1.5) * activation
    f = type(activation)(0.5) * wp.tanh(type(activation)(0.1) * (excitation - activation))
    return ((type(activation)(0.5) + f) / (rise * z) + (type(activation)(0.5) - f) * z / fall) * (
        excitation - activation
    )


PARAMETERS = {
    "active_force_width_scale": ("active_width", 1.0, 1e-2, 1e2),
    "passive_fiber_strain_at_one_norm_force": ("passive_strain", 0.6, 1e-3, 1e3),
    "tendon_strain_at_one_norm_force": ("tendon_strain", 0.049, 1e-4, 1.0),
}
"""OpenSim's property: name in `hill_muscle`, default, least and greatest value."""
