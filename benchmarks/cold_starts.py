"""First starts at once: three processes on an empty cache, one killed while it compiles, beside one alone.

    python -m benchmarks.cold_starts --output out/cold_starts.json

Each round has fresh folders for MyoWarp's and Warp's files. `ratio` is the time of the slowest process that
lives by that of one alone; at most 2 is wanted. Idle cores are needed for times; processor times say how much
the processes left to each other, on busy cores too.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from benchmarks.machine import IDLE_CORES, processor
from myowarp.apps.reports.machine import used_seconds


@dataclass
class Options:
    """Measure first starts."""

    output: Path = Path("out/cold_starts.json")
    """JSON file to write."""
    task: str = "myoElbowPose1D6MRandom-v0"
    """Task."""
    processes: int = 3
    """Processes that start at once."""
    kill_after: float = 8.0
    """Seconds until the last one is killed; at most half of the time of one alone."""
    rounds: int = 3
    """Measurements of each, in turns."""


def main() -> None:
    """Measure, print and write."""
    options = tyro.cli(Options, description=__doc__)
    rounds = []
    for number in range(options.rounds):
        alone = first_starts(options.task, 1, None)
        kill_after = min(options.kill_after, alone["seconds"][0] / 2)
        together = first_starts(options.task, options.processes, kill_after)
        ratio = max(together["seconds"]) / alone["seconds"][0]
        rounds.append({"ratio": ratio, "kill_after": kill_after, "alone": alone, "together": together})
        print(
            f"round {number}: {alone['seconds'][0]:.1f} s alone, {max(together['seconds']):.1f} s together, "
            f"{ratio:.2f} times"
        )
    report = {
        "ratio": statistics.median(one["ratio"] for one in rounds),
        "worst_ratio": max(one["ratio"] for one in rounds),
        "disturbed": any(one[k]["others"] > IDLE_CORES for one in rounds for k in ("alone", "together")),
        "processor": processor(),
        "cores": os.cpu_count(),
        "task": options.task,
        "rounds": rounds,
    }
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    print(
        f"First starts at once take {report['ratio']:.2f} times as long as one (median of {options.rounds})"
    )


def first_starts(task: str, processes: int, kill_after: float | None) -> dict[str, Any]:
    """Start processes on an empty cache, and return how long those took that were not killed.

    Args:
        task: Task id.
        processes: How many.
        kill_after: Seconds until the last one is killed; None: it is not.

    Raises:
        RuntimeError: One failed, or has other numbers than the first.
    """
    with tempfile.TemporaryDirectory() as folder:
        caches = {"MYOWARP_CACHE_DIR": f"{folder}/myowarp", "WARP_CACHE_PATH": f"{folder}/warp"}
        begin, busy = time.perf_counter(), sum(used_seconds())
        running = {}
        for index in range(processes):
            sizes = ["--num-worlds", "4", "--steps", "20", "--seed", "1", "--device", "cpu"]
            command = ["rollout", task, *sizes, "--save", f"{folder}/{index}.npz"]
            with Path(f"{folder}/{index}.log").open("w") as log:
                process = subprocess.Popen(
                    [sys.executable, "-m", "myowarp", *command],
                    stdout=log,
                    stderr=log,
                    env=os.environ | caches,
                )
            running[process.pid] = index, process
        victim = list(running)[-1] if kill_after is not None else None
        if victim is not None and kill_after is not None:
            time.sleep(kill_after)
            running[victim][1].kill()
        seconds, cpu_seconds, own = [], [], 0.0
        while running:
            pid, status, used = os.wait4(-1, 0)
            index, process = running.pop(pid)
            process.returncode = os.waitstatus_to_exitcode(status)  # wait4 has taken it from subprocess
            own += used.ru_utime + used.ru_stime
            if pid == victim:
                continue
            if process.returncode:
                raise RuntimeError(Path(f"{folder}/{index}.log").read_text())
            seconds.append(time.perf_counter() - begin)
            cpu_seconds.append(used.ru_utime + used.ru_stime)
        others = max(0.0, sum(used_seconds()) - busy - own) / (time.perf_counter() - begin)
        found = [np.load(path)["obs"] for path in sorted(Path(folder).glob("*.npz"))]
        if not all(np.array_equal(found[0], obs) for obs in found):
            raise RuntimeError("processes that started at once have other numbers than each other")
        return {"seconds": seconds, "cpu_seconds": cpu_seconds, "others": others}


if __name__ == "__main__":
    main()
