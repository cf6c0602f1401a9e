"""Static optimisation: which activations give the joint moments of a frame at the least cost?

    minimize  sum |a_i|^p    subject to    A a = b,  lower <= a <= upper

A holds moment arms times the force of a muscle at activation 1, b the moments that a motion takes. Few
equations stand against many muscles, so the dual problem is solved, in one unknown for each equation:

    minimize  sum_i psi(A_i . y) - y . b + e |y|^2 / 2,    psi(s) = max of s a - |a|^p within the bounds

by Newton steps with backtracking; a_i is where psi has its maximum. For p = 2 it is piecewise quadratic, and
what `kernels.bounded_least_squares` solves with the ridge e, in n^2 instead of m^2 numbers for n equations
and m muscles. e is small and counts in units of the row: it makes the solution of a frame that muscles cannot
hold unique, with what is missing left over. For p = 1 a term a^2 / 100 does.

Muscles of one leg and of the other share no row: of the second derivatives only the envelope is computed,
from the first row on that a muscle shares with each. Frames begin at the dual of the one before, in runs.

Sources: Crowninshield, Brand (1981), doi:10.1016/0021-9290(81)90035-X; dual of separable problems: Bertsekas,
*Nonlinear Programming* (1999), section 6.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch

SOFTNESS = 1e-9
"""e, in units of the squared row of A."""

STEPS = 200
"""Most Newton steps."""

TOLERANCE = 1e-9
"""Share of a row's size up to which an equation counts as met."""

ROUNDING = 1e-15
"""Share of |y . b| by which the cost may seem to rise: y is large where muscles cannot hold a frame."""

FLAT = 1e-3
"""Activation below which the slope of a cost with p > 2 is taken from there."""

LINEAR = 0.01
"""Weight of a^2 beside |a| where p = 1."""

RUN = 16
"""Frames that one thread solves, each from the solution of the one before, at most."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class DualWork:
    """What a frame works with.

    Attributes:
        dual: y, (num_worlds, num_rows).
        trial: y after the step.
        slope: Gradient.
        step: Newton step.
        size: Of rows of A.
        factor: Cholesky factor of the second derivatives, (num_worlds, num_rows, num_rows).
    """

    dual: wp.array2d[wp.float64]
    trial: wp.array2d[wp.float64]
    slope: wp.array2d[wp.float64]
    step: wp.array2d[wp.float64]
    size: wp.array2d[wp.float64]
    factor: wp.array3d[wp.float64]


@wp.func
def cost_of(a: wp.float64, exponent: wp.float64) -> wp.float64:
    """|a|^p, and a^2 / 100 more for p = 1."""
    size = wp.abs(a)
    if exponent == wp.float64(2.0):
        return a * a
    if exponent == wp.float64(1.0):
        return size + wp.float64(LINEAR) * a * a
    return wp.pow(size, exponent)


@wp.func
def best_activation(s: wp.float64, exponent: wp.float64) -> wp.vec2d:
    """Return a with cost'(a) = s, and da/ds there."""
    one = wp.float64(1.0)
    if exponent == wp.float64(2.0):
        return wp.vec2d(wp.float64(0.5) * s, wp.float64(0.5))
    size = wp.abs(s)
    if exponent == one:
        stiff = wp.float64(2.0) * wp.float64(LINEAR)
        over = wp.max(size - one, wp.float64(0.0))
        return wp.vec2d(wp.sign(s) * over / stiff, wp.where(size > one, one / stiff, wp.float64(0.0)))
    a = wp.pow(size / exponent, one / (exponent - one))
    least = wp.max(a, wp.float64(FLAT))
    return wp.vec2d(
        wp.sign(s) * a, one / (exponent * (exponent - one) * wp.pow(least, exponent - wp.float64(2.0)))
    )


@wp.func
def pull(
    worldid: int, i: int, row: wp.array2d[int], effect: wp.array3d[wp.float64], dual: wp.array2d[wp.float64]
) -> wp.float64:
    """A_i . y."""
    s = wp.float64(0.0)
    for slot in range(row.shape[1]):
        r = row[i, slot]
        if r < 0:
            break
        s += effect[worldid, i, slot] * dual[worldid, r]
    return s


@wp.func
def dual_cost(
    worldid: int,
    row: wp.array2d[int],
    effect: wp.array3d[wp.float64],
    right: wp.array2d[wp.float64],
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    exponent: wp.float64,
    work: DualWork,
    dual: wp.array2d[wp.float64],
) -> wp.float64:
    """sum psi(A_i . y) - y . b + e |y|^2 / 2."""
    total = wp.float64(0.0)
    for i in range(row.shape[0]):
        s = pull(worldid, i, row, effect, dual)
        best = best_activation(s, exponent)
        a = wp.clamp(best[0], lower[worldid, i], upper[worldid, i])
        total += s * a - cost_of(a, exponent)
    for r in range(right.shape[1]):
        y = dual[worldid, r]
        size = work.size[worldid, r]
        total += wp.float64(0.5) * wp.float64(SOFTNESS) * size * size * y * y - y * right[worldid, r]
    return total


