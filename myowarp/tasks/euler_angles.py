"""Euler angles (a, b, c) of R = Rx(a) Ry(b) Rz(c): about x, then about its own y and z."""

import mujoco
import numpy as np
import warp as wp

STRAIGHT = wp.constant(4.0 * 2.220446049250313e-16)  # cosine below which the first angle is 0


@wp.func
def euler_angles(m: wp.mat33) -> wp.vec3:
    """Angles (a, b, c) of R = Rx(a) Ry(b) Rz(c); a = 0 where b is a right angle."""
    cosine = wp.sqrt(m[2, 2] * m[2, 2] + m[1, 2] * m[1, 2])
    b = wp.atan2(m[0, 2], cosine)
    if cosine > STRAIGHT:
        return wp.vec3(-wp.atan2(m[1, 2], m[2, 2]), b, -wp.atan2(m[0, 1], m[0, 0]))
    return wp.vec3(0.0, b, wp.atan2(m[1, 0], m[1, 1]))


@wp.func
def principal(angle: float) -> float:
    """The same angle from -pi to pi."""
    return wp.atan2(wp.sin(angle), wp.cos(angle))


@wp.func
def same_rotation(angles: wp.vec3) -> wp.vec3:
    """Angles (a, b, c) of the same Rx(a) Ry(b) Rz(c), b from -pi/2 to pi/2."""
    if wp.cos(angles[1]) >= 0.0:
        return wp.vec3(principal(angles[0]), principal(angles[1]), principal(angles[2]))
    return wp.vec3(principal(angles[0] + wp.pi), principal(wp.pi - angles[1]), principal(angles[2] + wp.pi))


@wp.func
def turned(angles: wp.vec3) -> wp.quat:
    """Rx(a) Ry(b) Rz(c) as x, y, z, w."""
    x = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), angles[0])
    y = wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angles[1])
    z = wp.quat_from_axis_angle(wp.vec3(0.0, 0.0, 1.0), angles[2])
    return x * y * z


@wp.func
def wxyz(q: wp.quat) -> wp.quat:
    """Components in MuJoCo's order of a rotation in Warp's."""
    return wp.quat(q[3], q[0], q[1], q[2])


def quat_of(angles: tuple[float, float, float]) -> np.ndarray:
    """Return Rx(a) Ry(b) Rz(c) as w, x, y, z; host."""
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.array(angles), "xyz")
    return quat
