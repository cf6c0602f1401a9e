"""A weight in the hand in float64 NumPy, written from statics and solid bodies, not from our code."""

import numpy as np


def sphere_inertia(mass, radius):
    """Moment of inertia of a solid sphere about any axis through its center, 2/5 m r^2."""
    return 0.4 * mass * radius**2


def gravity_torque(mass, center, anchor, axis, gravity=(0.0, 0.0, -9.81)):
    """Torque of a weight about a hinge [N m]: axis . ((center - anchor) x m g).

    With d the distance of the center from the axis and s the angle between the plane of both and the vertical
    through the hinge, this is m g d sin(s) for a horizontal axis.
    """
    lever = np.asarray(center, dtype=np.float64) - anchor
    return mass * np.sum(np.cross(lever, gravity) * axis, axis=-1)
