"""Formulas that a file states, as programs of a stack machine: of forces, and of what is prescribed.

    each instruction takes its arguments off the stack and puts its value there; a curve is a chain of
    piecewise polynomials (`pieces`)

Source: the functions of Lepton, by which OpenSim's `ExpressionBased` classes read their formulas.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of
from myowarp.laws.pieces import Pieces, PieceTables, chain_of, evaluated, piece_tables

NULLARY = ("number", "variable")
UNARY = (
    "curve", "neg", "sqrt", "exp", "log", "sin", "cos", "sec", "csc", "tan", "cot", "asin", "acos", "atan",
    "sinh", "cosh", "tanh", "erf", "erfc", "step", "delta", "square", "cube", "recip", "abs",
)  # fmt: skip
BINARY = ("add", "sub", "mul", "div", "pow", "min", "max")
CODES = {name: code for code, name in enumerate((*NULLARY, *UNARY, *BINARY))}
"""Names of instructions in a text, and their numbers on the device."""

DEPTH = 24
"""Numbers on the stack, at most."""
VARIABLES = 6
"""Variables of an expression, at most."""

NUMBER, VARIABLE, CURVE, NEG, SQRT, EXP, LOG, SIN, COS, SEC, CSC, TAN, COT, ASIN, ACOS, ATAN, SINH, COSH = (
    wp.constant(code) for code in range(18)
)
TANH, ERF, ERFC, STEP, DELTA, SQUARE, CUBE, RECIP, ABS, ADD, SUB, MUL, DIV, POW, MIN, MAX = (
    wp.constant(code) for code in range(18, len(CODES))
)

Stack = wp.types.vector(length=DEPTH, dtype=wp.float64)  # mypy follows no call here


class Variables(wp.types.vector(length=VARIABLES, dtype=wp.float64)):  # type: ignore[misc]  # as above
    """Values of an expression's variables."""


@dataclass(frozen=True)
class Expression:
    """A formula of some variables.

    Attributes:
        code: Instructions in turn: a name of `CODES`, and its number: the variable's, the curve's, else 0.
        curves: Chains of piecewise polynomials.
    """

    code: tuple[tuple[str, float], ...]
    curves: tuple[tuple[Pieces, ...], ...] = ()

    def __post_init__(self) -> None:
        """Check that it can be run.

        Raises:
            ValueError: An instruction is unknown, or finds no arguments, or the stack overflows.
        """
        depth = 0
        for name, number in self.code:
            if name not in CODES or not math.isfinite(number):
                raise ValueError(f"a formula has no instruction {name!r} with {number}")
            if name in ("variable", "curve"):
                most = VARIABLES if name == "variable" else len(self.curves)
                if not 0 <= number < most or number % 1:
                    raise ValueError(f"a formula has no {name} {number:g}")
            needs = 2 if name in BINARY else 1 if name in UNARY else 0
            depth += 1 - needs
            if depth < 1 or depth > DEPTH:
                raise ValueError(f"a formula must leave 1 to {DEPTH} numbers on the stack, got {depth}")
        if depth != 1:
            raise ValueError(f"a formula must end with one number, got {depth}")

    def __or__(self, other: "Expression") -> "Expression":
        """Return this formula of what another one gives: its variable 0 is the other's value."""
        joined: list[tuple[str, float]] = []
        for name, number in self.code:
            own = (name, number + len(other.curves) if name == "curve" else number)
            joined += other.code if name == "variable" else [own]
        return Expression(tuple(joined), other.curves + self.curves)

    def of(self, variable: int, code: tuple[tuple[str, float], ...]) -> "Expression":
        """Return this formula with instructions in place of a variable."""
        own = [code if one == ("variable", float(variable)) else (one,) for one in self.code]
        return Expression(tuple(step for steps in own for step in steps), self.curves)

    @classmethod
    def from_entry(cls, entry: Any) -> "Expression":
        """Return what `entry` gave.

        Raises:
            ValueError: It cannot be run.
        """
        code = tuple((str(name), float(number)) for name, number in entry["code"])
        return cls(code, tuple(map(chain_of, entry["curves"])))

    def entry(self) -> dict[str, Any]:
        """Return what a text says of it."""
        curves = [[piece.entry() for piece in chain] for chain in self.curves]
        return {"code": [list(one) for one in self.code], "curves": curves}


def added(formulas: list[Expression], more: Iterable[Expression]) -> int:
    """Append formulas to others; return the number of the first, or -1: there are none."""
    before = len(formulas)
    formulas += more
    return before if len(formulas) > before else -1


