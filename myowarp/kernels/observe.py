"""Packing of state into the columns of an observation row."""

import warp as wp


@wp.func_native("""
const float* __restrict__ from = &wp::index(values, worldid, first);
float* __restrict__ to = &wp::index(obs, worldid, column);
for (int i = 0; i < count; ++i)
    to[i] = scale * from[i];
""")
def pack_range(
    obs: wp.array2d[float],
    worldid: int,
    column: int,
    values: wp.array2d[float],
    first: int,
    count: int,
    scale: float,
):
    """Write `scale * values[worldid, first : first + count]`; native, which becomes SIMD."""
    ...


@wp.func
def pack(obs: wp.array2d[float], worldid: int, column: int, values: wp.array2d[float], scale: float):
    """Write `scale * values[worldid]`."""
    pack_range(obs, worldid, column, values, 0, values.shape[1], scale)


@wp.kernel(enable_backward=False)
def observe_rows(
    # In:
    mask: wp.array[bool],
    values: wp.array2d[float],
    column: int,
    # Out:
    obs: wp.array2d[float],
):
    """obs[world, column + i] = values[world, i] in the worlds of the mask."""
    worldid, i = wp.tid()
    if mask[worldid]:
        obs[worldid, column + i] = values[worldid, i]


def masked_observe(mask: wp.array, values: wp.array, column: int, obs: wp.array) -> None:
    """Write `values` (num_worlds, n) into `obs` from `column` on, in the worlds of `mask` (num_worlds,)."""
    wp.launch(observe_rows, dim=values.shape, inputs=[mask, values, column], outputs=[obs])
