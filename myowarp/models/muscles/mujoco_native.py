"""MuJoCo's muscle, eight at a time: the law of mujoco.py in C++ that becomes SIMD, for the CPU.

The twin pays for itself: with the readable kernel a control step of 256 hands takes 7 % longer (`parity`) or
11 % (`fast`), of 256 elbows 7 % or 15 %, on one core. `muscle="mujoco_readable"` does without it.
"""

from pathlib import Path

import warp as wp

from myowarp.kernels.batching import batched
from myowarp.kernels.decay import DECAY
from myowarp.models.muscles.mujoco import MujocoMuscle, MujocoMuscleParams
from myowarp.spec.muscle import MUSCLES, Anatomy, BiasParams


@wp.func_native(DECAY + Path(__file__).with_suffix(".cpp").read_text())
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
    tension: wp.array2d[float],
    musculotendon_length: wp.array2d[float],
    musculotendon_velocity: wp.array2d[float],
    damping: wp.array2d[float],
    actuator_biasprm: wp.array2d[BiasParams],
):
    """Let a world's muscles act, every `threads`-th of them or of their groups; see `mujoco_muscle`."""
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
    threads: int,
    anatomy: Anatomy,
    # Out:
    activation: wp.array2d[float],
    workload: wp.array2d[float],
    tension: wp.array2d[float],
    length: wp.array2d[float],
    velocity: wp.array2d[float],
    damping: wp.array2d[float],
    actuator_biasprm: wp.array2d[BiasParams],
):
    """`mujoco_muscle`, to float32 rounding."""
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
        tension,
        length,
        velocity,
        damping,
        actuator_biasprm,
    )


class NativeMujocoMuscle(MujocoMuscle):
    """`MujocoMuscle` with the native kernel on the CPU; on CUDA every muscle has a thread of its own."""

    cpu_kernel = native_mujoco_muscle


MUSCLES.add("mujoco", NativeMujocoMuscle)
