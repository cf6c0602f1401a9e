"""MuJoCo's muscle, eight at a time: the law of mujoco.py in C++ that becomes SIMD, for the CPU.

The twin pays for itself: with the readable kernel a control step of 256 hands takes 8 % longer (`parity`) or
12 % (`fast`), of 256 elbows 8 % or 15 %, on one core. `muscle="mujoco_readable"` does without it.
"""

from pathlib import Path

import mujoco_warp as mjw
import warp as wp

from myowarp.definitions.muscle import MUSCLES, Anatomy, BiasParams, MuscleResults
from myowarp.kernels.batching import batched
from myowarp.kernels.decay import DECAY
from myowarp.kernels.launch import launch
from myowarp.models.muscles.mujoco import MujocoMuscle, MujocoMuscleParams


@wp.func_native(DECAY + Path(__file__).with_suffix(".cpp").read_text())
def contract(
    world: int,
    params: MujocoMuscleParams,
    anatomy: Anatomy,
    dt: float,
    midstep: bool,
    implicitness: float,
    ctrl: wp.array2d[float],
    actuator_length: wp.array2d[float],
    actuator_velocity: wp.array2d[float],
    activation: wp.array2d[float],
    results: MuscleResults,
    actuator_biasprm: wp.array2d[BiasParams],
):
    """Let the muscles of a world act; see `mujoco_muscle`."""
    ...


@wp.kernel(enable_backward=False)
def native_mujoco_muscle(
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
    anatomy: Anatomy,
    # Out:
    activation: wp.array2d[float],
    results: MuscleResults,
    actuator_biasprm: wp.array2d[BiasParams],
):
    """`mujoco_muscle`, to float32 rounding."""
    worldid = wp.tid()
    dt = opt_timestep[batched(worldid, opt_timestep.shape[0])]
    contract(
        worldid,
        params,
        anatomy,
        dt,
        midstep,
        implicitness,
        ctrl_in,
        actuator_length_in,
        actuator_velocity_in,
        activation,
        results,
        actuator_biasprm,
    )


class NativeMujocoMuscle(MujocoMuscle):
    """`MujocoMuscle` with the native kernel on the CPU; on CUDA every muscle has a thread of its own."""

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Engine callback; see `MuscleModel.launch`."""
        if not self.activation.device.is_cpu:
            super().launch(model, data)
            return
        launch(
            native_mujoco_muscle,
            self.activation.shape[0],
            self,
            data,
            model,
            opt_timestep=model.opt.timestep,
        )


MUSCLES.add("mujoco", NativeMujocoMuscle)
