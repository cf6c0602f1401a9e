"""Faults of capacity, counting of success, physics presets: what the contract tests do not cover."""

import numpy as np
import pytest

from myowarp.definitions.scene import Capacity
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.kernels.episode import FAULTS
from myowarp.sim import build as scene_module
from myowarp.sim.simulation import Simulation

ROWS_FAULT = next(bit for bit, text in FAULTS.items() if "rows" in text)
ACTION_FAULT = next(bit for bit, text in FAULTS.items() if "action" in text)
FAST_ERROR = (1e-5, 0.05)  # rad after one control step: other than parity, and close to it


def test_too_few_rows_is_a_fault_of_that_world(monkeypatch):
    """A finger pushed into several limits at once needs more than one row; a resting one does not."""
    monkeypatch.setattr(
        scene_module, "calibrate", lambda model, start, least: Capacity(contacts=16, rows=1, peak_contacts=0)
    )
    sim = Simulation(TASKS["myoFingerPoseFixed-v0"], 2, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(2))
    qpos = sim.scene.data.qpos.numpy()
    qpos[0] = sim.scene.oracle.jnt_range[:, 1] + 0.05
    qpos[1] = sim.scene.oracle.jnt_range.mean(axis=1)
    sim.action.fill_(-1.0)
    sim.step()
    fault = sim.transition.fault.numpy()
    assert fault[0] & ROWS_FAULT
    assert sim.transition.terminated.numpy()[0]
    assert fault[1] == 0
    assert not sim.transition.terminated.numpy()[1]


def test_action_that_is_not_finite_is_a_fault_of_that_world():
    sim = Simulation(TASKS["myoElbowPose1D6MFixed-v0"], 3, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.arange(3))
    action = np.zeros(sim.action.shape, dtype=np.float32)
    action[1, 2] = np.inf
    sim.action.assign(action)
    sim.step()
    np.testing.assert_array_equal(sim.transition.fault.numpy(), [0, ACTION_FAULT, 0])


def test_success_needs_more_than_five_solved_steps():
    """The elbow held at its target: solved from the first step, a success from the sixth."""
    sim = Simulation(TASKS["myoElbowPose1D6MFixed-v0"], 1, device="cpu", graph=False, progress=False)
    sim.reset(seeds=np.zeros(1, dtype=int))
    solved, success = [], []
    for _ in range(8):
        sim.scene.data.qpos.assign(sim.shards[0].program.target.numpy())
        sim.scene.data.qvel.zero_()
        sim.action.fill_(-1.0)
        sim.step()
        solved.append(bool(sim.transition.solved.numpy()[0]))
        success.append(bool(sim.transition.success.numpy()[0]))
    assert all(solved)
    assert success == [False] * 5 + [True] * 3


@pytest.mark.parametrize("key", ["myoHandPoseFixed-v0", "motorFingerPoseFixed-v0"])
def test_presets_cover_the_same_time(key):
    """`fast` takes fewer substeps, implicitly, and arrives nearly where `parity` does."""
    states = {}
    for physics in PHYSICS:
        sim = Simulation(TASKS[key], 4, device="cpu", graph=False, progress=False, physics=physics)
        sim.reset(seeds=np.arange(4))
        sim.action.assign(np.random.default_rng(0).uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
        elapsed = sim.scene.num_substeps * sim.scene.model.opt.timestep.numpy()[0]
        assert elapsed == pytest.approx(TASKS[key].control_dt, rel=1e-6)
        np.testing.assert_allclose(sim.scene.data.time.numpy(), TASKS[key].control_dt, rtol=1e-5)
        states[physics] = sim.scene.data.qpos.numpy().copy(), sim.scene.num_substeps
    assert states["fast"][1] < 0.7 * states["parity"][1]
    difference = np.abs(states["fast"][0] - states["parity"][0]).max()
    assert FAST_ERROR[0] < difference < FAST_ERROR[1]
