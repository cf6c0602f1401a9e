"""Import the engine in half the time."""

import contextlib
import gc
from collections.abc import Iterator
from typing import Any
from unittest import mock


@contextlib.contextmanager
def quick_import() -> Iterator[None]:
    """Leave out half of what it takes to import Warp, mujoco-warp and our kernels in the block.

    Warp parses every function of the engine, a thousand. The half a million objects of this stay: not looking
    through them for garbage, now and later, takes two seconds off start and exit. And Warp looks in each
    function for those that it calls, so that a module imported anew renews others; the engine's never are:
    not looking takes off another half second.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        with _engine_stays():
            yield
    finally:
        gc.freeze()
        if collects:
            gc.enable()


@contextlib.contextmanager
def _engine_stays() -> Iterator[None]:
    """Have Warp note no references of the engine's modules."""
    from warp._src.context import Module

    scan = getattr(Module, "_find_references", None)
    if scan is None:  # private to Warp: without it, an import is only slower
        yield
        return

    def scan_others(module: Any, function: Any) -> None:
        if not module.name.startswith("mujoco_warp."):
            scan(module, function)

    with mock.patch.object(Module, "_find_references", scan_others):
        yield
