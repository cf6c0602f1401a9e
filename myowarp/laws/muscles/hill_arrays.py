"""Hill muscles over arrays in float64, with derivatives: the kernels of `myowarp.muscle`.

Newton's method in a bracket finds an equilibrium, which is not recorded. One more step of Newton's is, with a
slope that counts as constant: its derivative is that of the implicit function theorem, dz = -dr / (dr/dz).
The laws are those of `hill_law`. Shapes of Millard's curves are tables and have no gradient.
"""

from typing import Any

import warp as wp

from myowarp.laws.curves import CurveTables64
from myowarp.laws.muscles.hill_law import (
    DEGROOTE,
    HillMuscle64,
    active_force_length_curve,
    degroote_activation_rate,
    fiber_of,
    fiber_pull,
    fiber_velocity,
    force_velocity_curve,
    passive_force_curve,
    steady_equilibrium,
    tendon_force_curve,
)

ACTIVE, PASSIVE, TENDON, VELOCITY = range(4)
TOLERANCE = wp.constant(wp.float64(1e-14))

CURVES: tuple[str, ...] = (
    "active_width",
    "passive_shape",
    "passive_strain",
    "passive_scale",
    "tendon_strain",
)
CURVES += ("velocity_shape", "eccentric_multiplier", "extrapolation_threshold")


@wp.struct
class Parameters:
    """All parameters; arrays (num_muscles,), those of `hill_muscle` under their names."""

    kind: wp.array[HillMuscle64]
    max_isometric_force: wp.array[wp.float64]
    optimal_fiber_length: wp.array[wp.float64]
    tendon_slack_length: wp.array[wp.float64]
    pennation_angle_at_optimal: wp.array[wp.float64]
    max_contraction_velocity: wp.array[wp.float64]
    fiber_damping: wp.array[wp.float64]
    minimum_activation: wp.array[wp.float64]
    activation_time_constant: wp.array[wp.float64]
    deactivation_time_constant: wp.array[wp.float64]
    active_width: wp.array[wp.float64]
    passive_shape: wp.array[wp.float64]
    passive_strain: wp.array[wp.float64]
    passive_scale: wp.array[wp.float64]
    tendon_strain: wp.array[wp.float64]
    velocity_shape: wp.array[wp.float64]
    eccentric_multiplier: wp.array[wp.float64]
    extrapolation_threshold: wp.array[wp.float64]
    tables: CurveTables64


@wp.func
def muscle_of(p: Parameters, i: int):
    """Parameters of a muscle, of which the width of its fibers follows: l_0 sin(pennation)."""
    m = HillMuscle64()
    m.law = p.kind[i].law
    m.rigid = p.kind[i].rigid
    m.curves = p.kind[i].curves
    m.shortest_fiber = p.kind[i].shortest_fiber
    m.max_isometric_force = p.max_isometric_force[i]
    m.optimal_fiber_length = p.optimal_fiber_length[i]
    m.tendon_slack_length = p.tendon_slack_length[i]
    m.fiber_width = p.optimal_fiber_length[i] * wp.sin(p.pennation_angle_at_optimal[i])
    m.max_contraction_velocity = p.max_contraction_velocity[i]
    m.fiber_damping = p.fiber_damping[i]
    m.minimum_activation = p.minimum_activation[i]
    m.active_width = p.active_width[i]
    m.passive_shape = p.passive_shape[i]
    m.passive_strain = p.passive_strain[i]
    m.passive_scale = p.passive_scale[i]
    m.tendon_strain = p.tendon_strain[i]
    m.velocity_shape = p.velocity_shape[i]
    m.eccentric_multiplier = p.eccentric_multiplier[i]
    m.extrapolation_threshold = p.extrapolation_threshold[i]
    return m


@wp.func
def unknown(x: wp.float64):
    """0 of a number, NaN of NaN and infinity, which comparisons and bounds of the laws would make numbers."""
    return x - x


@wp.kernel
def evaluate_curve(
    # Params:
    p: Parameters,
    which: int,
    # In:
    x: wp.array[wp.float64],
    activation: wp.array[wp.float64],
    # Out:
    multiplier: wp.array[wp.float64],
):
    """f_L, f_P, f_T or f_V at x."""
    k = wp.tid()
    m = muscle_of(p, k % p.kind.shape[0])
    if which == ACTIVE:
        multiplier[k] = active_force_length_curve(m, p.tables, x[k])[0]
    elif which == PASSIVE:
        multiplier[k] = passive_force_curve(m, p.tables, x[k])[0]
    elif which == TENDON:
        multiplier[k] = wp.max(tendon_force_curve(m, p.tables, x[k])[0], wp.float64(0.0))
    else:
        multiplier[k] = force_velocity_curve(m, p.tables, x[k], activation[k])[0]
    multiplier[k] += unknown(x[k]) + unknown(activation[k])


