"""MuJoCo's muscle in SIMD lanes: the law of mujoco.py in C++, for the CPU.

The twin pays for itself: with the readable kernel a control step of 256 hands takes 8 % longer (`parity`) or
12 % (`fast`), of 256 elbows 8 % or 15 %, on one core. `muscle="mujoco_readable"` does without it.
"""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.muscle import MUSCLES, Anatomy, BiasParams, MuscleResults
from myowarp.kernels.decay import DECAY
from myowarp.kernels.lanes import at_namespace_level, block_scratch, native_kernel
from myowarp.kernels.launch import launch
from myowarp.models.muscles.mujoco import MujocoMuscle, MujocoMuscleParams

MUSCLE_BLOCK = Path(__file__).with_name("muscle_block.cpp")
FILES = (DECAY, MUSCLE_BLOCK, Path(__file__).with_suffix(".cpp"))


@native_kernel(
    at_namespace_level(*FILES),
    does="""
    lanes::for_blocks(activation.shape[0], nullptr, scratch.data, [&](auto& block) {
        lanes::contract_block(block, params, anatomy, opt_timestep, midstep, implicitness, ctrl_in,
                              actuator_length_in, actuator_velocity_in, activation, results,
                              actuator_biasprm);
    });
    """,
)
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
    scratch: wp.array[float],
    implicitness: float,
    midstep: bool,
    anatomy: Anatomy,
    # Out:
    activation: wp.array2d[float],
    results: MuscleResults,
    actuator_biasprm: wp.array2d[BiasParams],
):
    """`mujoco_muscle`, to float32 rounding."""


class NativeMujocoMuscle(MujocoMuscle):
    """`MujocoMuscle` with the native kernel on the CPU; on CUDA every muscle has a thread of its own."""

    def __init__(
        self, model: mujoco.MjModel, num_worlds: int, parameters: Mapping[str, np.ndarray] | None = None
    ) -> None:
        """Allocate the memory of a block; see `MujocoMuscle`."""
        super().__init__(model, num_worlds, parameters)
        of_muscles, of_actuators = 7 * self.activation.shape[1], 3 * model.nu
        device = self.activation.device
        self.scratch = block_scratch(device, self.params, self.anatomy, of_muscles, of_actuators)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Engine callback; see `MuscleModel.launch`."""
        if not self.activation.device.is_cpu:
            super().launch(model, data)
            return
        launch(native_mujoco_muscle, 1, self, data, model, opt_timestep=model.opt.timestep)


MUSCLES.add("mujoco", NativeMujocoMuscle)
