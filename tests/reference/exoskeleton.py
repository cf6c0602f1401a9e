"""Exoskeleton of the elbow in float64 NumPy, written from the paper and from solid bodies.

Sources: Caggiano et al. (2022), arXiv:2205.13600, for the torque, a percentage of the biological torque;
`myoelbow_exo` of myo-sim 0.2.3 for the solids on the forearm.
"""

import numpy as np

# shape, size, center in the frame of the forearm [m], rotation about x [rad], mass [kg]
SOLIDS = (
    ("cylinder", (0.03, 0.03), (0.0, -0.12, 0.035), 1.3, 0.1),
    ("box", (0.01, 0.004, 0.06), (0.0, -0.05, 0.06), 1.3, 0.01),
    ("cylinder", (0.02, 0.01), (0.0, 0.0, 0.05), 0.0, 0.001),
)


def torque(assistance, moment_arm, tendon_force):
    """assistance sum r F [N m]; moment arms (..., muscles) [m], tensions (..., muscles) [N]."""
    return assistance * np.sum(np.asarray(moment_arm, dtype=np.float64) * tendon_force, axis=-1)


def solid_inertia(shape, size, mass):
    """Principal moments of a cylinder (radius, half length; along z) or a box (half sides)."""
    if shape == "cylinder":
        radius, half = size
        across = mass * (3.0 * radius**2 + (2.0 * half) ** 2) / 12.0
        return np.array([across, across, 0.5 * mass * radius**2])
    x, y, z = (2.0 * side for side in size)
    return mass / 12.0 * np.array([y**2 + z**2, x**2 + z**2, x**2 + y**2])


def forearm_part():
    """Mass, center of mass and inertia tensor about it, in the frame of the forearm; parallel axes."""
    mass = sum(solid[4] for solid in SOLIDS)
    center = sum(m * np.array(pos) for _, _, pos, _, m in SOLIDS) / mass
    tensor = np.zeros((3, 3))
    for shape, size, pos, angle, m in SOLIDS:
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        d = np.array(pos) - center
        tensor += turn @ np.diag(solid_inertia(shape, size, m)) @ turn.T
        tensor += m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, center, tensor
