"""Static optimisation: which activations give the joint moments of a frame at the least cost?

    minimize  sum |a_i|^p    subject to    A a = b,  lower <= a <= upper

A holds moment arms times the force of a muscle at activation 1, b the moments that a motion takes. Few
equations stand against many muscles, so the dual problem is solved, in one unknown for each equation, see
`dual_newton`. For p = 2 it is piecewise quadratic, and what `kernels.bounded_least_squares` solves with the
ridge e, in n^2 instead of m^2 numbers for n equations and m muscles. e is small and counts in units of the
row: it makes the solution of a frame that muscles cannot hold unique, with what is missing left over.

Frames begin at the dual of the one before, in runs. On the CPU and with p = 2 runs are solved in SIMD lanes.

Source: Crowninshield, Brand (1981), doi:10.1016/0021-9290(81)90035-X.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.motion.dual_newton import DualWork, Problem, optimize_activations
from myowarp.motion.dual_newton_lanes import optimize_in_lanes
from myowarp.process import check_on_cpu

RUN = 16
"""Frames that one thread solves, each from the solution of the one before, at most."""


@dataclass(frozen=True, eq=False)
class Activations:
    """Solutions of all frames.

    Attributes:
        activation: Shape (frames, unknowns).
        missing: Moment that is not met [N m] or [N], shape (frames, rows).
        residual: How far the solver is from its solution, in units of the rows, shape (frames,).
        dual: y, shape (frames, rows).
    """

    activation: np.ndarray
    missing: np.ndarray
    residual: np.ndarray
    dual: np.ndarray


def optimal_activations(
    rows: Sequence[Sequence[int]] | np.ndarray,
    effects: np.ndarray,
    right: np.ndarray,
    lower: np.ndarray | float = 0.0,
    upper: np.ndarray | float = 1.0,
    exponent: float = 2.0,
    device: Any = "cpu",
    near: np.ndarray | None = None,
    sequence: int = 0,
    scale: np.ndarray | float = 1.0,
    entries: np.ndarray | None = None,
) -> Activations:
    """Return the activations of least cost that give the wanted moments.

    Args:
        rows: For each unknown the rows of A that it has an entry in; -1 fills up behind them.
        effects: These entries, shape (frames, unknowns, entries).
        right: b, shape (frames, rows).
        lower: Bounds, broadcast to (1 or frames, unknowns); may be infinite.
        upper: Upper bounds.
        exponent: p >= 1.
        device: Where it is solved.
        near: Dual of a problem like this one, to begin at.
        sequence: Frames of a recording, where several follow each other: each is solved as if it were alone;
            0: there is one.
        scale: Factors on the entries of each unknown, broadcast as bounds are.
        entries: With `effects` of any shape (frames, ...), where each entry of `rows` is in a frame of them;
            -1: it is 1.

    Raises:
        ValueError: The exponent is below 1, a lower bound is above its upper one, or the device is no CPU.
    """
    check_on_cpu("optimal activations", device)
    if not 1.0 <= exponent < np.inf:
        raise ValueError(f"the exponent of activations must be at least 1 and finite, got {exponent}")
    frames, count = len(effects), len(rows)
    table = np.array(rows, np.int32).reshape(count, -1)
    bounds = [np.broadcast_to(x, np.broadcast_shapes(np.shape(x), (1, count))) for x in (lower, upper, scale)]
    if not (bounds[0] <= bounds[1]).all():
        raise ValueError("lower bounds of activations must be at most the upper ones")
    each = sequence or max(frames, 1)
    heads = np.arange(0, each, RUN if near is None else 1)
    first = (np.arange(0, frames, each)[:, None] + heads).ravel()
    first = np.append(first[first < frames], frames)
    with wp.ScopedDevice(device):
        problem = Problem()
        problem.row = wp.array(table, dtype=int)
        where = np.arange(table.size).reshape(table.shape) if entries is None else entries
        problem.entry = wp.array(where, dtype=int)
        problem.begin = wp.array(_first_shared(table, right.shape[1]), dtype=int)
        problem.effect = given(effects.reshape(frames, math.prod(effects.shape[1:])))
        problem.right = given(right)
        problem.lower, problem.upper, problem.scale = map(given, bounds)
        problem.exponent = float(exponent)
        work = DualWork()
        work.dual = wp.array(np.zeros(right.shape) if near is None else near, dtype=wp.float64)
        out = {
            "activation": wp.empty((frames, count), dtype=wp.float64),
            "missing": wp.empty(right.shape, dtype=wp.float64),
            "residual": wp.empty(frames, dtype=wp.float64),
        }
        if in_lanes(exponent):
            optimize_in_lanes(problem, wp.array(first, dtype=int), work.dual, **out)
        else:
            for name in ("trial", "slope", "step", "size"):
                setattr(work, name, wp.empty(right.shape, dtype=wp.float64))
            work.factor = wp.empty((*right.shape, right.shape[1]), dtype=wp.float64)
            heads = wp.array(first, dtype=int)
            launch(optimize_activations, len(first) - 1, problem=problem, first=heads, work=work, **out)
        activation, missing, residual = (array.numpy() for array in out.values())
        return Activations(activation, missing, residual, work.dual.numpy())


def in_lanes(exponent: float) -> bool:
    """Whether problems are solved in SIMD lanes."""
    return exponent == 2.0


def given(values: np.ndarray) -> wp.array:
    """Return numbers on the current device, on the CPU those of the array itself if it is contiguous."""
    return wp.array(np.ascontiguousarray(values, float), dtype=wp.float64, copy=False)


def _first_shared(table: np.ndarray, rows: int) -> np.ndarray:
    """Return for each row the first that any unknown has an entry in, too, among those up to it."""
    first = np.arange(rows, dtype=np.int32)
    for own in table:
        shared = own[own >= 0]
        if len(shared):
            first[shared] = np.minimum(first[shared], shared.min())
    return first
