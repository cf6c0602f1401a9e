"""Memory of a world, family by family and body by body, counted in three ways.

    python -m benchmarks.memory --output out/memory.json

Warp's own count of all arrays, engine included; the growth of the process (resident set), after a reset and
some steps with random actions; and the estimate that is checked before anything is built, which the error
message about too many worlds gives. The first two are differences between few worlds and many, each in a
process of its own: machine code, models and Python are there once, whatever the number of worlds.
"""

import json
import os
import re
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks.contestant import task_spec
from benchmarks.rivals import TASK_OF
from benchmarks.worlds import allocated
from myowarp.definitions.task import PHYSICS
from myowarp.progress import progress_bar
from myowarp.sim.simulation import Simulation

FAR_TOO_MANY = 10**7  # worlds
STEPS = 10


@dataclass
class Options:
    """Measure the memory of a world."""

    output: Path = Path("out/memory.json")
    """JSON file to write."""
    families: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-f"])] = tuple(TASK_OF)
    """Families and whole bodies of `benchmarks.rivals`."""
    sizes: tuple[int, int] = (64, 512)
    """Numbers of worlds: few and many."""


def stepped(task: str, physics: str, num_worlds: int) -> Simulation:
    """Return a simulation after some steps."""
    sim = Simulation(task_spec(task), num_worlds, device="cpu", physics=physics, progress=False)
    sim.reset(seeds=np.arange(num_worlds))
    rng = np.random.default_rng(0)
    for _ in range(STEPS):
        sim.action.assign(rng.uniform(-1, 1, sim.action.shape).astype(np.float32))
        sim.step()
    return sim


def count(task: str, physics: str, sizes: tuple[int, int]) -> dict[str, int]:
    """Return the bytes of a world: of all arrays, and of what the process grows by."""
    few, many = sizes
    with wp.ScopedMemoryTracker(print=False):
        small = stepped(task, physics, few)
        before, grown = allocated(), resident()
        large = stepped(task, physics, many)
        after, grown = allocated() - before, resident() - grown
    del small, large
    return {"arrays": round((after - before) / (many - few)), "process": round(grown / many)}


def resident() -> int:
    """Return the bytes of this process that are in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def asked_for(task: str, physics: str) -> int:
    """Return the bytes of a world that the error message about too many of them speaks of."""
    try:
        Simulation(task_spec(task), FAR_TOO_MANY, device="cpu", physics=physics, progress=False)
    except ValueError as error:
        gigabytes = re.search(r"need at least ([\d,.]+) GB", str(error))
        if gigabytes is None:
            raise
        return round(1e9 * float(gigabytes.group(1).replace(",", "")) / FAR_TOO_MANY)
    raise RuntimeError(f"{FAR_TOO_MANY:,} worlds of {task} fit")


def measure(task: str, physics: str, sizes: tuple[int, int]) -> dict[str, int]:
    """Return the memory of a world in three ways [bytes]."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(count, task, physics, sizes).result() | {"asked_for": asked_for(task, physics)}


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.memory")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    table = Table("family", "physics", "arrays [kB]", "process [kB]", "asked for [kB]")
    cases = [(family, physics) for family in options.families for physics in PHYSICS]
    with progress_bar("Counting", "cases") as bar:
        for family, physics in bar.track(cases):
            figures = measure(TASK_OF[family], physics, options.sizes)
            rows.append({"family": family, "task": TASK_OF[family], "physics": physics} | figures)
            table.add_row(family, physics, *(f"{value / 1e3:.0f}" for value in figures.values()))
            report = {"sizes": options.sizes, "unit": "bytes per world", "rows": rows}
            options.output.write_text(json.dumps(report, indent=1) + "\n")  # an early end loses none
    Console().print(table)


if __name__ == "__main__":
    main()
