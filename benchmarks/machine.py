"""The machine that is measured on, and who else uses its cores."""

import statistics
import time
from collections.abc import Callable, Iterable
from typing import TypeVar

from myowarp.apps.reports.machine import processor, used_seconds

__all__ = ["IDLE_CORES", "disturbances", "least_disturbed", "processor", "timed_here"]

IDLE_CORES = 0.1  # cores that others may keep busy before a measurement counts as disturbed
REPEATS = 4  # of a disturbed measurement

T = TypeVar("T")


def least_disturbed(measure: Callable[[], tuple[T, float]]) -> tuple[T, float]:
    """Measure, and again up to four times where others disturb it.

    Others are other processes, and on a virtual machine whoever its host gives the cores to meanwhile. They
    are seen on Linux only.

    Args:
        measure: Returns what it measured and the processor time that this took [s].

    Returns:
        What was measured when others kept the fewest cores busy, and how many that were.
    """
    tries: list[tuple[T, float]] = []
    while len(tries) <= REPEATS and all(others > IDLE_CORES for _, others in tries):
        begin, (busy, stolen) = time.perf_counter(), used_seconds()
        measured, own = measure()
        wall, (busy_after, stolen_after) = time.perf_counter() - begin, used_seconds()
        others = max(0.0, busy_after - busy - own) + stolen_after - stolen
        tries.append((measured, others / wall))
    return min(tries, key=lambda one: one[1])


def timed_here(measure: Callable[[], T]) -> Callable[[], tuple[T, float]]:
    """Return for `least_disturbed` what measures in this process."""

    def timed() -> tuple[T, float]:
        used = time.process_time()
        return measure(), time.process_time() - used

    return timed


def disturbances(others: Iterable[float]) -> dict[str, float]:
    """Return for a report how many cores others kept busy in all measurements."""
    cores = list(others)
    return {
        "median": round(statistics.median(cores), 3),
        "worst": round(max(cores), 3),
        "disturbed_measurements": sum(busy > IDLE_CORES for busy in cores),
        "measurements": len(cores),
    }
