"""MuJoCo's muscle: rigid tendon, no pennation, piecewise quadratic curves.

    F = -(s f_L(l) f_V(v) a + f_P(l)) F_max,    l = (length - l_T) / l_0,    v = velocity / (l_0 v_max)

with the strength s, 1 in a healthy muscle.

Source: MuJoCo documentation, *Modeling, Actuators, Muscles*. The active and the passive part each have
their own length scale and peak force, as `gainprm` and `biasprm` do. Given the same length and velocity,
forces agree with MuJoCo C to 1e-5 of the peak; the engine's lengths, in float32, add up to 7e-5 in short
muscles of the hand (tests/test_muscles.py).
"""

from pathlib import Path

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src.types import vec10

from myowarp.kernels.activation import ACTIVATION
from myowarp.kernels.batching import batched, num_threads
from myowarp.kernels.curves import CURVES
from myowarp.kernels.reset import masked_fill
from myowarp.spec.muscle import MUSCLES, Anatomy, MuscleModel


@wp.struct
class MujocoMuscleParams:
    """Parameters of all muscles; each array but the first is (1 or num_worlds, num_muscles) on its own.

    Attributes:
        actuator_id: Actuator of each muscle, shape (num_muscles,).
        excitation_range: Lowest and highest excitation [1].
        activation_time_constant: Time constant at full rise [s].
        deactivation_time_constant: Time constant of decay [s].
        smoothing_width: Width of the switch between the two [1].
        max_isometric_force: Peak active force [N].
        optimal_fiber_length: Length scale l_0 of the active part [m].
        tendon_slack_length: Length offset l_T of the active part [m].
        min_norm_length: l at which the active force starts [1].
        max_norm_length: l at which the active force ends [1].
        max_contraction_velocity: v_max [l_0/s].
        eccentric_multiplier: Largest f_V [1].
        passive_peak_force: Force that scales f_P [N].
        passive_optimal_length: l_0 of the passive part [m].
        passive_slack_length: l_T of the passive part [m].
        passive_max_norm_length: l_max of f_P; half way from 1 to it f_P is half of `passive_multiplier` [1].
        passive_multiplier: Scale of f_P [1].
    """

    actuator_id: wp.array[int]
    excitation_range: wp.array2d[wp.vec2]
    activation_time_constant: wp.array2d[float]
    deactivation_time_constant: wp.array2d[float]
    smoothing_width: wp.array2d[float]
    max_isometric_force: wp.array2d[float]
    optimal_fiber_length: wp.array2d[float]
    tendon_slack_length: wp.array2d[float]
    min_norm_length: wp.array2d[float]
    max_norm_length: wp.array2d[float]
    max_contraction_velocity: wp.array2d[float]
    eccentric_multiplier: wp.array2d[float]
    passive_peak_force: wp.array2d[float]
    passive_optimal_length: wp.array2d[float]
    passive_slack_length: wp.array2d[float]
    passive_max_norm_length: wp.array2d[float]
    passive_multiplier: wp.array2d[float]


SOURCE = Path(__file__).with_suffix(".cpp").read_text()


@wp.func_native(CURVES + ACTIVATION + SOURCE)
def contract(
    world: int,
    thread: int,
    threads: int,
    params: MujocoMuscleParams,
    anatomy: Anatomy,
    dt: float,
    midstep: bool,
    implicitness: float,
    ctrl: wp.array2d[float],
    actuator_length: wp.array2d[float],
    actuator_velocity: wp.array2d[float],
    activation: wp.array2d[float],
    workload: wp.array2d[float],
    actuator_biasprm: wp.array2d[vec10],
):
    """Let a world's muscles act, every `threads`-th of them or of their groups; see `mujoco_muscle`."""
    ...


@wp.kernel(enable_backward=False)
def mujoco_muscle(
    # Model:
    opt_timestep: wp.array[float],
    # Params:
    params: MujocoMuscleParams,
    # Data in:
    ctrl_in: wp.array2d[float],
    actuator_length_in: wp.array2d[float],
    actuator_velocity_in: wp.array2d[float],
    # In:
    implicitness: float,
    midstep: bool,
    threads: int,
    anatomy: Anatomy,
    # Out:
    activation: wp.array2d[float],
    workload: wp.array2d[float],
    actuator_biasprm: wp.array2d[vec10],
):
    """F from the present activation; then a += dt da/dt, in MuJoCo's order. Midstep: F from a(t + dt/2).

    The workload is the integral of a f_L f_V [s]; F is written as b0 + b2 velocity (`MuscleModel`).
    """
    worldid, thread = wp.tid()
    dt = opt_timestep[batched(worldid, opt_timestep.shape[0])]
    contract(
        worldid,
        thread,
        threads,
        params,
        anatomy,
        dt,
        midstep,
        implicitness,
        ctrl_in,
        actuator_length_in,
        actuator_velocity_in,
        activation,
        workload,
        actuator_biasprm,
    )


def peak_force(prm: np.ndarray, acc0: np.ndarray) -> np.ndarray:
    """Return the peak force [N] that a muscle's gain or bias parameters mean, shape (num_muscles,).

    A negative stored force asks for scale / acc0, acc0 being the acceleration by unit force at qpos0.
    """
    return np.where(prm[:, 2] < 0.0, prm[:, 3] / np.maximum(acc0, 1e-15), prm[:, 2])


