"""Where sites are, and random hands and places of objects for the states that are written."""

import mujoco
import numpy as np

PALM_SITES = ("S_grasp", "S_grasp_r")
NUM_HAND = 23


def num_joints(env):
    """Joints of the hand or the arm; those of objects come after them."""
    return getattr(env, "_obj_qposadr", NUM_HAND)


def palm(env):
    """Where the palm is."""
    names = {env.model.site(i).name for i in range(env.model.nsite)}
    return site(env, next(name for name in PALM_SITES if name in names))


def site(env, name):
    return env.data.site(name).xpos.copy()


def rotation(quat):
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def direction(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def hand_pose(env, rng, scale, arm_scale=1.0):
    """Hand joints moved from the start by a fraction of the way to random values in the limits.

    The three forearm and wrist joints move by `scale` times `arm_scale`.
    """
    low, high = env.model.jnt_range[: num_joints(env)].T
    start = env._init_qpos[: num_joints(env)]
    offset = scale * (rng.uniform(low, high) - start)
    offset[:3] *= arm_scale
    return start + offset


def start_forced(wrapped, rng, scale):
    """Reset and write random velocities, activations and hand joints."""
    env = wrapped.unwrapped
    wrapped.reset(seed=int(rng.integers(2**31)))
    env.data.qpos[: num_joints(env)] = hand_pose(env, rng, scale)
    env.data.qvel[:] = rng.normal(size=env.model.nv)
    env.data.act[:] = rng.uniform(size=env.model.na)
    mujoco.mj_forward(env.model, env.data)
    return env


def random_quat(rng):
    quat = rng.normal(size=4)
    return quat / np.linalg.norm(quat)


def place_at_palm(env, rng):
    """Random hand; a point within some centimetres of the palm for the object."""
    low, high = env.model.jnt_range[: num_joints(env)].T
    env.data.qpos[: num_joints(env)] = rng.uniform(low, high)
    mujoco.mj_forward(env.model, env.data)
    return palm(env) + rng.normal(scale=0.015, size=3)
