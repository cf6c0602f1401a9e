"""A bushing: springs and dampers between two frames, along and about three axes: OpenSim's BushingForce.

Frame M in frame F has the angles (a, b, c) of R = X(a) Y(b) Z(c) and the position p. They are deflections q,
with the forces -K q - C dq/dt. The force acts at the origin of M, along F; the torque on M is N^T times those
about the angles, where dq/dt = N w, w the angular velocity of M in F along M. F gets the opposite.

Source: OpenSim 4.6, class BushingForce; Simbody's Force::LinearBushing.
"""

import warp as wp


@wp.struct
class Bushing:
    """A bushing.

    Attributes:
        first: Number of the body that carries F, -1 for ground.
        second: The same of M.
        first_rotation: Axes of F in its body.
        first_origin: Its origin there [m].
        second_rotation: The same of M.
        second_origin: The same of M.
        turn_stiffness: About the three angles [N m/rad].
        shift_stiffness: Along the axes of F [N/m].
        turn_damping: [N m s/rad].
        shift_damping: [N s/m].
    """

    first: int
    second: int
    first_rotation: wp.mat33d
    first_origin: wp.vec3d
    second_rotation: wp.mat33d
    second_origin: wp.vec3d
    turn_stiffness: wp.vec3d
    shift_stiffness: wp.vec3d
    turn_damping: wp.vec3d
    shift_damping: wp.vec3d


@wp.func
def bushing_force(bushing: Bushing, position: wp.vec3d, velocity: wp.vec3d) -> wp.vec3d:
    """Return the force on M at its origin, along F [N]; of where M is in F, and how fast it moves there."""
    spring = wp.cw_mul(bushing.shift_stiffness, position)
    return -spring - wp.cw_mul(bushing.shift_damping, velocity)


@wp.func
def bushing_torque(bushing: Bushing, turned: wp.mat33d, spin: wp.vec3d) -> wp.vec3d:
    """Return the torque on M, along M [N m]; of its axes in F, and its angular velocity in F along M."""
    one, zero = wp.float64(1.0), wp.float64(0.0)
    a = wp.atan2(-turned[1, 2], turned[2, 2])
    b = wp.asin(wp.clamp(turned[0, 2], -one, one))
    c = wp.atan2(-turned[0, 1], turned[0, 0])
    cos_b, cos_c, sin_c = wp.cos(b), wp.cos(c), wp.sin(c)
    tan_b = wp.sin(b) / cos_b
    to_rates = wp.mat33d(
        cos_c / cos_b, -sin_c / cos_b, zero, sin_c, cos_c, zero, -tan_b * cos_c, tan_b * sin_c, one
    )
    spring = wp.cw_mul(bushing.turn_stiffness, wp.vec3d(a, b, c))
    return wp.transpose(to_rates) * (-spring - wp.cw_mul(bushing.turn_damping, to_rates * spin))
