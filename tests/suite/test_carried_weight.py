"""MyoSuite's own exoskeleton ids, beyond what test_oracle compares for every id: motor and drawn weights."""

import json
from pathlib import Path

import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

DATA = Path(__file__).parents[1] / "data/myosuite"
RANDOM = "myoElbowPose1D6MExoRandom-v0"
MAX_TORQUE = 8.5  # N m
FIELD = 1e-6  # relative, float32 roundings of host values


def elbows(num_worlds):
    """Return a simulation of the id that draws weights."""
    return Simulation(TASKS[RANDOM], num_worlds, device="cpu", graph=False, progress=False)


def test_motor_is_actuator_0_and_the_parts_weigh_nothing():
    exo, plain = (BODIES[name].build().compile() for name in ("elbow_exo", "elbow"))
    assert exo.actuator(0).name == "Exo"
    assert exo.actuator(0).gear[0] == MAX_TORQUE
    for name in ("r_humerus", "r_ulna_radius_hand"):
        assert exo.body(name).mass == plain.body(name).mass
    assert exo.body("carry_weight").mass == 0.1


def test_weights_are_drawn_like_upstream():
    record = np.load(DATA / f"{RANDOM}.npz")
    low, high = json.loads(str(record["meta"]))["weight_range"]
    sim = elbows(512)
    sim.reset(seeds=np.arange(512))
    first = sim.shards[0].program.weight.mass.numpy()[:, 0].copy()
    body = sim.scene.oracle.body("carry_weight").id
    np.testing.assert_array_equal(sim.scene.model.body_mass.numpy()[:, body], first)
    assert low <= first.min() < low + 0.02
    assert high - 0.02 < first.max() <= high
    assert abs(np.corrcoef(first, sim.scene.data.qpos.numpy()[:, 0])[0, 1]) < 0.15
    assert abs(np.corrcoef(first, sim.shards[0].program.target.numpy()[:, 0])[0, 1]) < 0.15
    sim.reset(np.arange(512) % 2 == 0)
    changed = sim.shards[0].program.weight.mass.numpy()[:, 0] != first
    np.testing.assert_array_equal(changed, np.arange(512) % 2 == 0)


def test_what_follows_from_a_weight():
    """Inertia of the ball and softness of the joint's stops, against MyoSuite's recompiled models."""
    record = np.load(DATA / f"{RANDOM}.npz")
    mass = record["forced_weight"]
    assert np.ptp(mass) > 1.5  # kg
    sim = elbows(len(mass))
    sim.shards[0].program.weight.mass.assign(mass[:, None])
    sim.shards[0].program.weight.hang(wp.ones(len(mass), dtype=bool))
    model, body = sim.scene.model, sim.scene.oracle.body("carry_weight").id
    inertia = model.body_inertia.numpy()[:, body]
    np.testing.assert_allclose(inertia, record["forced_weight_inertia"], rtol=FIELD)
    softness = model.dof_invweight0.numpy()
    np.testing.assert_allclose(softness, record["forced_dof_invweight0"], rtol=1e-5)
    assert np.ptp(softness) > 1.0
    subtree = model.body_subtreemass.numpy()[:, 1]
    np.testing.assert_allclose(subtree, model.body_mass.numpy()[:, 1:].sum(axis=1), rtol=FIELD)


def test_the_motor_is_commanded_unchanged():
    sim = elbows(5)
    action = np.zeros((5, 7), dtype=np.float32)
    action[:, 0] = (-3.0, -1.0, 0.2, 0.5, 1.0)
    sim.action.assign(action)
    sim.shards[0].launch_action()
    np.testing.assert_array_equal(sim.scene.data.ctrl.numpy()[:, 0], np.clip(action[:, 0], -1, 1))
