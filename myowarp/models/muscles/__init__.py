"""Muscle models: each a class with its parameters, its state, one kernel and its launcher.

A muscle model reads musculotendon length and velocity from MuJoCo's tendons and writes the force; it never
knows how the path was computed. A new muscle model is one file here and one import at the foot of this
one.
"""

import abc

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco import MjModel, mjtDyn

from myowarp.registry import Registry


class MuscleModel(abc.ABC):
    """The muscles of a body in all worlds: parameters, activation and force.

    In the stepped model the muscles are stateless actuators, force = b0 + b1 length + b2 velocity
    (MuJoCo's AFFINE bias with gain 0). `launch`, called by the engine in every physics step between
    velocity and force stage, writes b0 = F - kv velocity and b2 = kv, with kv = dF/dvelocity: exactly the
    force F, and exactly its derivative for integrators that are implicit in velocity.

    Attributes:
        actuator_id: Actuator of each muscle, shape (num_muscles,), host.
        names: Muscle names, in that order.
        activation: State [1], shape (num_worlds, num_muscles).
    """

    def __init__(self, model: MjModel, num_worlds: int) -> None:
        """Allocate the state for the muscles found in `model`, on the current Warp device."""
        is_muscle = model.actuator_dyntype == mjtDyn.mjDYN_MUSCLE
        self.actuator_id = np.flatnonzero(is_muscle).astype(np.int32)
        self.names = tuple(model.actuator(i).name for i in self.actuator_id)
        self.activation = wp.zeros((num_worlds, len(self.names)), dtype=float)

    @abc.abstractmethod
    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write the muscles' `actuator_biasprm` and advance `activation` by one physics step."""

    @abc.abstractmethod
    def reset(self, mask: wp.array) -> None:
        """Put the worlds of `mask` (num_worlds,) bool to rest."""


MUSCLES: Registry[type[MuscleModel]] = Registry("muscle model")

from myowarp.models.muscles import mujoco  # noqa: E402, F401  (it registers itself)
