"""A bushing: springs and dampers between two frames, along and about three axes: OpenSim's BushingForce.

Frame M in frame F has the angles (a, b, c) of R = X(a) Y(b) Z(c) and the position p. They are deflections q,
with the forces -K q - C dq/dt; K q may be any formula of all q. The force acts at the origin of M, along F;
the torque on M is N^T times those about the angles, where dq/dt = N w, w the angular velocity of M in F along
M. F gets the opposite.

Source: OpenSim 4.6, classes BushingForce, FunctionBasedBushingForce and ExpressionBasedBushingForce;
Simbody's Force::LinearBushing.
"""

import warp as wp

from myowarp.laws.expressions import Programs, Variables, run


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
        program: First of six formulas of the deflections in place of stiffness; -1: there are none.
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
    program: int


@wp.struct
class BodyMotion:
    """Place and motion of a body, in ground.

    Attributes:
        rotation: Its axes.
        origin: [m].
        turn: Angular velocity [rad/s].
        shift: Velocity of the point of it that is where ground's origin is [m/s].
    """

    rotation: wp.mat33d
    origin: wp.vec3d
    turn: wp.vec3d
    shift: wp.vec3d


@wp.struct
class Wrench:
    """A force [N], and a torque about ground's origin [N m], in ground's axes."""

    force: wp.vec3d
    torque: wp.vec3d


@wp.func
def bushing_wrench(bushing: Bushing, formulas: Programs, first: BodyMotion, second: BodyMotion) -> Wrench:
    """Return what acts on the second body; the first gets the opposite."""
    first_axes = first.rotation * bushing.first_rotation
    second_axes = second.rotation * bushing.second_rotation
    begin = first.origin + first.rotation * bushing.first_origin
    end = second.origin + second.rotation * bushing.second_origin
    to_first = wp.transpose(first_axes)
    spin = second.turn - first.turn
    # How the second origin moves in the first frame.
    velocity = to_first * (second.shift - first.shift + wp.cross(spin, end))
    position = to_first * (end - begin)
    angles, to_rates = deflection(to_first * second_axes)
    springs = wp.cw_mul(bushing.shift_stiffness, position)
    moments = wp.cw_mul(bushing.turn_stiffness, angles)
    if bushing.program >= 0:
        at = Variables()
        for k in range(3):
            at[k] = angles[k]
            at[k + 3] = position[k]
        for k in range(3):
            moments[k] = run(formulas, bushing.program + k, at)
            springs[k] = run(formulas, bushing.program + k + 3, at)
    force = first_axes * (-springs - wp.cw_mul(bushing.shift_damping, velocity))
    rates = to_rates * (wp.transpose(second_axes) * spin)
    torque = second_axes * (wp.transpose(to_rates) * (-moments - wp.cw_mul(bushing.turn_damping, rates)))
    found = Wrench()
    found.force = force
    found.torque = torque + wp.cross(end, force)
    return found


@wp.func
def deflection(turned: wp.mat33d):
    """Return the angles of M in F, and what takes an angular velocity along M to their rates; of M's axes."""
    one, zero = wp.float64(1.0), wp.float64(0.0)
    a = wp.atan2(-turned[1, 2], turned[2, 2])
    b = wp.asin(wp.clamp(turned[0, 2], -one, one))
    c = wp.atan2(-turned[0, 1], turned[0, 0])
    cos_b, cos_c, sin_c = wp.cos(b), wp.cos(c), wp.sin(c)
    tan_b = wp.sin(b) / cos_b
    to_rates = wp.mat33d(
        cos_c / cos_b, -sin_c / cos_b, zero, sin_c, cos_c, zero, -tan_b * cos_c, tan_b * sin_c, one
    )
    return wp.vec3d(a, b, c), to_rates
