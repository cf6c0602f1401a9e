"""Kernels of Hill muscles: parameters and state of all worlds, a physics step, and what is read from fibers.

The law is that of hill_law.py.
"""

import warp as wp

from myowarp.definitions.muscle import (
    Anatomy,
    BiasParams,
    FiberStates,
    MuscleResults,
    affine_bias,
)
from myowarp.kernels.batching import batched, of_world
from myowarp.laws.curves import CurveTables
from myowarp.laws.muscles.hill_law import (
    TOLERANCE,
    HillMuscle,
    active_force_length_curve,
    along_tendon,
    equilibrium,
    fiber_of,
    fiber_pull,
    fiber_velocity,
    force_velocity_curve,
    hill_activation_step,
    passive_force_curve,
    steady_equilibrium,
    tendon_force_curve,
)


@wp.struct
class HillParams:
    """Parameters of all muscles; arrays of numbers are (1 or num_worlds, num_muscles).

    Attributes:
        actuator_id: Actuator of each muscle, shape (num_muscles,).
        excitation_range: Lowest and highest excitation [1], shape (num_muscles,).
        activation_time_constant: Time constant at full rise [s].
        deactivation_time_constant: Time constant of decay [s].
        muscles: What the law needs, each row on its own.
        tables: Millard's and Schutte's curves.
    """

    actuator_id: wp.array[int]
    excitation_range: wp.array[wp.vec2]
    activation_time_constant: wp.array2d[float]
    deactivation_time_constant: wp.array2d[float]
    muscles: wp.array2d[HillMuscle]
    tables: CurveTables


@wp.struct
class Fibers:
    """State of the muscles; arrays (num_worlds, num_muscles).

    Attributes:
        activation: [1].
        fiber_length: [m], on a path of the expected length; empty, as the next two, if no tendon is elastic.
        expected_length: Length of the path that the last step expected [m].
        fiber_share: How much of what the path is longer the fiber takes, the tendon having the rest [1].
    """

    activation: wp.array2d[float]
    fiber_length: wp.array2d[float]
    expected_length: wp.array2d[float]
    fiber_share: wp.array2d[float]


@wp.func
def along_present_tendon(m: HillMuscle, fibers: Fibers, worldid: int, muscleid: int, length: float) -> float:
    """z of the state on a path of this length, where fiber and tendon still agree."""
    more = fibers.fiber_share[worldid, muscleid] * (length - fibers.expected_length[worldid, muscleid])
    return wp.max(along_tendon(m, fibers.fiber_length[worldid, muscleid]) + more, m.shortest_fiber)


@wp.func
def pull_rigid(
    m: HillMuscle, tables: CurveTables, activation: float, strength: float, length: float, velocity: float
) -> wp.vec3:
    """(z, f, df/dvelocity) of a fiber on a tendon that keeps its slack length; f >= 0."""
    free = length - m.tendon_slack_length
    z = wp.max(free, m.shortest_fiber)
    if free > m.shortest_fiber:
        pull = fiber_pull(m, tables, activation, strength, z, velocity, 0.0, 0.0)
        if pull[0] > 0.0:
            return wp.vec3(z, pull[0], pull[2])
    return wp.vec3(z, 0.0, 0.0)


@wp.func
def step_elastic(
    m: HillMuscle,
    tables: CurveTables,
    activation: float,
    strength: float,
    dt: float,
    length: float,
    velocity: float,
    now: float,
):
    """(z after dt, f_T now, df_T/dvelocity, the fiber's share of what more the path is longer).

    The derivative is dt times the stiffness of fiber and tendon in series. Less of it, as in the trapezoidal
    rule, does not hold bodies that are light beside the muscle.
    """
    strain = (length - now - m.tendon_slack_length) / m.tendon_slack_length
    force = wp.max(tendon_force_curve(m, tables, strain)[0], 0.0)
    z, share, by_velocity = float(now), float(0.0), float(0.0)
    if dt > 0.0:
        found = equilibrium(
            m,
            tables,
            activation,
            strength,
            length + dt * velocity,
            0.0,
            fiber_of(m, now),
            1.0 / dt,
            now + dt * velocity,
            TOLERANCE,
        )
        z = found[0]
        both = found[2] + found[3]
        if both > 0.0:
            share = wp.clamp(found[2] / both, 0.0, 1.0)
            if force > 0.0 and found[3] > 0.0:
                by_velocity = dt * share * found[3]
    return wp.vec4(z, force, by_velocity, share)


