"""Hill muscles with pennation and an elastic or rigid tendon, under the curves of four published models.

With the fiber length l, its part z = l cos(phi) along the tendon and a constant width l sin(phi), the path's
length L and forces in maximum isometric forces:

    (a f_L(l) f_V(v) + f_P(l) + beta v) cos(phi) = f_T((L - z) / slack length - 1)

An elastic tendon makes l a state. A physics step solves the equation for z at its end, at L + dt dL/dt and
with v = (l - l before) / dt (backward Euler): the residual has one sign where the fiber is shortest and the
other where the tendon is slack, so that Newton's method is kept in a bracket and cannot fail. Where the path
ends up a little longer than expected, fiber and tendon share the rest as the springs that they were in that
step. The tendon pulls with what it has at the beginning of a step, as the engine's steps ask for: they are
those of a leapfrog, whose velocities are half a step behind its positions. How the pull changes within a
step reaches the body as damping. A rigid tendon has z = L - slack length, v from the path's velocity, and no
state.

Sources: thelen2003.py, millard2012.py, degroote_fregly2016.py, schutte1993.py; bounds of the fiber: OpenSim's
MuscleFixedWidthPennationModel. Where we differ from OpenSim 4.6: the step is implicit and fixed instead of
explicit and adaptive; De Groote's tendon does not push, and its state is the fiber length; activation under
preset `fast` is that in the middle of a step.
"""

from typing import TYPE_CHECKING, Any

import warp as wp

from myowarp.laws.muscles.activation import activation_step
from myowarp.laws.muscles.degroote_fregly2016 import (
    degroote_activation_rate,
    degroote_active_force_length,
    degroote_force_velocity,
    degroote_passive_force,
    degroote_tendon_force,
)
from myowarp.laws.muscles.millard2012 import (
    millard_active_force_length,
    millard_force_velocity,
    millard_passive_force,
    millard_tendon_force,
)
from myowarp.laws.muscles.schutte1993 import (
    schutte_activation_rate,
    schutte_fiber_force,
    schutte_force_velocity,
    schutte_tendon_force,
)
from myowarp.laws.muscles.thelen2003 import (
    thelen_active_force_length,
    thelen_force_velocity,
    thelen_passive_force,
    thelen_tendon_force,
)

THELEN, MILLARD, DEGROOTE, SCHUTTE = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)

SCHUTTE_CLASS = "Schutte1993Muscle_Deprecated"
OPENSIM_LAWS = {
    "Thelen2003Muscle": 0,
    "Millard2012EquilibriumMuscle": 1,
    "Millard2012AccelerationMuscle": 1,
    "DeGrooteFregly2016Muscle": 2,
    SCHUTTE_CLASS: 3,
}
"""Law of OpenSim's muscle classes."""


NUMBERS = ("law", "rigid", "curves")
PARAMETERS = (
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "fiber_width",
    "shortest_fiber",
    "max_contraction_velocity",
    "fiber_damping",
    "minimum_activation",
    "active_width",
    "passive_shape",
    "passive_strain",
    "passive_scale",
    "tendon_strain",
    "velocity_shape",
    "eccentric_multiplier",
    "extrapolation_threshold",
)


def hill_muscle(real: type) -> Any:
    """Return the struct of one muscle's parameters in a floating-point type.

    law: `THELEN`, `MILLARD`, `DEGROOTE` or `SCHUTTE`. rigid: 1: the tendon keeps its slack length. curves:
    number of the first of Millard's four or Schutte's three tables. max_isometric_force [N],
    optimal_fiber_length [m], tendon_slack_length [m]; fiber_width: distance between the planes that fibers
    run between [m]; shortest_fiber: least z [m]; max_contraction_velocity [optimal fiber lengths / s];
    fiber_damping: beta; minimum_activation: floor of activation and excitation. Curves of Thelen and De
    Groote: active_width (KshapeActive, active_force_width_scale), passive_shape (KshapePassive),
    passive_strain and tendon_strain where f_P and f_T are 1, passive_scale (0: no f_P), velocity_shape (Af),
    eccentric_multiplier (Flen), extrapolation_threshold (fv_linear_extrap_threshold).
    """
    fields = dict.fromkeys(NUMBERS, int) | dict.fromkeys(PARAMETERS, real)
    return wp.struct(type("HillMuscle", (), {"__annotations__": fields, "__module__": __name__}))


if TYPE_CHECKING:
    HillMuscle = Any
    HillMuscle64 = Any
else:
    HillMuscle = hill_muscle(wp.float32)
    HillMuscle64 = hill_muscle(wp.float64)


@wp.func
def active_force_length_curve(m: Any, tables: Any, length: Any):
    """f_L and its slope."""
    if m.law == MILLARD:
        return millard_active_force_length(m, tables, length)
    if m.law == THELEN:
        return thelen_active_force_length(m, length)
    if m.law == SCHUTTE:
        return schutte_fiber_force(tables, m.curves, length)
    return degroote_active_force_length(m, length)


