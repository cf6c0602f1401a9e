"""Arrays of Warp structs, each given by its fields in order, made by one thread at a time.

NumPy reads the shape of a struct's vectors with `ast`. Two threads that do so at once may end in a
`SystemError` before Python 3.11.8 and 3.12.1 (https://github.com/python/cpython/issues/106905).
"""

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

_PARSING = threading.Lock()


def struct_array(struct: Any, values: Sequence[tuple[Any, ...]]) -> wp.array:
    """Return an array of structs on the current device.

    Args:
        struct: A class that `wp.struct` decorated.
        values: The fields of each, in the order of the class.
    """
    with _PARSING:
        return wp.array(np.array(list(values), dtype=struct.numpy_dtype()), dtype=struct)
