"""Functions that are replaced for the thread alone that replaces them."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

from myowarp.process import BUILD_LOCK


@contextlib.contextmanager
def replaced(holder: Any, name: str, function: Callable[..., Any]) -> Iterator[None]:
    """Replace a function in the block for the calling thread; other threads get the one that was there."""
    with BUILD_LOCK:
        mine, theirs = threading.get_ident(), getattr(holder, name)

        def chosen(*args: Any, **kwargs: Any) -> Any:
            return (function if threading.get_ident() == mine else theirs)(*args, **kwargs)

        with mock.patch.object(holder, name, chosen):
            yield
