"""Cost of each muscle condition: the environment step with it beside the same step without.

    python -m benchmarks.conditions --output out/conditions.json

Every registered condition, with its defaults, on each body that can have it. Steps with and without take
turns, so that a busy machine slows both; the median of their ratio over rounds counts, between its quartiles,
and the ratio of the fastest of each. The row `none` compares the healthy step with itself: differences of its
size mean nothing. Time is that of the stepping thread, where others on the same cores weigh less; on a GPU
choose the wall clock.
"""

import json
import os
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import PACKAGES, Timed
from benchmarks.machine import processor
from benchmarks.soak import suited
from myowarp.definitions.condition import CONDITIONS, Condition
from myowarp.definitions.task import TASKS
from myowarp.progress import progress_bar
from myowarp.sim.simulation import Simulation

CLOCKS = {"thread": time.thread_time, "wall": time.perf_counter}


@dataclass
class Options:
    """Measure what muscle conditions cost."""

    output: Path = Path("out/conditions.json")
    """JSON file to write."""
    tasks: tuple[str, ...] = ("myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v1")
    """Task names with version, one for each body."""
    num_worlds: int = 256
    """Worlds stepped together."""
    device: str = "cpu"
    """Warp device."""
    clock: Literal["thread", "wall"] = "thread"
    """Time of the stepping thread, or wall time."""
    rounds: int = 31
    """Rounds; the median counts."""
    seconds: float = 0.1
    """Rough duration of one measurement."""


def contestant(key: str, conditions: tuple[str | Condition, ...], options: Options) -> Timed:
    """Return a simulation with or without a condition."""
    sim = Simulation(
        TASKS[key], options.num_worlds, device=options.device, conditions=conditions, progress=False
    )
    return Timed(sim, CLOCKS[options.clock])


def measure_task(key: str, options: Options, console: Console) -> list[dict[str, object]]:
    """Return one row a condition that the body can have."""
    healthy = contestant(key, (), options)
    contestants = {"none": contestant(key, (), options)}
    for name in CONDITIONS:
        try:
            contestants[name] = contestant(key, (suited(name, TASKS[key]),), options)
        except ValueError as refusal:
            console.print(f"{name}: {refusal}")
    steps = max(1, round(options.seconds / healthy.run(4)))
    times = {name: np.empty((options.rounds, 2)) for name in contestants}
    with progress_bar(key, "rounds", console) as bar:
        for i in bar.track(range(options.rounds)):
            for name, other in contestants.items():
                pair = (healthy, other) if i % 2 == 0 else (other, healthy)
                found = [one.run(steps) for one in pair]
                times[name][i] = found if i % 2 == 0 else found[::-1]
    rows = []
    for name, (without, seconds) in ((name, pairs.T) for name, pairs in times.items()):
        percent = 100.0 * (seconds / without - 1.0)
        low, middle, high = np.percentile(percent, (25, 50, 75))
        rows.append(
            {
                "task": TASKS[key].env_id,
                "condition": name,
                "env_step_us_per_world": round(1e6 * np.median(seconds) / options.num_worlds, 3),
                "without_us_per_world": round(1e6 * np.median(without) / options.num_worlds, 3),
                "cost_percent": round(middle, 2),
                "quartiles_percent": [round(low, 2), round(high, 2)],
                "cost_of_fastest_percent": round(100.0 * (seconds.min() / without.min() - 1.0), 2),
            }
        )
    return rows


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.conditions")
    console, load = Console(stderr=True), os.getloadavg()[0]
    rows = [row for key in options.tasks for row in measure_task(key, options, console)]
    report = {
        "processor": processor(),
        "load_before": round(load, 2),
        "device": options.device,
        "num_worlds": options.num_worlds,
        "clock": options.clock,
        "rounds": options.rounds,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
    }
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    table = Table("task", "condition", "µs per world", "cost", "quartiles", "of the fastest")
    for row in rows:
        low, high = row["quartiles_percent"]
        numbers = (f"{row['cost_percent']:+.1f} %", f"{low:+.1f}..{high:+.1f}")
        fastest = f"{row['cost_of_fastest_percent']:+.1f} %"
        table.add_row(row["task"], row["condition"], f"{row['env_step_us_per_world']:.1f}", *numbers, fastest)
    Console().print(table)


if __name__ == "__main__":
    main()
