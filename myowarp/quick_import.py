"""Import the engine in half the time."""

import contextlib
import gc
from collections.abc import Iterator
from unittest import mock


@contextlib.contextmanager
def quick_import() -> Iterator[None]:
    """Leave out half of what it takes to import Warp, mujoco-warp and our kernels in the block.

    Warp parses all their functions, a thousand. The half a million objects of this stay: not looking through
    them for garbage, now and later, takes two seconds off start and exit. And Warp looks in each function for
    those that it calls, so that a module imported anew renews others; these never are: not looking takes off
    another half second.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        with _imported_once():
            yield
    finally:
        gc.freeze()
        if collects:
            gc.enable()


def _imported_once() -> contextlib.AbstractContextManager[object]:
    """Have Warp note no references of the modules that are imported in a block."""
    from warp._src.context import Module

    if not hasattr(Module, "_find_references"):  # private to Warp: without it, an import is only slower
        return contextlib.nullcontext()
    return mock.patch.object(Module, "_find_references")
