"""What a muscle model is: a class with its parameters, its state, one kernel and its launcher.

It reads musculotendon length and velocity from MuJoCo's tendons and writes the force; it never knows how the
path was computed.
"""

import abc

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco import MjModel, mjtDyn

from myowarp.spec.registry import Registry


@wp.struct
class Anatomy:
    """What a condition can change in any muscle model; arrays (1 or num_worlds, num_muscles).

    Attributes:
        path: Actuator whose tendon the muscle pulls; its control stays its own.
        strength: Factor on the active force [1].
        transmission: Factor on the whole force [1]; 0 for a torn tendon.
    """

    path: wp.array2d[int]
    strength: wp.array2d[float]
    transmission: wp.array2d[float]


BiasParams = wp.types.vector(10, float)
"""MuJoCo's `biasprm`."""


@wp.func
def affine_bias(tension: float, damping: float, velocity: float) -> BiasParams:
    """b0 = damping velocity - tension, b2 = -damping: b0 + b1 length + b2 velocity = -tension."""
    bias = BiasParams()
    bias[0] = damping * velocity - tension
    bias[2] = -damping
    return bias


@wp.kernel(enable_backward=False)
def restore_anatomy(
    # Out:
    anatomy: Anatomy,
):
    """strength = transmission = 1, from where the conditions of a control step start."""
    worldid, muscleid = wp.tid()
    anatomy.strength[worldid, muscleid] = 1.0
    anatomy.transmission[worldid, muscleid] = 1.0


class MuscleModel(abc.ABC):
    """The muscles of a body in all worlds: parameters, activation and force.

    In the stepped model the muscles are stateless actuators, force = b0 + b1 length + b2 velocity
    (MuJoCo's AFFINE bias with gain 0). `launch`, called by the engine in every physics step between
    velocity and force stage, writes b0 = F - kv velocity and b2 = kv: exactly the force F, and for
    integrators that are implicit in velocity kv = implicitness dF/dvelocity.

    Attributes:
        actuator_id: Actuator of each muscle, shape (num_muscles,), host.
        names: Muscle names, in that order.
        activation: State [1], shape (num_worlds, num_muscles).
        midstep: Whether forces come from the activation in the middle of a physics step, exactly integrated,
            rather than from the one at its start.
        implicitness: Share of dF/dvelocity in kv, 0 for explicit integrators.
        anatomy: What conditions change in it.
        workload: Time integral of the normalized active force a f_L f_V [s], shape (num_worlds,
            num_muscles), empty until `record_workload`; whoever uses it sets it back to 0.
    """

    midstep = False
    implicitness = 0.0

    def __init__(self, model: MjModel, num_worlds: int) -> None:
        """Allocate the state for the muscles found in `model`, on the current Warp device."""
        is_muscle = model.actuator_dyntype == mjtDyn.mjDYN_MUSCLE
        self.actuator_id = np.flatnonzero(is_muscle).astype(np.int32)
        self.names = tuple(model.actuator(i).name for i in self.actuator_id)
        shape = (num_worlds, len(self.names))
        for name in ("activation", "tension", "length", "velocity", "damping"):
            setattr(self, name, wp.zeros(shape, dtype=float))
        self.workload = wp.zeros((0, 0), dtype=float)
        self.anatomy = Anatomy()
        self._set_anatomy(1)

    def individualize(self) -> None:
        """Give every world an anatomy of its own; before anything is captured."""
        self._set_anatomy(self.activation.shape[0])

    def record_workload(self) -> None:
        """Integrate the workload from now on; before anything is captured."""
        self.workload = wp.zeros_like(self.activation)

    def _set_anatomy(self, rows: int) -> None:
        """Allocate a healthy anatomy."""
        shape = (rows, len(self.names))
        self.anatomy.path = wp.array(np.broadcast_to(self.actuator_id, shape).copy(), dtype=int)
        self.anatomy.strength = wp.ones(shape, dtype=float)
        self.anatomy.transmission = wp.ones(shape, dtype=float)

    @abc.abstractmethod
    def set_length_range(self, muscleid: int, length_range: tuple[float, float], mask: wp.array) -> None:
        """Fit a muscle to lengths of its path, in some worlds; a launch, after `individualize`.

        Args:
            muscleid: The muscle.
            length_range: Least and greatest musculotendon length [m], over which its fibers operate.
            mask: The worlds, shape (num_worlds,) bool.
        """

    @abc.abstractmethod
    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write the muscles' `actuator_biasprm` and advance `activation` by one physics step."""

    @abc.abstractmethod
    def reset(self, mask: wp.array) -> None:
        """Put the worlds of `mask` (num_worlds,) bool to rest."""


MUSCLES: Registry[type[MuscleModel]] = Registry("muscle model")
