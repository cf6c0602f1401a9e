"""The spring and damper that stop a coordinate beyond its limits: OpenSim's CoordinateLimitForce.

Beyond a limit both set in over a transition, by the step S(t) = 10 t^3 - 15 t^4 + 6 t^5, t from 0 to 1:

    f = k_low S_low (low - q) - k_high S_high (q - high) - c (S_low + S_high) dq/dt

Source: OpenSim 4.6, class CoordinateLimitForce. Where we differ: a limit without stiffness damps as
others do; OpenSim's force is then no number.
"""

import warp as wp


@wp.struct
class CoordinateLimit:
    """Limits of a joint or of a coordinate [rad or m].

    Attributes:
        address: Where its value stands, of a joint in qpos.
        dof: Along which degree of freedom it acts.
        low: Where the lower spring begins.
        high: Where the upper spring begins.
        low_stiffness: Of the lower spring [N m/rad or N/m].
        high_stiffness: Of the upper spring.
        damping: Beyond the transitions [N m s/rad or N s/m].
        transition: Way over which a spring and the damper set in, above 0.
    """

    address: int
    dof: int
    low: wp.float64
    high: wp.float64
    low_stiffness: wp.float64
    high_stiffness: wp.float64
    damping: wp.float64
    transition: wp.float64


@wp.func
def onset(x: wp.float64) -> wp.float64:
    """S(x), 0 below 0 and 1 above 1."""
    t = wp.clamp(x, wp.float64(0.0), wp.float64(1.0))
    return t * t * t * (wp.float64(10.0) + t * (wp.float64(6.0) * t - wp.float64(15.0)))


@wp.func
def limit_spring(limit: CoordinateLimit, q: wp.float64) -> wp.float64:
    """k_low S_low (low - q) - k_high S_high (q - high) [N m or N]."""
    below, above = limit.low - q, q - limit.high
    force = limit.low_stiffness * onset(below / limit.transition) * below
    return force - limit.high_stiffness * onset(above / limit.transition) * above


@wp.func
def limit_damping(limit: CoordinateLimit, q: wp.float64) -> wp.float64:
    """c (S_low + S_high) [N m s/rad or N s/m]."""
    below, above = limit.low - q, q - limit.high
    return limit.damping * (onset(below / limit.transition) + onset(above / limit.transition))
