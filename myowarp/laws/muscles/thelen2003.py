"""The curves of Thelen's muscle: Gaussian f_L, exponential f_P, toe and line for f_T, hyperbolic f_V.

Source: Thelen 2003 (doi:10.1115/1.1531112) in the form of OpenSim's Thelen2003Muscle. Each function returns
the multiplier and its slope, of float32 or float64; `m` is a `hill_muscle`.
"""

import math
from typing import Any

import warp as wp

from myowarp.laws.curves import growth

TOE_SHAPE, TOE_FORCE, LINEAR_FORCE = wp.constant(3.0), wp.constant(0.33), wp.constant(0.67)
TOE_GROWTH = wp.constant(math.expm1(3.0))
TOE_SHARE = wp.constant(99.0 * math.exp(3.0) / (166.0 * math.exp(3.0) - 67.0))
"""Strain at the end of the toe, of that at f_T = 1."""


@wp.func
def thelen_active_force_length(m: Any, length: Any):
    """f_L = exp(-(l - 1)^2 / KshapeActive)."""
    stretch = length - type(length)(1.0)
    value = wp.exp(-stretch * stretch / m.active_width)
    return wp.vector(value, -type(length)(2.0) * stretch / m.active_width * value)


@wp.func
def thelen_passive_force(m: Any, length: Any):
    """f_P = (exp(k (l - 1) / strain) - 1) / (exp(k) - 1) from l = 1 on, else 0; k = KshapePassive."""
    zero, one = type(length)(0.0), type(length)(1.0)
    if length <= one:
        return wp.vector(zero, zero)
    rate = m.passive_shape / m.passive_strain
    rise = growth(rate * (length - one))
    scale = wp.exp(m.passive_shape) - one
    return wp.vector((rise[0] - one) / scale, rate * rise[1] / scale)


@wp.func
def thelen_tendon_force(m: Any, strain: Any):
    """f_T = 0.33 (exp(3 e / e_toe) - 1) / (exp(3) - 1) up to e_toe, then a line to 1; 0 when slack."""
    zero, one = type(strain)(0.0), type(strain)(1.0)
    if strain <= zero:
        return wp.vector(zero, zero)
    toe_force, toe_strain = type(strain)(TOE_FORCE), type(strain)(TOE_SHARE) * m.tendon_strain
    if strain > toe_strain:
        stiffness = type(strain)(LINEAR_FORCE) / (m.tendon_strain - toe_strain)
        return wp.vector(toe_force + stiffness * (strain - toe_strain), stiffness)
    rate, scale = type(strain)(TOE_SHAPE) / toe_strain, toe_force / type(strain)(TOE_GROWTH)
    rise = wp.exp(rate * strain)
    return wp.vector(scale * (rise - one), scale * rate * rise)


@wp.func
def thelen_force_velocity(m: Any, velocity: Any, activation: Any):
    """f_V = (k + v) / (k - v / Af) shortening, (k + q Flen v) / (k + q v) lengthening, lines at the ends.

    k = 0.25 + 0.75 a, q = (2 + 2 / Af) / (Flen - 1): eq. 6 and 7, solved for the force. The lines begin at
    v = -k and where f_V is `fv_linear_extrap_threshold` of Flen.
    """
    zero, one, two = type(velocity)(0.0), type(velocity)(1.0), type(velocity)(2.0)
    k = type(velocity)(0.25) + type(velocity)(0.75) * activation
    if velocity <= zero:
        v = wp.max(velocity, -k)
        pole = k - v / m.velocity_shape
        slope = (one + one / m.velocity_shape) * k / (pole * pole)
        return wp.vector((k + v) / pole + slope * (velocity - v), slope)
    limit = m.eccentric_multiplier
    q = (two + two / m.velocity_shape) / (limit - one)
    end = m.extrapolation_threshold * limit
    w = wp.min(velocity, k * (end - one) / (q * (limit - end)))
    pole = k + q * w
    slope = q * k * (limit - one) / (pole * pole)
    return wp.vector((k + q * limit * w) / pole + slope * (velocity - w), slope)


PARAMETERS = {
    "KshapeActive": ("active_width", 0.45, 1e-3, 1e3),
    "KshapePassive": ("passive_shape", 5.0, 1e-3, 50.0),
    "FmaxMuscleStrain": ("passive_strain", 0.6, 1e-3, 1e3),
    "FmaxTendonStrain": ("tendon_strain", 0.04, 1e-4, 1.0),
    "Af": ("velocity_shape", 0.25, 1e-3, 1e3),
    "Flen": ("eccentric_multiplier", 1.4, 1.001, 1e3),
    "fv_linear_extrap_threshold": ("extrapolation_threshold", 0.95, 0.5, 0.9999),
}
"""OpenSim's property: name in `hill_muscle`, default, least and greatest value."""
