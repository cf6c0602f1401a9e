"""The law of Hill muscles in float64, on the device."""

import warp as wp

from myowarp.laws.curves import CurveTables64
from myowarp.laws.muscles import hill_law

# Kernels of tests are compiled once and launched for a moment.
wp.set_module_options({"enable_backward": False, "optimization_level": 0})
Hill64 = hill_law.hill_muscle(wp.float64)


@wp.kernel
def velocity_64(
    m: wp.array2d[Hill64],
    tables: CurveTables64,
    a: wp.array[wp.float64],
    norm_length: wp.array[wp.float64],
    pull: wp.array[wp.float64],
    velocity: wp.array[wp.float64],
):
    i = wp.tid()
    one, tolerance = wp.float64(1.0), wp.float64(1e-13)
    found = hill_law.fiber_velocity(m[0, 0], tables, a[i], one, norm_length[i], pull[i], tolerance)
    velocity[i] = found[0]
