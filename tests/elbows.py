"""Simulations of the elbow with conditions, and the same states in MuJoCo C."""

import mujoco
import numpy as np

from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

KEY = "myoElbowPose1D6MRandom-v0"
NUM_WORLDS = 256


def worn(conditions=(), num_worlds=NUM_WORLDS, physics="parity"):
    """Return a simulation of elbows with conditions in place."""
    options = {"device": "cpu", "graph": False, "progress": False, "physics": physics}
    sim = Simulation(TASKS[KEY], num_worlds, conditions=conditions, **options)
    sim.shards[0].launch_conditions()
    return sim


def learner_env(num_worlds, horizon, seed=0):
    """Return elbows with short episodes as the trainer has them."""
    how = {"autoreset_mode": "disabled", "output": "torch", "copy": False, "progress": False}
    setup = Setup(task=KEY, seed=seed, horizon=horizon, device="cpu")
    return MyoWarpVectorEnv(setup, num_worlds, **how)


class States:
    """Random states of the elbow, exactly representable in float32."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        self.qpos = np.float32(rng.uniform(0.05, 2.2, (NUM_WORLDS, 1)))
        self.qvel = np.float32(2.0 * rng.normal(size=(NUM_WORLDS, 1)))
        self.activation = np.float32(rng.uniform(0.0, 1.0, (NUM_WORLDS, 6)))

    def put(self, sim):
        """Write the states into a simulation."""
        sim.scene.data.qpos.assign(self.qpos)
        sim.scene.data.qvel.assign(self.qvel)
        sim.scene.muscles.activation.assign(self.activation)
        return sim.scene.data


def in_c(model, states, call, *, scale=None, torque=None):
    """Return data of MuJoCo C after `call` in every state; forces scaled, or a torque applied, per world."""
    gain, bias = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    rows = []
    for world in range(NUM_WORLDS):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = states.qpos[world], states.qvel[world]
        data.act[:] = states.activation[world]
        if scale is not None:  # of the peak forces, active and passive
            model.actuator_gainprm[:, 2] = gain[:, 2] * scale[world]
            model.actuator_biasprm[:, 2] = bias[:, 2] * scale[world]
        if torque is not None:
            data.qfrc_applied[:] = torque[world]
        call(model, data)
        rows.append(data)
    model.actuator_gainprm[:], model.actuator_biasprm[:] = gain, bias
    return rows