@wp.func
def passive_force_curve(m: Any, tables: Any, length: Any):
    """f_P and its slope."""
    if m.law == MILLARD:
        return millard_passive_force(m, tables, length)
    if m.law == THELEN:
        return thelen_passive_force(m, length)
    if m.law == SCHUTTE:
        return schutte_fiber_force(tables, m.curves + 1, length)
    return degroote_passive_force(m, length)


@wp.func
def tendon_force_curve(m: Any, tables: Any, strain: Any):
    """f_T and its slope, over strain."""
    if m.law == MILLARD:
        return millard_tendon_force(m, tables, strain)
    if m.law == THELEN:
        return thelen_tendon_force(m, strain)
    if m.law == SCHUTTE:
        return schutte_tendon_force(m, tables, strain)
    return degroote_tendon_force(m, strain)


@wp.func
def force_velocity_curve(m: Any, tables: Any, velocity: Any, activation: Any):
    """f_V and its slope; only Thelen's depends on the activation."""
    if m.law == MILLARD:
        return millard_force_velocity(m, tables, velocity)
    if m.law == THELEN:
        return thelen_force_velocity(m, velocity, activation)
    if m.law == SCHUTTE:
        return schutte_force_velocity(m, velocity)
    return degroote_force_velocity(m, velocity, activation)


@wp.func
def fiber_pull(
    m: Any, tables: Any, activation: Any, strength: Any, z: Any, velocity: Any, before: Any, per_step: Any
):
    """((a s f_L f_V + f_P + beta v) cos(phi), its slope by z [1/m], its slope by velocity [s/m]).

    v = ((l - before) per_step + velocity cos(phi)) / (l_0 v_max): of a step, or of a tendon that keeps its
    length while the path has a velocity.
    """
    length = wp.sqrt(z * z + m.fiber_width * m.fiber_width)
    cosine = z / length
    turn = (type(z)(1.0) - cosine * cosine) / length
    scale = m.optimal_fiber_length * m.max_contraction_velocity
    speed = ((length - before) * per_step + velocity * cosine) / scale
    speed_slope = (cosine * per_step + velocity * turn) / scale
    norm_length = length / m.optimal_fiber_length
    active = active_force_length_curve(m, tables, norm_length)
    passive = passive_force_curve(m, tables, norm_length)
    factor = force_velocity_curve(m, tables, speed, activation)
    drive = activation * strength
    force = drive * active[0] * factor[0] + passive[0] + m.fiber_damping * speed
    by_speed = drive * active[0] * factor[1] + m.fiber_damping
    slope = (drive * active[1] * factor[0] + passive[1]) * cosine / m.optimal_fiber_length
    slope += by_speed * speed_slope
    return wp.vector(force * cosine, slope * cosine + force * turn, by_speed * cosine * cosine / scale)


@wp.func
def equilibrium(
    m: Any,
    tables: Any,
    activation: Any,
    strength: Any,
    length: Any,
    velocity: Any,
    before: Any,
    per_step: Any,
    start: Any,
    tolerance: Any,
):
    """(z [m], f_T, its slope by z [1/m], slope of the fiber's pull by z [1/m]) where fiber and tendon agree.

    Newton's method from `start` on, in a bracket; a step that leaves it, or after which the residual has not
    been halved, is replaced by bisection. It ends with a step below tolerance (l_0 + slack length), or with
    one of Newton's below `NEWTON` times that and `NEWTON_SPEED`, whose error is its square; the tendon's
    force follows the last step by its slope.
    """
    half = type(start)(0.5)
    low = m.shortest_fiber
    slack = wp.max(length - m.tendon_slack_length, low)
    high = wp.max(slack, wp.sqrt(wp.max(before * before - m.fiber_width * m.fiber_width, low * low)))
    small = tolerance * (m.optimal_fiber_length + wp.abs(m.tendon_slack_length))
    near = small * type(start)(NEWTON)
    if per_step > type(start)(0.0):
        speed = type(start)(NEWTON_SPEED) * m.optimal_fiber_length * m.max_contraction_velocity
        near = wp.clamp(speed / per_step, small, near)
    z = wp.clamp(start, low, high)
    last = type(start)(1.0e30)
    tension, stiffness, slope = type(start)(0.0), type(start)(0.0), type(start)(0.0)
    for _ in range(80):
        pull = fiber_pull(m, tables, activation, strength, z, velocity, before, per_step)
        tendon = tendon_force_curve(m, tables, (length - z - m.tendon_slack_length) / m.tendon_slack_length)
        tension, stiffness, slope = tendon[0], tendon[1] / m.tendon_slack_length, pull[1]
        residual = pull[0] - tension
        if residual < type(start)(0.0):
            low = z
        else:
            high = z
        nearer = z - residual / (slope + stiffness)
        most = near
        fits = slope + stiffness > type(start)(0.0) and nearer >= low and nearer <= high
        if not fits or wp.abs(residual) > half * last:
            nearer = half * (low + high)
            most = small
        last = wp.abs(residual)
        step = nearer - z
        tension -= stiffness * step
        z = nearer
        if wp.abs(step) <= most:
            break
    return wp.vector(z, tension, stiffness, slope)


