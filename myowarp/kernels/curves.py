"""Muscle curves: force multipliers over normalized length and velocity.

MuJoCo's curves are piecewise quadratic (MuJoCo documentation, *Modeling, Actuators, Muscles*). All
functions map floats to floats, dimensionless.
"""

import warp as wp


@wp.func
def quadratic_force_length(length: float, lmin: float, lmax: float) -> float:
    """Active force-length multiplier f_L, in [0, 1]: 0 at lmin and lmax, 1 at 1, C1 throughout."""
    multiplier = float(0.0)
    rise = 0.5 * (lmin + 1.0)
    fall = 0.5 * (1.0 + lmax)
    if length >= lmin and length <= lmax:
        if length <= rise:
            x = (length - lmin) / (rise - lmin)
            multiplier = 0.5 * x * x
        elif length <= 1.0:
            x = (1.0 - length) / (1.0 - rise)
            multiplier = 1.0 - 0.5 * x * x
        elif length <= fall:
            x = (length - 1.0) / (fall - 1.0)
            multiplier = 1.0 - 0.5 * x * x
        else:
            x = (lmax - length) / (lmax - fall)
            multiplier = 0.5 * x * x
    return multiplier


@wp.func
def quadratic_force_velocity(velocity: float, fvmax: float) -> float:
    """Force-velocity multiplier f_V: 0 at -1 (full shortening), 1 at 0, fvmax at fvmax - 1 and beyond."""
    saturation = fvmax - 1.0
    multiplier = fvmax
    if velocity <= -1.0:
        multiplier = float(0.0)
    elif velocity <= 0.0:
        multiplier = (velocity + 1.0) * (velocity + 1.0)
    elif velocity <= saturation:
        multiplier = fvmax - (saturation - velocity) * (saturation - velocity) / saturation
    return multiplier


@wp.func
def quadratic_force_velocity_slope(velocity: float, fvmax: float) -> float:
    """Derivative of `quadratic_force_velocity` by its velocity, >= 0."""
    saturation = fvmax - 1.0
    slope = float(0.0)
    if velocity > -1.0 and velocity <= 0.0:
        slope = 2.0 * (velocity + 1.0)
    elif velocity > 0.0 and velocity <= saturation:
        slope = 2.0 * (saturation - velocity) / saturation
    return slope


@wp.func
def quadratic_passive_force(length: float, lmax: float, fpmax: float) -> float:
    """Passive force multiplier f_P: 0 up to 1, fpmax / 2 half way to lmax, linear beyond; C1."""
    multiplier = float(0.0)
    half_way = 0.5 * (1.0 + lmax)
    if length > 1.0:
        x = (length - 1.0) / wp.max(half_way - 1.0, 1.0e-15)
        multiplier = fpmax * 0.5 * x * x
        if length > half_way:
            multiplier = fpmax * (x - 0.5)
    return multiplier
