"""Values from the host into arrays of the simulation."""

import numpy as np
import warp as wp


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
