"""Joints that follow others: MuJoCo's joint equalities.

    q_i - q0_i = sum_k c_k (q_j - q0_j)^k,    k = 0..4

with the values q0 of the model's zero. Source: MuJoCo documentation, *XML reference, equality/joint*.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

POINT_JOINTS = (mujoco.mjtJoint.mjJNT_HINGE.value, mujoco.mjtJoint.mjJNT_SLIDE.value)
"""Joints with one coordinate."""


@dataclass(frozen=True)
class Coupling:
    """A joint that follows.

    Attributes:
        joint: Id of the joint.
        driver: Id of the joint that it follows; -1 for none, it then stays where it is put.
        polynomial: c, shape (5,).
    """

    joint: int
    driver: int
    polynomial: np.ndarray


def couplings(model: mujoco.MjModel) -> list[Coupling]:
    """Return the active couplings of a model; a driver that itself follows comes before its followers."""
    ties = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & model.eq_active0.astype(bool)
    waiting = [
        Coupling(int(model.eq_obj1id[i]), int(model.eq_obj2id[i]), model.eq_data[i, :5].copy())
        for i in np.flatnonzero(ties)
    ]
    ordered: list[Coupling] = []
    while waiting:
        late = {coupling.joint for coupling in waiting}
        ready = [coupling for coupling in waiting if coupling.driver not in late]
        ordered += ready or waiting  # a ring has no beginning
        waiting = [coupling for coupling in waiting if ready and coupling.driver in late]
    return ordered


def follow(model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Put the joints that follow to where their drivers are in `qpos` (nq,), in place."""
    for coupling in couplings(model):
        driver, address = model.jnt_qposadr[[coupling.driver, coupling.joint]]
        moved = qpos[driver] - model.qpos0[driver] if coupling.driver >= 0 else 0.0
        qpos[address] = model.qpos0[address] + np.polynomial.polynomial.polyval(moved, coupling.polynomial)
