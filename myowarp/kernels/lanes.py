"""Worlds in SIMD lanes, for native functions whose steps are alike in every world, on the CPU device.

A tree of bodies is the same in all worlds, so that 4, 8 or 16 of them, as many as a vector register of the
machine holds, go through it at once. `lanes.cpp` has the vectors, and moves rows of the engine's arrays into
them and back. Code for it runs a world at a time, too, with the same bits: where few worlds are
left for a block, and where the compiler has no vectors. The width follows from the CPU's features, which are
in the key of Warp's cache.

Stages that adjoin share a launch: their functions of a block follow one another in it (`rigid_body.py`). A
function asks the block for what it reads, `block.in(array)`, and for what it writes, `block.out<T>(array)`;
what an earlier one wrote is in lanes then, and is not gathered again. So a function asks for what it
overwrites before it asks to write it.
"""

import math
from pathlib import Path
from typing import Any

import warp as wp

WIDEST = 16
"""Lanes of the widest registers, AVX-512."""

STRIDED = Path(__file__).with_name("strided.cpp")
"""Source with worlds side by side in threads of a GPU."""

DOUBLES = Path(__file__).with_name("double_lanes.cpp")
"""Source with lanes in float64, as many as there are in float32."""


def at_namespace_level(*sources: Path, **constants: float) -> str:
    """Return the text of a native function that declares templates, which no function can hold.

    It does nothing: it ends at once, declares constants and what `lanes.cpp` and the sources have, and begins
    a function that does nothing either. A kernel calls it before the native function that uses them.
    """
    kinds = {name: "int" if isinstance(value, int) else "float" for name, value in constants.items()}
    texts = [f"constexpr {kind} {name} = {constants[name]!r};\n" for name, kind in kinds.items()]
    texts += [file.read_text() for file in (Path(__file__).with_name("lanes.cpp"), *sources)]
    return f"}}\n{''.join(texts)}static inline void after_{sources[-1].stem}() {{"


def block_scratch(device: wp.Device, *owners: Any) -> wp.array[float]:
    """Return memory for a block of worlds: for a row of each array of these structs, in every lane.

    An owner that is a number stands for so many floats.
    """
    return wp.empty(
        (row_floats(*owners) + 1) * WIDEST, dtype=float, device=device
    )  # a vector begins at a multiple of its size


def row_floats(*owners: Any) -> int:
    """Return how many floats a row of each array of these structs has, and owners that are numbers."""
    arrays = [array for one in owners if not isinstance(one, int) for array in arrays_of(one)]
    return sum(one for one in owners if isinstance(one, int)) + sum(
        math.prod(array.shape[1:]) * wp.types.type_size_in_bytes(array.dtype) // 4
        for array in arrays
        if array is not None
    )


def arrays_of(owner: Any) -> list[wp.array]:
    """Return an array, or those of a struct and of the structs in it."""
    if isinstance(owner, wp.array):
        return [owner]
    return [array for one in vars(owner).values() if hasattr(one, "__dict__") for array in arrays_of(one)]
