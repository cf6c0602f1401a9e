"""Simulations of the hand with conditions, and the same states in MuJoCo C."""

import mujoco
import numpy as np
from configurations import configurations
from stepping import forward, repeated_step

import myowarp.tasks.variants  # noqa: F401  (registers the tasks)
from myowarp.definitions.task import TASKS
from myowarp.sim.simulation import Simulation

HAND, CONTACT_HAND, ELBOW = "myoHandReachFixed-v0", "myoHandKeyTurnFixed-v0", "myoElbowPose1D6MFixed-v0"
HANDS = (HAND, CONTACT_HAND)
EIP, EPL, FPL = 21, 22, 24  # muscles and actuators
CONTROL_DT = 0.02  # s, of all tasks here


def simulation(key, num_worlds, conditions, **options):
    settings = {"device": "cpu", "graph": False, "progress": False, "autoreset": "disabled"} | options
    sim = Simulation(TASKS[key], num_worlds, conditions=conditions, **settings)
    sim.reset(seeds=np.arange(num_worlds))
    return sim


def act(sim, step=0):
    """Take a step with random actions, the same in every simulation."""
    rng = np.random.default_rng(step)
    actions = rng.uniform(-1, 1, (64, sim.action.shape[1]))[: sim.num_worlds]
    sim.action.assign(actions.astype(np.float32))
    sim.step()


def state(sim):
    """Return all of a simulation's worlds that a step changes, one row each."""
    data = sim.scene.data
    arrays = (data.qpos, data.qvel, sim.scene.muscles.activation, sim.transition.obs)
    return np.concatenate([array.numpy() for array in arrays], axis=1)


class States:
    """Random states in which nothing touches, for the engine and for MuJoCo C."""

    def __init__(self, sim, seed=0):
        model, rng, n = sim.scene.oracle, np.random.default_rng(seed), sim.num_worlds
        self.qpos = np.float32(configurations(model, sim.scene.qpos_start.numpy(), n, seed))
        self.qvel = np.float32(rng.normal(size=(n, model.nv)))
        self.activation, self.ctrl = (np.float32(rng.uniform(0.0, 1.0, (n, 39))) for _ in range(2))

    def load(self, sim):
        """Write the states into a simulation, poison what has to be written, and let its conditions act."""
        data, model = sim.scene.data, sim.scene.model
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        ctrl = np.zeros(data.ctrl.shape, dtype=np.float32)
        ctrl[:, :39] = self.ctrl
        for array, values in (
            (data.qpos, self.qpos),
            (data.qvel, self.qvel),
            (data.ctrl, ctrl),
            (sim.scene.muscles.activation, self.activation),
        ):
            array.assign(values)
        for array in (data.actuator_force, data.qacc):
            array.fill_(np.nan)
        if sim.shards[0].effects:
            sim.scene.muscles.anatomy.transmission.fill_(np.nan)
        data.qacc_warmstart.zero_()
        bias = model.actuator_biasprm.numpy()
        bias[:] = np.nan
        model.actuator_biasprm.assign(bias)
        sim.shards[0].launch_conditions()

    def in_c(self, model, world, num_substeps=0):
        """Return MuJoCo C's data of one state, after some substeps."""
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = self.qpos[world], self.qvel[world]
        data.act[:], data.ctrl[:] = self.activation[world], self.ctrl[world]
        if num_substeps:
            mujoco.mj_step(model, data, num_substeps)
        else:
            mujoco.mj_forward(model, data)
        return data


def compare_with_c(sim, models):
    """Compare force, acceleration and a control step with one C model per world.

    Returns:
        The worst errors of each world, by name, shape (num_worlds,).
    """
    states, data, muscles = States(sim), sim.scene.data, sim.scene.muscles
    states.load(sim)
    forward(sim.scene, sim.shards[0].stages)
    path = muscles.anatomy.path.numpy()
    forces = np.take_along_axis(data.actuator_force.numpy(), path, axis=1)
    accelerations = data.qacc.numpy().copy()
    states.load(sim)
    step = repeated_step(sim.scene, sim.shards[0].stages)
    for _ in range(sim.scene.num_substeps):
        step()
    errors = {"force": [], "qacc": [], "qpos": [], "activation": []}
    for world, model in enumerate(models):
        first, last = states.in_c(model, world), states.in_c(model, world, sim.scene.num_substeps)
        peak = np.maximum(model.actuator_gainprm[:, 2], 1.0)
        errors["force"].append((np.abs(forces[world] - first.actuator_force) / peak).max())
        scale = np.abs(first.qacc).max()
        errors["qacc"].append(np.abs(accelerations[world] - first.qacc).max() / scale)
        errors["qpos"].append(np.abs(data.qpos.numpy()[world] - last.qpos).max())
        errors["activation"].append(np.abs(muscles.activation.numpy()[world] - last.act).max())
    return {name: np.array(values) for name, values in errors.items()}
