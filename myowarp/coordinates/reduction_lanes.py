"""`reduce_dynamics` of worlds in lanes, on the CPU device: for a walker a tenth of the time."""

from pathlib import Path

import warp as wp

from myowarp.coordinates.reduction import Acting, Damping, Followers, Moments, Reduced
from myowarp.engine.stages.arrays import InertiaRows
from myowarp.kernels.lanes import at_namespace_level, native_kernel


@native_kernel(
    at_namespace_level(Path(__file__).with_suffix(".cpp")),
    does="""
    lanes::for_blocks(slopes.shape[0], nullptr, scratch.data, [&](auto& block) {
        lanes::reduce_block(block, followers, inertia, damping, acting, moments, slopes, excess, reduced);
    });
    """,
)
def reduce_blocks(
    # Params:
    followers: Followers,
    inertia: InertiaRows,
    damping: Damping,
    # In:
    scratch: wp.array[float],
    acting: Acting,
    moments: Moments,
    slopes: wp.array2d[float],
    excess: wp.array2d[float],
    # Out:
    reduced: Reduced,
):
    """`reduce_dynamics`, to float32 rounding."""
