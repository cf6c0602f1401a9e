"""Muscle curves: force multipliers over normalized length and velocity.

MuJoCo's curves are piecewise quadratic (MuJoCo documentation, *Modeling, Actuators, Muscles*). All
functions map floats to floats, dimensionless. The arithmetic is in curves.cpp, for other native functions:
put `CURVES` before their source.
"""

from pathlib import Path

import warp as wp

CURVES = Path(__file__).with_suffix(".cpp").read_text()


@wp.func_native(CURVES + "return quadratic_force_length(length, lmin, lmax);")
def quadratic_force_length(length: float, lmin: float, lmax: float) -> float:
    """Active force-length multiplier f_L, in [0, 1]: 0 at lmin and lmax, 1 at 1, C1 throughout."""
    ...


@wp.func_native(CURVES + "return quadratic_force_velocity(velocity, fvmax);")
def quadratic_force_velocity(velocity: float, fvmax: float) -> float:
    """Force-velocity multiplier f_V: 0 at -1 (full shortening), 1 at 0, fvmax at fvmax - 1 and beyond."""
    ...


@wp.func_native(CURVES + "return quadratic_force_velocity_slope(velocity, fvmax);")
def quadratic_force_velocity_slope(velocity: float, fvmax: float) -> float:
    """Derivative of `quadratic_force_velocity` by its velocity, >= 0."""
    ...


@wp.func_native(CURVES + "return quadratic_passive_force(length, lmax, fpmax);")
def quadratic_passive_force(length: float, lmax: float, fpmax: float) -> float:
    """Passive force multiplier f_P: 0 up to 1, fpmax / 2 half way to lmax, linear beyond; C1."""
    ...
