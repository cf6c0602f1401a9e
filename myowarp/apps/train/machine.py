"""The machine that is measured on, and who else uses its cores."""

import os
import platform
import shutil
import time
from pathlib import Path

from myowarp.disk import existing

COPIES = 2  # of a replay at once, in memory and on disk, while it is saved


def processor() -> str:
    """Return the processor's name."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line
        ]
        if names:
            return names[0]
    return platform.processor() or platform.machine()


def multiplies_bfloat16() -> bool:
    """Return whether the processor multiplies bfloat16 (Linux tells); without, it is slow."""
    info = Path("/proc/cpuinfo")
    words = info.read_text().split() if info.exists() else []
    return not {"avx512_bf16", "amx_bf16", "bf16"}.isdisjoint(words)


def used_seconds() -> tuple[float, float]:
    """Return the processor time that all processes here have used so far, and that the host has kept [s].

    Both are 0 where it is not known (Linux tells).
    """
    if not (stat := Path("/proc/stat")).exists():
        return 0.0, 0.0
    words = stat.read_text().splitlines()[0].split()[1:]
    user, nice, system, _, _, irq, softirq, stolen, *_ = (int(w) / os.sysconf("SC_CLK_TCK") for w in words)
    return user + nice + system + irq + softirq, stolen


class Stopwatch:
    """Wall time and processor time of this process, and how many cores others kept busy, from now on.

    Others are other processes, and on a virtual machine whoever its host gives the cores to meanwhile.
    """

    def __init__(self) -> None:
        self._begin = time.perf_counter(), time.process_time(), *used_seconds()

    def read(self) -> dict[str, float]:
        """Return `seconds`, `cpu_seconds` of this process on all cores, and `cores_busy_with_others`."""
        now = time.perf_counter(), time.process_time(), *used_seconds()
        wall, own, busy, stolen = (after - before for after, before in zip(now, self._begin, strict=True))
        others = max(0.0, busy - own) + stolen if busy else 0.0
        return {"seconds": wall, "cpu_seconds": own, "cores_busy_with_others": others / max(wall, 1e-9)}


def check_replay(size: int, folder: Path) -> None:
    """Raise a clear error now if this machine cannot hold and save a replay.

    A save copies it once more, and the last checkpoint stays until the new one is whole.

    Args:
        size: Of the replay [B].
        folder: Where checkpoints go; it may not exist yet.

    Raises:
        ValueError: There is not enough memory or disk.
    """
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for what, there in (("memory", memory), ("disk", shutil.disk_usage(existing(folder)).free)):
        if (needed := COPIES * size) > there:
            raise ValueError(
                f"--replay needs {needed / 1e9:.1f} GB of {what} to be kept and saved, this machine has "
                f"{there / 1e9:.1f} GB; choose a smaller --replay"
            )
