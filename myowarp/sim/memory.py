"""Whether the worlds of a scene fit into memory, found out before they are allocated.

Linux promises memory that it does not have, and ends the process once it is used.
"""

import contextlib
import dataclasses
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import mujoco_warp as mjw
import warp as wp

LARGE_WORLD = 2**21  # bytes; a hand that holds an object has 1e5, the whole body 9e5, under `fast` 1.8e6
MEMINFO, CGROUP_LIMIT = Path("/proc/meminfo"), Path("/sys/fs/cgroup/memory.max")


def check_memory(
    make_data: Callable[[int], Iterable[mjw.Data | wp.array | None]],
    further: int,
    num_worlds: int,
    device: wp.Device,
) -> None:
    """Raise if worlds need more memory than is available.

    Args:
        make_data: Allocates the arrays of the engine and of the step in so many worlds, and on CUDA what a
            step allocates: most of what a simulation needs.
        further: What the task keeps of each world besides [bytes].
        num_worlds: Number of worlds.
        device: Where they are to live.

    Raises:
        ValueError: They do not fit.
    """
    available = available_memory(device)
    if available is None or num_worlds * LARGE_WORLD <= available:
        return
    with wp.ScopedDevice(device):
        one, two = (sum(map(num_bytes, make_data(number))) + number * further for number in (1, 2))
    needed = one + (num_worlds - 1) * (two - one)
    if needed > available:
        raise ValueError(
            f"{num_worlds:,} worlds need at least {needed / 1e9:,.1f} GB of memory, got "
            f"{available / 1e9:,.1f} GB on {device.alias}; use at most {available // (two - one):,} worlds"
        )


def available_memory(device: wp.Device) -> int | None:
    """Return how much memory is available on a device [bytes]; None where that is not known."""
    if not device.is_cpu:
        return int(device.free_memory)
    limits = []
    with contextlib.suppress(OSError, AttributeError):  # not Linux
        kilobytes = re.search(r"MemAvailable:\s+(\d+)", MEMINFO.read_text())
        limits.append(1024 * int(kilobytes.group(1)))  # type: ignore[union-attr]
    with contextlib.suppress(OSError, ValueError):  # no container, or one without a limit
        limits.append(int(CGROUP_LIMIT.read_text()))
    return min(limits, default=None)


def num_bytes(thing: Any) -> int:
    """Return the size of all arrays of a dataclass."""
    if isinstance(thing, wp.array):
        return int(thing.capacity)
    if not dataclasses.is_dataclass(thing):
        return 0
    return sum(num_bytes(getattr(thing, field.name)) for field in dataclasses.fields(thing))