@wp.kernel(enable_backward=False)
def find_equilibrium(
    # Params:
    p: Parameters,
    # In:
    activation: wp.array[wp.float64],
    length: wp.array[wp.float64],
    velocity: wp.array[wp.float64],
    # Out:
    root: wp.array[wp.vec2d],
):
    """(z, 1 / slope of the residual) where fiber and tendon agree; slope 0: z is at an end of its range."""
    k = wp.tid()
    m = muscle_of(p, k % p.kind.shape[0])
    zero, one = wp.float64(0.0), wp.float64(1.0)
    slack = length[k] - m.tendon_slack_length
    root[k] = wp.vec2d(wp.max(slack, m.shortest_fiber), zero)
    if m.rigid == 0:
        a = wp.max(activation[k], m.minimum_activation)
        found = steady_equilibrium(m, p.tables, a, one, length[k], velocity[k], zero, TOLERANCE)
        slope = found[2] + found[3]
        inside = found[0] > m.shortest_fiber and found[0] < slack
        root[k] = wp.vec2d(found[0], wp.where(inside and slope > zero, one / slope, zero))


@wp.kernel
def hold_muscles(
    # Params:
    p: Parameters,
    # In:
    activation: wp.array[wp.float64],
    length: wp.array[wp.float64],
    velocity: wp.array[wp.float64],
    root: wp.array[wp.vec2d],
    # Out:
    fiber_length: wp.array[wp.float64],
    tendon_force: wp.array[wp.float64],
):
    """l and T at the root z; the step that is left of it, z - r / slope, has the root's derivative."""
    k = wp.tid()
    m = muscle_of(p, k % p.kind.shape[0])
    zero, one = wp.float64(0.0), wp.float64(1.0)
    a = wp.max(activation[k], m.minimum_activation)
    z = root[k][0]
    force = zero
    missing = unknown(activation[k]) + unknown(length[k]) + unknown(velocity[k])
    if m.rigid == 0:
        pull = fiber_pull(m, p.tables, a, one, z, velocity[k], zero, zero)[0]
        strain = (length[k] - z - m.tendon_slack_length) / m.tendon_slack_length
        residual = pull - tendon_force_curve(m, p.tables, strain)[0]
        settled = z - residual * root[k][1]
        strain = (length[k] - settled - m.tendon_slack_length) / m.tendon_slack_length
        if root[k][1] == zero and z > m.shortest_fiber:
            settled = length[k] - m.tendon_slack_length
            strain = zero
        fiber_length[k] = fiber_of(m, settled)
        force = tendon_force_curve(m, p.tables, strain)[0]
    else:
        settled = length[k] - m.tendon_slack_length
        if settled > m.shortest_fiber:
            fiber_length[k] = fiber_of(m, settled)
            force = fiber_pull(m, p.tables, a, one, settled, velocity[k], zero, zero)[0]
        else:
            fiber_length[k] = fiber_of(m, m.shortest_fiber)
    fiber_length[k] += missing
    tendon_force[k] = m.max_isometric_force * wp.max(force, zero) + missing


@wp.func
def along_fiber(p: Parameters, m: Any, length: wp.float64, fiber: wp.float64):
    """(z, pull along the fiber that holds the tendon in balance [F_max], f_T)."""
    z = wp.sqrt(wp.max(fiber * fiber - m.fiber_width * m.fiber_width, wp.float64(1e-30)))
    strain = (length - z - m.tendon_slack_length) / m.tendon_slack_length
    force = wp.max(tendon_force_curve(m, p.tables, strain)[0], wp.float64(0.0))
    return wp.vec3d(z, force * fiber / z, force)


