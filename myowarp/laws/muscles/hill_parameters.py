"""Parameters of muscles under the laws of `hill_law`, from OpenSim's properties."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp

from myowarp.laws.curves import KNOTS
from myowarp.laws.muscles import degroote_fregly2016, millard2012, schutte1993, thelen2003
from myowarp.laws.muscles.hill_law import DEGROOTE, MILLARD, SCHUTTE, THELEN, hill_muscle
from myowarp.laws.muscles.millard2012 import ACTIVE, millard_tables

COMMON: Mapping[str, tuple[float, float]] = {
    "max_isometric_force": (1e-6, math.inf),
    "optimal_fiber_length": (1e-4, math.inf),
    "tendon_slack_length": (0.0, math.inf),
    "pennation_angle_at_optimal": (0.0, 1.47),
    "maximum_pennation_angle": (0.1, 1.5707),
    "max_contraction_velocity": (1e-3, math.inf),
    "fiber_damping": (0.0, 1e3),
    "minimum_activation": (0.0, 0.99),
    "activation_time_constant": (1e-6, math.inf),
    "deactivation_time_constant": (1e-6, math.inf),
    "ignore_tendon_compliance": (0.0, 1.0),
    "ignore_activation_dynamics": (0.0, 1.0),
}
"""Least and greatest value of what every law has, under OpenSim's names."""


MAX_PENNATION = math.acos(0.1)  # rad


LAWS: Mapping[int, Mapping[str, tuple[str | None, float, float, float]]] = {
    THELEN: thelen2003.PARAMETERS,
    MILLARD: millard2012.PARAMETERS,
    DEGROOTE: degroote_fregly2016.PARAMETERS,
    SCHUTTE: schutte1993.PARAMETERS,
}
"""Parameters of the curves."""


SHARED = {"maximum_pennation_angle": MAX_PENNATION, "ignore_tendon_compliance": 0.0}


DEFAULTS: Mapping[int, Mapping[str, float]] = {
    law: {
        **SHARED,
        "fiber_damping": damping,
        "minimum_activation": floor,
        "ignore_passive_fiber_force": 0.0,
    }
    for law, (damping, floor) in enumerate(((0.0, 0.01), (0.1, 0.01), (0.0, 0.0), (0.1, 0.0)))
}
"""OpenSim's, of what is not a curve; De Groote's and Schutte's muscles have no floor of the activation."""


def defaults_of(law: int) -> dict[str, float]:
    """Return OpenSim's defaults of all that a law has; NaN: OpenSim computes it."""
    return {**DEFAULTS[law], **{name: default for name, (_, default, _, _) in LAWS[law].items()}}


FIELDS = (
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "max_contraction_velocity",
    "minimum_activation",
)
"""Fields of `hill_muscle` that are properties as they stand."""


LEAST_FIBER = 1e-6
"""Least z where the law names none [optimal fiber lengths]."""


LEAST_DAMPING = 1e-3
"""Damping below this is none to OpenSim."""


MOST_CURVES = 4096
"""Muscles with Millard curves of their own."""


def hill_parameters(
    law: int,
    values: Mapping[str, np.ndarray],
    rigid: bool = False,
    real: type = wp.float32,
    knots: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return parameters of muscles under a law, and the tables of Millard's or Schutte's curves.

    Args:
        law: `THELEN`, `MILLARD`, `DEGROOTE` or `SCHUTTE`.
        values: OpenSim's properties by name, SI units, all that broadcast to (rows, num_muscles); those of
            the law's curves that are missing are OpenSim's defaults.
        rigid: Whether no tendon stretches.
        real: Floating-point type of the parameters.
        knots: Of Schutte's splines, as `schutte_tables` takes them, shape (num_muscles, 3, 2, most knots).

    Returns:
        `hill_muscle(real)`, shape (rows, num_muscles); values and spans for `tabulated`.

    Raises:
        ValueError: Too many curves differ.
    """
    own = LAWS[law]
    given: dict[str, Any] = {**defaults_of(law), **values}
    each = [np.atleast_2d(np.asarray(value, float)) for value in given.values()]
    arrays = dict(zip(given, np.broadcast_arrays(*each), strict=True))
    shape = arrays["optimal_fiber_length"].shape
    rows = np.zeros(shape, hill_muscle(real).numpy_dtype())
    rows["law"] = law
    slack = arrays["tendon_slack_length"]
    rows["rigid"] = rigid | (arrays["ignore_tendon_compliance"] == 1.0) | (slack <= 0.0)
    for name in FIELDS:
        rows[name] = arrays[name]
    damping = np.zeros(shape) if law == THELEN else arrays["fiber_damping"]
    rows["fiber_damping"] = np.where(damping < LEAST_DAMPING, 0.0, damping)
    length = arrays["optimal_fiber_length"]
    width = length * np.sin(arrays["pennation_angle_at_optimal"])
    bounded = law in (THELEN, MILLARD)
    shortest = width / np.sin(arrays["maximum_pennation_angle"]) if bounded else width
    if law == MILLARD:
        shortest = np.maximum(shortest, arrays[f"{ACTIVE}min_norm_active_fiber_length"] * length)
    rows["fiber_width"], rows["shortest_fiber"] = width, np.sqrt(shortest**2 - width**2)
    rows["shortest_fiber"] = np.maximum(rows["shortest_fiber"], LEAST_FIBER * length)
    rows["passive_scale"] = 1.0 - arrays["ignore_passive_fiber_force"]
    for name, (field, *_) in own.items():
        if field is not None:
            rows[field] = arrays[name]
    if law == SCHUTTE and rows.size and knots is not None:
        flat = np.nan_to_num(knots.reshape(len(knots), -1), nan=np.inf)  # which is equal to itself
        _, first, which = np.unique(flat, axis=0, return_index=True, return_inverse=True)
        rows["curves"] = 3 * which.reshape(1, -1)
        found = [schutte1993.schutte_tables(knots[one]) for one in first]
        return rows, np.concatenate([t for t, _ in found]), np.concatenate([s for _, s in found])
    if law != MILLARD or not rows.size:
        return rows, np.zeros((0, KNOTS, 2)), np.zeros((0, 2))
    shaping = {name: arrays[name] for name in (*own, "fiber_damping")}
    shaping["ignore_tendon_compliance"] = rows["rigid"].astype(float)
    columns = np.stack([values.ravel() for values in shaping.values()], axis=-1)
    unique, which = np.unique(columns, axis=0, return_inverse=True)
    if len(unique) > MOST_CURVES:
        raise ValueError(
            f"at most {MOST_CURVES} muscles may have curves of their own, got {len(unique)} kinds of them; "
            "vary forces and lengths instead"
        )
    rows["curves"] = 4 * which.reshape(shape)
    found = [millard_tables(dict(zip(shaping, row, strict=True))) for row in unique]
    return rows, np.concatenate([t for t, _ in found]), np.concatenate([s for _, s in found])
