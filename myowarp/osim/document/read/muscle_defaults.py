"""Default parameters of OpenSim's muscle classes.

Asked of OpenSim 4.6 itself, class by class; a file states only what differs, though most state all.
Optional properties (`curviness` of a Millard curve) have no default: their class computes them.
"""

import math

from myowarp.laws.muscles import millard2012
from myowarp.laws.muscles.hill_parameters import MAX_PENNATION
from myowarp.osim.document.functions import SimmSpline

FORCE_LENGTH = SimmSpline(
    (-5.0, 0.998, 0.999, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.601, 1.602, 5.0),
    (0.0, 0.0, 0.0, 0.0, 0.035, 0.12, 0.26, 0.55, 1.17, 2.0, 2.0, 2.0, 2.0),
)
"""Of a ligament, over length / resting length; of fibers of spline muscles, over fiber length."""

MILLARD_CURVES = {
    name: default for name, (_, default, *_) in millard2012.PARAMETERS.items() if not math.isnan(default)
}
"""Parameters of the curves for which the law has a default; OpenSim computes the others itself."""

DEFAULTS: dict[str, dict[str, float]] = {
    "Thelen2003Muscle": {
        "min_control": 0.01,
        "default_activation": 0.05,
        "default_fiber_length": 0.1,
        "FmaxTendonStrain": 0.04,
        "FmaxMuscleStrain": 0.6,
        "KshapeActive": 0.45,
        "KshapePassive": 5.0,
        "Af": 0.25,
        "Flen": 1.4,
        "fv_linear_extrap_threshold": 0.95,
        "maximum_pennation_angle": MAX_PENNATION,
        "activation_time_constant": 0.015,
        "deactivation_time_constant": 0.05,
        "minimum_activation": 0.01,
    },
    "Millard2012EquilibriumMuscle": {
        "min_control": 0.01,
        "fiber_damping": 0.1,
        "default_activation": 0.05,
        "default_fiber_length": 0.1,
        "activation_time_constant": 0.01,
        "deactivation_time_constant": 0.04,
        "minimum_activation": 0.01,
        "maximum_pennation_angle": MAX_PENNATION,
        **MILLARD_CURVES,
    },
    "DeGrooteFregly2016Muscle": {
        "min_control": 0.0,
        "activation_time_constant": 0.015,
        "deactivation_time_constant": 0.06,
        "default_activation": 0.5,
        "default_normalized_tendon_force": 0.5,
        "active_force_width_scale": 1.0,
        "fiber_damping": 0.0,
        "passive_fiber_strain_at_one_norm_force": 0.6,
        "tendon_strain_at_one_norm_force": 0.049,
        "ignore_passive_fiber_force": 0.0,
        "activation_dynamics_smoothing": 0.1,
    },
    "Millard2012AccelerationMuscle": {
        "min_control": 0.0,
        "default_activation": 0.0,
        "default_fiber_length": 0.1,
        "MuscleFirstOrderActivationDynamicModel.activation_time_constant": 0.01,
        "MuscleFirstOrderActivationDynamicModel.deactivation_time_constant": 0.04,
        "fiber_damping": 0.01,
        **MILLARD_CURVES,
    },
    "MeyerFregly2016Muscle": {
        "min_control": 0.0,
        "activation_time_constant": 0.015,
        "deactivation_time_constant": 0.06,
        "default_activation": 0.5,
        "active_force_width_scale": 1.0,
        "fiber_damping": 0.0,
        "ignore_passive_fiber_force": 0.0,
        "activation_dynamics_smoothing": 0.1,
    },
    "RigidTendonMuscle": {"min_control": 0.0},
    "Schutte1993Muscle_Deprecated": {
        "min_control": 0.0,
        "time_scale": 0.1,
        "activation1": 7.667,
        "activation2": 1.45985,
        "damping": 0.1,
    },
    "Delp1990Muscle_Deprecated": {
        "min_control": 0.0,
        "time_scale": 0.1,
        "activation1": 7.667,
        "activation2": 1.45985,
        "mass": 0.00287,
    },
    "Thelen2003Muscle_Deprecated": {
        "min_control": 0.0,
        "activation_time_constant": 0.01,
        "deactivation_time_constant": 0.04,
        "Vmax": 10.0,
        "Vmax0": 5.0,
        "FmaxTendonStrain": 0.033,
        "FmaxMuscleStrain": 0.6,
        "KshapeActive": 0.5,
        "KshapePassive": 4.0,
        "damping": 0.05,
        "Af": 0.3,
        "Flen": 1.8,
    },
}
"""Class: parameter: default, under the names of `Muscle.parameters`; `min_control` is the excitation's."""
