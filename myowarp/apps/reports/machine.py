"""The machine that is measured on, and who else uses its cores."""

import os
import platform
import time
from pathlib import Path


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
