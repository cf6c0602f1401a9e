"""Launches one after the other, from a list of addresses; on the CPU."""

from enum import IntEnum, auto
from pathlib import Path

import warp as wp


class Operation(IntEnum):
    """The first word of a row of a program; the other three say with what."""

    FINISH = 0
    LAUNCH = auto()  # a kernel: addresses of its code, its bounds and its arguments
    SET = auto()  # bytes: address, value, number
    COPY = auto()  # bytes: address of the target, address of the source, number
    CALL = auto()  # a function of C: its address, two arguments
    TRY = auto()  # to get a yes, which skips a row: a function's address, argument, what is called after a no
    JUMP = auto()  # as many rows further, or back where negative
    JUMP_IF_ZERO = auto()  # an integer is 0: its address, as many rows further


TRIES = 1000  # at most, half a microsecond each with `sched_yield` between
SOURCE = (
    f"constexpr int TRIES = {TRIES};\n"
    f"enum {{ {', '.join(f'{operation.name} = {operation.value}' for operation in Operation)} }};\n"
    + Path(__file__).with_suffix(".cpp").read_text()
)


@wp.func_native(SOURCE)
def run(program: wp.array2d[wp.uint64], row: int):
    """Do what the rows from this one on say, up to FINISH."""
    ...


@wp.kernel(enable_backward=False, module="unique")
def replay(
    # In:
    program: wp.array2d[wp.uint64],
):
    """Run a program, which begins in row 0: for one thread."""
    row = wp.tid()
    run(program, row)