@wp.func
def steady_equilibrium(
    m: Any, tables: Any, activation: Any, strength: Any, length: Any, velocity: Any, near: Any, tolerance: Any
):
    """`equilibrium` while the tendon keeps its length; from a z near it, or, at 0, a tendon 2 % too long."""
    zero = type(near)(0.0)
    start = near
    if near <= zero:
        start = length - m.tendon_slack_length - type(near)(0.02) * m.tendon_slack_length
    return equilibrium(m, tables, activation, strength, length, velocity, zero, zero, start, tolerance)


NEWTON = wp.constant(50.0)
"""Longest last step of Newton's method, in steps of bisection."""

NEWTON_SPEED = wp.constant(1e-3)
"""Largest change of the fiber's velocity by it [maximum contraction velocities]."""


@wp.func
def fiber_velocity(
    m: Any, tables: Any, activation: Any, strength: Any, norm_length: Any, pull: Any, tolerance: Any
):
    """v [l_0 v_max] where a s f_L f_V(v) + f_P + beta v is the pull along the fiber.

    Newton's method in the bracket -10..10, of fibers that nothing damps under Millard's law -1..1, beyond
    which its f_V does not change; where the equation has no solution, the end that is nearer to one.

    Returns:
        (v, f_V(v)).
    """
    half, one = type(pull)(0.5), type(pull)(1.0)
    high = wp.where(m.law == MILLARD and m.fiber_damping == type(pull)(0.0), one, type(pull)(10.0))
    low = -high
    active = activation * strength * active_force_length_curve(m, tables, norm_length)[0]
    wanted = pull - passive_force_curve(m, tables, norm_length)[0]
    v, last = type(pull)(0.0), type(pull)(1.0e30)
    factor = force_velocity_curve(m, tables, v, activation)
    for _ in range(80):
        factor = force_velocity_curve(m, tables, v, activation)
        residual = active * factor[0] + m.fiber_damping * v - wanted
        slope = active * factor[1] + m.fiber_damping
        if residual < type(pull)(0.0):
            low = v
        else:
            high = v
        nearer = v - residual / slope
        if (
            not (slope > type(pull)(0.0) and nearer >= low and nearer <= high)
            or wp.abs(residual) > half * last
        ):
            nearer = half * (low + high)
        last = wp.abs(residual)
        if wp.abs(nearer - v) <= tolerance:
            break
        v = nearer
    return wp.vector(v, factor[0])


@wp.func
def along_tendon(m: Any, fiber_length: Any):
    """z = sqrt(l^2 - width^2), at least the shortest."""
    square = fiber_length * fiber_length - m.fiber_width * m.fiber_width
    return wp.sqrt(wp.max(square, m.shortest_fiber * m.shortest_fiber))


@wp.func
def fiber_of(m: Any, z: Any):
    """l = sqrt(z^2 + width^2)."""
    return wp.sqrt(z * z + m.fiber_width * m.fiber_width)


TOLERANCE = wp.constant(2e-7)
"""A step of Newton's method that changes nothing, in float32."""


@wp.func
def hill_activation_step(
    m: HillMuscle, dt: float, midstep: bool, excitation: float, activation: float, rise: float, fall: float
) -> wp.vec2:
    """(a that pulls, a after dt), not beyond the excitation; both at least the floor.

    a(t) is solved exactly, under De Groote's law by the midpoint rule. A rigid tendon is pulled by a at the
    start of the step, with `midstep` in its middle; an elastic one is in equilibrium, a included, at its end.
    """
    u, a = wp.max(excitation, m.minimum_activation), wp.max(activation, m.minimum_activation)
    steps = wp.vec2()
    low, high = wp.min(a, u), wp.max(a, u)
    if m.law == DEGROOTE:
        middle = a + 0.5 * dt * degroote_activation_rate(u, a, rise, fall)
        middle = wp.clamp(middle, low, high)
        steps = wp.vec2(middle, a + dt * degroote_activation_rate(u, middle, rise, fall))
    elif m.law == SCHUTTE:
        rate = schutte_activation_rate(u, a, rise, fall)
        steps = wp.vec2(u + (a - u) * wp.exp(-0.5 * dt * rate), u + (a - u) * wp.exp(-dt * rate))
    else:
        steps = activation_step(dt, True, u, a, rise, fall, 0.0)
    after = wp.clamp(steps[1], low, high)
    if m.rigid == 0:
        return wp.vec2(after, after)
    return wp.vec2(wp.where(midstep, wp.clamp(steps[0], low, high), a), after)
