"""Import the engine in half the time."""

import contextlib
import gc
from collections.abc import Iterator
from unittest import mock


@contextlib.contextmanager
def quick_import() -> Iterator[None]:
    """Leave out half of what it takes to import Warp, mujoco-warp and our kernels in the block.

    Warp parses all their functions, a thousand, and half a million objects of this stay: not looking through
    them for garbage meanwhile takes a second off. And Warp looks in each function for those that it calls, to
    renew it where one of them is imported anew, as ours and the engine's must not be: not looking takes off
    another half second.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        with _references_unseen():
            yield
    finally:
        if collects:
            gc.enable()


def _references_unseen() -> contextlib.AbstractContextManager[object]:
    """Have Warp note no references of the modules that are imported in a block."""
    try:
        from warp._src.context import Module
    except ImportError:
        Module = object
    if not hasattr(Module, "_find_references"):  # private to Warp: without it, an import is only slower
        return contextlib.nullcontext()

    def find_none(module: Module, function: object) -> None:
        pass

    return mock.patch.object(Module, "_find_references", find_none)
