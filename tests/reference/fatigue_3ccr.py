"""3CC-r in float64 NumPy, written from the papers, not from our kernels.

Sources: Xia, Frey Law (2008), doi:10.1016/j.jbiomech.2008.07.013, eq. 1-4: dM_R/dt = -C + R M_F,
dM_A/dt = C - F M_A, dM_F/dt = F M_A - R M_F, with C = L_D (TL - M_A) if M_A < TL and M_R > TL - M_A,
L_D M_R if M_A < TL and M_R <= TL - M_A, and L_R (TL - M_A) if M_A >= TL. Looft, Herkert, Frey-Law (2018),
doi:10.1016/j.jbiomech.2018.06.005: R is r R at rest. L_D and L_R are the rates of the muscle's activation,
L_D = 1 / (tau_act (0.5 + 1.5 M_A)) and L_R = (0.5 + 1.5 M_A) / tau_deact, integrated exactly over the step
as in MyoSuite 3.0.0, which also limits C so that the compartments stay in 0..1 and takes TL <= 0.01 as rest.

All three compartments are integrated, each on its own. Arguments are arrays that broadcast.
"""

import numpy as np

REST_LOAD = 0.01


def flow_bounds(active, resting, fatigued, fatigue_rate, recovery_rate, dt):
    """Least and greatest C [1/s] with which no compartment leaves 0..1 in a step."""
    least_active = -active / dt + fatigue_rate * active
    least_resting = (resting - 1.0) / dt + recovery_rate * fatigued
    most_active = (1.0 - active) / dt + fatigue_rate * active
    most_resting = resting / dt + recovery_rate * fatigued
    return np.maximum(least_active, least_resting), np.minimum(most_active, most_resting)


def flow(active, resting, target_load, tau_act, tau_deact, dt):
    """C [1/s] before it is limited."""
    speed = 0.5 + 1.5 * active
    develop = (1.0 - np.exp(-dt / (tau_act * speed))) / dt
    relax = (1.0 - np.exp(-dt * speed / tau_deact)) / dt
    missing = target_load - active
    enough = resting > missing
    return np.select(
        [(missing > 0) & enough, (missing > 0) & ~enough],
        [develop * missing, develop * resting],
        relax * missing,
    )


def step(state, target_load, rates, time_constants, dt):
    """Return (M_A, M_R, M_F) after one step; rates are (F, R, r), time constants (tau_act, tau_deact)."""
    active, resting, fatigued = state
    fatigue_rate, recovery_rate, rest_recovery_factor = rates
    recovery_rate = recovery_rate * np.where(target_load <= REST_LOAD, rest_recovery_factor, 1.0)
    low, high = flow_bounds(active, resting, fatigued, fatigue_rate, recovery_rate, dt)
    c = flow(active, resting, target_load, *time_constants, dt)
    c = np.minimum(np.maximum(c, low), high)
    return (
        active + dt * (c - fatigue_rate * active),
        resting + dt * (-c + recovery_rate * fatigued),
        fatigued + dt * (fatigue_rate * active - recovery_rate * fatigued),
    )
