"""Parts that a process has once: its cores, Warp, one construction at a time, lines that are said once.

To build a simulation is to change what belongs to the process: the functions that launch, the capture that is
being made, the default device, the level of Warp's log. Two threads that built at the same time would take
each other's launches for their own. Steps go on meanwhile: a captured graph uses nothing of this.
"""

import contextlib
import functools
import logging
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import ParamSpec, TypeVar

import warp as wp

from myowarp.disk import writable_folder

P = ParamSpec("P")
R = TypeVar("R")

logger = logging.getLogger("myowarp")

NO_DRIVER = "Could not find or load the NVIDIA CUDA driver"  # as Warp's native code says
GPU_FILES = ("/dev/nvidiactl", "/dev/dxg")  # of a machine that has an NVIDIA GPU: Linux, WSL

CORES = "MYOWARP_CORES"
"""Environment variable: most cores that a process uses, where several share a machine."""

BUILD_LOCK = threading.RLock()
"""Held by the thread that builds, or launches without a graph."""

if hasattr(os, "register_at_fork"):  # a child would inherit half of a construction, and nobody to end it
    os.register_at_fork(
        before=BUILD_LOCK.acquire, after_in_parent=BUILD_LOCK.release, after_in_child=BUILD_LOCK.release
    )


def with_build_lock(build: Callable[P, R]) -> Callable[P, R]:
    """Return a function that waits until no other thread builds."""

    @functools.wraps(build)
    def waiting(*args: P.args, **kwargs: P.kwargs) -> R:
        with BUILD_LOCK:
            return build(*args, **kwargs)

    return waiting


def listed(names: Sequence[str], most: int) -> str:
    """Return names with commas, the first few of many and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


@cache
def warn_once(message: str) -> None:
    """Log a message, the first time only."""
    logger.warning(message)


@contextlib.contextmanager
def stop_asked() -> Iterator[Callable[[], bool]]:
    """Yield whether Ctrl-C or SIGTERM came; the first one is a wish, a second one acts as ever."""
    came: list[bool] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return

    def note(*_: object) -> None:
        came.append(True)
        for number, handler in before.items():
            signal.signal(number, handler)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, note)
    try:
        yield lambda: bool(came)
    finally:
        note()


def check_on_cpu(what: str, device: object) -> None:
    """Raise ValueError for a device other than the CPU, where `what`, in float64 and for few worlds, runs."""
    if str(device) != "cpu":
        raise ValueError(f"{what} run on the CPU, got device {str(device)!r}; leave device out")


def num_cores() -> int:
    """Return how many cores this process may use."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    most = os.environ.get(CORES, "")
    return max(1, min(found, int(most))) if most.isdecimal() else found


@with_build_lock
@cache
def start_warp() -> str:
    """Start Warp, with a folder for its machine code that can be written.

    Returns:
        Why there is no CUDA device, as far as Warp said so; it is not printed where there is no GPU either.
    """
    with _without_driver_warning() as said:
        try:
            wp.init()
        except OSError as error:
            folder = Path(error.filename or wp.config.kernel_cache_dir or "warp")
            wp.config.kernel_cache_dir = str(writable_folder(folder, "WARP_CACHE_PATH"))
            wp.init()
    given = Path(wp.config.kernel_cache_dir)
    folder = writable_folder(given, "WARP_CACHE_PATH")
    if folder != given:
        for module in given.glob("wp_*"):
            with contextlib.suppress(
                OSError
            ):  # it is there; or Windows allows no links: it is compiled again
                (folder / module.name).symlink_to(module, target_is_directory=True)
        wp.config.kernel_cache_dir = str(folder)
    return "".join(said)


@contextlib.contextmanager
def _without_driver_warning() -> Iterator[list[str]]:
    """Keep one line of Warp's native code off the error stream where it says what everybody knows: no GPU."""
    said: list[str] = []
    try:
        stream = os.dup(2)
    except OSError:  # there is no error stream
        yield said
        return
    with tempfile.TemporaryFile() as held:
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(held.fileno(), 2)
        try:
            yield said
        finally:
            os.dup2(stream, 2)
            os.close(stream)
            held.seek(0)
            for line in held:
                if NO_DRIVER.encode() in line and not any(map(os.path.exists, GPU_FILES)):
                    said[:] = [NO_DRIVER]
                else:
                    os.write(2, line)
