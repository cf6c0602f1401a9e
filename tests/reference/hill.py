"""Static tendon force of Hill muscles in float64 NumPy, from the papers, not from our code.

Reads `muscles.csv`. Thelen 2003 (doi:10.1115/1.1531112), appendix; Millard et al. 2013
(doi:10.1115/1.4023390), quintic Bezier curves, here as fine tables of their parameter; De Groote et al. 2016
(doi:10.1007/s10439-016-1591-9), supplement. Equilibrium by bisection of (a f_L + f_P) cos(phi) = f_T in the
fiber length along the tendon, at constant fiber width. Forces in maximum isometric forces; a muscle
shorter than its slack tendon and its shortest fiber has none.
"""

import csv
from math import acos, comb, exp, log, sin

import numpy as np

BISECTIONS = 60  # to 1e-18 of a bracket of 1 m
TABLE = np.linspace(0.0, 1.0, 20001)


def read(path):
    """Yield (name, class, {property: number}) of every row; units are dropped, empty cells left out."""
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            numbers = {key.split(" [")[0]: cell for key, cell in row.items() if " [" in key and cell}
            yield row["name"], row["class"], {key: float(cell) for key, cell in numbers.items()}


def bezier(knots, curviness):
    """Return y(x) through (x, y, slope), with lines outside; doubled control points at the crossing."""
    xs, ys = [], []
    for (x0, y0, s0), (x1, y1, s1), c in zip(knots[:-1], knots[1:], curviness, strict=True):
        x = (x0 + x1) / 2 if s0 == s1 else (y1 - y0 + s0 * x0 - s1 * x1) / (s0 - s1)
        y = y0 + s0 * (x - x0)
        share = 0.1 + 0.8 * c
        near, far = np.array([x0, y0]), np.array([x1, y1])
        a, b = near + share * ([x, y] - near), far + share * ([x, y] - far)
        basis = [comb(5, i) * TABLE**i * (1 - TABLE) ** (5 - i) for i in range(6)]
        curve = np.einsum("iu,ik->ku", basis, [near, a, a, b, b, far])
        xs.append(curve[0])
        ys.append(curve[1])
    xs, ys = np.concatenate(xs), np.concatenate(ys)
    (x0, y0, s0), (x1, y1, s1) = knots[0], knots[-1]

    def value(x):
        inside = np.interp(x, xs, ys)
        return np.where(x < x0, y0 + s0 * (x - x0), np.where(x > x1, y1 + s1 * (x - x1), inside))

    return value


def thelen(p):
    """f_L, f_P, f_T, least fiber length."""
    e0, k = p["FmaxTendonStrain"], p["KshapePassive"]
    toe = 99 * e0 * exp(3) / (166 * exp(3) - 67)
    stiffness = 0.67 / (e0 - toe)

    def tendon(n):
        e = np.maximum(n - 1, 0.0)
        return np.where(
            e > toe, 0.33 + stiffness * (e - toe), 0.33 * (np.exp(3 * e / toe) - 1) / (exp(3) - 1)
        )

    def passive(n):
        return (np.exp(k * np.maximum(n - 1, 0) / p["FmaxMuscleStrain"]) - 1) / (exp(k) - 1)

    return lambda n: np.exp(-((n - 1) ** 2) / p["KshapeActive"]), passive, tendon, 0.0


