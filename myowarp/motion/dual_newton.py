"""Newton's method on the dual of a static optimisation, a run of frames a thread.

    minimize  sum_i psi(A_i . y) - y . b + e |y|^2 / 2,    psi(s) = max of s a - |a|^p within the bounds

Steps are halved until the cost falls; a_i is where psi has its maximum. Of the second derivatives only the
envelope is computed, from the first row on that an unknown shares with each: muscles of one leg and of the
other share none. For p = 1 a term a^2 / 100 makes the solution unique.

Source: dual of separable problems, Bertsekas, *Nonlinear Programming* (1999), section 6.1.
"""

import warp as wp

from myowarp.kernels.batching import batched

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

ARMIJO = 1e-4
"""Share of the expected descent that a step must have."""

HALVINGS = 40
"""Most of a step."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class Problem:
    """min sum |a_i|^p with A a = b of all frames; bounds and scale may be those of one, for all.

    Attributes:
        row: For each unknown the rows of A that it has an entry in, -1 behind them.
        entry: For each of these the column of `effect`; -1: the entry is 1.
        begin: For each row the first that any unknown has an entry in, too, among those up to it.
        effect: Entries of A before they are scaled, (num_worlds, num_entries).
        scale: Factor on the entries of an unknown.
        right: b, (num_worlds, num_rows).
        lower: Least a.
        upper: Greatest a.
        exponent: p.
    """

    row: wp.array2d[int]
    entry: wp.array2d[int]
    begin: wp.array[int]
    effect: wp.array2d[wp.float64]
    scale: wp.array2d[wp.float64]
    right: wp.array2d[wp.float64]
    lower: wp.array2d[wp.float64]
    upper: wp.array2d[wp.float64]
    exponent: wp.float64


@wp.struct
class DualWork:
    """Arrays of a frame's iteration.

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
def entry(worldid: int, i: int, slot: int, problem: Problem) -> wp.float64:
    """Return an entry of A."""
    scale = problem.scale[batched(worldid, problem.scale.shape[0]), i]
    column = problem.entry[i, slot]
    if column < 0:
        return scale
    return scale * problem.effect[worldid, column]


@wp.func
def bounded(worldid: int, i: int, problem: Problem, a: wp.float64) -> wp.float64:
    """Return a within its bounds."""
    low = problem.lower[batched(worldid, problem.lower.shape[0]), i]
    return wp.clamp(a, low, problem.upper[batched(worldid, problem.upper.shape[0]), i])


@wp.func
def pull(worldid: int, i: int, problem: Problem, dual: wp.array2d[wp.float64]) -> wp.float64:
    """A_i . y."""
    s = wp.float64(0.0)
    for slot in range(problem.row.shape[1]):
        r = problem.row[i, slot]
        if r < 0:
            break
        s += entry(worldid, i, slot, problem) * dual[worldid, r]
    return s


@wp.func
def dual_cost(worldid: int, problem: Problem, work: DualWork, dual: wp.array2d[wp.float64]) -> wp.float64:
    """sum psi(A_i . y) - y . b + e |y|^2 / 2."""
    total = wp.float64(0.0)
    for i in range(problem.row.shape[0]):
        s = pull(worldid, i, problem, dual)
        a = bounded(worldid, i, problem, best_activation(s, problem.exponent)[0])
        total += s * a - cost_of(a, problem.exponent)
    for r in range(problem.right.shape[1]):
        y = dual[worldid, r]
        size = work.size[worldid, r]
        total += wp.float64(0.5) * wp.float64(SOFTNESS) * size * size * y * y - y * problem.right[worldid, r]
    return total