def length_scale(prm: np.ndarray, lengthrange: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return l_0 and l_T [m], each (num_muscles,): l runs over prm[0..1] as length over its range."""
    optimal = (lengthrange[:, 1] - lengthrange[:, 0]) / np.maximum(prm[:, 1] - prm[:, 0], 1e-15)
    return optimal, lengthrange[:, 0] - prm[:, 0] * optimal


@wp.kernel(enable_backward=False)
def set_length_scale(
    # Params:
    muscleid: int,
    active_scale: wp.vec2,
    passive_scale: wp.vec2,
    # In:
    mask: wp.array[bool],
    # Out:
    params: MujocoMuscleParams,
):
    """(l_0, l_T) = scale, of the active and the passive part, in the worlds of the mask."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    params.optimal_fiber_length[worldid, muscleid] = active_scale[0]
    params.tendon_slack_length[worldid, muscleid] = active_scale[1]
    params.passive_optimal_length[worldid, muscleid] = passive_scale[0]
    params.passive_slack_length[worldid, muscleid] = passive_scale[1]


LENGTHS = (
    "optimal_fiber_length",
    "tendon_slack_length",
    "passive_optimal_length",
    "passive_slack_length",
)
"""Parameters that follow from a range of lengths."""


class MujocoMuscle(MuscleModel):
    """MuJoCo's muscle in a kernel of ours; parameters are read from a compiled `mujoco.MjModel`.

    Attributes:
        params: The parameters, editable in place.
    """

    def __init__(self, model: mujoco.MjModel, num_worlds: int) -> None:
        """Read the parameters of every actuator with muscle dynamics."""
        super().__init__(model, num_worlds)
        ids = self.actuator_id
        gain, bias = model.actuator_gainprm[ids], model.actuator_biasprm[ids]
        dyn, acc0 = model.actuator_dynprm[ids], model.actuator_acc0[ids]
        self._curves = gain, bias
        optimal, slack = length_scale(gain, model.actuator_lengthrange[ids])
        passive_optimal, passive_slack = length_scale(bias, model.actuator_lengthrange[ids])
        limited = model.actuator_ctrllimited[ids, None]
        bounds = np.clip(np.where(limited, model.actuator_ctrlrange[ids], (0.0, 1.0)), 0.0, 1.0)

        self.params = MujocoMuscleParams()
        self.params.actuator_id = wp.array(ids, dtype=int)
        self.params.excitation_range = wp.array(bounds[None], dtype=wp.vec2)
        for name, values in {
            "activation_time_constant": dyn[:, 0],
            "deactivation_time_constant": dyn[:, 1],
            "smoothing_width": dyn[:, 2],
            "max_isometric_force": peak_force(gain, acc0),
            "optimal_fiber_length": optimal,
            "tendon_slack_length": slack,
            "min_norm_length": gain[:, 4],
            "max_norm_length": gain[:, 5],
            "max_contraction_velocity": gain[:, 6],
            "eccentric_multiplier": gain[:, 8],
            "passive_peak_force": peak_force(bias, acc0),
            "passive_optimal_length": passive_optimal,
            "passive_slack_length": passive_slack,
            "passive_max_norm_length": bias[:, 5],
            "passive_multiplier": bias[:, 7],
        }.items():
            setattr(self.params, name, wp.array(values[None], dtype=float))

    def individualize(self) -> None:
        """Give every world an anatomy and length scales of its own."""
        super().individualize()
        for name in LENGTHS:
            values = np.repeat(getattr(self.params, name).numpy(), self.activation.shape[0], axis=0)
            setattr(self.params, name, wp.array(values, dtype=float))

    def set_length_range(self, muscleid: int, length_range: tuple[float, float], mask: wp.array) -> None:
        """Launch `set_length_scale`; see `MuscleModel.set_length_range`."""
        row, lengths = [muscleid], np.array([length_range])
        active_scale, passive_scale = (
            wp.vec2(*np.concatenate(length_scale(curve[row], lengths))) for curve in self._curves
        )
        wp.launch(
            set_length_scale,
            dim=mask.shape[0],
            inputs=[muscleid, active_scale, passive_scale, mask],
            outputs=[self.params],
        )

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Engine callback; see `MuscleModel.launch`."""
        num_worlds, num_muscles = self.activation.shape
        threads = num_threads(self.activation.device, num_muscles)
        wp.launch(
            mujoco_muscle,
            dim=(num_worlds, threads),
            inputs=[
                model.opt.timestep,
                self.params,
                data.ctrl,
                data.actuator_length,
                data.actuator_velocity,
                self.implicitness,
                self.midstep,
                threads,
                self.anatomy,
            ],
            outputs=[self.activation, self.workload, model.actuator_biasprm],
        )

    def reset(self, mask: wp.array) -> None:
        """Set the activation of the worlds of `mask` to 0."""
        masked_fill(mask, self.activation, 0.0)


MUSCLES.add("mujoco", MujocoMuscle)
