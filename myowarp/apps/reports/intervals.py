"""95 % intervals: Student's, a bootstrap's, the jackknife's, Wilson's of a proportion, Newcombe's of two."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

CONFIDENCE = 0.95
RESAMPLES = 9_999  # of a bootstrap
Z = 1.959963984540054  # quantile of the normal distribution for 95 %


def student(values: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return Student's 95 % interval of the mean over the first axis, NaN with fewer than two values."""
    from scipy import stats

    values = np.asarray(values, dtype=float)
    if (n := len(values)) < 2:
        return (np.full(values.shape[1:], np.nan),) * 2
    mean = values.mean(axis=0)
    half = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, n - 1) * values.std(axis=0, ddof=1) / math.sqrt(n)
    return mean - half, mean + half


def mean_interval(values: ArrayLike, least: float = -math.inf, most: float = math.inf) -> tuple[float, float]:
    """Return a 95 % interval of a mean that stays within what is possible.

    It is Student's; where that leaves the possible range, it is the bias-corrected bootstrap (Efron 1987,
    JASA 82:171). Fewer than two values have none, and neither have values that are all the same.

    Args:
        values: Independent values, shape (n,).
        least: Least possible mean.
        most: Greatest possible mean.
    """
    from scipy import stats

    values = np.asarray(values, dtype=float)
    if len(values) < 2 or np.ptp(values) == 0.0:
        return math.nan, math.nan
    low, high = map(float, student(values))
    if least <= low and high <= most:
        return low, high
    found = stats.bootstrap(
        (values,), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, method="BCa", rng=0
    ).confidence_interval
    return float(found.low), float(found.high)


def jackknife(values: ArrayLike, statistic: Callable[[np.ndarray], float]) -> tuple[float, float]:
    """Return a 95 % interval of a statistic of independent values, NaN with fewer than two.

    The statistic s is in its middle. Its width is that of Student's interval of the pseudo-values
    n s - (n - 1) s_i, with s_i of all values but one; of a mean it is that of the values. Source: Tukey 1958,
    Ann Math Stat 29:614.

    Args:
        values: Independent values, each a number or an array, shape (n, ...).
        statistic: Function of some of them, (m, ...) to a number.
    """
    values = np.asarray(values, dtype=float)
    n = len(values)
    if n < 2:
        return math.nan, math.nan
    without = np.array([statistic(np.delete(values, i, axis=0)) for i in range(n)])
    whole = statistic(values)
    low, high = student(n * whole - (n - 1) * without)
    half = 0.5 * float(high - low)
    return whole - half, whole + half


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a proportion. Source: Wilson 1927, JASA 22:209.

    Written out, because `myowarp eval` runs where SciPy is not installed.
    """
    share, z2 = successes / trials, Z * Z / trials
    middle = share + z2 / 2.0
    half = Z * math.sqrt(share * (1.0 - share) / trials + z2 / (4.0 * trials))
    return max(0.0, (middle - half) / (1.0 + z2)), min(1.0, (middle + half) / (1.0 + z2))


def newcombe(successes: int, trials: int, successes_then: int, trials_then: int) -> tuple[float, float]:
    """Return a 95 % interval of the difference of two proportions, the second minus the first.

    Source: Newcombe 1998, Statistics in Medicine 17:873, method 10: from Wilson's intervals of both.
    """
    first, second = successes / trials, successes_then / trials_then
    low, high = wilson(successes, trials)
    low_then, high_then = wilson(successes_then, trials_then)
    down, up = math.hypot(second - low_then, high - first), math.hypot(high_then - second, first - low)
    return second - first - down, second - first + up
