"""Kernels around functions of one world: all blocks of an observation in one, all terms of a reward in one.

A parameter's name says what a function gets: a world's row of an array (num_worlds, ...), an array or a
number that all worlds share, or a measure. A measure is such a function itself; a kernel computes it once.
`worldid` is the world. `i` counts: a function with this parameter is called for each number, or vector, of
its block.
"""

from __future__ import annotations

import inspect
import typing
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import warp as wp

from myowarp.kernels.observe import pack_range

COUNTER = "i"
GIVEN = (COUNTER, "worldid")
WARP_TYPES: dict[Any, type] = {float: wp.float32, int: wp.int32, bool: wp.bool}

_MODULES: set[str] = set()  # names of the modules of the kernels below


@dataclass(frozen=True)
class Row:
    """Numbers that an observation copies: `factor * array[world, first : first + size]`.

    Attributes:
        array: Name of an array (num_worlds, n) of floats.
        first: The first of its numbers.
        factor: Name of a number; "" for 1.
    """

    array: str
    first: int = 0
    factor: str = ""


Source: TypeAlias = Any  # Row | wp.Function, which mypy does not see
Measures: TypeAlias = tuple[tuple[str, wp.Function], ...]


def parameters(function: wp.Function) -> tuple[str, ...]:
    """Return the names of a function's parameters."""
    return tuple(inspect.signature(function.func).parameters)


def parameter_type(function: wp.Function, name: str) -> tuple[type, int]:
    """Return the type of the entries of a parameter, and its number of dimensions, 0 for a number."""
    annotation = typing.get_type_hints(function.func)[name]
    ndim = getattr(annotation, "ndim", 0)
    entry = annotation.dtype if ndim else annotation
    return WARP_TYPES.get(entry, entry), ndim


def num_numbers(function: wp.Function) -> int:
    """Return how many numbers a function returns; 0 if it says neither a number nor a vector."""
    result = typing.get_type_hints(function.func).get("return")
    shape: tuple[int, ...] = (1,) if result in (float, wp.float32) else getattr(result, "_shape_", ())
    return shape[0] if len(shape) == 1 else 0


def num_counted(source: Source | None, size: int) -> int:
    """Return how often a source is evaluated for a block of `size` numbers, or how many numbers it copies."""
    is_counted = isinstance(source, wp.Function) and COUNTER in parameters(source)
    return size // num_numbers(source) if is_counted else size


