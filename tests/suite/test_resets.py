"""What episodes start from: the task's start, or where the last one ended. Random ones: test_starts.py."""

import numpy as np
import pytest
from often import of_each

from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation
from myowarp.sim.starts import posture_joints

SCENES = sorted({TASKS[key].scene_key: key for key in TASKS if "Random" in key or "P2" in key}.values())
NUM_WORLDS = 24
FLOAT32 = 1e-6  # rad, rounding of joint angles


def simulation(key, reset, **options):
    settings = {"device": "cpu", "graph": False, "progress": False, "autoreset": "same_step"} | options
    sim = Simulation(TASKS[key], NUM_WORLDS, shards=1, reset=reset, **settings)
    sim.reset(seeds=np.arange(NUM_WORLDS))
    return sim


@pytest.mark.parametrize("key", of_each(SCENES))
def test_fixed(key):
    """Every world starts in the task's start posture."""
    sim = simulation(key, "fixed")
    address = sim.scene.oracle.jnt_qposadr[posture_joints(sim.scene.oracle)]
    start = TASKS[key].start(sim.scene.oracle)[address]
    np.testing.assert_allclose(
        sim.scene.data.qpos.numpy()[:, address], np.tile(start, (NUM_WORLDS, 1)), atol=FLOAT32
    )


@pytest.mark.parametrize("key", of_each(SCENES))
def test_none_carries_the_state_over(key):
    """Ends of episodes leave the mechanics alone, bit for bit; goals and counters are new."""
    free, short = simulation(key, "none", horizon=1000), simulation(key, "none", horizon=3)
    fixed = simulation(key, "fixed", horizon=3)
    rng = np.random.default_rng(0)
    ended = np.zeros(NUM_WORLDS, dtype=bool)
    for step in range(4):
        action = rng.uniform(-1, 1, free.action.shape).astype(np.float32)
        for sim in (free, short, fixed):
            sim.action.assign(action)
            sim.step()
        ended |= short.transition.terminated.numpy() | free.transition.terminated.numpy()
        if step == 2:
            assert short.transition.truncated.numpy().all()
            assert not short.episode.step_count.numpy().any()
            assert (short.scene.keys.episode.numpy() == 2).all()
    same = ~ended
    assert same.any()
    for name in ("qpos", "qvel"):
        carried, whole = (getattr(sim.scene.data, name).numpy()[same] for sim in (short, free))
        np.testing.assert_array_equal(carried, whole)
    activations = (sim.scene.muscles.activation.numpy()[same] for sim in (short, free))
    np.testing.assert_array_equal(*activations)
    assert not np.array_equal(fixed.scene.data.qpos.numpy()[same], free.scene.data.qpos.numpy()[same])


def test_none_still_resets_a_broken_world():
    sim = simulation("myoElbowPose1D6MRandom-v0", "none")
    sim.scene.data.qvel.numpy()[3] = np.nan
    sim.step()
    assert sim.transition.fault.numpy()[3]
    assert sim.scene.data.qvel.numpy()[3] == 0
    assert np.isfinite(sim.scene.data.qpos.numpy()).all()
    assert np.abs(sim.scene.data.qvel.numpy()[np.arange(NUM_WORLDS) != 3]).min() > 0


def test_unknown_reset_is_refused():
    with pytest.raises(ValueError, match=r"^reset 'never' unknown; available: task, fixed, random, none$"):
        simulation("myoElbowPose1D6MRandom-v0", "never")
