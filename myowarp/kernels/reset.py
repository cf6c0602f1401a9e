"""Masked reset of world state, and draws of an episode; nothing here allocates or reads back."""

from typing import Any

import mujoco_warp as mjw
import warp as wp

from myowarp.kernels.batching import as_rows
from myowarp.kernels.launch import launch
from myowarp.kernels.random import POSTURE, RandomKeys, open_stream


@wp.kernel(enable_backward=False)
def fill_rows(
    # In:
    mask: wp.array[bool],
    value: float,
    # Out:
    values: wp.array2d[float],
):
    """values[world, :] = value in the worlds of the mask."""
    worldid = wp.tid()
    if mask[worldid]:
        for i in range(values.shape[1]):
            values[worldid, i] = value


def masked_fill(mask: wp.array, values: wp.array, value: float) -> None:
    """Set the rows of `values` (num_worlds, ...) that `mask` (num_worlds,) selects to `value`."""
    wp.launch(fill_rows, dim=values.shape[0], inputs=[mask, value], outputs=[as_rows(values)])


@wp.kernel(enable_backward=False)
def copy_rows(
    # In:
    mask: wp.array[bool],
    source: wp.array2d[Any],
    # Out:
    target: wp.array2d[Any],
):
    """target[world, :] = source[world, :] in the worlds of the mask."""
    worldid = wp.tid()
    if mask[worldid]:
        for i in range(target.shape[1]):
            target[worldid, i] = source[worldid, i]


def masked_copy(mask: wp.array | None, source: wp.array, target: wp.array) -> None:
    """Copy the rows of `source` (num_worlds, ...) that `mask` (num_worlds,) selects; None: all."""
    if mask is None:
        wp.copy(target, source)
    else:
        wp.launch(copy_rows, dim=mask.shape, inputs=[mask, as_rows(source)], outputs=[as_rows(target)])


@wp.kernel(enable_backward=False)
def reset_world(
    # In:
    mask: wp.array[bool],
    qpos_start: wp.array[float],
    # Data out:
    qpos_out: wp.array2d[float],
    qvel_out: wp.array2d[float],
    ctrl_out: wp.array2d[float],
    qacc_warmstart_out: wp.array2d[float],
    time_out: wp.array[float],
    overflow_out: wp.array[int],
):
    """Put the worlds of the mask into the start configuration at rest."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    for i in range(qpos_out.shape[1]):
        qpos_out[worldid, i] = qpos_start[i]
    for i in range(qvel_out.shape[1]):
        qvel_out[worldid, i] = 0.0
        qacc_warmstart_out[worldid, i] = 0.0
    for i in range(ctrl_out.shape[1]):
        ctrl_out[worldid, i] = 0.0
    time_out[worldid] = 0.0
    overflow_out[worldid] = 0


def reset_worlds(mask: wp.array, qpos_start: wp.array, data: mjw.Data) -> None:
    """Reset the mechanical state of the worlds that `mask` (num_worlds,) bool selects.

    Everything else in `data` is recomputed from this state by the next step.
    """
    launch(reset_world, data.nworld, data, mask=mask, qpos_start=qpos_start)


@wp.kernel(enable_backward=False)
def place_start(
    # Params:
    starts: wp.array2d[float],
    start_address: wp.array[int],
    # In:
    keys: RandomKeys,
    reset: wp.array[bool],
    # Data out:
    qpos_out: wp.array2d[float],
):
    """qpos[address] = a row of the table, drawn uniformly."""
    worldid = wp.tid()
    if not reset[worldid]:
        return
    state = open_stream(keys, worldid, POSTURE)
    row = wp.randi(state, 0, starts.shape[0])
    for i in range(start_address.shape[0]):
        qpos_out[worldid, start_address[i]] = starts[row, i]


@wp.kernel(enable_backward=False)
def sample_uniform(
    # In:
    low: wp.array[float],
    high: wp.array[float],
    choices: wp.array[float],
    stream: int,
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    drawn: wp.array2d[float],
):
    """drawn ~ U(low, high); or one of the choices, where there are such."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, stream)
    for i in range(drawn.shape[1]):
        if choices.shape[0] > 0:
            drawn[worldid, i] = choices[wp.randi(state, 0, choices.shape[0])]
        else:
            drawn[worldid, i] = wp.randf(state, low[i], high[i])
