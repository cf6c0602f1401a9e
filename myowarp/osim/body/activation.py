"""Activation dynamics of OpenSim's muscles as MuJoCo's: `dynprm` = (time constants up and down, smoothing).

MuJoCo's muscle follows Thelen and Millard exactly, da/dt = (u - a) / tau with tau = tau_up (0.5 + 1.5 a)
rising and tau_down / (0.5 + 1.5 a) falling, but for OpenSim's floor on the activation (0.01 by default),
which MuJoCo does not have. De Groote's blend of both rates and Schutte's rates are approximated.
"""

import math

import numpy as np

from myowarp.osim.body.hill_muscle import HillMuscle
from myowarp.osim.document.model import Note

SWITCH_SLOPE = 1.875
"""Slope of MuJoCo's quintic switch per width, at its middle."""


def activation_dynamics(muscle: HillMuscle) -> tuple[tuple[float, float, float] | None, tuple[Note, ...]]:
    """Return MuJoCo's `dynprm` [s, s, 1], None where activation equals excitation, and what is not exact."""
    v = muscle.values
    if v["ignore_activation_dynamics"] or muscle.kind == "RigidTendonMuscle":
        return None, ()
    if muscle.kind == "DeGrooteFregly2016Muscle":
        return _blended_rates(muscle)
    if "time_scale" in v:
        half_way = 0.5 + 1.5 * 0.5
        up = v["time_scale"] / (v["activation1"] + v["activation2"]) / half_way
        down = v["time_scale"] / v["activation2"] * half_way
        rule = "the activation's rate under full or no excitation is matched at activation 0.5"
        note = Note(muscle.name, rule, f"factor {half_way / 0.5:.1f} in the rate, at activation 0")
        return (up, down, 0.0), (note,)
    nested = (
        "MuscleFirstOrderActivationDynamicModel." if muscle.kind == "Millard2012AccelerationMuscle" else ""
    )
    return (v[f"{nested}activation_time_constant"], v[f"{nested}deactivation_time_constant"], 0.0), ()


def _blended_rates(muscle: HillMuscle) -> tuple[tuple[float, float, float], tuple[Note, ...]]:
    """Fit tau = (tau_up z + tau_down / z) / 2 to De Groote's 2 / tau = 1 / (t_up z) + z / t_down.

    Both classes switch around u = a over a width far above 1, so that they hardly leave the middle.
    """
    v = muscle.values
    steepness = v.get("activation_dynamics_smoothing", 0.1)
    z = 0.5 + 1.5 * np.linspace(0.0, 1.0, 21)
    tau = 2.0 / (1.0 / (v["activation_time_constant"] * z) + z / v["deactivation_time_constant"])
    basis = np.array([z / 2.0, 0.5 / z]).T / tau[:, None]
    constants = np.maximum(np.linalg.lstsq(basis, np.ones_like(z))[0], 1e-4)
    off = float(np.abs(basis @ constants - 1.0).max())
    rule = "the blend of activation rates is replaced by MuJoCo's blend of time constants"
    note = Note(muscle.name, rule, f"{100 * off:.0f} % of the time constant, midway between the two rates")
    width = SWITCH_SLOPE / (0.5 * steepness) if steepness > 0.0 else math.inf
    return (float(constants[0]), float(constants[1]), width), (note,)
