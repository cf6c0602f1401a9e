"""Reward primitives that several task families share."""

import warp as wp


@wp.func
def indicator(condition: bool) -> float:
    """1 if the condition holds, else 0."""
    return wp.where(condition, 1.0, 0.0)


@wp.func
def activation_effort(activation: wp.array2d[float], worldid: int) -> float:
    """Norm of the activations divided by their number, MyoSuite's `act_mag`; 0 without muscles."""
    total = float(0.0)
    for i in range(activation.shape[1]):
        total += activation[worldid, i] * activation[worldid, i]
    return wp.sqrt(total) / wp.max(float(activation.shape[1]), 1.0)


EFFORT = ("1", "minus the effort: Euclidean norm of the activations over their number")
"""Unit and meaning of `-activation_effort`, the end of an entry of `definitions.task.weighted`."""


@wp.func
def squared_distance(
    target: wp.array2d[float], values: wp.array2d[float], address: wp.array[int], worldid: int
) -> float:
    """Sum of squared differences of `target[worldid]` and `values[worldid, address]`."""
    total = float(0.0)
    for i in range(target.shape[1]):
        difference = target[worldid, i] - values[worldid, address[i]]
        total += difference * difference
    return total
