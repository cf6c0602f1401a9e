"""Metabolic rate of a muscle after Bhargava 2004, in float64 NumPy, from the paper."""

import numpy as np


def bhargava(mass, u, n, v, active, force, slow_ratio=0.5):
    """Bhargava 2004, equations 1 to 11, in float64 [W]."""
    slow, fast = slow_ratio * np.sin(np.pi * u / 2), (1 - slow_ratio) * (1 - np.cos(np.pi * u / 2))
    steady = mass * (40 * slow + 133 * fast)
    steady += mass * np.interp(n, (0.5, 1.0, 1.5), (0.5, 1.0, 0.0)) * (74 * slow + 111 * fast)
    shortening, work = 0.25 * force * np.maximum(-v, 0.0), -active * v
    shortening -= np.minimum(steady + shortening + work, 0.0)
    return np.maximum(steady + shortening, mass) + work
