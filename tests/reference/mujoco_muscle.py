"""MuJoCo's muscle in float64 NumPy, written from its documentation, not from our kernels.

Source: MuJoCo documentation, *Modeling, Muscles* (lengths, curves, peak force), *Computation,
Activation dynamics* (time constants) and *XML reference, actuator/muscle* (`tausmooth`). One point
follows the implementation: the documented passive curve is cubic and passes through fpmax at lmax,
the function `mju_muscleBias` is quadratic and passes through 1.5 fpmax there; MuJoCo computes the
latter. `tests/suite/test_curves.py` compares every function here with MuJoCo's own.

Array arguments broadcast; parameter rows `prm` are (range0, range1, force, scale, lmin, lmax, vmax,
fpmax, fvmax), as in `gainprm` and `biasprm`.
"""

import numpy as np


def force_length(length, lmin, lmax):
    """Bump: 0 outside (lmin, lmax), 1 at 1, quadratic splines that meet half way."""
    length = np.asarray(length, dtype=np.float64)
    rise, fall = (lmin + 1.0) / 2.0, (1.0 + lmax) / 2.0
    pieces = [
        (length > lmin) & (length < rise),
        (length >= rise) & (length < 1.0),
        (length >= 1.0) & (length < fall),
        (length >= fall) & (length < lmax),
    ]
    values = [
        0.5 * ((length - lmin) / (rise - lmin)) ** 2,
        1.0 - 0.5 * ((1.0 - length) / (1.0 - rise)) ** 2,
        1.0 - 0.5 * ((length - 1.0) / (fall - 1.0)) ** 2,
        0.5 * ((lmax - length) / (lmax - fall)) ** 2,
    ]
    return np.select(pieces, values, 0.0)


def force_velocity(velocity, fvmax):
    """0 up to -1, parabola to 1 at 0, parabola to fvmax at fvmax - 1, constant beyond."""
    velocity = np.asarray(velocity, dtype=np.float64)
    c = np.asarray(fvmax - 1.0)
    pieces = [velocity <= -1.0, velocity <= 0.0, velocity <= c]
    width = np.where(c > 0.0, c, 1.0)  # without an eccentric branch the last piece is never used
    values = [0.0, (velocity + 1.0) ** 2, fvmax - (c - velocity) ** 2 / width]
    return np.select(pieces, values, fvmax)


def passive_force(length, lmax, fpmax):
    """0 up to 1, half a parabola to fpmax / 2 at (1 + lmax) / 2, its tangent beyond."""
    length = np.asarray(length, dtype=np.float64)
    half_way = (1.0 + lmax) / 2.0
    x = (length - 1.0) / (half_way - 1.0)
    beyond = (length - half_way) / (half_way - 1.0)
    return fpmax * np.select([length <= 1.0, length <= half_way], [0.0, 0.5 * x**2], 0.5 + beyond)


def activation_rate(ctrl, act, tau_act, tau_deact, smoothing_width=0.0):
    """da/dt = (u - a) / tau [1/s], u = ctrl within [0, 1]."""
    act = np.asarray(act, dtype=np.float64)
    difference = np.clip(ctrl, 0.0, 1.0) - act
    scale = 0.5 + 1.5 * np.clip(act, 0.0, 1.0)
    rising, falling = tau_act * scale, tau_deact / scale
    width = np.broadcast_to(np.asarray(smoothing_width, dtype=np.float64), difference.shape)
    hard = width == 0.0
    x = np.clip(difference / np.where(hard, 1.0, width) + 0.5, 0.0, 1.0)
    weight = np.where(hard, difference > 0.0, 6.0 * x**5 - 15.0 * x**4 + 10.0 * x**3)
    return difference / (falling + weight * (rising - falling))


def activation_after(time, ctrl, act, tau_act, tau_deact):
    """Activation after a time [s] of constant excitation: `activation_rate` solved, hard switch.

    With w = u - a and c = 0.5 + 1.5 u separation of variables gives, where u > a, c ln(w / w_0) -
    1.5 (w - w_0) = -t / tau_act, here solved by Newton for ln(w / w_0); otherwise, with y = -w,
    y / (c + 1.5 y) = y_0 / (c + 1.5 y_0) exp(-c t / tau_deact).
    """
    excitation, act = np.clip(ctrl, 0.0, 1.0), np.asarray(act, dtype=np.float64)
    c = 0.5 + 1.5 * excitation
    rise, fall = np.maximum(excitation - act, 0.0), np.maximum(act - excitation, 0.0)
    x = np.zeros(np.broadcast(time, rise).shape)
    for _ in range(30):
        x -= (c * x - 1.5 * rise * np.expm1(x) + time / tau_act) / (c - 1.5 * rise * np.exp(x))
    part = fall / (c + 1.5 * fall) * np.exp(-c * time / tau_deact)
    return np.where(
        excitation > act, excitation - rise * np.exp(x), excitation + c * part / (1.0 - 1.5 * part)
    )


def peak_force(acc0, prm):
    """Peak force [N]: the third parameter, or scale / acc0 where it is negative."""
    return np.where(prm[..., 2] < 0.0, prm[..., 3] / acc0, prm[..., 2])


def operating_length(lengthrange, prm):
    """L_0 and L_T [m]: the length range over L_0 is the parameter range after L_T is taken off."""
    optimal = (lengthrange[..., 1] - lengthrange[..., 0]) / (prm[..., 1] - prm[..., 0])
    return optimal, lengthrange[..., 0] - prm[..., 0] * optimal


def gain(length, velocity, lengthrange, acc0, prm):
    """Active force of a fully activated muscle [N], negative: a muscle pulls."""
    optimal, slack = operating_length(lengthrange, prm)
    norm_velocity = velocity / (optimal * prm[..., 6])
    flv = force_length((length - slack) / optimal, prm[..., 4], prm[..., 5])
    return -peak_force(acc0, prm) * flv * force_velocity(norm_velocity, prm[..., 8])


def bias(length, lengthrange, acc0, prm):
    """Passive force [N], negative."""
    optimal, slack = operating_length(lengthrange, prm)
    return -peak_force(acc0, prm) * passive_force((length - slack) / optimal, prm[..., 5], prm[..., 7])