@wp.func
def dual_newton(
    worldid: int, problem: Problem, work: DualWork, activation: wp.array2d[wp.float64]
) -> wp.float64:
    """Activations, gradient and Newton step at y; returns the largest gradient in units of its row."""
    rows = problem.right.shape[1]
    for r in range(rows):
        soft = wp.float64(SOFTNESS) * work.size[worldid, r] * work.size[worldid, r]
        work.slope[worldid, r] = soft * work.dual[worldid, r] - problem.right[worldid, r]
        for c in range(problem.begin[r], r):
            work.factor[worldid, r, c] = wp.float64(0.0)
        work.factor[worldid, r, r] = soft
    for i in range(problem.row.shape[0]):
        best = best_activation(pull(worldid, i, problem, work.dual), problem.exponent)
        a = bounded(worldid, i, problem, best[0])
        activation[worldid, i] = a
        for slot in range(problem.row.shape[1]):
            r = problem.row[i, slot]
            if r < 0:
                break
            x = entry(worldid, i, slot, problem)
            work.slope[worldid, r] += x * a
            if a == best[0]:
                for other in range(problem.row.shape[1]):
                    c = problem.row[i, other]
                    if c < 0:
                        break
                    if c <= r:
                        work.factor[worldid, r, c] += x * entry(worldid, i, other, problem) * best[1]
    largest = wp.float64(0.0)
    for r in range(rows):
        largest = wp.max(largest, wp.abs(work.slope[worldid, r]) / work.size[worldid, r])
        work.step[worldid, r] = -work.slope[worldid, r]
    for r in range(rows):
        for c in range(problem.begin[r], r + 1):
            total = work.factor[worldid, r, c]
            for k in range(wp.max(problem.begin[r], problem.begin[c]), c):
                total -= work.factor[worldid, r, k] * work.factor[worldid, c, k]
            if r > c:
                work.factor[worldid, r, c] = total / work.factor[worldid, c, c]
            else:
                least = wp.float64(0.1) * wp.float64(SOFTNESS) * work.size[worldid, r] * work.size[worldid, r]
                work.factor[worldid, r, r] = wp.sqrt(wp.max(total, least))
    for r in range(rows):
        total = work.step[worldid, r]
        for k in range(problem.begin[r], r):
            total -= work.factor[worldid, r, k] * work.step[worldid, k]
        work.step[worldid, r] = total / work.factor[worldid, r, r]
    for back in range(rows):
        r = rows - 1 - back
        found = work.step[worldid, r] / work.factor[worldid, r, r]
        work.step[worldid, r] = found
        for k in range(problem.begin[r], r):
            work.step[worldid, k] -= work.factor[worldid, r, k] * found
    return largest


@wp.func
def optimize_frame(
    worldid: int,
    problem: Problem,
    work: DualWork,
    activation: wp.array2d[wp.float64],
    missing: wp.array2d[wp.float64],
    residual: wp.array[wp.float64],
):
    """Solve a frame by Newton's method from the dual that is there; see `optimize_activations`."""
    good = bool(True)
    rows = problem.right.shape[1]
    for r in range(rows):
        work.size[worldid, r] = wp.float64(0.0)
        good = good and wp.isfinite(problem.right[worldid, r])
    for i in range(problem.row.shape[0]):
        activation[worldid, i] = problem.lower[batched(worldid, problem.lower.shape[0]), i]
        for slot in range(problem.row.shape[1]):
            if problem.row[i, slot] >= 0:
                x = entry(worldid, i, slot, problem)
                good = good and wp.isfinite(x)
                work.size[worldid, problem.row[i, slot]] += x * x
    for r in range(rows):
        size = wp.sqrt(work.size[worldid, r])
        work.size[worldid, r] = wp.where(size > wp.float64(0.0), size, wp.float64(1.0))
        missing[worldid, r] = problem.right[worldid, r]
    residual[worldid] = wp.float64(wp.inf)
    if not good:
        return
    cost = dual_cost(worldid, problem, work, work.dual)
    done = bool(False)
    for _ in range(STEPS):
        if not done:
            residual[worldid] = dual_newton(worldid, problem, work, activation)
            done = residual[worldid] < wp.float64(TOLERANCE)
            if not done:
                descent = wp.float64(0.0)
                rounding = wp.float64(0.0)
                for r in range(rows):
                    descent += work.slope[worldid, r] * work.step[worldid, r]
                    size = wp.abs(work.dual[worldid, r] * problem.right[worldid, r])
                    rounding += wp.float64(ROUNDING) * size
                length = wp.float64(1.0)
                found = bool(False)
                for _ in range(HALVINGS):
                    if not found:
                        for r in range(rows):
                            work.trial[worldid, r] = work.dual[worldid, r] + length * work.step[worldid, r]
                        now = dual_cost(worldid, problem, work, work.trial)
                        if now <= cost + wp.float64(ARMIJO) * length * descent + rounding:
                            found = True
                            cost = now
                        else:
                            length *= wp.float64(0.5)
                if found:
                    for r in range(rows):
                        work.dual[worldid, r] = work.trial[worldid, r]
                done = not found
    for i in range(problem.row.shape[0]):
        for slot in range(problem.row.shape[1]):
            if problem.row[i, slot] >= 0:
                given = entry(worldid, i, slot, problem) * activation[worldid, i]
                missing[worldid, problem.row[i, slot]] -= given


@wp.kernel(enable_backward=False)
def optimize_activations(
    # In:
    problem: Problem,
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
                for r in range(problem.right.shape[1]):
                    work.dual[frame, r] = work.dual[frame - 1, r]
        optimize_frame(frame, problem, work, activation, missing, residual)
