"""Arrays of the simulation for users of NumPy, torch or Warp, and their actions back."""

import importlib.util
from typing import Any

import numpy as np
import warp as wp

from myowarp.registry import check_choice

OUTPUTS = ("numpy", "torch", "warp")


def to_output(array: wp.array, output: str, copy: bool) -> Any:
    """Return an array as one of `OUTPUTS`.

    Args:
        array: Array of the simulation.
        output: Library.
        copy: Whether to copy; otherwise the result is a view wherever the device allows one, which for
            NumPy means the CPU.
    """
    if output == "warp":
        return wp.clone(array) if copy else array
    if output == "torch":
        tensor = wp.to_torch(array)
        return tensor.clone() if copy else tensor
    host = array.numpy()
    return host.copy() if copy else host


def checked_action(actions: Any, shape: tuple[int, ...]) -> Any:
    """Return actions as something that `wp.array.assign` takes.

    Args:
        actions: NumPy array, torch tensor or Warp array of floating point numbers.
        shape: Shape required.

    Raises:
        ValueError: Wrong shape or dtype; or on the host an entry that is not finite. Entries on another
            device are not looked at, which would wait for it.
    """
    if isinstance(actions, wp.array):
        if actions.shape != shape or actions.dtype != wp.float32:
            raise ValueError(
                f"actions must be float32 of shape {shape}, "
                f"got {actions.dtype.__name__} of shape {actions.shape}"
            )
        return actions
    if hasattr(actions, "detach"):
        tensor = actions.detach()
        _check(str(tensor.dtype), tensor.is_floating_point(), tuple(tensor.shape), shape)
        tensor = tensor.float().contiguous()
        if tensor.device.type != "cpu":
            return wp.from_torch(tensor)
        actions = tensor.numpy()
    host = np.asarray(actions)
    _check(str(host.dtype), np.issubdtype(host.dtype, np.floating), host.shape, shape)
    if not np.isfinite(host).all():
        worlds = np.flatnonzero(~np.isfinite(host).all(axis=1)).tolist()
        raise ValueError(f"actions must be finite, got NaN or infinity for worlds {worlds}")
    return np.ascontiguousarray(np.clip(host, -1.0, 1.0), dtype=np.float32)


def _check(dtype: str, floating: bool, got: tuple[int, ...], required: tuple[int, ...]) -> None:
    """Raise ValueError for a wrong dtype or shape."""
    if not floating or got != required:
        raise ValueError(f"actions must be floating point of shape {required}, got {dtype} of shape {got}")


def check_output(output: str) -> str:
    """Return an output that can be had.

    Raises:
        ValueError: It is none of `OUTPUTS`.
        ImportError: Its library is not installed.
    """
    check_choice("output", output, OUTPUTS)
    if importlib.util.find_spec(output) is None:
        raise ImportError(
            f'output="{output}" needs {output}, which is not installed; run `pip install "myowarp[{output}]"`'
        )
    return output
