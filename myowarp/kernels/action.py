"""Policy action in [-1, 1] to MuJoCo control.

Muscles: excitation = 1 / (1 + exp(-5 (a - 0.5))), MyoSuite's map: 0.001 at a = -1, 0.076 at 0, 0.924 at 1.
Motors of a body without muscles, and muscles where a task says so: linear onto their control range.
"""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import warp as wp

from myowarp.kernels.decay import DECAY
from myowarp.kernels.lanes import at_namespace_level

MUSCLE = wp.constant(0)
MOTOR = wp.constant(1)

STEEPNESS = 5.0  # of the sigmoid; MyoSuite 3.0.0
CENTER = 0.5  # action at which the excitation is 0.5; MyoSuite 3.0.0
LEAST_EXCITATION = 1e-6  # below what the action -1 gives, and finite under the logarithm

EXCITATION = f"excitation = 1 / (1 + exp(-{STEEPNESS:g} (action - {CENTER:g})))"
"""The excitation of a muscle, as a formula to print."""


LINEAR_EXCITATION = "excitation = (1 + action) / 2"
"""The same, where a task says so."""


def excitation(action: float, linear: bool = False) -> float:
    """Return the excitation that an action in [-1, 1] stands for; on the host, for people."""
    if linear:
        return 0.5 * (1.0 + action)
    return 1.0 / (1.0 + math.exp(-STEEPNESS * (action - CENTER)))


def action_of(excitation: npt.NDArray[np.floating], linear: bool = False) -> npt.NDArray[np.floating]:
    """Return the actions in [-1, 1] that come closest to excitations from 0 to 1, same shape; on the host."""
    if linear:
        return np.clip(2.0 * excitation - 1.0, -1.0, 1.0)
    inner = np.clip(excitation, LEAST_EXCITATION, 1.0 - LEAST_EXCITATION)
    return np.clip(CENTER + np.log(inner / (1.0 - inner)) / STEEPNESS, -1.0, 1.0)


FAULT_ACTION = wp.constant(8)

CONSTANTS = f"""
constexpr int MUSCLE = {MUSCLE};
constexpr float STEEPNESS = {STEEPNESS}f, CENTER = {CENTER}f;
"""
SOURCE = CONSTANTS + Path(__file__).with_suffix(".cpp").read_text()


@wp.func_native(at_namespace_level(DECAY))
def declare_decay(thread: int):
    """Declare the template of `decay.cpp`."""
    ...


@wp.func_native(SOURCE)
def map_action(
    worldid: int,
    actuator_kind: wp.array[int],
    actuator_ctrlrange: wp.array2d[wp.vec2],
    action: wp.array2d[float],
    ctrl: wp.array2d[float],
) -> bool:
    """Set a world's controls; returns whether all of its actions are finite. The others count as 0."""
    ...


@wp.kernel(enable_backward=False)
def apply_action(
    # Model:
    actuator_kind: wp.array[int],
    actuator_ctrlrange: wp.array2d[wp.vec2],
    # In:
    action: wp.array2d[float],
    # Data out:
    ctrl_out: wp.array2d[float],
    # Out:
    fault: wp.array[int],
):
    """ctrl = map(clip(action, -1, 1)); a world with a non-finite action is marked."""
    worldid = wp.tid()
    declare_decay(worldid)
    finite = map_action(worldid, actuator_kind, actuator_ctrlrange, action, ctrl_out)
    fault[worldid] = wp.where(finite, 0, FAULT_ACTION)
