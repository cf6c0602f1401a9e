"""`optimize_activations` for p = 2 on the CPU: a run of frames in each SIMD lane.

The twin pays for itself: static optimisation of 54 muscles takes a fifth of the time.
"""

from pathlib import Path

import warp as wp

from myowarp.kernels.lanes import DOUBLES, WIDEST, at_namespace_level, native_kernel
from myowarp.kernels.launch import launch
from myowarp.motion import dual_newton
from myowarp.motion.dual_newton import Problem

CONSTANTS: dict[str, float] = {
    name: getattr(dual_newton, name)
    for name in ("SOFTNESS", "STEPS", "TOLERANCE", "ROUNDING", "ARMIJO", "HALVINGS")
}

wp.set_module_options({"enable_backward": False})


@native_kernel(
    at_namespace_level(DOUBLES, Path(__file__).with_suffix(".cpp"), **CONSTANTS),
    does="lanes::optimize_runs(scratch.data, problem, first, dual, activation, missing, residual);",
)
def optimize_activations_in_lanes(
    # In:
    problem: Problem,
    first: wp.array[int],
    scratch: wp.array[wp.float64],
    # Out:
    dual: wp.array2d[wp.float64],
    activation: wp.array2d[wp.float64],
    missing: wp.array2d[wp.float64],
    residual: wp.array[wp.float64],
):
    """`optimize_activations` for p = 2, to rounding."""


def optimize_in_lanes(problem: Problem, first: wp.array[int], dual: wp.array2d[wp.float64], **out: wp.array):
    """Solve runs of frames from the dual that is there, see `optimize_activations`."""
    (count, width), rows = problem.row.shape, problem.right.shape[1]
    numbers = count * (width + 3) + rows * (rows + 7)
    scratch = wp.empty((numbers + 1) * WIDEST, dtype=wp.float64)
    launch(optimize_activations_in_lanes, 1, problem=problem, first=first, scratch=scratch, dual=dual, **out)
