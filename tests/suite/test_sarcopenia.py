"""Sarcopenia: the active force is scaled, the passive one stays; every muscle of every kind of body."""

import mujoco
import numpy as np
import pytest
from configurations import configurations
from hands import ELBOW, HAND, simulation
from reference import mujoco_muscle, sarcopenia

from myowarp.definitions.parameter import Ramp, Uniform
from myowarp.models.conditions.sarcopenia import Sarcopenia

FINGER = "myoFingerPoseFixed-v0"  # its peak forces are stored as a scale by acceleration
NUM_STATES = 60

FORCE = 1e-6  # of the peak; a product and a sum in float32
EFFECT = 10.0


def forces(key, strength, activation):
    """Return the muscles' forces [N] in random states, shape (NUM_STATES, num_muscles), and their peaks."""
    sim = simulation(key, NUM_STATES, Sarcopenia(strength) if strength is not None else ())
    model, data, muscles = sim.scene.oracle, sim.scene.data, sim.scene.muscles
    ids, rng = muscles.actuator_id, np.random.default_rng(0)
    in_c = mujoco.MjData(model)
    length, velocity = np.zeros((2, NUM_STATES, model.nu))
    for world, qpos in enumerate(configurations(model, model.qpos0, NUM_STATES, 0, beyond=0.2)):
        in_c.qpos[:], in_c.qvel[:] = qpos, rng.normal(size=model.nv)
        mujoco.mj_forward(model, in_c)
        length[world], velocity[world] = in_c.actuator_length, in_c.actuator_velocity
    data.actuator_length.assign(np.float32(length))
    data.actuator_velocity.assign(np.float32(velocity))
    muscles.activation.assign(np.float32(np.broadcast_to(activation, muscles.activation.shape)))
    sim.scene.model.actuator_biasprm.fill_(np.nan)
    sim.shards[0].launch_conditions()
    muscles.launch(sim.scene.model, data)
    peak = mujoco_muscle.peak_force(model.actuator_acc0[ids], model.actuator_gainprm[ids])
    return sim.scene.model.actuator_biasprm.numpy()[:, ids, 0].astype(np.float64), peak


@pytest.mark.parametrize("key", [FINGER, ELBOW, HAND])
class TestForce:
    """Given the same lengths, velocities and activations."""

    def test_is_the_reference(self, key):
        """Another strength in every world and muscle."""
        healthy, peak = forces(key, None, 0.7)
        passive = forces(key, None, 0.0)[0]
        strength = np.float32(np.random.default_rng(1).uniform(0.0, 1.5, healthy.shape))
        weak = forces(key, strength, 0.7)[0]
        assert (np.abs(weak - sarcopenia.force(healthy, passive, strength)) / peak).max() < FORCE
        assert (np.abs(weak - healthy) / peak).max() > EFFECT * FORCE

    def test_active_force_halves_exactly(self, key):
        """To the last bit, by default, wherever no passive force is added; and passive force stays."""
        healthy, passive = forces(key, None, 0.7)[0], forces(key, None, 0.0)[0]
        weak = forces(key, Sarcopenia().strength, 0.7)[0]
        active = (passive == 0.0) & (healthy != 0.0)
        assert active.sum() > NUM_STATES
        np.testing.assert_array_equal(weak[active], sarcopenia.PAPER * healthy[active])
        for strength in (0.5, 0.0, 2.0):
            np.testing.assert_array_equal(forces(key, strength, 0.0)[0], passive)
        assert (passive != 0.0).any()


def test_percent_is_no_strength():
    """A share of 30 would be thirty times healthy."""
    message = "sarcopenia strength must be at most 4 times the healthy one, got 30; for 30 % write 0.3"
    for strength in (30, Ramp(1.0, Uniform(0.2, 30.0)), {"BRA": 30}):
        with pytest.raises(ValueError, match=f"^{message}$"):
            simulation(ELBOW, 1, Sarcopenia(strength))