@wp.func
def dual_newton(
    worldid: int,
    row: wp.array2d[int],
    begin: wp.array[int],
    effect: wp.array3d[wp.float64],
    right: wp.array2d[wp.float64],
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    exponent: wp.float64,
    work: DualWork,
    activation: wp.array2d[wp.float64],
) -> wp.float64:
    """Activations, gradient and Newton step at y; returns the largest gradient in units of its row."""
    rows = right.shape[1]
    for r in range(rows):
        soft = wp.float64(SOFTNESS) * work.size[worldid, r] * work.size[worldid, r]
        work.slope[worldid, r] = soft * work.dual[worldid, r] - right[worldid, r]
        for c in range(begin[r], r):
            work.factor[worldid, r, c] = wp.float64(0.0)
        work.factor[worldid, r, r] = soft
    for i in range(row.shape[0]):
        best = best_activation(pull(worldid, i, row, effect, work.dual), exponent)
        a = wp.clamp(best[0], lower[worldid, i], upper[worldid, i])
        activation[worldid, i] = a
        inside = best[0] >= lower[worldid, i] and best[0] <= upper[worldid, i]
        for slot in range(row.shape[1]):
            r = row[i, slot]
            if r < 0:
                break
            x = effect[worldid, i, slot]
            work.slope[worldid, r] += x * a
            if inside:
                for other in range(row.shape[1]):
                    c = row[i, other]
                    if c < 0:
                        break
                    if c <= r:
                        work.factor[worldid, r, c] += x * effect[worldid, i, other] * best[1]
    largest = wp.float64(0.0)
    for r in range(rows):
        largest = wp.max(largest, wp.abs(work.slope[worldid, r]) / work.size[worldid, r])
        work.step[worldid, r] = -work.slope[worldid, r]
    for r in range(rows):
        for c in range(begin[r], r + 1):
            total = work.factor[worldid, r, c]
            for k in range(wp.max(begin[r], begin[c]), c):
                total -= work.factor[worldid, r, k] * work.factor[worldid, c, k]
            if r > c:
                work.factor[worldid, r, c] = total / work.factor[worldid, c, c]
            else:
                least = wp.float64(0.1) * wp.float64(SOFTNESS) * work.size[worldid, r] * work.size[worldid, r]
                work.factor[worldid, r, r] = wp.sqrt(wp.max(total, least))
    for r in range(rows):
        total = work.step[worldid, r]
        for k in range(begin[r], r):
            total -= work.factor[worldid, r, k] * work.step[worldid, k]
        work.step[worldid, r] = total / work.factor[worldid, r, r]
    for back in range(rows):
        r = rows - 1 - back
        found = work.step[worldid, r] / work.factor[worldid, r, r]
        work.step[worldid, r] = found
        for k in range(begin[r], r):
            work.step[worldid, k] -= work.factor[worldid, r, k] * found
    return largest


@wp.func
def optimize_frame(
    worldid: int,
    row: wp.array2d[int],
    begin: wp.array[int],
    effect: wp.array3d[wp.float64],
    right: wp.array2d[wp.float64],
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    exponent: wp.float64,
    work: DualWork,
    activation: wp.array2d[wp.float64],
    missing: wp.array2d[wp.float64],
    residual: wp.array[wp.float64],
):
    """Solve a frame by Newton's method from the dual that is there; see `optimize_activations`."""
    good = bool(True)
    for r in range(right.shape[1]):
        work.size[worldid, r] = wp.float64(0.0)
        good = good and wp.isfinite(right[worldid, r])
    for i in range(row.shape[0]):
        activation[worldid, i] = lower[worldid, i]
        for slot in range(row.shape[1]):
            if row[i, slot] >= 0:
                x = effect[worldid, i, slot]
                good = good and wp.isfinite(x)
                work.size[worldid, row[i, slot]] += x * x
    for r in range(right.shape[1]):
        size = wp.sqrt(work.size[worldid, r])
        work.size[worldid, r] = wp.where(size > wp.float64(0.0), size, wp.float64(1.0))
        missing[worldid, r] = right[worldid, r]
    residual[worldid] = wp.float64(wp.inf)
    if not good:
        return
    cost = dual_cost(worldid, row, effect, right, lower, upper, exponent, work, work.dual)
    done = bool(False)
    for _ in range(STEPS):
        if not done:
            residual[worldid] = dual_newton(
                worldid, row, begin, effect, right, lower, upper, exponent, work, activation
            )
            done = residual[worldid] < wp.float64(TOLERANCE)
            if not done:
                descent = wp.float64(0.0)
                rounding = wp.float64(0.0)
                for r in range(right.shape[1]):
                    descent += work.slope[worldid, r] * work.step[worldid, r]
                    rounding += wp.float64(ROUNDING) * wp.abs(work.dual[worldid, r] * right[worldid, r])
                length = wp.float64(1.0)
                found = bool(False)
                for _ in range(40):
                    if not found:
                        for r in range(right.shape[1]):
                            work.trial[worldid, r] = work.dual[worldid, r] + length * work.step[worldid, r]
                        now = dual_cost(worldid, row, effect, right, lower, upper, exponent, work, work.trial)
                        if now <= cost + wp.float64(1.0e-4) * length * descent + rounding:
                            found = True
                            cost = now
                        else:
                            length *= wp.float64(0.5)
                if found:
                    for r in range(right.shape[1]):
                        work.dual[worldid, r] = work.trial[worldid, r]
                done = not found
    for i in range(row.shape[0]):
        for slot in range(row.shape[1]):
            if row[i, slot] >= 0:
                missing[worldid, row[i, slot]] -= effect[worldid, i, slot] * activation[worldid, i]