def millard(p):
    """f_L, f_P, f_T, least fiber length."""
    x0, x1, x3, s = (
        p[f"ActiveForceLengthCurve.{name}"]
        for name in (
            "min_norm_active_fiber_length",
            "transition_norm_fiber_length",
            "max_norm_active_fiber_length",
            "shallow_ascending_slope",
        )
    )
    undamped = p["fiber_damping"] < 0.001 and not p["ignore_tendon_compliance"]
    floor = max(0.1, p["ActiveForceLengthCurve.minimum_value"]) if undamped else 0.0
    y1 = 1 - s * (0.95 - x1)
    active = [
        (x0, floor, 0.0),
        ((x0 + x1) / 2, y1 / 2, 1.25 * y1 / (x1 - x0)),
        ((x1 + 0.95) / 2, (1 + y1) / 2, s),
        (1.0, 1.0, 0.0),
        ((1.05 + x3) / 2, 0.5, -1 / (x3 - 0.05 - 1.05)),
        (x3, floor, 0.0),
    ]

    e0, e1 = (p[f"FiberForceLengthCurve.strain_at_{name}_force"] for name in ("zero", "one_norm"))
    stiffness = p.get("FiberForceLengthCurve.stiffness_at_one_norm_force", 2 / (e1 - e0))
    low = p.get("FiberForceLengthCurve.stiffness_at_low_force", 0.2)
    foot = min(0.1 / stiffness, 0.1 * (e1 - e0))
    passive = [(1 + e0, 0.0, 0.0), (1 + e0 + foot, low * foot / 2, low), (1 + e1, 1.0, stiffness)]

    et = p["TendonForceLengthCurve.strain_at_one_norm_force"]
    stiffness = p.get("TendonForceLengthCurve.stiffness_at_one_norm_force", 1.375 / et)
    toe_force = p.get("TendonForceLengthCurve.norm_force_at_toe_end", 2 / 3)
    toe = 1 + et - (1 - toe_force) / stiffness
    middle = 1 + et - (1 - toe_force / 2) / stiffness
    start = 1 + (toe - 1) / 10
    slope = toe_force / 2 / (middle - start)
    tendon = [(1.0, 0.0, 0.0), ((start + middle) / 2, toe_force / 4, slope), (toe, toe_force, stiffness)]

    passive_curviness = p.get("FiberForceLengthCurve.curviness", 0.75)
    tendon_curviness = p.get("TendonForceLengthCurve.curviness", 0.5)
    return (
        bezier(active, [1.0] * 5),
        bezier(passive, [passive_curviness] * 2),
        bezier(tendon, [tendon_curviness] * 2),
        x0,
    )


def de_groote(p):
    """f_L, f_P, f_T, least fiber length."""
    b = [
        (0.8150671134243542, 1.055033428970575, 0.162384573599574, 0.063303448465465),
        (0.433004984392647, 0.716775413397760, -0.029947116970696, 0.200356847296188),
        (0.1, 1.0, 0.353553390593274, 0.0),
    ]
    e0 = p["passive_fiber_strain_at_one_norm_force"]
    offset = exp(4 * (0.2 - 1) / e0)
    kt = log(1.2 / 0.2) / p["tendon_strain_at_one_norm_force"]

    def active(n):
        n = 1 + (n - 1) / p["active_force_width_scale"]
        return sum(b1 * np.exp(-0.5 * (n - b2) ** 2 / (b3 + b4 * n) ** 2) for b1, b2, b3, b4 in b)

    def passive(n):
        return (np.exp(4 * (n - 1) / e0) - offset) / (exp(4) - offset)

    return active, passive, lambda n: 0.2 * np.exp(kt * (n - 1)) - 0.2, 0.0


CLASSES = {
    "Thelen2003Muscle": thelen,
    "Millard2012EquilibriumMuscle": millard,
    "DeGrooteFregly2016Muscle": de_groote,
}


def tendon_force(kind, p, activation, length):
    """Return the static tendon force at arrays of activation and length [m]."""
    active, passive, tendon, shortest = CLASSES[kind](p)
    optimal, slack = p["optimal_fiber_length"], p["tendon_slack_length"]
    width = optimal * sin(p["pennation_angle_at_optimal"])
    if kind != "DeGrooteFregly2016Muscle":
        shortest = max(shortest * optimal, width / sin(p.get("maximum_pennation_angle", acos(0.1))))
    low = np.full(np.shape(length), np.sqrt(max(shortest**2 - width**2, 0.0)))
    high = np.maximum(length - slack, low)
    taut = length - slack > low

    def fiber_force(z):
        fiber = np.hypot(z, width)
        return (
            (activation * active(fiber / optimal) + passive(fiber / optimal)) * z / np.maximum(fiber, 1e-15)
        )

    if p["ignore_tendon_compliance"]:
        return np.where(taut, fiber_force(np.where(taut, high, 1.0)), 0.0)
    for _ in range(BISECTIONS):
        z = 0.5 * (low + high)
        pulled = fiber_force(z) < tendon((length - z) / slack)
        low, high = np.where(pulled, z, low), np.where(pulled, high, z)
    return np.where(taut, tendon((length - high) / slack), 0.0)
