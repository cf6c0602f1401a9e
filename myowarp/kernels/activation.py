"""Excitation to activation: first-order dynamics, faster up than down.

Source: Millard, Uchida, Seth, Delp (2013), doi:10.1115/1.4023390, eq. 1-2, in MuJoCo's form (MuJoCo
documentation, *Modeling, Actuators, Muscles*), which adds an optional smooth switch between the two
time constants. The arithmetic is in activation.cpp, for other native functions: put `ACTIVATION` before their
source.
"""

from pathlib import Path

import warp as wp

ACTIVATION = Path(__file__).with_suffix(".cpp").read_text()


@wp.func_native(ACTIVATION + "return activation_rate(excitation, activation, tau_act, tau_deact, width);")
def activation_rate(
    excitation: float, activation: float, tau_act: float, tau_deact: float, width: float
) -> float:
    """Return da/dt = (u - a) / tau(u, a) [1/s].

    tau = tau_act (0.5 + 1.5 a) where u > a, tau_deact / (0.5 + 1.5 a) otherwise [s]; over a `width` of u - a
    the switch is a smooth quintic step, 0 switches hard.
    """
    ...


@wp.func_native(ACTIVATION + "return activation_after(time, excitation, activation, tau_act, tau_deact);")
def activation_after(
    time: float, excitation: float, activation: float, tau_act: float, tau_deact: float
) -> float:
    """Return a(t) where the excitation is constant: `activation_rate` solved, with the hard switch.

    The switch never turns, since a approaches u from one side. With c = 0.5 + 1.5 u and w = |u - a|, rising:
    c ln(w / w_0) - 1.5 (w - w_0) = -t / tau_act, solved by Halley's method;
    falling: w / (c + 1.5 w) = w_0 / (c + 1.5 w_0) exp(-c t / tau_deact).
    """
    ...
