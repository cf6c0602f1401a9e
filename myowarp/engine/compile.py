"""Compile all kernels of a step before it runs: in parallel, with progress.

Warp compiles a module when one of its kernels is first launched, one after the other: half a minute of
silence for a hand. Here the launches are first only listed, then their modules are compiled on all cores.
"""

import contextlib
import logging
import os
import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import cache
from pathlib import Path
from typing import Any

import warp as wp

from myowarp.engine.kernel_cache import load_module
from myowarp.engine.patch import is_empty
from myowarp.engine.replaced import replaced
from myowarp.process import BUILD_LOCK, warn_once
from myowarp.progress import patient_bar

logger = logging.getLogger("myowarp")

PATIENCE = 0.5  # s without a word
BLOCK_DIM = 256  # threads of a block on CUDA where a launch names none; Warp's


@contextlib.contextmanager
def recorded() -> Iterator[list[tuple[wp.Module, int]]]:
    """Note all launches that have threads instead of launching; what a loop repeats counts once.

    Yields:
        Module and threads of a block of each launch, in their order.
    """
    found: list[tuple[wp.Module, int]] = []

    def launch(*args: Any, **kwargs: Any) -> None:
        kernel = args[0] if args else kwargs["kernel"]
        if is_empty(*args, **kwargs):
            return
        if kernel.is_generic:
            _specialise(*args, **kwargs)
        found.append((kernel.module, kwargs.get("block_dim") or BLOCK_DIM))

    def call_while(condition: Any, while_body: Callable[..., None], **kwargs: Any) -> None:
        while_body(**kwargs)

    def call_if(condition: Any, on_true: Any = None, on_false: Any = None, **kwargs: Any) -> None:
        for branch in (on_true, on_false):
            if callable(branch):
                branch(**kwargs)

    with (
        replaced(wp, "launch", launch),
        replaced(wp, "launch_tiled", launch),
        replaced(wp, "capture_while", call_while),
        replaced(wp, "capture_if", call_if),
    ):
        yield found


def _specialise(
    kernel: wp.Kernel, dim: Any = None, inputs: Sequence[Any] = (), outputs: Sequence[Any] = (), **_: Any
) -> None:
    """Give a kernel of any types the form for these arguments.

    Warp does so at the launch, and then compiles the module once more, which has a form more than on disk.
    """
    kernel.add_overload(kernel.infer_argument_types([*inputs, *outputs]))


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep Warp's log of loaded modules off the terminal."""
    with BUILD_LOCK:
        level = wp.config.log_level
        wp.config.log_level = max(level, wp.LOG_ERROR)
        try:
            yield
        finally:
            wp.config.log_level = level


def compile_kernels(
    launches: Callable[[], None], device: wp.Device, show: bool = True
) -> tuple[wp.Module, ...]:
    """Compile and load the modules of every kernel that `launches` launches.

    Args:
        launches: Launches kernels; it is called once, with launching switched off.
        device: Where they will run.
        show: Whether to draw a progress bar once this takes longer than a moment.

    Returns:
        The modules.
    """
    with recorded() as found:
        launches()
    # CUDA's machine code is made for one number of threads, the CPU's serves all.
    wanted = list(dict.fromkeys((module, 1 if device.is_cpu else block_dim) for module, block_dim in found))
    # Processes that start at once take from disk what another has compiled: each begins with other modules.
    random.Random().shuffle(wanted)
    damaged: list[Path] = []
    with (
        patient_bar("Compiling kernels", "modules", len(wanted), patience=PATIENCE, show=show) as advance,
        ThreadPoolExecutor(os.cpu_count()) as pool,
    ):
        for load in as_completed(
            pool.submit(load_module, module, device, block_dim) for module, block_dim in wanted
        ):
            if (folder := load.result()) is not None:
                damaged.append(folder)
            advance(1)
    if damaged:
        logger.warning(
            "compiled kernels were damaged or changed on disk and are compiled anew: %d modules in %s",
            *(len(damaged), damaged[0].parent),
        )
    return tuple(dict.fromkeys(module for module, _ in found))


@cache
def can_renew_code() -> bool:
    """Whether Warp's modules keep their machine code where `renew_code` looks for it."""
    return hasattr(wp.Module, "execs") or "execs" in vars(wp.get_module(__name__))


def renew_code(modules: Iterable[wp.Module]) -> None:
    """Have Warp load the machine code of modules once more when they are next launched on the CPU.

    Tile kernels keep the address of their scratch memory in a static variable of their module (Warp's
    `tile.h`), so that two threads must never run the same code of such a kernel. Graphs captured from here on
    have code of their own; those captured before keep theirs.
    """
    if not can_renew_code():
        warn_once("Warp has changed: parts of the worlds step one after the other, which is slower")
        return
    for module in modules:
        module.execs = {key: loaded for key, loaded in module.execs.items() if not loaded.device.is_cpu}