@wp.kernel(enable_backward=False)
def contract_hill(
    # Model:
    opt_timestep: wp.array[float],
    # Params:
    params: HillParams,
    # Data in:
    ctrl_in: wp.array2d[float],
    actuator_length_in: wp.array2d[float],
    actuator_velocity_in: wp.array2d[float],
    # In:
    implicitness: float,
    midstep: bool,
    threads: int,
    anatomy: Anatomy,
    # Out:
    fibers: Fibers,
    results: MuscleResults,
    actuator_biasprm: wp.array2d[BiasParams],
):
    """T = transmission F_max f_T, or the pull of the fiber on a rigid tendon; l(t + dt), a(t + dt).

    damping = implicitness dT/dvelocity.
    """
    worldid, thread = wp.tid()
    dt = opt_timestep[batched(worldid, opt_timestep.shape[0])]
    for i in range(thread, fibers.activation.shape[1], threads):
        m = params.muscles[batched(worldid, params.muscles.shape[0]), i]
        bounds = params.excitation_range[i]
        steps = hill_activation_step(
            m,
            dt,
            midstep,
            wp.clamp(ctrl_in[worldid, params.actuator_id[i]], bounds[0], bounds[1]),
            fibers.activation[worldid, i],
            of_world(params.activation_time_constant, worldid, i),
            of_world(params.deactivation_time_constant, worldid, i),
        )
        pathid = anatomy.path[batched(worldid, anatomy.path.shape[0]), i]
        length, velocity = actuator_length_in[worldid, pathid], actuator_velocity_in[worldid, pathid]
        strength = of_world(anatomy.strength, worldid, i)
        before = float(0.0)
        if fibers.fiber_length.shape[0] > 0:
            before = fibers.fiber_length[worldid, i]
        z, norm_force, by_velocity = float(0.0), float(0.0), float(0.0)
        expected, share = float(length), float(0.0)
        if m.rigid == 1:
            held = pull_rigid(m, params.tables, steps[0], strength, length, velocity)
            z, norm_force, by_velocity = held[0], held[1], held[2]
        else:
            now = along_present_tendon(m, fibers, worldid, i, length)
            before = wp.where(before >= 0.0, fiber_of(m, now), float(before))
            moved = step_elastic(m, params.tables, steps[0], strength, dt, length, velocity, now)
            z, norm_force, by_velocity, share = moved[0], moved[1], moved[2], moved[3]
            expected = wp.where(dt > 0.0, length + dt * velocity, length)
        after = fiber_of(m, z)
        if m.rigid == 0 and not before >= 0.0:  # no length, or none at all: a fault, not a repair
            after, norm_force, by_velocity = wp.nan, float(0.0), float(0.0)
        force = of_world(anatomy.transmission, worldid, i) * m.max_isometric_force
        damping = wp.where(implicitness > 0.0, implicitness * force * by_velocity, 0.0)
        fibers.activation[worldid, i] = steps[1]
        results.tension[worldid, i] = force * norm_force
        results.length[worldid, i] = length
        results.velocity[worldid, i] = velocity
        results.damping[worldid, i] = damping
        if results.workload.shape[0] > 0:
            speed = velocity * z / after
            if m.rigid == 0 and dt > 0.0:
                speed = (after - before) / dt
            norm_speed = speed / (m.optimal_fiber_length * m.max_contraction_velocity)
            active = active_force_length_curve(m, params.tables, after / m.optimal_fiber_length)[0]
            factor = force_velocity_curve(m, params.tables, norm_speed, steps[0])[0]
            results.workload[worldid, i] += dt * wp.max(steps[0] * active * factor, 0.0)
        if fibers.fiber_length.shape[0] > 0:
            fibers.fiber_length[worldid, i] = after
            fibers.expected_length[worldid, i] = expected
            fibers.fiber_share[worldid, i] = share
        actuator_biasprm[worldid, pathid] = affine_bias(force * norm_force, damping, velocity)


