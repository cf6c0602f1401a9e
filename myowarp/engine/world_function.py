"""Kernels around a function of one world, such as a reward term, and what keeps a function from being one."""

from __future__ import annotations

import ast
import contextlib
import inspect
import re
import textwrap
from pathlib import Path

import warp as wp

from myowarp.kernels.world_function import parameters, world_kernels
from myowarp.process import warn_once

PLACE = re.compile(r'Error while parsing function "([^"]+)" at (.+):(\d+):\n.*\n;')  # in what Warp says


def check_function(function: wp.Function) -> None:
    """Raise ValueError if no kernel can be made around a function, or if it writes what it may only read.

    Warp translates it, which takes milliseconds; nothing is compiled. Where Warp's private names for that are
    gone, errors come when it is compiled.
    """
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function.func))).body
    assert isinstance(definition, ast.FunctionDef)
    if not _returns(definition.body):
        raise ValueError(f"{function.key} must return a value on every way through it")
    try:
        names = parameters(function)
        kernel, _ = world_kernels(function.key, (function,), (), (), frozenset(names))
        written = _translate(kernel)
    except RecursionError as error:
        raise ValueError(f"{function.key} calls itself, which Warp does not translate") from error
    except Exception as error:  # of Warp's translator, under many names, and of what a user's names stand for
        raise ValueError(_reason(function, error)) from error
    for name in names:
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
        warn_once(f"Warp has changed, functions of tasks are checked only when they are compiled: {error}")
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
