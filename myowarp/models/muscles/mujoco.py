"""MuJoCo's muscle: rigid tendon, no pennation, piecewise quadratic curves.

    F = -(s f_L(l) f_V(v) a + f_P(l)) F_max,    l = (length - l_T) / l_0,    v = velocity / (l_0 v_max)

with the strength s, 1 in a healthy muscle.

Source: MuJoCo documentation, *Modeling, Actuators, Muscles*. The active and the passive part each have
their own length scale and peak force, as `gainprm` and `biasprm` do. Given the same length and velocity,
forces agree with MuJoCo C to 1e-5 of the peak; the engine's lengths, in float32, add up to 7e-5 in short
muscles of the hand (tests/suite/test_muscles.py).
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.muscle import (
    MUSCLES,
    Anatomy,
    BiasParams,
    FiberStates,
    MuscleGeometry,
    MuscleModel,
    MuscleResults,
    affine_bias,
)
from myowarp.kernels.batching import batched, num_threads, of_world
from myowarp.kernels.launch import launch
from myowarp.laws.muscles.activation import TINY, activation_step


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


@wp.func
def active_force_length_multiplier(
    norm_length: float, min_norm_length: float, max_norm_length: float
) -> float:
    """f_L(l) in [0, 1]: 1 - 2 x^2 up to x = 1/2, then 2 (1 - x)^2, 0 from x = 1 on.

    x is the way from 1 to where the force ends, l_min or l_max, as a share.
    """
    end = wp.where(norm_length < 1.0, 1.0 - min_norm_length, max_norm_length - 1.0)
    x = wp.abs(1.0 - norm_length) / end
    if x < 0.5:
        return 1.0 - 2.0 * x * x
    rest = wp.max(1.0 - x, 0.0)
    return 2.0 * rest * rest


@wp.func
def force_velocity_multiplier(norm_velocity: float, eccentric_multiplier: float) -> float:
    """f_V(v): (v + 1)^2 from -1 to 0, then f - (f - 1 - v)^2 / (f - 1), f = f_Vmax from v = f - 1 on."""
    if norm_velocity <= 0.0:
        rise = wp.max(norm_velocity + 1.0, 0.0)
        return rise * rise
    saturation = eccentric_multiplier - 1.0
    rest = wp.max(saturation - norm_velocity, 0.0)
    return eccentric_multiplier - rest * (rest / wp.max(saturation, TINY))


@wp.func
def force_velocity_slope(norm_velocity: float, eccentric_multiplier: float) -> float:
    """df_V/dv >= 0: 2 (v + 1) from -1 to 0, then 2 (f - 1 - v) / (f - 1), 0 outside."""
    if norm_velocity <= 0.0:
        return 2.0 * wp.max(norm_velocity + 1.0, 0.0)
    saturation = eccentric_multiplier - 1.0
    return 2.0 * (wp.max(saturation - norm_velocity, 0.0) / wp.max(saturation, TINY))


@wp.func
def passive_force_multiplier(
    norm_length: float, passive_max_norm_length: float, passive_multiplier: float
) -> float:
    """f_P(l) = f x^2 / 2 up to x = 1, then f (x - 1/2), with x = 2 (l - 1) / (l_max - 1); 0 up to l = 1."""
    x = 2.0 * wp.max(norm_length - 1.0, 0.0) / wp.max(passive_max_norm_length - 1.0, TINY)
    return passive_multiplier * wp.where(x <= 1.0, 0.5 * x * x, x - 0.5)


@wp.func
def active_multipliers(
    params: MujocoMuscleParams, worldid: int, muscleid: int, length: float, velocity: float
) -> wp.vec3:
    """(f_L(l), f_V(v), df_V/dvelocity), l = (length - l_T) / l_0, v = velocity / (l_0 v_max)."""
    optimal = of_world(params.optimal_fiber_length, worldid, muscleid)
    max_velocity = optimal * of_world(params.max_contraction_velocity, worldid, muscleid)
    norm_length = (length - of_world(params.tendon_slack_length, worldid, muscleid)) / optimal
    norm_velocity = velocity / max_velocity
    min_norm_length = of_world(params.min_norm_length, worldid, muscleid)
    max_norm_length = of_world(params.max_norm_length, worldid, muscleid)
    eccentric = of_world(params.eccentric_multiplier, worldid, muscleid)
    return wp.vec3(
        active_force_length_multiplier(norm_length, min_norm_length, max_norm_length),
        force_velocity_multiplier(norm_velocity, eccentric),
        force_velocity_slope(norm_velocity, eccentric) / max_velocity,
    )


@wp.func
def passive_force(params: MujocoMuscleParams, worldid: int, muscleid: int, length: float) -> float:
    """F_Pmax f_P(l) [N], l = (length - l_T) / l_0 of the passive part."""
    slack = of_world(params.passive_slack_length, worldid, muscleid)
    norm_length = (length - slack) / of_world(params.passive_optimal_length, worldid, muscleid)
    max_norm_length = of_world(params.passive_max_norm_length, worldid, muscleid)
    multiplier = of_world(params.passive_multiplier, worldid, muscleid)
    peak = of_world(params.passive_peak_force, worldid, muscleid)
    return peak * passive_force_multiplier(norm_length, max_norm_length, multiplier)


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
    results: MuscleResults,
    actuator_biasprm: wp.array2d[BiasParams],
):
    """T = transmission (a s F_max f_L f_V + F_Pmax f_P), damping = implicitness dT/dvelocity; a(t + dt).

    The workload is the integral of a f_L f_V [s].
    """
    worldid, thread = wp.tid()
    dt = opt_timestep[batched(worldid, opt_timestep.shape[0])]
    for m in range(thread, activation.shape[1], threads):
        bounds = params.excitation_range[batched(worldid, params.excitation_range.shape[0]), m]
        steps = activation_step(
            dt,
            midstep,
            wp.clamp(ctrl_in[worldid, params.actuator_id[m]], bounds[0], bounds[1]),
            activation[worldid, m],
            of_world(params.activation_time_constant, worldid, m),
            of_world(params.deactivation_time_constant, worldid, m),
            of_world(params.smoothing_width, worldid, m),
        )
        pathid = anatomy.path[batched(worldid, anatomy.path.shape[0]), m]
        length, velocity = actuator_length_in[worldid, pathid], actuator_velocity_in[worldid, pathid]
        active = active_multipliers(params, worldid, m, length, velocity)
        strength = of_world(anatomy.strength, worldid, m)
        transmission = of_world(anatomy.transmission, worldid, m)
        isometric = steps[0] * strength * of_world(params.max_isometric_force, worldid, m) * active[0]
        tension = transmission * (isometric * active[1] + passive_force(params, worldid, m, length))
        damping = float(0.0)  # an explicit integrator has no use for it; b0 + b2 velocity would only round
        if implicitness > 0.0:
            damping = implicitness * transmission * isometric * active[2]
        activation[worldid, m] = steps[1]
        results.tension[worldid, m] = tension
        results.length[worldid, m] = length
        results.velocity[worldid, m] = velocity
        results.damping[worldid, m] = damping
        if results.workload.shape[0] > 0:
            results.workload[worldid, m] += dt * (steps[0] * active[0] * active[1])
        actuator_biasprm[worldid, pathid] = affine_bias(tension, damping, velocity)


@wp.kernel(enable_backward=False)
def read_mujoco_fibers(
    # Params:
    params: MujocoMuscleParams,
    # In:
    activation: wp.array2d[float],
    length: wp.array2d[float],
    velocity: wp.array2d[float],
    anatomy: Anatomy,
    # Out:
    fibers: FiberStates,
):
    """Fibers in line with a tendon that keeps its length: l of the active part, the path's velocity."""
    worldid, m = wp.tid()
    path, speed = length[worldid, m], velocity[worldid, m]
    optimal = of_world(params.optimal_fiber_length, worldid, m)
    active = active_multipliers(params, worldid, m, path, speed)
    strength = of_world(anatomy.strength, worldid, m)
    transmission = of_world(anatomy.transmission, worldid, m)
    isometric = (
        activation[worldid, m] * strength * of_world(params.max_isometric_force, worldid, m) * active[0]
    )
    fibers.norm_length[worldid, m] = (path - of_world(params.tendon_slack_length, worldid, m)) / optimal
    fibers.velocity[worldid, m] = speed
    fibers.norm_velocity[worldid, m] = speed / optimal
    fibers.active_force[worldid, m] = transmission * isometric * active[1]
    fibers.passive_force[worldid, m] = transmission * passive_force(params, worldid, m, path)
    fibers.active_force_length[worldid, m] = active[0]


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

    PARAMETERS: ClassVar[Mapping[str, tuple[float, float]]] = {
        "activation_time_constant": (0.0, math.inf),
        "deactivation_time_constant": (0.0, math.inf),
        "smoothing_width": (0.0, math.inf),
        "max_isometric_force": (0.0, math.inf),
        "optimal_fiber_length": (1e-6, math.inf),
        "tendon_slack_length": (-math.inf, math.inf),
        "min_norm_length": (0.0, 0.999),
        "max_norm_length": (1.001, math.inf),
        "max_contraction_velocity": (1e-6, math.inf),
        "eccentric_multiplier": (1.0, math.inf),
        "passive_peak_force": (0.0, math.inf),
        "passive_optimal_length": (1e-6, math.inf),
        "passive_slack_length": (-math.inf, math.inf),
        "passive_max_norm_length": (1.001, math.inf),
        "passive_multiplier": (0.0, math.inf),
    }
    TAKES_HILL: ClassVar[bool] = False

    def __init__(
        self, model: mujoco.MjModel, num_worlds: int, parameters: Mapping[str, np.ndarray] | None = None
    ) -> None:
        """Read the parameters of every actuator with muscle dynamics; see `MuscleModel`."""
        super().__init__(model, num_worlds, parameters)
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
        self.params.activation_time_constant = self.activation_time_constant
        self.params.deactivation_time_constant = self.deactivation_time_constant
        for name, values in {
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
            setattr(self.params, name, self._parameter(name, values))

    def individualize(self) -> None:
        """Give every world an anatomy and length scales of its own."""
        super().individualize()
        for name in LENGTHS:
            values = np.broadcast_to(getattr(self.params, name).numpy(), self.activation.shape)
            setattr(self.params, name, wp.array(values.copy(), dtype=float))

    def geometry(self) -> MuscleGeometry:
        """Return the active part; see `MuscleModel.geometry`."""
        names = (*MuscleGeometry._fields[:4], "tendon_slack_length")
        return MuscleGeometry(*(getattr(self.params, name).numpy() for name in names))

    def record_workload(self) -> None:
        """Integrate the workload from now on; see `MuscleModel.record_workload`."""
        self.workload = wp.zeros_like(self.activation)

    def read_fibers(self, fibers: FiberStates) -> None:
        """Launch `read_mujoco_fibers`; see `MuscleModel.read_fibers`."""
        launch(read_mujoco_fibers, self.tension.shape, self, fibers=fibers)

    @property
    def tells_fibers(self) -> bool:
        """Whether the muscle is this one: fibers that a subclass adds are not known here."""
        return self.STATE == MuscleModel.STATE

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
        threads = num_threads(self.activation.device, self.activation.shape[1])
        launch(
            mujoco_muscle,
            (self.activation.shape[0], threads),
            self,
            data,
            model,
            opt_timestep=model.opt.timestep,
            threads=threads,
        )


MUSCLES.add("mujoco_readable", MujocoMuscle)