@wp.kernel(enable_backward=False)
def read_hill_fibers(
    # Params:
    params: HillParams,
    # In:
    fibers: Fibers,
    length: wp.array2d[float],
    velocity: wp.array2d[float],
    anatomy: Anatomy,
    # Out:
    states: FiberStates,
):
    """(l / l_0, v, F a s f_L f_V, F (f_P + beta v)) on a path of this length and velocity.

    With an elastic tendon v is where fiber and tendon agree, as in OpenSim; fibers that are as short as they
    can be do not shorten. With a rigid one v is the path's velocity times cos(phi).
    """
    worldid, i = wp.tid()
    m = params.muscles[batched(worldid, params.muscles.shape[0]), i]
    a = wp.max(fibers.activation[worldid, i], m.minimum_activation)
    strength = of_world(anatomy.strength, worldid, i)
    free = length[worldid, i] - m.tendon_slack_length
    z = wp.max(free, m.shortest_fiber)
    if m.rigid == 0:
        z = along_present_tendon(m, fibers, worldid, i, length[worldid, i])
    fiber = fiber_of(m, z)
    norm_length = fiber / m.optimal_fiber_length
    fastest = m.optimal_fiber_length * m.max_contraction_velocity
    v = wp.where(free > m.shortest_fiber, velocity[worldid, i] * z / fiber / fastest, 0.0)
    factor = force_velocity_curve(m, params.tables, v, a)[0]
    if m.rigid == 0:
        strain = (free - z) / m.tendon_slack_length
        pull = wp.max(tendon_force_curve(m, params.tables, strain)[0], 0.0) * fiber / z
        found = fiber_velocity(m, params.tables, a, strength, norm_length, pull, TOLERANCE)
        v, factor = found[0], found[1]
        if v < 0.0 and z <= m.shortest_fiber:
            v = float(0.0)
            factor = force_velocity_curve(m, params.tables, v, a)[0]
    active = active_force_length_curve(m, params.tables, norm_length)[0]
    passive = passive_force_curve(m, params.tables, norm_length)[0] + m.fiber_damping * v
    force = of_world(anatomy.transmission, worldid, i) * m.max_isometric_force
    states.norm_length[worldid, i] = norm_length
    states.velocity[worldid, i] = v * fastest
    states.norm_velocity[worldid, i] = v * m.max_contraction_velocity
    states.active_force[worldid, i] = force * a * strength * active * factor
    states.passive_force[worldid, i] = force * passive
    states.active_force_length[worldid, i] = active


@wp.kernel(enable_backward=False)
def settle_hill(
    # Params:
    params: HillParams,
    # In:
    length: wp.array2d[float],
    velocity: wp.array2d[float],
    anatomy: Anatomy,
    mask: wp.array[bool],
    # Out:
    fibers: Fibers,
):
    """l at which fiber and tendon agree, the tendon keeping its length."""
    worldid, i = wp.tid()
    if mask[worldid]:
        m = params.muscles[batched(worldid, params.muscles.shape[0]), i]
        slack = length[worldid, i] - m.tendon_slack_length
        z = wp.max(slack, m.shortest_fiber)
        if m.rigid == 0:
            found = steady_equilibrium(
                m,
                params.tables,
                wp.max(fibers.activation[worldid, i], m.minimum_activation),
                of_world(anatomy.strength, worldid, i),
                length[worldid, i],
                velocity[worldid, i],
                0.0,
                TOLERANCE,
            )
            z = found[0]
        fibers.fiber_length[worldid, i] = fiber_of(m, z)
        fibers.expected_length[worldid, i] = length[worldid, i]
        fibers.fiber_share[worldid, i] = 0.0


@wp.kernel(enable_backward=False)
def sample_curves(
    # Params:
    params: HillParams,
    # In:
    norm_length: wp.array[float],
    strain: wp.array[float],
    # Out:
    forces: wp.array3d[float],
):
    """(f_L + f_P at rest, f_T) of each muscle of the first world."""
    i, point = wp.tid()
    m = params.muscles[0, i]
    active = active_force_length_curve(m, params.tables, norm_length[point])[0]
    forces[i, point, 0] = active + passive_force_curve(m, params.tables, norm_length[point])[0]
    forces[i, point, 1] = tendon_force_curve(m, params.tables, strain[point])[0]


@wp.kernel(enable_backward=False)
def set_lengths(
    # Params:
    muscleid: int,
    optimal: float,
    slack: float,
    rigid: int,
    # In:
    mask: wp.array[bool],
    # Out:
    parameters: wp.array2d[HillMuscle],
):
    """(l_0, slack length), width and shortest fiber in proportion, in the worlds of the mask."""
    worldid = wp.tid()
    if mask[worldid]:
        m = parameters[worldid, muscleid]
        ratio = optimal / m.optimal_fiber_length
        m.optimal_fiber_length = optimal
        m.tendon_slack_length = slack
        m.fiber_width = ratio * m.fiber_width
        m.shortest_fiber = ratio * m.shortest_fiber
        m.rigid = rigid
        parameters[worldid, muscleid] = m