@wp.struct
class Programs:
    """Expressions on the device.

    Attributes:
        first: Instruction of each, and the number of all.
        op: Of each instruction, a code.
        number: What it needs.
        curves: Of all.
    """

    first: wp.array[int]
    op: wp.array[int]
    number: wp.array[wp.float64]
    curves: PieceTables


def programs(expressions: Iterable[Expression]) -> Programs:
    """Return expressions on the current Warp device."""
    kept = list(expressions)
    code: list[tuple[int, float]] = []
    curves: list[tuple[Pieces, ...]] = []
    for one in kept:
        for name, number in one.code:
            code.append((CODES[name], number + len(curves) if name == "curve" else number))
        curves += one.curves
    return struct_of(
        Programs,
        first=np.cumsum([0, *(len(one.code) for one in kept)]),
        op=[op for op, _ in code] or [0],
        number=[number for _, number in code] or [0.0],
        curves=piece_tables(curves),
    )


@wp.func
def unary(op: int, x: wp.float64) -> wp.float64:
    """Return a function of one number."""
    one, zero = wp.float64(1.0), wp.float64(0.0)
    if op == NEG:
        return -x
    if op == SQRT:
        return wp.sqrt(x)
    if op == EXP:
        return wp.exp(x)
    if op == LOG:
        return wp.log(x)
    if op == SIN:
        return wp.sin(x)
    if op == COS:
        return wp.cos(x)
    if op == SEC:
        return one / wp.cos(x)
    if op == CSC:
        return one / wp.sin(x)
    if op == TAN:
        return wp.tan(x)
    if op == COT:
        return one / wp.tan(x)
    if op == ASIN:
        return wp.asin(x)
    if op == ACOS:
        return wp.acos(x)
    if op == ATAN:
        return wp.atan(x)
    if op == SINH:
        return wp.sinh(x)
    if op == COSH:
        return wp.cosh(x)
    if op == TANH:
        return wp.tanh(x)
    if op == ERF:
        return wp.erf(x)
    if op == ERFC:
        return wp.erfc(x)
    if op == STEP:
        return wp.where(x >= zero, one, zero)
    if op == DELTA:
        return wp.where(x == zero, one, zero)
    if op == SQUARE:
        return x * x
    if op == CUBE:
        return x * x * x
    if op == RECIP:
        return one / x
    return wp.abs(x)


@wp.func
def binary(op: int, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return a function of two numbers."""
    if op == ADD:
        return x + y
    if op == SUB:
        return x - y
    if op == MUL:
        return x * y
    if op == DIV:
        return x / y
    if op == POW:
        if y == wp.float64(2.0):
            return x * x
        return wp.pow(x, y)
    if op == MIN:
        return wp.min(x, y)
    return wp.max(x, y)


@wp.func
def run(tables: Programs, program: int, variables: Variables) -> wp.float64:
    """Return the value of an expression."""
    stack, size = Stack(), int(0)
    for at in range(tables.first[program], tables.first[program + 1]):
        op, number = tables.op[at], tables.number[at]
        if op == NUMBER:
            stack[size] = number
            size += 1
        elif op == VARIABLE:
            stack[size] = variables[int(number)]
            size += 1
        elif op == CURVE:
            stack[size - 1] = evaluated(tables.curves, int(number), stack[size - 1])[0]
        elif op < ADD:
            stack[size - 1] = unary(op, stack[size - 1])
        else:
            size -= 1
            stack[size - 1] = binary(op, stack[size - 1], stack[size])
    return stack[0]


@wp.kernel(enable_backward=False)
def run_programs(
    # Params:
    tables: Programs,
    # In:
    variables: wp.array2d[wp.float64],
    # Out:
    value: wp.array2d[wp.float64],
):
    """Values of all expressions."""
    row, program = wp.tid()
    at = Variables()
    for k in range(variables.shape[1]):
        at[k] = variables[row, k]
    value[row, program] = run(tables, program, at)


def values_of(expressions: Iterable[Expression], variables: np.ndarray) -> np.ndarray:
    """Return expressions of rows of variables, shape (rows, variables), as (rows, expressions).

    Warp must have been started (`process.start_warp`).
    """
    kept = list(expressions)
    with wp.ScopedDevice("cpu"):
        value = wp.empty((len(variables), len(kept)), dtype=wp.float64)
        launch(
            run_programs,
            value.shape,
            tables=programs(kept),
            variables=wp.array(variables, dtype=wp.float64),
            value=value,
        )
        return value.numpy().copy()
