"""Change what the engine launches, without changing the engine.

Its functions launch by `wp.launch` and `wp.launch_tiled`; for a block these pass every kernel through a
function of ours first.
"""

import contextlib
import functools
from collections.abc import Callable, Iterable, Iterator
from typing import Any
from unittest import mock

import warp as wp


def is_empty(*args: Any, **kwargs: Any) -> bool:
    """Whether a launch with these arguments has no threads, as the engine's for what a model lacks.

    Warp makes nothing of such a launch, so that its kernel need not be compiled.
    """
    dim = kwargs["dim"] if "dim" in kwargs else args[1]
    return 0 in (dim if isinstance(dim, Iterable) else (dim,))


@contextlib.contextmanager
def exchanged(change: Callable[[wp.Kernel], wp.Kernel | None]) -> Iterator[None]:
    """Launch `change(kernel)` in place of each kernel in the block, nothing where that is None.

    Launches without threads are left out.
    """

    def changing(launch: Callable[..., Any]) -> Callable[..., Any]:
        def launch_changed(kernel: wp.Kernel, *args: Any, **kwargs: Any) -> Any:
            chosen = None if is_empty(kernel, *args, **kwargs) else change(kernel)
            return None if chosen is None else launch(chosen, *args, **kwargs)

        return launch_changed

    with (
        mock.patch.object(wp, "launch", changing(wp.launch)),
        mock.patch.object(wp, "launch_tiled", changing(wp.launch_tiled)),
    ):
        yield


@functools.cache
def _alone(kernel: wp.Kernel) -> wp.Kernel:
    """Return a copy of a kernel of the engine that has a module of its own; others as they are.

    Warp compiles modules whole, and the engine's hold dozens of kernels of which a step launches a few: alone
    these are ready in half the time.
    """
    module = kernel.module
    if kernel.is_generic or len(module.kernels) == 1 or not module.name.startswith("mujoco_warp."):
        return kernel
    return wp.kernel(kernel.func, module="unique", module_options=dict(module.options), **kernel.options)


def engine_kernels_alone() -> contextlib.AbstractContextManager[None]:
    """Launch each kernel of the engine from a module of its own in the block."""
    return exchanged(_alone)
