"""Kernels' way through worlds: rows of batched arrays, and the number of threads."""

import math

import warp as wp


@wp.func
def batched(world: int, size: int) -> int:
    """Return a world's row of an array with `size` of them, world % size; a division takes long."""
    if world < size:
        return world
    if size == 1:
        return 0
    return world % size


@wp.func
def of_world(values: wp.array2d[float], world: int, index: int) -> float:
    """Return values[world, index] of an array (1 or num_worlds, n)."""
    return values[batched(world, values.shape[0]), index]


def as_rows(values: wp.array) -> wp.array:
    """Return an array (num_worlds, ...) as the same memory (num_worlds, n)."""
    return values.reshape((values.shape[0], math.prod(values.shape[1:])))


def num_threads(device: wp.Device, number: int) -> int:
    """Return in how many threads to walk through a number of things.

    One for each on a GPU; a single one on the CPU, which runs them in turn and copies a launch's arguments
    for every one.
    """
    return 1 if device.is_cpu else number
