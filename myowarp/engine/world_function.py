"""Kernels around a function of one world, such as a reward term, and what keeps a function from being one."""

from __future__ import annotations

import ast
import contextlib
import inspect
import re
import textwrap
import typing
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import warp as wp

from myowarp.engine.said import say_once

WARP_TYPES: dict[Any, type] = {float: wp.float32, int: wp.int32, bool: wp.bool}
PLACE = re.compile(r'Error while parsing function "([^"]+)" at (.+):(\d+):\n.*\n;')  # in what Warp says

_MODULES: set[str] = set()  # names of the modules of the kernels below


def parameter_type(function: wp.Function, name: str) -> tuple[type, int]:
    """Return the type of the entries of a parameter, and its number of dimensions, 0 for a number."""
    annotation = typing.get_type_hints(function.func)[name]
    entry = getattr(annotation, "dtype", annotation)
    return WARP_TYPES.get(entry, entry), getattr(annotation, "ndim", 0)


@cache
def kernel_around(function: wp.Function, size: int) -> wp.Kernel:
    """Return the kernel that writes what a function of one world returns into the rows of a mask.

    Its text is written here, for its arguments are the function's: `mask`, the function's parameters with a
    row or a value for each world, `column`, `out`.

    Args:
        function: The function, all of whose parameters have types.
        size: How many numbers it returns.
    """
    names = list(inspect.signature(function.func).parameters)
    types = [parameter_type(function, name) for name in names]
    parameters = [
        f"{name}: wp.array(dtype=dtypes[{i}], ndim={types[i][1] + 1})" for i, name in enumerate(names)
    ]
    value = f"function({', '.join(f'{name}[worldid]' for name in names)})"
    lines = (
        f"def extension(mask: wp.array[bool], {', '.join([*parameters, 'column: int'])}, "
        "out: wp.array2d[float]):",
        "    worldid = wp.tid()",
        "    if mask[worldid]:",
        f"        value = {value}",
        *(f"        out[worldid, column + {i}] = value{f'[{i}]' if size > 1 else ''}" for i in range(size)),
    )
    source = "\n".join(lines) + "\n"
    scope: dict[str, Any] = {"wp": wp, "function": function, "dtypes": [dtype for dtype, _ in types]}
    exec(compile(source, "<myowarp extension>", "exec", dont_inherit=True), scope)
    code = zlib.crc32(inspect.getsource(function.func).encode())
    name = f"myowarp_extension.{function.key}_{code:08x}"
    while name in _MODULES:
        name += "_"
    _MODULES.add(name)
    scope["extension"].__module__ = name
    return wp.Kernel(
        scope["extension"],
        key=f"extend_{function.key}",
        module=wp.get_module(name),
        options={"enable_backward": False},
        source=source,
    )


def check_function(function: wp.Function, size: int) -> None:
    """Raise ValueError if no kernel can be made around a function, or if it writes what it may only read.

    Warp translates it, which takes milliseconds; nothing is compiled. Where Warp's private names for that are
    gone, errors come when it is compiled.
    """
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function.func))).body
    assert isinstance(definition, ast.FunctionDef)
    if not _returns(definition.body):
        raise ValueError(f"{function.key} must return a value on every way through it")
    try:
        kernel = kernel_around(function, size)
        written = _translate(kernel)
    except RecursionError as error:
        raise ValueError(f"{function.key} calls itself, which Warp does not translate") from error
    except Exception as error:
        raise ValueError(_reason(function, error)) from error
    for name in inspect.signature(function.func).parameters:
        if name in written:
            raise ValueError(f"{function.key} writes to {name!r}, which it may only read")


def _returns(body: list[ast.stmt]) -> bool:
    """Whether all ways through statements return a value."""
    last = body[-1]
    if isinstance(last, ast.If):
        return _returns(last.body) and bool(last.orelse) and _returns(last.orelse)
    return isinstance(last, ast.Return) and last.value is not None


def _translate(kernel: wp.Kernel) -> set[str]:
    """Have Warp translate a kernel; return the names of the parameters that it writes to."""
    try:
        from warp._src import context

        build, lock = context.ModuleBuilder, context._codegen_lock
        options = kernel.module.resolve_options(wp.config) | {"verify_autograd_array_access": True}
    except (ImportError, AttributeError) as error:
        say_once(f"Warp has changed, functions of tasks are checked only when they are compiled: {error}")
        return set()
    with lock:
        build(kernel.module, options)
    with contextlib.suppress(AttributeError):
        return {argument.label for argument in kernel.adj.args if argument.is_write}
    return set()


def _reason(function: wp.Function, error: Exception) -> str:
    """Return in a sentence what Warp says: the innermost place in a file, and what is wrong there."""
    said = str(error.args[0] if error.args else error)
    *_, reason = PLACE.split(said)
    places = [place for place in PLACE.findall(said) if Path(place[1]).is_file()]
    where = f"line {places[-1][2]} of {Path(places[-1][1]).name}, {places[-1][0]}" if places else function.key
    return f"Warp does not translate {where}: {' '.join(reason.split())}"
