"""Where sites are, and random hands and places of objects for the states that are written."""

import mujoco
import numpy as np

PALM_SITE = "S_grasp"
NUM_HAND = 23


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
    low, high = env.model.jnt_range[:NUM_HAND].T
    start = env._init_qpos[:NUM_HAND]
    offset = scale * (rng.uniform(low, high) - start)
    offset[:3] *= arm_scale
    return start + offset


def start_forced(wrapped, rng, scale):
    """Reset and write random velocities, activations and hand joints."""
    env = wrapped.unwrapped
    wrapped.reset(seed=int(rng.integers(2**31)))
    env.data.qpos[:NUM_HAND] = hand_pose(env, rng, scale)
    env.data.qvel[:] = rng.normal(size=env.model.nv)
    env.data.act[:] = rng.uniform(size=env.model.na)
    mujoco.mj_forward(env.model, env.data)
    return env


def random_quat(rng):
    quat = rng.normal(size=4)
    return quat / np.linalg.norm(quat)


def place_at_palm(env, rng):
    """Random hand; a point within some centimetres of the palm for the object."""
    low, high = env.model.jnt_range[:NUM_HAND].T
    env.data.qpos[:NUM_HAND] = rng.uniform(low, high)
    mujoco.mj_forward(env.model, env.data)
    return site(env, PALM_SITE) + rng.normal(scale=0.015, size=3)
