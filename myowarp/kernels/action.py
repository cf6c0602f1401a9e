"""Policy action in [-1, 1] to MuJoCo control.

Muscles: excitation = 1 / (1 + exp(-5 (a - 0.5))), MyoSuite's map: 0 at rest, 0.924 at most. Motors of a
body without muscles: linear onto their control range.
"""

import warp as wp

MUSCLE = wp.constant(0)
MOTOR = wp.constant(1)

STEEPNESS = wp.constant(5.0)  # of the sigmoid; MyoSuite 3.0.0
CENTER = wp.constant(0.5)  # action at which the excitation is 0.5; MyoSuite 3.0.0

LARGEST = wp.constant(3.4028235e38)  # finite float32; comparing takes less time than `isfinite`

FAULT_ACTION = wp.constant(8)


@wp.func
def action_to_excitation(action: float) -> float:
    """Return the excitation in (0, 1)."""
    return 1.0 / (1.0 + wp.exp(-STEEPNESS * (action - CENTER)))


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
    """ctrl = map(clip(action, -1, 1)); a world with a non-finite action rests and is marked."""
    worldid = wp.tid()
    rangeid = worldid % actuator_ctrlrange.shape[0]
    mark = int(0)
    for i in range(action.shape[1]):
        a = action[worldid, i]
        if not (wp.abs(a) <= LARGEST):
            mark = FAULT_ACTION
            a = float(0.0)
        a = wp.clamp(a, -1.0, 1.0)
        if actuator_kind[i] == MUSCLE:
            ctrl_out[worldid, i] = action_to_excitation(a)
        else:
            low = actuator_ctrlrange[rangeid, i][0]
            high = actuator_ctrlrange[rangeid, i][1]
            ctrl_out[worldid, i] = 0.5 * (low + high) + 0.5 * (high - low) * a
    fault[worldid] = mark
