"""Memory of a world: what a simulation allocates more when it has more worlds.

    python -m benchmarks.memory --output out/memory.json

Warp's own count of all arrays of a device, engine included; with contacts the slots that all worlds share are
part of it. Machine code, models and Python are there once, whatever the number of worlds.
"""

import gc
import json
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import tyro
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import PACKAGES
from benchmarks.rivals import FAMILIES
from myowarp.progress import progress_bar
from myowarp.sim import Simulation
from myowarp.spec import PHYSICS, TASKS


@dataclass
class Options:
    """Measure the memory of a world."""

    output: Path = Path("out/memory.json")
    """JSON file to write."""
    sizes: tuple[int, int] = (64, 1024)
    """Numbers of worlds between which the difference is taken."""
    device: str = "cpu"
    """Warp device."""


def allocated() -> int:
    """Return the bytes of all arrays that live."""
    gc.collect()
    return int(wp._src.context.runtime.core.wp_alloc_tracker_get_current_bytes())


def bytes_of(task: str, physics: str, num_worlds: int, device: str) -> int:
    """Return what a simulation allocates."""
    before = allocated()
    sim = Simulation(TASKS[task], num_worlds, device=device, physics=physics, progress=False)
    after = allocated()
    sim.close()
    return after - before


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.memory")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    small, large = options.sizes
    console, rows = Console(), []
    cases = [(family, task, physics) for family, task in FAMILIES.items() for physics in PHYSICS]
    with (
        wp.ScopedMemoryTracker(print=False),
        progress_bar("Allocating", "cases", Console(stderr=True)) as bar,
    ):
        for family, task, physics in bar.track(cases):
            few, many = (bytes_of(task, physics, size, options.device) for size in options.sizes)
            per_world = round((many - few) / (large - small))
            rows.append({"family": family, "task": task, "physics": physics, "bytes_per_world": per_world})
    report = {
        "device": options.device,
        "sizes": options.sizes,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    table = Table("family", "physics", "kB a world")
    for row in rows:
        table.add_row(row["family"], row["physics"], f"{row['bytes_per_world'] / 1e3:.1f}")
    console.print(table)


if __name__ == "__main__":
    main()
