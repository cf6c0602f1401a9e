"""Values from the host into arrays of the simulation."""

import numpy as np
import numpy.typing as npt
import warp as wp


def is_finite(numbers: npt.ArrayLike) -> np.ndarray:
    """Say which numbers are finite in float32, as arrays of the simulation hold them: 1e300 is not."""
    try:
        with np.errstate(over="ignore"):
            return np.isfinite(np.asarray(numbers, dtype=np.float64).astype(np.float32))
    except OverflowError:  # an integer beyond float64
        return np.zeros(np.shape(numbers), dtype=bool)


def write(array: wp.array, values: np.ndarray | wp.array) -> None:
    """Write values of the same shape into an array.

    On the CPU NumPy does it: Warp's own copy looks at the capture of whichever thread makes one, and fails
    when that ends meanwhile.
    """
    if not array.device.is_cpu or (isinstance(values, wp.array) and not values.device.is_cpu):
        array.assign(values)
        return
    host = values.numpy() if isinstance(values, wp.array) else values
    np.copyto(array.numpy(), host, casting="unsafe")
