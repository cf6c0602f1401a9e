"""The policy "hold": its formula, and what it does to an elbow."""

import numpy as np
import pytest

from myowarp.apps.policies import hold
from myowarp.definitions.task import TASKS
from myowarp.models.conditions.load import Load
from myowarp.models.conditions.sarcopenia import Sarcopenia
from myowarp.sim.build import oracle_model
from myowarp.sim.simulation import Simulation

ELBOW = "myoElbowPose1D6MRandom-v0"


def test_hold_excites_what_pulls_towards_the_target():
    """One joint: the flexors' excitation is gain (error - lead velocity), the extensors rest."""
    sim = Simulation(TASKS[ELBOW], 1, device="cpu", graph=False, progress=False)
    policy = hold.Hold(sim.scene)
    for error, velocity in ((0.2, 0.0), (0.3, 1.0), (-0.25, 0.5)):
        obs = np.zeros((1, 9))
        obs[0, 1], obs[0, 2] = velocity * 0.02, error
        action = policy(obs)[0].astype(float)
        excitation = 1 / (1 + np.exp(-5 * (action - 0.5)))
        drive = hold.GAIN * (error - hold.LEAD * velocity)
        pulling = np.array([False] * 3 + [True] * 3) == (drive > 0)
        np.testing.assert_allclose(excitation[pulling], abs(drive), rtol=1e-5)
        assert (action[~pulling] == -1).all()


def test_hold_holds_the_elbow():
    """Healthy, it comes near its target and stays; weak and loaded it stops short of it."""
    trials = 16
    weak, load = np.repeat([1.0, 0.3], trials), np.repeat([0.0, 3.0], trials)
    conditions = (Sarcopenia(weak), Load(load))
    sim = Simulation(TASKS[ELBOW], 2 * trials, device="cpu", conditions=conditions, progress=False)
    policy = hold.Hold(sim.scene)
    sim.reset(seeds=np.tile(np.arange(trials), 2))
    errors = [np.abs(sim.transition.obs.numpy()[:, 2])]
    for _ in range(60):
        sim.action.assign(policy(sim.transition.obs.numpy()))
        sim.step()
        errors.append(np.abs(sim.transition.obs.numpy()[:, 2]))
    start, late = errors[0].mean(), np.mean(errors[45:], axis=0)
    assert late[:trials].mean() < 0.06 < 0.2 < late[trials:].mean() < start
    assert np.std(errors[45:], axis=0)[:trials].max() < 0.02


def test_moment_arms_have_the_muscles_signs():
    arms = hold.moment_arms(oracle_model(TASKS[ELBOW]))[:, 0]
    assert (arms[:3] < -5e-3).all()
    assert (arms[3:] > 5e-3).all()


def test_hold_needs_muscles():
    sim = Simulation(TASKS["motorFingerPoseFixed-v0"], 1, device="cpu", graph=False, progress=False)
    with pytest.raises(
        ValueError,
        match=r"^policy 'hold' drives muscles; the body of task 'motorFingerPoseFixed-v0' has none$",
    ):
        hold.Hold(sim.scene)
