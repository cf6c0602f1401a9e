"""One construction at a time, and replaced functions for the thread alone that replaces them.

To build a simulation is to change what belongs to the whole process: the functions that launch, the capture
that is being made, the default device, the level of Warp's log. Two threads that built at the same time would
take each other's launches for their own. Steps go on meanwhile: a captured graph uses nothing of this.
"""

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterator
from typing import Any, ParamSpec, TypeVar
from unittest import mock

P = ParamSpec("P")
R = TypeVar("R")

BUILD_LOCK = threading.RLock()
"""Held by the thread that builds, or launches without a graph."""

if hasattr(os, "register_at_fork"):  # a child would inherit half of a construction, and nobody to end it
    os.register_at_fork(
        before=BUILD_LOCK.acquire, after_in_parent=BUILD_LOCK.release, after_in_child=BUILD_LOCK.release
    )


def with_build_lock(build: Callable[P, R]) -> Callable[P, R]:
    """Return a function that waits until no other thread builds."""

    @functools.wraps(build)
    def waiting(*args: P.args, **kwargs: P.kwargs) -> R:
        with BUILD_LOCK:
            return build(*args, **kwargs)

    return waiting


@contextlib.contextmanager
def replaced(holder: Any, name: str, function: Callable[..., Any]) -> Iterator[None]:
    """Replace a function in the block for the calling thread; other threads get the one that was there."""
    with BUILD_LOCK:
        mine, theirs = threading.get_ident(), getattr(holder, name)

        def chosen(*args: Any, **kwargs: Any) -> Any:
            return (function if threading.get_ident() == mine else theirs)(*args, **kwargs)

        with mock.patch.object(holder, name, chosen):
            yield
