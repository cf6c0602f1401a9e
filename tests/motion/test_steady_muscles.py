"""Muscles held steady on the device against the NumPy laws, which are OpenSim's to 1e-8."""

from dataclasses import replace

import numpy as np
import opensim_muscles
import pytest

from myowarp.motion.steady_muscles import SteadyMuscles
from myowarp.opensim.muscle.spline_tables import SPLINES

TABLES = 5e-6
"""Share of the maximum isometric force: Millard's curves are tables on the device."""


@pytest.mark.parametrize("name", ["variants", "arm26"])
def test_the_same_as_in_numpy(name):
    """Elastic and rigid tendons, slack ones, and fibers at their shortest; each frame has its own factor."""
    muscles = opensim_muscles.load(name)[1]
    splines = "Delp1990Muscle_Deprecated"
    muscles.append(replace(muscles[0], name="splines", kind=splines, functions=SPLINES[splines]))
    steady, random = SteadyMuscles(muscles), np.random.default_rng(1)
    values = [muscle.values for muscle in steady.muscles]
    optimal, slack = (
        np.array([v[n] for v in values]) for n in ("optimal_fiber_length", "tendon_slack_length")
    )
    shape = (33, len(values))
    length = slack + optimal * random.uniform(0.2, 1.5, shape)
    velocity = optimal * random.uniform(-6.0, 6.0, shape)
    activation, factor = random.uniform(0.0, 1.0, shape), random.uniform(0.95, 1.05, shape)
    force, along = steady.at(activation, length, velocity, factor)
    bare, _ = steady.at(activation, length, velocity)
    for k, muscle in enumerate(steady.muscles):
        own = factor[:, k] * slack[k]
        z, wanted = muscle.steady(activation[:, k], length[:, k], velocity[:, k], own)
        most = muscle.values["max_isometric_force"]
        np.testing.assert_allclose(force[:, k] / most, wanted, atol=TABLES, err_msg=muscle.name)
        np.testing.assert_allclose(along[:, k], z, atol=1e-5 * optimal[k], err_msg=muscle.name)
    strength = np.array([v["max_isometric_force"] for v in values])
    assert (np.abs(force - bare) / strength).max() > 100 * TABLES, "the slack length matters"
