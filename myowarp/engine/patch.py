"""Change what the engine's own stages launch, without changing the engine.

They launch by `wp.launch` and `wp.launch_tiled`; inside a `with` block these pass every kernel through a
function of ours first. How the engine finds shallow contacts is changed for good (`shallow_contacts`). If a
private name of the engine is gone, its own stage runs, and one line says so.
"""

import contextlib
import functools
import importlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import warp as wp

from myowarp.engine.replaced import replaced
from myowarp.engine.shallow_contacts import find_shallow_contacts
from myowarp.process import BUILD_LOCK, warn_once

find_shallow_contacts()


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
        BUILD_LOCK,
        replaced(wp, "launch", changing(wp.launch)),
        replaced(wp, "launch_tiled", changing(wp.launch_tiled)),
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


ONE_THREAD = (("solver", "_jtdaj_groups_per_world"), ("collision_convex", "_ccd_grid_size"))
"""Module and function of the engine that say in how many parts to split work on the CPU."""


@functools.cache
def _splits() -> tuple[tuple[Any, str], ...]:
    """Return those of `ONE_THREAD` that there are."""
    found = []
    for name, function in ONE_THREAD:
        try:
            module = importlib.import_module(f"mujoco_warp._src.{name}")
            getattr(module, function)
        except (ImportError, AttributeError) as error:
            warn_once(f"mujoco-warp has changed, its sums may depend on the number of worlds: {error}")
        else:
            found.append((module, function))
    return tuple(found)


@contextlib.contextmanager
def one_thread(device: wp.Device) -> Iterator[None]:
    """Have the engine split no work over threads in the block; on the CPU, which runs them in turn.

    Below 4 worlds mujoco-warp sums J' D J of a sparse model in several parts, and the rounding is another
    one; it looks for convex contacts in as many threads as there is room for, most of which find nothing.
    """
    with contextlib.ExitStack() as stack:
        for module, function in _splits() if device.is_cpu else ():
            stack.enter_context(replaced(module, function, lambda *args, **kwargs: 1))
        yield
