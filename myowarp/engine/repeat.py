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
    """Launch `launches` so many times, in a loop, so that a graph holds them once.

    On CUDA a loop must not allocate, as the engine does: see `Arena`.

    Args:
        launches: Launches kernels.
        times: How often, >= 1.
        countdown: Counter of the loop, shape (1,).
    """

    def once() -> None:
        launches()
        wp.launch(count_down, dim=1, outputs=[countdown])

    countdown.fill_(times)
    wp.capture_while(countdown, once)
