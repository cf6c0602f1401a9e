"""Lengths that are polynomials of coordinates, in SIMD lanes on the CPU: a world in each lane.

The twin of `path.polynomial_length` pays for itself: 92 paths of a gait model, polynomials of order 5, take a
sixteenth of the time.
"""

from pathlib import Path

import warp as wp

from myowarp.kernels.lanes import DOUBLES, at_namespace_level
from myowarp.laws.paths.path import MOST_VARIABLES, PathTables

wp.set_module_options({"enable_backward": False})

SOURCE = Path(__file__).with_suffix(".cpp")


@wp.func_native(at_namespace_level(DOUBLES, SOURCE, MOST_VARIABLES=MOST_VARIABLES))
def declare_follow_polynomials(thread: int):
    """Declare the template of `polynomials.cpp`."""
    ...


@wp.func_native("""
    lanes::follow_polynomials(scratch.data, tables, numbers, value, length, by_variable);
""")
def follow_all_polynomials(
    scratch: wp.array[wp.float64],
    tables: PathTables,
    numbers: wp.array[int],
    value: wp.array2d[wp.float64],
    length: wp.array2d[wp.float64],
    by_variable: wp.array2d[wp.float64],
):
    """Compute lengths and derivatives in all worlds, as many at a time as there are lanes."""
    ...


@wp.kernel(enable_backward=False)
def follow_polynomials(
    # Params:
    tables: PathTables,
    numbers: wp.array[int],
    # In:
    value: wp.array2d[wp.float64],
    scratch: wp.array[wp.float64],
    # Out:
    length: wp.array2d[wp.float64],
    by_variable: wp.array2d[wp.float64],
):
    """Length = sum c x_1^p_1 ... x_n^p_n of paths of these numbers, and its derivatives by the variables."""
    thread = wp.tid()
    declare_follow_polynomials(thread)
    follow_all_polynomials(scratch, tables, numbers, value, length, by_variable)
