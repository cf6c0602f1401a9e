"""Arrays of the simulation for users of NumPy, torch or Warp, and their actions back."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import warp as wp

from myowarp.definitions.registry import check_choice
from myowarp.extras import check_installed
from myowarp.kernels.write import write
from myowarp.process import with_build_lock

OUTPUTS = ("numpy", "torch", "warp")


class Output:
    """Gives arrays of the simulation as those of another library."""

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
        check_installed(f'output="{library}"', library, library)
        self._library = library
        self._copy = copy

    def of(self, arrays: Mapping[str, wp.array]) -> Callable[[], dict[str, Any]]:
        """Return a function that returns these arrays, by name, in the library's kind.

        The simulation never replaces its arrays, so that what can be shared is wrapped once, here: a dozen
        wrappings take as long as a step of a few elbows.
        """
        library, copy = self._library, self._copy
        if library == "warp":
            return lambda: _cloned(arrays) if copy else dict(arrays)
        if library == "torch":
            tensors = {name: wp.to_torch(array) for name, array in arrays.items()}
            return lambda: {name: tensor.clone() if copy else tensor for name, tensor in tensors.items()}
        if not all(array.device.is_cpu for array in arrays.values()):
            return lambda: {name: array.numpy() for name, array in arrays.items()}
        views = {name: array.numpy() for name, array in arrays.items()}
        return lambda: {name: view.copy() if copy else view for name, view in views.items()}


@with_build_lock
def _cloned(arrays: Mapping[str, wp.array]) -> dict[str, wp.array]:
    """Return copies of arrays by name."""
    return {name: wp.clone(array) for name, array in arrays.items()}


def dense(tensor: Any) -> Any:
    """Return a torch tensor without its gradient.

    Raises:
        ValueError: It is sparse, or has no values.
    """
    tensor = tensor.detach()
    if tensor.is_meta or str(tensor.layout) != "torch.strided":
        raise ValueError(
            f"actions must be a dense tensor with values, got {tensor.layout} on {tensor.device}"
        )
    return tensor


def on_host(tensor: Any) -> np.ndarray:
    """Return the values of a torch tensor; as float32 where it has fewer bits, since NumPy has no bfloat16.

    Raises:
        ValueError: It is sparse, or has no values.
    """
    tensor = dense(tensor).cpu()
    host: np.ndarray = (tensor if tensor.dtype.itemsize == 8 else tensor.float()).numpy()
    return host


class ActionInput:
    """Takes the actions of users of NumPy, torch or Warp."""

    def __init__(self, action: wp.array) -> None:
        """Choose the array of float32 to write them to."""
        self._action = action
        self._host = action.numpy() if action.device.is_cpu else None

    def __call__(self, actions: Any) -> None:
        """Write actions, which `kernels.action` clips to [-1, 1].

        Args:
            actions: NumPy array, torch tensor or Warp array of floating point numbers.

        Raises:
            ValueError: Wrong shape or dtype, or a tensor without values; or on the host an entry that is not
                finite. Entries on another device are not looked at, which would wait for it. Nothing is
                written.
        """
        if isinstance(actions, wp.array):
            if actions.shape != self._action.shape or actions.dtype != wp.float32:
                raise ValueError(
                    f"actions must be float32 of shape {self._action.shape}, "
                    f"got {actions.dtype.__name__} of shape {actions.shape}"
                )
            write(self._action, actions)
            return
        if hasattr(actions, "detach"):
            tensor = dense(actions)
            self._check(tensor.dtype, tensor.is_floating_point(), tuple(tensor.shape))
            if tensor.device.type != "cpu":
                self._action.assign(wp.from_torch(tensor.float().contiguous()))
                return
            actions = on_host(tensor)
        try:
            host = np.asarray(actions)
        except (ValueError, RuntimeError) as error:  # rows of several lengths, or parts that are no arrays
            raise ValueError(
                f"actions must be floating point of shape {self._action.shape}, got {type(actions).__name__} "
                "that is no array"
            ) from error
        self._check(host.dtype, host.dtype.kind == "f", host.shape)
        finite = np.isfinite(host)
        if np.count_nonzero(finite) < finite.size:
            worlds = np.flatnonzero(~finite.all(axis=1)).tolist()
            first = f"{worlds[:5]}" + (f" and {len(worlds) - 5} more" if len(worlds) > 5 else "")
            raise ValueError(f"actions must be finite, got NaN or infinity for worlds {first}")
        if host.dtype != np.float32:
            host = host.clip(-1.0, 1.0).astype(np.float32)  # which may not hold what is larger
        if self._host is None:
            self._action.assign(host)
        else:
            np.copyto(self._host, host)

    def _check(self, dtype: Any, floating: bool, shape: tuple[int, ...]) -> None:
        """Raise ValueError for a wrong dtype or shape."""
        if not floating or shape != self._action.shape:
            raise ValueError(
                f"actions must be floating point of shape {self._action.shape}, got {dtype} of shape {shape}"
            )
