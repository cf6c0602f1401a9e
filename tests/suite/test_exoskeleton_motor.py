"""The exoskeleton with a motor that the policy commands: torque against MuJoCo C, effort."""

import gymnasium
import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
from elbows import KEY, NUM_WORLDS, States, in_c, worn
from stepping import engine_alone

from myowarp.models.conditions.exoskeleton import Exoskeleton

MAX_TORQUE = 8.5  # N m
BARE = {"forearm_mass": 0.0}  # so that the torque is alone

TORQUE = 1e-5
"""Of the largest torque of the muscles; the engine's float32 forces and moment arms, measured 4e-6."""

ROUNDING = 1e-6  # of a number of order one, a few float32 operations


def test_one_more_action():
    for motor, actions in ((False, 6), (True, 7)):
        env = gymnasium.make_vec(
            f"MyoWarp/{KEY}", num_envs=2, device="cpu", conditions=Exoskeleton(motor=motor)
        )
        assert env.single_action_space.shape == (actions,)
        assert env.single_observation_space.shape == (9,)
        env.reset(seed=0)
        action = np.full((2, actions), 0.25, dtype=np.float32)
        info = env.step(action)[-1]
        assert ("terms/exo_effort" in info) == motor
        assert info["exo_torque"].shape == (2,)
        assert np.abs(info["exo_torque"]).min() > 0
        if motor:
            np.testing.assert_allclose(info["exo_torque"], 0.25 * MAX_TORQUE, rtol=ROUNDING)
        env.close()


def test_torque_moves_the_elbow():
    states, sim = States(), worn(Exoskeleton(motor=True, **BARE))
    command = np.linspace(-1.5, 1.5, NUM_WORLDS)
    torque = MAX_TORQUE * np.clip(command, -1.0, 1.0)
    rows = in_c(worn(num_worlds=1).scene.oracle, states, mujoco.mj_forward, torque=torque)
    expected = np.array([data.qacc for data in rows])
    action = np.full((NUM_WORLDS, 7), -1.0, dtype=np.float32)
    action[:, 6] = command
    sim.action.assign(action)
    sim.shards[0].launch_action()
    data = states.put(sim)
    engine_alone(mjw.forward)(sim.scene.model, data)
    assert np.abs(data.qacc.numpy() - expected).max() <= TORQUE * np.abs(expected).max()
    np.testing.assert_allclose(data.actuator_force.numpy()[:, 6], torque, rtol=ROUNDING)


@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_effort_is_the_squared_torque(weight):
    """Relative to the largest; it counts in the reward with its weight only."""
    sim = worn(Exoskeleton(motor=True, max_torque=4.0, effort_weight=weight), 5)
    command = np.array([-1.0, -0.5, 0.0, 0.25, 3.0], dtype=np.float32)
    action = np.zeros((5, 7), dtype=np.float32)
    action[:, 6] = command
    sim.reset(seeds=np.arange(5))
    sim.action.assign(action)
    sim.transition.terms.fill_(np.nan)
    sim.step()
    terms, names = sim.transition.terms.numpy(), [term.name for term in sim.terms]
    effort = -np.square(np.clip(command, -1, 1))
    np.testing.assert_allclose(terms[:, names.index("exo_effort")], effort, rtol=ROUNDING)
    np.testing.assert_allclose(
        sim.shards[0].effects[0].torque.numpy(), 4.0 * np.clip(command, -1, 1), rtol=ROUNDING
    )
    weights = [term.weight for term in sim.terms]
    assert weights[-1] == weight
    np.testing.assert_allclose(sim.transition.reward.numpy(), terms @ weights, rtol=1e-5)