class _Body:
    """The lines of a kernel, and what its names stand for."""

    def __init__(self, measures: Measures, rows: frozenset[str]) -> None:
        """Begin; of the arrays named in `rows` a function gets the world's row."""
        self.measures, self.rows = dict(measures), rows
        self.lines: list[str] = []
        self.scope: dict[str, Any] = {"wp": wp, "pack_range": pack_range}
        self.arguments: dict[str, str] = {}
        self._begun: set[str] = set()

    def argument(self, name: str, dtype: type, ndim: int = 0) -> str:
        """Have the kernel take an argument; return its name."""
        self.scope[f"{name}_type"] = wp.array(dtype=dtype, ndim=ndim) if ndim else dtype
        self.arguments[name] = f"{name}: {name}_type"
        return name

    def value(self, function: wp.Function) -> str:
        """Return the expression of a function's value; before it come the measures that it reads."""
        name = next((name for name, measure in self.measures.items() if measure is function), None)
        return self._call(function) if name is None else self.measure(name)

    def measure(self, name: str) -> str:
        """Return the name of a measure's value, computed in a line of its own.

        Raises:
            ValueError: It needs its own value.
        """
        if name not in self._begun:
            self._begun.add(name)
            self.lines.append(f"{name} = {self._call(self.measures[name])}")
        elif not any(line.startswith(f"{name} = ") for line in self.lines):
            raise ValueError(f"measure {name!r} must not need its own value, but those that it reads do")
        return name

    def _call(self, function: wp.Function) -> str:
        called = f"{function.key}_{len(self.scope)}"
        self.scope[called] = function
        given = []
        for name in parameters(function):
            if name in self.measures:
                given.append(self.measure(name))
            elif name in GIVEN:
                given.append(name)
            else:
                dtype, ndim = parameter_type(function, name)
                is_row = name in self.rows
                self.argument(name, dtype, ndim + is_row)
                given.append(f"{name}[worldid]" if is_row else name)
        return f"{called}({', '.join(given)})"

    def kernel(self, name: str, module: str, head: str, first: Iterable[str] = ()) -> wp.Kernel:
        """Return the kernel; its text is its only source."""
        lines = ("worldid = wp.tid()", *first, *self.lines)
        signature = ", ".join([*self.arguments.values(), head])
        source = f"def {name}({signature}):\n" + "".join(f"    {line}\n" for line in lines)
        exec(compile(source, f"<{module}>", "exec", dont_inherit=True), self.scope)
        self.scope[name].__module__ = module
        options = {"enable_backward": False}
        return wp.Kernel(self.scope[name], name, wp.get_module(module), options=options, source=source)

    def write_block(self, k: int, source: Source) -> None:
        """Add the lines that write a block of the observation."""
        if isinstance(source, Row):
            array = self.argument(source.array, wp.float32, 2)
            factor = self.argument(source.factor, wp.float32) if source.factor else "1.0"
            place = f"first[{k}], {array}, {int(source.first)}, count[{k}]"
            self.lines.append(f"pack_range(obs, worldid, {place}, {factor})")
            return
        value, size = self.value(source), num_numbers(source)
        is_counted = COUNTER in parameters(source)
        lines = [f"value{k} = {value}"]
        for j in range(size):
            column = f"first[{k}] + {size} * {COUNTER} + {j}" if is_counted else f"first[{k}] + {j}"
            lines.append(f"obs[worldid, {column}] = value{k}" + (f"[{j}]" if size > 1 else ""))
        if is_counted:
            lines = [f"for {COUNTER} in range(count[{k}]):", *(f"    {line}" for line in lines)]
        self.lines += lines


@cache
def world_kernels(
    name: str,
    sources: tuple[Source | None, ...],
    measures: Measures,
    terms: tuple[wp.Function | None, ...],
    rows: frozenset[str],
) -> tuple[wp.Kernel, wp.Kernel]:
    """Return the kernels that write an observation, and the terms of a reward; None is left to others.

    They take by name what the functions read. The first also takes `mask`, `first`, `count` and `obs`: block
    k has count[k] numbers, or vectors, from column first[k] on. The second also takes `step_count`, `terms`,
    `solved` and `failed`: the flags are the measures of these names.

    Args:
        name: What they belong to.
        sources: What writes each block of the observation.
        measures: By name, what functions read of each other.
        terms: What computes each term of the reward.
        rows: Names of the arrays of which a function gets the world's row.
    """
    observed, scored = _Body(measures, rows), _Body(measures, rows)
    for k, source in enumerate(sources):
        if source is not None:
            observed.write_block(k, source)
    scored.argument("step_count", wp.int32, 1)
    for k, term in enumerate(terms):
        if term is not None:
            scored.lines.append(f"terms[worldid, {k}] = {scored.value(term)}")
    for flag in ("solved", "failed"):
        if flag in scored.measures:
            scored.lines.append(f"{flag}_out[worldid] = {scored.measure(flag)}")
    module = f"myowarp_worlds.{name}_{zlib.crc32(repr((observed.lines, scored.lines)).encode()):08x}"
    while module in _MODULES:
        module += "_"
    _MODULES.add(module)
    masked = ("if not mask[worldid]:", "    return")
    to_obs = "mask: wp.array[bool], first: wp.array[int], count: wp.array[int], obs: wp.array2d[float]"
    to_terms = "terms: wp.array2d[float], solved_out: wp.array[bool], failed_out: wp.array[bool]"
    return (
        observed.kernel("observe", module, to_obs, masked),
        scored.kernel("score", module, to_terms),
    )
