"""Random configurations of any model, for tests that run over everything registered."""

import mujoco
import numpy as np

TURN = np.pi  # rad, largest angle of a hinge without limits
SHIFT = 0.02  # m, largest displacement of what slides or floats without limits


def configurations(model, start, count, seed, beyond=0.0):
    """Return random configurations, shape (count, nq).

    Joints with limits are uniform in their ranges, which `beyond` widens at both ends by this part of their
    widths; the others are near where they start, balls and free bodies in any orientation.
    """
    rng = np.random.default_rng(seed)
    qpos = np.tile(start, (count, 1))
    for joint, kind in enumerate(model.jnt_type):
        first = model.jnt_qposadr[joint]
        if kind in (mujoco.mjtJoint.mjJNT_HINGE.value, mujoco.mjtJoint.mjJNT_SLIDE.value):
            reach = TURN if kind == mujoco.mjtJoint.mjJNT_HINGE.value else SHIFT
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-reach, reach)
            margin = beyond * (high - low) * model.jnt_limited[joint]
            qpos[:, first] = rng.uniform(low - margin, high + margin, count)
            continue
        if kind == mujoco.mjtJoint.mjJNT_FREE.value:
            qpos[:, first : first + 3] += rng.uniform(-SHIFT, SHIFT, (count, 3))
            first += 3
        quat = rng.normal(size=(count, 4))
        qpos[:, first : first + 4] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    return qpos