@wp.kernel(enable_backward=False)
def optimize_activations(
    # Model:
    row: wp.array2d[int],
    begin: wp.array[int],
    # In:
    effect: wp.array3d[wp.float64],
    right: wp.array2d[wp.float64],
    lower: wp.array2d[wp.float64],
    upper: wp.array2d[wp.float64],
    exponent: wp.float64,
    first: wp.array[int],
    # Out:
    work: DualWork,
    activation: wp.array2d[wp.float64],
    missing: wp.array2d[wp.float64],
    residual: wp.array[wp.float64],
):
    """a = argmin sum |a|^p with A a = b within bounds; `missing` is b - A a.

    A thread solves the frames from its first to that of the next thread; the first begins at the dual that is
    there, others at that of the frame before. The residual is the largest gradient of the dual problem in
    units of its row. It is infinite, and a the lower bound, where a number of the problem is not finite.
    """
    worldid = wp.tid()
    for frame in range(first[worldid], first[worldid + 1]):
        if frame > first[worldid]:
            if residual[frame - 1] < wp.float64(TOLERANCE):
                for r in range(right.shape[1]):
                    work.dual[frame, r] = work.dual[frame - 1, r]
        optimize_frame(
            frame, row, begin, effect, right, lower, upper, exponent, work, activation, missing, residual
        )


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
    device: Any = None,
    near: np.ndarray | None = None,
    sequence: int = 0,
) -> Activations:
    """Return the activations of least cost that give the wanted moments.

    Args:
        rows: For each unknown the rows of A that it has an entry in; -1 fills up behind them.
        effects: These entries, shape (frames, unknowns, entries).
        right: b, shape (frames, rows).
        lower: Bounds, broadcast to (frames, unknowns); may be infinite.
        upper: Upper bounds.
        exponent: p >= 1.
        device: Where it is solved.
        near: Dual of a problem like this one, to begin at.
        sequence: Frames of a recording, where several follow each other: each is solved as if it were alone;
            0: there is one.

    Raises:
        ValueError: The exponent is below 1, or a lower bound is above its upper one.
    """
    if not 1.0 <= exponent < np.inf:
        raise ValueError(f"the exponent of activations must be at least 1 and finite, got {exponent}")
    frames, count = effects.shape[:2]
    bounds = [np.broadcast_to(np.asarray(bound, float), (frames, count)) for bound in (lower, upper)]
    if not (bounds[0] <= bounds[1]).all():
        raise ValueError("lower bounds of activations must be at most the upper ones")
    table, each = np.array(rows, np.int32).reshape(count, -1), sequence or max(frames, 1)
    heads = np.arange(0, each, RUN if near is None else 1)
    first = (np.arange(0, frames, each)[:, None] + heads).ravel()
    first = np.append(first[first < frames], frames)
    with wp.ScopedDevice(device):
        work = DualWork()
        work.dual = wp.array(np.zeros(right.shape) if near is None else near, dtype=wp.float64)
        for name in ("trial", "slope", "step", "size"):
            setattr(work, name, wp.zeros(right.shape, dtype=wp.float64))
        work.factor = wp.zeros((*right.shape, right.shape[1]), dtype=wp.float64)
        activation, missing = (
            wp.zeros((frames, count), dtype=wp.float64),
            wp.zeros(right.shape, dtype=wp.float64),
        )
        residual = wp.zeros(frames, dtype=wp.float64)
        launch(
            optimize_activations,
            len(first) - 1,
            row=wp.array(table, dtype=int),
            begin=wp.array(_first_shared(table, right.shape[1]), dtype=int),
            effect=wp.array(effects, dtype=wp.float64),
            right=wp.array(right, dtype=wp.float64),
            lower=wp.array(bounds[0], dtype=wp.float64),
            upper=wp.array(bounds[1], dtype=wp.float64),
            exponent=float(exponent),
            first=wp.array(first, dtype=int),
            work=work,
            activation=activation,
            missing=missing,
            residual=residual,
        )
        return Activations(activation.numpy(), missing.numpy(), residual.numpy(), work.dual.numpy())


def _first_shared(table: np.ndarray, rows: int) -> np.ndarray:
    """Return for each row the first that any unknown has an entry in, too, among those up to it."""
    first = np.arange(rows, dtype=np.int32)
    for own in table:
        shared = own[own >= 0]
        if len(shared):
            first[shared] = np.minimum(first[shared], shared.min())
    return first
