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


def struct_of(kind: Any, /, **fields: Any) -> Any:
    """Return a struct; what is given for a field that is an array is put on the current device, in its type.

    Args:
        kind: A class that `wp.struct` decorated.
        **fields: Fields by name; of an array of structs the fields of each, as for `struct_array`. Arrays of
            Warp, structs, and single numbers and vectors stay as they are.
    """
    struct = kind()
    for name, value in fields.items():
        array = kind.vars[name].type
        if getattr(array, "ndim", 0) and not isinstance(value, wp.array):
            of_structs = isinstance(array.dtype, type(kind))
            value = struct_array(array.dtype, value) if of_structs else wp.array(value, dtype=array.dtype)
        setattr(struct, name, value)
    return struct


def zeros_of(
    kind: Any, others: int | tuple[int, ...] | None = None, /, **shapes: int | tuple[int, ...]
) -> Any:
    """Return a struct with arrays of zeros on the current device.

    Args:
        kind: A class that `wp.struct` decorated.
        others: Shape of all arrays that are not named; None: they stay empty.
        **shapes: Shapes by name.
    """
    struct = kind()
    every = {} if others is None else dict.fromkeys(kind.vars, others)
    for name, shape in (every | shapes).items():
        setattr(struct, name, wp.zeros(shape, dtype=kind.vars[name].type.dtype))
    return struct
