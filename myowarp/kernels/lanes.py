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

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
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


def native_kernel(
    *declared: str, does: str, module: str | None = None
) -> Callable[[Callable[..., None]], wp.Kernel]:
    """Return a decorator that makes a kernel of a signature and its docstring: one thread runs C++.

    Args:
        *declared: What `at_namespace_level` returned: templates that the C++ uses.
        does: The C++; parameters have their names in it.
        module: Warp's module in which to compile it; None: that of the signature.
    """

    def kernel_of(signature: Callable[..., None]) -> wp.Kernel:
        name, parameters = signature.__name__, ", ".join(inspect.signature(signature).parameters)
        calls = {f"declare_{k}": text for k, text in enumerate(declared)}
        natives = {call: _native(_of_thread, f"{call}_of_{name}", text) for call, text in calls.items()}
        natives["act"] = _native(signature, f"act_of_{name}", does)
        lines = ("thread = wp.tid()", *(f"{call}(thread)" for call in calls), f"act({parameters})")
        source = f"def {name}({parameters}):\n" + "".join(f"    {line}\n" for line in lines)
        function = _renamed(signature, name, {"wp": wp, **natives})
        of = wp.get_module(signature.__module__ if module is None else module)
        return wp.Kernel(function, name, of, options={"enable_backward": False}, source=source)

    return kernel_of


def _of_thread(thread: int) -> None:
    """Stand for the signature of a native function that declares templates."""


def _native(signature: Any, name: str, text: str) -> wp.Function:
    """Return a native function of a signature, under another name."""
    return wp.func_native(text)(_renamed(signature, name, {}))


def _renamed(signature: Any, name: str, scope: dict[str, Any]) -> FunctionType:
    """Return a function under another name, which finds more in its scope."""
    found = FunctionType(signature.__code__, signature.__globals__ | scope, name, None, signature.__closure__)
    found.__annotations__, found.__module__ = signature.__annotations__, signature.__module__
    found.__qualname__, found.__doc__ = name, signature.__doc__
    return found


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
