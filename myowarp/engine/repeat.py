"""The same launches several times in a row."""

from collections.abc import Callable

import warp as wp


@wp.kernel(enable_backward=False)
def count_down(
    # Out:
    countdown: wp.array[int],
):
    """countdown -= 1."""
    i = wp.tid()
    countdown[i] -= 1


def repeat(launches: Callable[[], None], times: int, countdown: wp.array) -> None:
    """Launch `launches` so many times.

    On the CPU this is a loop, whose graph holds them, and what they allocate, once. On CUDA a loop must not
    allocate, as `mjw.step` does.

    Args:
        launches: Launches kernels.
        times: How often, >= 1.
        countdown: Counter of the loop, shape (1,).
    """
    if not countdown.device.is_cpu:
        for _ in range(times):
            launches()
        return

    def once() -> None:
        launches()
        wp.launch(count_down, dim=1, outputs=[countdown])

    countdown.fill_(times)
    wp.capture_while(countdown, once)
