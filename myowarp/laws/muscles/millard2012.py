"""The curves of Millard's muscle: chains of quintic Bezier corners, as tables.

Source: Millard, Uchida, Seth, Delp 2013 (doi:10.1115/1.4023390) in the form of OpenSim's
Millard2012EquilibriumMuscle; the corners are those of laws/millard_curves.py, the error of their tables
that of laws/curves.py. Each function returns the multiplier and its slope, of float32 or float64; `m` is
a `hill_muscle`, whose `curves` is the number of the first of four tables: f_L, f_P, f_T over strain, f_V.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp

from myowarp.laws.curves import tabulate, tabulated
from myowarp.laws.millard_curves import BezierChain, millard_curves


@wp.func
def millard_active_force_length(m: Any, tables: Any, length: Any):
    """f_L, 0 (or 0.1 where neither fiber nor tendon damps) outside of the range in which the fiber acts."""
    return tabulated(tables, m.curves, length)


@wp.func
def millard_passive_force(m: Any, tables: Any, length: Any):
    """f_P, 1 at `strain_at_one_norm_force`, a line beyond."""
    return tabulated(tables, m.curves + 1, length)


@wp.func
def millard_tendon_force(m: Any, tables: Any, strain: Any):
    """f_T, a toe up to 2/3, then a line through 1 at `strain_at_one_norm_force`."""
    return tabulated(tables, m.curves + 2, strain)


@wp.func
def millard_force_velocity(m: Any, tables: Any, velocity: Any):
    """f_V, from 0 at -1 through 1 at rest to the largest lengthening."""
    return tabulated(tables, m.curves + 3, velocity)


ACTIVE, VELOCITY = "ActiveForceLengthCurve.", "ForceVelocityCurve."
FIBER, TENDON = "FiberForceLengthCurve.", "TendonForceLengthCurve."

PARAMETERS = {
    f"{ACTIVE}min_norm_active_fiber_length": (None, 0.4441, 1e-3, 0.7),
    f"{ACTIVE}transition_norm_fiber_length": (None, 0.73, 0.1, 0.94),
    f"{ACTIVE}max_norm_active_fiber_length": (None, 1.8123, 1.2, 10.0),
    f"{ACTIVE}shallow_ascending_slope": (None, 0.8616, 1e-3, 3.0),
    f"{ACTIVE}minimum_value": (None, 0.1, 0.0, 0.5),
    f"{VELOCITY}concentric_slope_at_vmax": (None, 0.0, 0.0, 0.5),
    f"{VELOCITY}concentric_slope_near_vmax": (None, 0.25, 0.0, 0.9),
    f"{VELOCITY}isometric_slope": (None, 5.0, 1.2, 100.0),
    f"{VELOCITY}eccentric_slope_at_vmax": (None, 0.0, 0.0, 0.5),
    f"{VELOCITY}eccentric_slope_near_vmax": (None, 0.15, 0.0, 0.5),
    f"{VELOCITY}max_eccentric_velocity_force_multiplier": (None, 1.4, 1.05, 5.0),
    f"{VELOCITY}concentric_curviness": (None, 0.6, 0.0, 1.0),
    f"{VELOCITY}eccentric_curviness": (None, 0.9, 0.0, 1.0),
    f"{FIBER}strain_at_zero_force": (None, 0.0, -0.5, 1.0),
    f"{FIBER}strain_at_one_norm_force": (None, 0.7, 1e-2, 5.0),
    f"{FIBER}stiffness_at_low_force": (None, np.nan, 0.0, 1e3),
    f"{FIBER}stiffness_at_one_norm_force": (None, np.nan, 1e-2, 1e4),
    f"{FIBER}curviness": (None, np.nan, 0.0, 1.0),
    f"{TENDON}strain_at_one_norm_force": (None, 0.049, 1e-4, 1.0),
    f"{TENDON}stiffness_at_one_norm_force": (None, np.nan, 1e-1, 1e5),
    f"{TENDON}norm_force_at_toe_end": (None, np.nan, 1e-3, 0.999),
    f"{TENDON}curviness": (None, np.nan, 0.0, 1.0),
}
"""OpenSim's property: None, default (NaN: OpenSim computes it), least and greatest value."""


def millard_tables(values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the four tables of a muscle, as `tabulate` does, from OpenSim's properties."""
    curves = millard_curves({name: value for name, value in values.items() if not np.isnan(value)})
    chains = curves.active, curves.passive, curves.tendon, curves.velocity

    def shifted(chain: BezierChain, by: float) -> tuple:
        return lambda x: chain(x + by), chain.knots[0][0] - by, chain.knots[-1][0] - by

    return tabulate([shifted(chain, float(i == 2)) for i, chain in enumerate(chains)])
