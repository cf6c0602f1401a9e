"""OpenSim's own muscle bench, in the engine, against OpenSim 4.6 (data/record_opensim_bench.py).

A mass that hangs from one muscle, a ball that it pulls, and a path that is prescribed.
"""

import numpy as np
import pytest
from muscle_bench import PEAK, RECORDED, SCENES, deviations, swing, unbalanced

from myowarp.definitions.muscle import MUSCLES
from myowarp.models.muscles.hill import Hill

HILL = [name for name in MUSCLES if issubclass(MUSCLES[name], Hill)]

EQUILIBRIUM = 2e-5
"""Of the peak: OpenSim's force at the start, in float32."""

TRAJECTORY = {0.0005: 0.003, 0.001: 0.005, 0.002: 0.01, 0.005: 0.02}
"""Of the range of the motion, by time step."""

FORCE = {0.0005: 0.001, 0.001: 0.002, 0.002: 0.0035, 0.005: 0.01}
"""RMS, of the peak."""

WORK = {"hanging": 0.75, "ball": 12.0}
"""Times the time step [1/s]: velocities are half a step old."""

FELT = {"hanging": 5.0, "ball": 25.0}
"""Times the square of the time step [1/s^2]: velocities at the times of positions, and the force as felt."""

ROUNDING = 2e-5
"""Of float32, in the same."""

STEPS = 0.0005, 0.001, 0.002, 0.005
QUICK = "hanging", 0.002
"""The scene and the time step that `make test` runs."""

CASES = [
    pytest.param(case, dt, marks=() if (case.split()[0], dt) == QUICK else pytest.mark.slow)
    for case in RECORDED
    for dt in STEPS
]


@pytest.mark.parametrize(("case", "dt"), CASES)
def test_moves_as_in_opensim(tmp_path, case, dt):
    """And the work of the muscle is the change of energy, as states are and at the times between."""
    position, _, force = RECORDED[case].T[:, :-1]
    motion = swing(tmp_path, case, dt)
    off, rms = deviations(case, dt, motion)
    assert np.ptp(position) > 0.014
    assert abs(motion.tension[0] - force[0]) / PEAK < EQUILIBRIUM
    assert off < TRAJECTORY[dt]
    assert rms < FORCE[dt]
    scene = case.split()[0]
    if scene != "sine":
        assert unbalanced(scene, motion) < WORK[scene] * dt
        assert unbalanced(scene, motion.between()) < FELT[scene] * dt**2 + ROUNDING


@pytest.mark.parametrize("name", HILL)
def test_a_light_body_comes_to_rest(tmp_path, name):
    """Beside its mass of 10 g the muscle is so stiff that half of its derivative would not hold it."""
    motion = swing(tmp_path, f"light {name} 0", 0.005, like="hanging millard2012 0")
    spring = SCENES["light"].spring
    assert np.abs(motion.tension).max() < PEAK
    assert np.abs(motion.velocity).max() < 2.0
    assert abs(motion.tension[-1] - spring * (0.42 - motion.position[-1])) < 0.01 * PEAK
    assert motion.tension[-1] > 0.2 * PEAK
