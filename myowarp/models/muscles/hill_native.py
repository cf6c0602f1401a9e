"""Hill muscles in SIMD lanes: the laws of hill_law.py in C++, for the CPU.

The twin pays for itself: with the readable kernel a physics step of 64 hands in 16 lanes takes 3.5 times as
long under elastic tendons, twice as long under rigid ones. CUDA and float64 have the readable laws.
"""

from pathlib import Path

import warp as wp

from myowarp.definitions.muscle import Anatomy, BiasParams, MuscleResults
from myowarp.kernels.decay import DECAY
from myowarp.kernels.lanes import at_namespace_level, native_kernel
from myowarp.laws.muscles import hill_law
from myowarp.laws.muscles.thelen2003 import TOE_GROWTH, TOE_SHARE
from myowarp.models.muscles.hill_kernels import (
    Fibers,
    HillParams,
)
from myowarp.models.muscles.mujoco_native import MUSCLE_BLOCK

PLACES = (*hill_law.NUMBERS, *hill_law.PARAMETERS)
CONSTANTS: dict[str, float] = {name.upper(): place for place, name in enumerate(PLACES)} | {
    "NUM_WORDS": len(PLACES),
    "THELEN": int(hill_law.THELEN),
    "MILLARD": int(hill_law.MILLARD),
    "DEGROOTE": int(hill_law.DEGROOTE),
    "SCHUTTE": int(hill_law.SCHUTTE),
    "TOE_GROWTH": float(TOE_GROWTH),
    "TOE_SHARE": float(TOE_SHARE),
    "TOLERANCE": float(hill_law.TOLERANCE),
    "NEWTON": float(hill_law.NEWTON),
    "NEWTON_SPEED": float(hill_law.NEWTON_SPEED),
}


@native_kernel(
    at_namespace_level(DECAY, MUSCLE_BLOCK, Path(__file__).with_suffix(".cpp"), **CONSTANTS),
    does="""
    lanes::for_blocks(fibers.activation.shape[0], nullptr, scratch.data, [&](auto& block) {
        lanes::contract_hill_block(block, params, anatomy, opt_timestep, midstep, implicitness, ctrl_in,
                                   actuator_length_in, actuator_velocity_in, fibers, results,
                                   actuator_biasprm);
    });
    """,
)
def native_contract_hill(
    # Model:
    opt_timestep: wp.array[float],
    # Params:
    params: HillParams,
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
    fibers: Fibers,
    results: MuscleResults,
    actuator_biasprm: wp.array2d[BiasParams],
):
    """`contract_hill`, to float32 rounding."""
