"""How many contacts and constraint rows a world can need, found from the model and from random motion.

Arrays in mujoco-warp have fixed sizes; what does not fit is dropped, with wrong physics. So sizes are
measured with MuJoCo C, with a margin, and never guessed.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from myowarp.models.slim import colliding_pairs

MARGIN = 1.5  # over the largest number of contacts seen
NUM_POSES = 200
NUM_EPISODES = 8
EPISODE_STEPS = 500


@dataclass(frozen=True)
class Capacity:
    """Sizes for one world.

    Attributes:
        contacts: Contacts, and candidate pairs of the broad phase.
        rows: Constraint rows.
        peak_contacts: Largest number of contacts seen.
    """

    contacts: int
    rows: int
    peak_contacts: int


def calibrate(model: mujoco.MjModel) -> Capacity:
    """Return sizes for a model.

    Limits, friction loss and equalities have an exact bound. Contacts are counted over random poses within
    the joint ranges and over random-control motion from the initial pose; a model in which no pair of
    geoms can collide needs none.
    """
    pairs = colliding_pairs(model)
    rows = int(model.jnt_limited.sum() + model.tendon_limited.sum())
    rows += int((model.dof_frictionloss > 0).sum() + (model.tendon_frictionloss > 0).sum())
    rows += 6 * model.neq
    if not pairs:
        return Capacity(contacts=0, rows=max(rows, 1), peak_contacts=0)
    peak = _peak_contacts(model)
    contacts = int(np.ceil(MARGIN * peak))
    condim = max(int(model.geom_condim.max()), int(model.pair_dim.max(initial=1)))
    rows += max(contacts, 1) * max(1, 2 * (condim - 1))
    return Capacity(contacts=max(contacts, len(pairs)), rows=max(rows, 1), peak_contacts=peak)


def _peak_contacts(model: mujoco.MjModel) -> int:
    """Return the largest number of contacts met in MuJoCo C."""
    rng = np.random.default_rng(0)
    data = mujoco.MjData(model)
    low, high = model.jnt_range.T
    scalar = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
    address = model.jnt_qposadr[scalar & (model.jnt_limited > 0)]
    peak = 0
    for _ in range(NUM_POSES):
        mujoco.mj_resetData(model, data)
        data.qpos[address] = rng.uniform(low, high)[scalar & (model.jnt_limited > 0)]
        mujoco.mj_forward(model, data)
        peak = max(peak, data.ncon)
    for _ in range(NUM_EPISODES):
        mujoco.mj_resetData(model, data)
        for step in range(EPISODE_STEPS):
            if step % 10 == 0:
                data.ctrl[:] = rng.uniform(*model.actuator_ctrlrange.T)
            mujoco.mj_step(model, data)
            peak = max(peak, data.ncon)
    return peak
