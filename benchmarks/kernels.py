"""Cycles that each kernel of a physics step takes for a world, and each part of the contact solver.

    python -m benchmarks.kernels
    python -m benchmarks.kernels myoHandKeyTurnRandom-v0 --num-worlds 256

A captured control step is replayed here operation by operation, from states reached by random actions, with
the CPU time of this thread read around each launch. Of all rounds the least counts, since other work on the
machine only adds. The solver's parts are the comments `// Part: name` of `contact_solve.cpp`, compiled in for
this benchmark alone as reads of the cycle counter. Cycles are those of that counter. Linux on one core.
"""

import ctypes
import json
import os
import re
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import CONTACT_TASKS
from benchmarks.machine import processor
from benchmarks.substep import Options as Warmup
from benchmarks.substep import Physics
from myowarp.definitions.task import TASKS
from myowarp.engine.idle import idle_kernels
from myowarp.engine.patch import exchanged
from myowarp.engine.replay import Operation
from myowarp.engine.stages import contact_solve
from myowarp.sim.build import stepped_of

PART = re.compile(r"// Part: (.*)\n")
COUNTED = """
auto* counted = (unsigned long long*){address}ull;
int part = 0;
auto since = __builtin_readcyclecounter();
auto enter = [&](int next) {{
    const auto now = __builtin_readcyclecounter();
    counted[part] += now - since;
    since = now;
    part = next;
}};
"""


@dataclass
class Options:
    """Measure kernels."""

    tasks: tyro.conf.Positional[tuple[str, ...]] = (*CONTACT_TASKS, "myoHandPoseRandom-v0", "myoLegWalk-v0")
    """Task names with version."""
    output: Path = Path("out/kernels.json")
    """JSON file to write."""
    num_worlds: int = 64
    """Worlds stepped together."""
    rounds: int = 10
    """Rounds; the least counts."""


class Parts:
    """Counters of the solver's parts, compiled in from here on."""

    def __init__(self) -> None:
        self.names = ("others", *PART.findall(contact_solve.SOURCE))
        self.cycles = np.zeros(len(self.names), dtype=np.uint64)
        numbers = iter(range(1, len(self.names)))
        source = PART.sub(lambda _: f"enter({next(numbers)});\n", contact_solve.SOURCE)
        head, body = source.split("\n\n", 1)
        counters = COUNTED.format(address=self.cycles.ctypes.data)
        contact_solve.SOURCE = f"{head}\n{counters}{body}\nenter(0);\n"


class Kernels(Physics):
    """The captured control step of one task, launch by launch."""

    def __init__(self, key: str, options: Options) -> None:
        super().__init__(TASKS[key], options.num_worlds, Warmup())
        self.keys: list[str] = []
        with exchanged(self._note):
            self._graph = self.graph(self.names, idle_kernels(stepped_of(self.scene)))
        self.rows = self._graph.replay.rows.view(np.int64).tolist()
        number = sum(row[0] == Operation.LAUNCH for row in self.rows)
        self.keys = self.keys[-1 - number : -1]  # after those that were compiled; the last is `replay` itself
        self.taken: dict[str, int] = {}

    def _note(self, kernel: wp.Kernel) -> wp.Kernel:
        self.keys.append(kernel.key.split("__locals__")[-1].removeprefix("_"))
        return kernel

    def replay(self) -> None:
        """Do what `engine.replay` does, and add up the nanoseconds of each kernel."""
        launch = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
        row = 0
        launches = (i for i, (operation, *_) in enumerate(self.rows) if operation == Operation.LAUNCH)
        keys = dict(zip(launches, self.keys, strict=True))
        while self.rows[row][0] != Operation.FINISH:
            operation, first, second, third = self.rows[row]
            jump = 1
            if operation == Operation.LAUNCH:
                code, begin = launch(first), time.thread_time_ns()
                code(second, third)
                self.taken[keys[row]] += time.thread_time_ns() - begin
            elif operation == Operation.SET:
                ctypes.memset(first, second, third)
            elif operation == Operation.COPY:
                ctypes.memmove(first, second, third)
            elif operation == Operation.JUMP:
                jump = first
            elif operation == Operation.JUMP_IF_ZERO:
                jump = second if ctypes.c_int.from_address(first).value == 0 else 1
            row += jump

    def measure(self, parts: Parts, rounds: int) -> dict[str, dict[str, float]]:
        """Return thousands of cycles of a world and step, by kernel and by part of the solver."""
        times, cycles = [], []
        for _ in range(rounds):
            self.taken = defaultdict(int)
            parts.cycles[:] = 0
            self.run(self.replay)
            times.append(self.taken)
            cycles.append(parts.cycles.copy())
        thousands = 1e3 * self.num_steps * self.scene.num_worlds
        least = {key: cycles_of(min(taken[key] for taken in times)) / thousands for key in times[0]}
        solver: dict[str, float] = defaultdict(float)
        for name, count in zip(parts.names, np.min(cycles, axis=0), strict=True):  # some have several places
            solver[name] += count / thousands
        return {"kernels": _ordered(least), "solver": _ordered(solver)}


def cycles_of(nanoseconds: float) -> float:
    """Return how far the cycle counter gets, at the rate that Linux gives."""
    found = re.search(r"cpu MHz\s*: ([\d.]+)", Path("/proc/cpuinfo").read_text())
    if found is None:
        raise RuntimeError("/proc/cpuinfo must give the processor's rate in MHz; use Linux on x86")
    return nanoseconds * float(found[1]) / 1e3


def _ordered(figures: dict[str, Any]) -> dict[str, float]:
    return {name: round(float(x), 2) for name, x in sorted(figures.items(), key=lambda item: -item[1]) if x}


def main() -> None:
    """Measure, print a table a task, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.kernels")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    load, parts, console = os.getloadavg()[0], Parts(), Console()
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for key in options.tasks:
        rows[key] = Kernels(key, options).measure(parts, options.rounds)
        table = Table("kilocycles of a world and step", key)
        for kind, figures in rows[key].items():
            table.add_row(kind, f"{sum(figures.values()):.1f}")
            for name, value in figures.items():
                table.add_row(f"  {name}", f"{value:.2f}")
        console.print(table)
    report = {
        "processor": processor(),
        "load_before": round(load, 2),
        "num_worlds": options.num_worlds,
        "rounds": options.rounds,
        "physics": "parity",
        "kilocycles": rows,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
