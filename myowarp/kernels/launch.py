"""Launch a kernel by the names of its parameters."""

import inspect
from functools import cache
from typing import Any

import warp as wp


@cache
def _arguments(kernel: wp.Kernel) -> tuple[str, ...]:
    """Return the names of a kernel's arguments: its parameters without `_in` and `_out`."""
    parameters = inspect.signature(kernel.func).parameters
    return tuple(name.removesuffix("_in").removesuffix("_out") for name in parameters)


def launch(
    kernel: wp.Kernel, dim: int | tuple[int, ...], *owners: object, block_dim: int = 256, **given: Any
) -> None:
    """Launch a kernel whose arguments are found by name.

    A parameter `x`, `x_in` or `x_out` is what is given as `x`, else the attribute `x` of the first owner that
    has it. `wp.launch` takes arguments by position and checks only dtype and rank, so that swapped arrays of
    one kind would go unseen.

    Args:
        kernel: The kernel.
        dim: Its threads.
        *owners: Objects whose attributes are arguments.
        block_dim: Threads of a block on CUDA.
        **given: Arguments by the parameter's name, without `_in` or `_out`.

    Raises:
        TypeError: An argument is missing, or given and not wanted.
    """
    names = _arguments(kernel)
    if surplus := given.keys() - set(names):
        raise TypeError(f"kernel {kernel.key} takes {', '.join(names)}, got {', '.join(sorted(surplus))} too")
    reader = f"kernel {kernel.key}"
    inputs = [given[name] if name in given else find(name, owners, reader) for name in names]
    wp.launch(kernel, dim=dim, inputs=inputs, block_dim=block_dim)


def find(name: str, owners: tuple[object, ...], reader: str) -> Any:
    """Return the attribute of the first owner that has it.

    Args:
        name: Its name.
        owners: Objects that may have it.
        reader: What needs it, for the message.

    Raises:
        TypeError: None has it.
    """
    for owner in owners:
        if hasattr(owner, name):
            return getattr(owner, name)
    kinds = ", ".join(type(owner).__name__ for owner in owners)
    raise TypeError(f"{reader} needs {name!r}; it is not given, and no attribute of {kinds}")
