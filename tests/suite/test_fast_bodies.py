"""Bodies whose joints follow others, under `fast`: exactly, and as near to fine steps as it is said."""

import numpy as np
import pytest

from benchmarks import accuracy
from myowarp.definitions.task import TASKS
from myowarp.osim.bundle.couplings import couplings, follow
from myowarp.sim.simulation import Simulation

FOLLOWED = 2e-6  # rad or m: polynomials in float32
LIMIT = 0.02  # rad, root mean square over joints (benchmarks/accuracy.py)

LEGS = "myoLegStandRandom-v0"


def misplaced(sim):
    """Return how far the joints that follow are from where they belong, (num_worlds, num_followers)."""
    model, qpos = sim.scene.oracle, sim.scene.data.qpos.numpy().astype(float)
    placed = qpos.copy()
    for row in placed:
        follow(model, row)
    followers = model.jnt_qposadr[[tie.joint for tie in couplings(model)]]
    return np.abs(qpos - placed)[:, followers]


@pytest.mark.parametrize("physics", ["fast", "parity"])
def test_joints_follow_exactly_under_fast(physics):
    """From the reset on, which moves them apart; springs let them go."""
    sim = Simulation(LEGS, 3, device="cpu", physics=physics, graph=False, progress=False)
    sim.reset(seeds=np.arange(3))
    apart = [misplaced(sim)]
    sim.action.assign(np.random.default_rng(0).uniform(-1.0, 1.0, sim.action.shape).astype(np.float32))
    for _ in range(3):
        sim.step()
        apart.append(misplaced(sim))
    assert apart[0].shape == (3, 14)
    if physics == "fast":
        assert np.max(apart) < FOLLOWED
        assert sim.scene.data.ne.numpy().max() == 0
    else:
        assert np.max(apart[0]) > 0.1
        assert np.max(apart[-1]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("key", [LEGS, "myoArmReachFixed-v0"])
def test_coarse_steps_hold_the_tolerance(key):
    """Beside MuJoCo C in steps of 0.1 ms, with springs that hold as hard as these can."""
    study = accuracy.prepare(key, accuracy.Options(episodes=6))
    rows = {row["preset"]: row for row in accuracy.in_engine(study)}
    assert rows["fast"]["joints_rad"] < LIMIT
    assert rows["fast"]["step_ms"] > 1e3 * 1.5 * TASKS[key].physics_dt
    assert np.ptp(study.reference, axis=(0, 1)).max() > 10 * LIMIT
