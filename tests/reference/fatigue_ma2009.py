"""Fatigue of Ma et al. in float64 NumPy, written from the papers, not from our kernels.

Source: Caggiano et al. (2022), arXiv:2205.13600: F_upd(t) = F_max exp(-k int_0^t F_act / F_max du), with
F_act the active force, whose peak is F_upd. `peak_force_left` integrates that as it stands, in small steps;
`closed_form` is its solution at a constant normalized force c = F_act / F_upd = a f_L f_V.
"""

import numpy as np


def peak_force_left(norm_force, rate, dt, initial=0.0):
    """F_upd / F_max after every step, from a f_L f_V [1] in each, shape (steps, ...); rate in 1/s.

    Each step is one of the classical Runge-Kutta scheme in the exponent s = k int F_act / F_max du.
    """
    exponent = -np.log(1.0 - np.asarray(initial, dtype=np.float64)) + np.zeros(np.shape(norm_force)[1:])
    left = []
    for c in np.asarray(norm_force, dtype=np.float64):

        def slope(s, c=c):
            return rate * c * np.exp(-s)

        k1 = slope(exponent)
        k2 = slope(exponent + dt / 2 * k1)
        k3 = slope(exponent + dt / 2 * k2)
        k4 = slope(exponent + dt * k3)
        exponent = exponent + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        left.append(np.exp(-exponent))
    return np.array(left)


def closed_form(norm_force, rate, time, initial=0.0):
    """F_upd / F_max at a time [s] under a constant a f_L f_V: 1 / (1 / (1 - f_0) + k c t)."""
    return 1.0 / (1.0 / (1.0 - initial) + rate * norm_force * time)
