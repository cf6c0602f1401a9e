"""Metabolic rate of a muscle: heat and work of its fibers, after Bhargava 2004 and Umberger 2010.

    rate = max(activation + maintenance + shortening heat, 1 W/kg) + work

Both laws take what any muscle model knows of its fibers, in float32 or float64. They are those of OpenSim
4.6's probes, equal to 1e-12 in float64. Fiber velocity is negative while fibers shorten. Where heat and work
would be negative together, the shortening heat is raised until they are 0 (`forbid_negative_total_power`
there). A body has a basal rate besides.

Sources: Bhargava, Pandy, Anderson (2004), J Biomech 37:81, doi:10.1016/S0021-9290(03)00239-2; Umberger,
Gerritsen, Martin (2003), Comput Methods Biomech Biomed Engin 6:99, doi:10.1080/1025584031000091678; Umberger
(2010), J R Soc Interface 7:1329, doi:10.1098/rsif.2010.0084. Slow fibers are recruited first in both, as
Bhargava has it.
"""

from typing import Any

import warp as wp

BASAL_RATE = 1.2  # W/kg of the whole body
SPECIFIC_TENSION = 0.25e6  # Pa
DENSITY = 1059.7  # kg/m^3


def muscle_mass(max_isometric_force: Any, optimal_fiber_length: Any) -> Any:
    """Return masses of muscles [kg]: cross section times density times optimal fiber length.

    Args:
        max_isometric_force: Peak active force [N], a number or an array.
        optimal_fiber_length: Fiber length at which it is reached [m], likewise.
    """
    return max_isometric_force / SPECIFIC_TENSION * DENSITY * optimal_fiber_length


@wp.func
def recruited(excitation: Any, slow_twitch_ratio: Any):
    """slow = r sin(pi u / 2), fast = (1 - r) (1 - cos(pi u / 2)): recruited shares of all fibers."""
    quarter = type(excitation)(wp.half_pi) * excitation
    one = type(excitation)(1.0)
    return slow_twitch_ratio * wp.sin(quarter), (one - slow_twitch_ratio) * (one - wp.cos(quarter))


@wp.func
def nonnegative(steady: Any, shortening: Any, work: Any, muscle_mass: Any):
    """heat = max(steady + shortening', m 1 W/kg), with shortening' such that heat + work >= 0; and work."""
    debt = wp.min(steady + shortening + work, type(work)(0.0))
    return wp.max(steady + shortening - debt, muscle_mass), work


@wp.func
def bhargava2004(
    muscle_mass: Any,
    slow_twitch_ratio: Any,
    excitation: Any,
    norm_fiber_length: Any,
    fiber_velocity: Any,
    active_fiber_force: Any,
    fiber_force: Any,
):
    """A = m (40 slow + 133 fast); M = m g(n) (74 slow + 111 fast); S = -0.25 F v; W = -F_a v [W].

    g rises from 0.5 at n <= 0.5 to 1 at n = 1 and falls to 0 at n = 1.5; S is 0 while fibers lengthen.

    Args:
        muscle_mass: m [kg].
        slow_twitch_ratio: Share of slow fibers [1].
        excitation: u [1].
        norm_fiber_length: n, fiber length over its optimum [1].
        fiber_velocity: v [m/s], lengthening > 0.
        active_fiber_force: F_a along the fibers [N].
        fiber_force: F, active and passive, along the fibers [N].

    Returns:
        Heat and work [W].
    """
    u = excitation
    slow, fast = recruited(excitation, slow_twitch_ratio)
    activation = type(u)(40.0) * slow + type(u)(133.0) * fast
    maintenance = type(u)(74.0) * slow + type(u)(111.0) * fast
    falling = type(u)(3.0) - type(u)(2.0) * norm_fiber_length
    share = wp.max(wp.min(wp.max(norm_fiber_length, type(u)(0.5)), falling), type(u)(0.0))
    shortening = type(u)(0.25) * fiber_force * wp.max(-fiber_velocity, type(u)(0.0))
    steady = muscle_mass * (activation + share * maintenance)
    return nonnegative(steady, shortening, -active_fiber_force * fiber_velocity, muscle_mass)


@wp.func
def umberger2010(
    muscle_mass: Any,
    slow_twitch_ratio: Any,
    excitation: Any,
    activation: Any,
    norm_fiber_length: Any,
    active_force_length: Any,
    norm_fiber_velocity: Any,
    max_contraction_velocity: Any,
    active_fiber_power: Any,
    aerobic_factor: Any,
):
    """AM = k A^0.6 (128 (1 - s) + 25), S = -k A^2 (...) v or k A (...) v [W/kg]; W = -F_a v [W].

    s is the slow share of the recruited fibers; A = u while activation rises, else (u + a) / 2. While fibers
    shorten, S has 100 v / (v_max / 2.5) of the slow ones, at most 100, and 153 v / v_max of the fast ones;
    while they lengthen, four times the slow coefficient. Beyond the optimal length 0.6 of AM and all of S
    scale with the active force-length curve.

    Args:
        muscle_mass: m [kg].
        slow_twitch_ratio: Share of slow fibers [1].
        excitation: u [1].
        activation: a [1].
        norm_fiber_length: n, fiber length over its optimum [1].
        active_force_length: Multiplier of the active force at n [1].
        norm_fiber_velocity: v [optimal fiber lengths / s], lengthening > 0.
        max_contraction_velocity: v_max [optimal fiber lengths / s].
        active_fiber_power: -F_a v [W], > 0 while fibers shorten under tension.
        aerobic_factor: k, 1.5 with the heat of recovery, 1 without it.

    Returns:
        Heat and work [W].
    """
    u = excitation
    zero = type(u)(0.0)
    one = type(u)(1.0)
    slow, fast = recruited(excitation, slow_twitch_ratio)
    share = one
    if excitation > zero:
        share = slow / (slow + fast)
    level = wp.where(excitation > activation, excitation, type(u)(0.5) * (excitation + activation))
    steady = aerobic_factor * wp.pow(level, type(u)(0.6)) * (type(u)(128.0) * (one - share) + type(u)(25.0))
    per_slow = type(u)(250.0) / max_contraction_velocity
    per_fast = type(u)(153.0) / max_contraction_velocity
    shortening = type(u)(4.0) * level * per_slow * norm_fiber_velocity
    if norm_fiber_velocity <= zero:
        of_slow = wp.min(-per_slow * norm_fiber_velocity, type(u)(100.0)) * share
        of_fast = -per_fast * norm_fiber_velocity * (one - share)
        shortening = level * level * (of_slow + of_fast)
    if norm_fiber_length > one:
        steady *= type(u)(0.4) + type(u)(0.6) * active_force_length
        shortening *= active_force_length
    shortening *= aerobic_factor
    return nonnegative(muscle_mass * steady, muscle_mass * shortening, active_fiber_power, muscle_mass)
