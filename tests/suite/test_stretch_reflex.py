"""Stretch reflexes: a swing of an arm beside OpenSim's ToyReflexController, and delays by their formula.

The recording is from `tests/data/record_opensim_reflex.py`.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import myowarp
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import place
from myowarp.tasks.from_file import from_osim

DATA = Path(__file__).parents[1] / "data"
RECORDED = np.load(DATA / "opensim/reflex.npz")
SPEED = (2.0, -9.0)
EXCITATION = 0.05
STEP, EVERY = 5e-4, 0.01
ANGLE, EXCITED = np.radians(0.5), 0.01
"""Worst errors, measured 0.34 degrees; the reflex changes angles by 42 degrees, excitations by 0.22."""


def swing(gain, delay=0.0):
    """Return angles, excitations and relative speeds of stretch in each physics step."""
    task = from_osim(DATA / "osim/arm26.osim", stops=False, far=1e6, horizon=10_000, replace=True)
    task = dataclasses.replace(task, physics_dt=STEP, num_substeps=1)
    reflex = myowarp.StretchReflex(gain=gain, delay=delay)
    sim = Simulation(task, 1, device="cpu", conditions=(reflex,), autoreset="disabled", progress=False)
    scene, muscles = sim.scene, sim.scene.muscles
    sim.reset(seeds=np.zeros(1, int))
    joints = [scene.oracle.joint(name).qposadr[0] for name in ("r_shoulder_elev", "r_elbow_flex")]
    qpos, qvel = scene.data.qpos.numpy(), np.zeros((1, scene.oracle.nv))
    qpos[0, joints], qvel[0, joints] = RECORDED["values"][0, 0], SPEED
    order = [RECORDED["muscles"].tolist().index(name) for name in muscles.names]
    muscles.activation.fill_(EXCITATION)
    place(sim, {"data.qpos": qpos, "data.qvel": qvel}, np.arange(1))
    muscles.activation.fill_(EXCITATION)
    muscles.fiber_length.assign(RECORDED["fibers"][None, order].astype(np.float32))
    sim.action.fill_(float(0.5 + np.log(EXCITATION / (1.0 - EXCITATION)) / 5.0))
    geometry = muscles.geometry()
    fastest = geometry.optimal_fiber_length[0] * geometry.max_contraction_velocity[0]
    angles, controls, stretches = [], [], []
    for _ in range(round(0.3 / STEP)):
        angles.append(scene.data.qpos.numpy()[0, joints])
        sim.step()
        controls.append(scene.data.ctrl.numpy()[0, muscles.actuator_id])
        stretches.append(np.maximum(muscles.velocity.numpy()[0] / fastest, 0.0))
    sim.close()
    return np.array(angles), np.array(controls), np.array(stretches), order


def test_a_swing_is_that_of_opensim():
    every = round(EVERY / STEP)
    count = len(RECORDED["values"][0]) - 1
    moved = np.abs(RECORDED["values"][1] - RECORDED["values"][0]).max()
    assert moved > 10 * ANGLE
    for row, gain in enumerate(RECORDED["gains"]):
        angles, controls, _, order = swing(float(gain))
        off = np.abs(angles[::every][:count] - RECORDED["values"][row][:count])
        assert off.max() < ANGLE, gain
        excitation = np.clip(RECORDED["excitation"][row][:count, order], 0.0, 1.0)
        assert np.abs(controls[::every][:count] - excitation).max() < EXCITED, gain
    assert RECORDED["excitation"][1].max() > EXCITATION + 10 * EXCITED


@pytest.mark.parametrize("steps", [1, 7])
def test_excitation_follows_the_stretch_after_a_delay(steps):
    """Of a number of physics steps; what a muscle is excited by then is in `ctrl` behind the step."""
    gain = 0.8
    _, controls, stretches, _ = swing(gain, delay=steps * STEP)
    before = np.concatenate([np.zeros((steps - 1, stretches.shape[1])), stretches])[: len(stretches)]
    np.testing.assert_allclose(controls, np.clip(EXCITATION + gain * before, 0.0, 1.0), atol=1e-6)
    assert before.max() > 0.1


@pytest.mark.parametrize("delay", [-0.1, 0.6, np.nan, "soon", True])
def test_a_delay_that_is_none_is_one_sentence(delay):
    with pytest.raises(ValueError, match=r"^stretch_reflex delay must be a time from 0 to 0\.5 s, got "):
        myowarp.StretchReflex(delay=delay)
