"""Arrays of the simulation for users of NumPy, torch or Warp, and their actions back."""

import importlib.util
from typing import Any

import numpy as np
import warp as wp

from myowarp.registry import check_choice

OUTPUTS = ("numpy", "torch", "warp")


class Output:
    """Gives arrays of the simulation as those of another library.

    The simulation never replaces its arrays, so what the CPU device can share is wrapped once.
    """

    def __init__(self, library: str, copy: bool) -> None:
        """Choose the library.

        Args:
            library: One of `OUTPUTS`.
            copy: Whether to copy; otherwise the result is a view wherever the device allows one, which for
                NumPy means the CPU.

        Raises:
            ValueError: It is none of `OUTPUTS`.
            ImportError: The library is not installed.
        """
        check_choice("output", library, OUTPUTS)
        if importlib.util.find_spec(library) is None:
            raise ImportError(
                f'output="{library}" needs {library}, which is not installed; '
                f'run `pip install "myowarp[{library}]"`'
            )
        self._library = library
        self._copy = copy
        self._views: dict[int, tuple[wp.array, Any]] = {}

    def __call__(self, array: wp.array) -> Any:
        """Return an array in the library's kind."""
        if self._library == "warp":
            return wp.clone(array) if self._copy else array
        view = self._view(array)
        if not self._copy:
            return view
        return view.clone() if self._library == "torch" else view.copy()

    def _view(self, array: wp.array) -> Any:
        """Return a view as a tensor or NumPy array; of an array on a GPU, NumPy gets a copy."""
        if id(array) in self._views:
            return self._views[id(array)][1]
        if self._library == "torch":
            view = wp.to_torch(array)
        else:
            view = array.numpy()
        if array.device.is_cpu:
            self._views[id(array)] = array, view  # the array too, so that no other gets its id
        return view


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