@wp.kernel(enable_backward=False)
def find_velocity(
    # Params:
    p: Parameters,
    # In:
    activation: wp.array[wp.float64],
    length: wp.array[wp.float64],
    fiber_length: wp.array[wp.float64],
    # Out:
    root: wp.array[wp.vec2d],
):
    """(v, 1 / slope of the residual) where fiber and tendon agree; slope 0 where they cannot."""
    k = wp.tid()
    m = muscle_of(p, k % p.kind.shape[0])
    zero, one = wp.float64(0.0), wp.float64(1.0)
    root[k] = wp.vec2d(zero, zero)
    if m.rigid == 0:
        a = wp.max(activation[k], m.minimum_activation)
        pull = along_fiber(p, m, length[k], fiber_length[k])[1]
        n = fiber_length[k] / m.optimal_fiber_length
        v = fiber_velocity(m, p.tables, a, one, n, pull, TOLERANCE)[0]
        shortest = fiber_of(m, m.shortest_fiber) * (one + wp.float64(1e-9))
        if v < zero and fiber_length[k] <= shortest:
            return  # as short as it can be
        active = a * active_force_length_curve(m, p.tables, n)[0]
        factor = force_velocity_curve(m, p.tables, v, a)
        slope = active * factor[1] + m.fiber_damping
        residual = active * factor[0] + m.fiber_damping * v - pull
        residual += passive_force_curve(m, p.tables, n)[0]
        solved = slope > zero and wp.abs(residual) < wp.float64(1e-9)
        root[k] = wp.vec2d(v, wp.where(solved, one / slope, zero))


@wp.kernel
def contract_muscles(
    # Params:
    p: Parameters,
    # In:
    activation: wp.array[wp.float64],
    length: wp.array[wp.float64],
    velocity: wp.array[wp.float64],
    fiber_length: wp.array[wp.float64],
    root: wp.array[wp.vec2d],
    # Out:
    speed: wp.array[wp.float64],
    tendon_force: wp.array[wp.float64],
    fiber_power: wp.array[wp.float64],
    tendon_power: wp.array[wp.float64],
):
    """dl/dt [m/s], T [N], -F dl/dt and -T d(tendon length)/dt [W], of fibers of a given length."""
    k = wp.tid()
    m = muscle_of(p, k % p.kind.shape[0])
    zero, one = wp.float64(0.0), wp.float64(1.0)
    a = wp.max(activation[k], m.minimum_activation)
    scale = m.optimal_fiber_length * m.max_contraction_velocity
    if m.rigid == 0:
        n = fiber_length[k] / m.optimal_fiber_length
        held = along_fiber(p, m, length[k], fiber_length[k])
        v = root[k][0]
        residual = a * active_force_length_curve(m, p.tables, n)[0]
        residual *= force_velocity_curve(m, p.tables, v, a)[0]
        residual += passive_force_curve(m, p.tables, n)[0] + m.fiber_damping * v - held[1]
        fiber_speed = (v - residual * root[k][1]) * scale
        speed[k] = fiber_speed
        tendon_force[k] = m.max_isometric_force * held[2]
        fiber_power[k] = -m.max_isometric_force * held[1] * fiber_speed
        tendon_power[k] = (
            -m.max_isometric_force * held[2] * (velocity[k] - fiber_speed * fiber_length[k] / held[0])
        )
    else:
        z = length[k] - m.tendon_slack_length
        if z > m.shortest_fiber:
            pull = fiber_pull(m, p.tables, a, one, z, velocity[k], zero, zero)[0]
            force = m.max_isometric_force * wp.max(pull, zero)
            speed[k] = velocity[k] * z / fiber_of(m, z)
            tendon_force[k] = force
            fiber_power[k] = -force * velocity[k]
    missing = unknown(activation[k]) + unknown(length[k])
    missing += unknown(velocity[k]) + unknown(fiber_length[k])
    speed[k] += missing
    tendon_force[k] += missing
    fiber_power[k] += missing
    tendon_power[k] += missing


@wp.kernel
def rate_of_activation(
    # Params:
    p: Parameters,
    # In:
    excitation: wp.array[wp.float64],
    activation: wp.array[wp.float64],
    # Out:
    rate: wp.array[wp.float64],
):
    """da/dt = (u - a) / tau [1/s], tau = tau_act (0.5 + 1.5 a) or tau_deact / (0.5 + 1.5 a); De Groote's."""
    k = wp.tid()
    i = k % p.kind.shape[0]
    missing = unknown(excitation[k]) + unknown(activation[k])
    u = wp.max(excitation[k], p.minimum_activation[i])
    a = wp.max(activation[k], p.minimum_activation[i])
    rise, fall = p.activation_time_constant[i], p.deactivation_time_constant[i]
    scale = wp.float64(0.5) + wp.float64(1.5) * a
    if p.kind[i].law == DEGROOTE:
        rate[k] = degroote_activation_rate(u, a, rise, fall) + missing
    elif u > a:
        rate[k] = (u - a) / (rise * scale) + missing
    else:
        rate[k] = (u - a) * scale / fall + missing
