"""What a world costs, in time and memory, with few worlds and with many.

    python -m benchmarks.worlds --output out/worlds.json

Time is wall time of the vector environment on all cores. Batches of every size take turns and run the same
number of steps from a reset on, since what lies in a hand touches more of it later: batches that run for the
same time would be compared in different states. Memory is Warp's own count of all arrays, engine included;
machine code, models and Python are there once, whatever the number of worlds.
"""

import gc
import json
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import PACKAGES, processor
from benchmarks.rivals import FAMILIES
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.progress import progress_bar
from myowarp.spec import PHYSICS


@dataclass
class Options:
    """Measure what a world costs."""

    output: Path = Path("out/worlds.json")
    """JSON file to write."""
    families: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-f"])] = tuple(FAMILIES)
    """Families of `benchmarks.rivals`."""
    sizes: tuple[int, ...] = (64, 256, 1024)
    """Numbers of worlds, growing."""
    steps: int = 10
    """Control steps with random actions after each reset."""
    rounds: int = 11
    """Rounds; the median counts."""


class Batch:
    """An environment, and what it allocated."""

    def __init__(self, task: str, physics: str, num_worlds: int) -> None:
        before = allocated()
        self.env = MyoWarpVectorEnv(task, num_worlds, device="cpu", physics=physics)
        self.bytes = allocated() - before
        self.actions = np.random.default_rng(0)

    def seconds(self, steps: int, episodes: int) -> float:
        """Return the wall time of a control step, of episodes that begin in states of their own."""
        elapsed = 0.0
        for episode in range(episodes):
            self.env.reset(seed=episode * self.env.num_envs)
            for _ in range(steps):
                actions = self.actions.uniform(-1, 1, self.env.action_space.shape).astype(np.float32)
                begin = time.perf_counter()
                self.env.step(actions)
                elapsed += time.perf_counter() - begin
        return elapsed / (steps * episodes)


def allocated() -> int:
    """Return the bytes of all arrays that live."""
    gc.collect()
    return int(wp._src.context.runtime.core.wp_alloc_tracker_get_current_bytes())


def measure(task: str, physics: str, options: Options) -> dict[str, object]:
    """Return time and memory of a world at each size."""
    batches = {size: Batch(task, physics, size) for size in options.sizes}
    few, *_, many = options.sizes
    episodes = {size: max(1, many // 2 // size) for size in options.sizes}
    for batch in batches.values():
        batch.seconds(1, 1)
    times = np.array(
        [
            [batch.seconds(options.steps, episodes[size]) / size for size, batch in batches.items()]
            for _ in range(options.rounds)
        ]
    )
    for batch in batches.values():
        batch.env.close()
    ratios = np.median(times / times[:, -1:], axis=0)
    return {
        "bytes_per_world": round((batches[many].bytes - batches[few].bytes) / (many - few)),
        "us_per_world": dict(zip(options.sizes, (1e6 * np.median(times, axis=0)).round(2), strict=True)),
        "over_largest": dict(zip(options.sizes, ratios.round(3), strict=True)),
    }


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.worlds")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    cases = [(family, physics) for family in options.families for physics in PHYSICS]
    with wp.ScopedMemoryTracker(print=False), progress_bar("Stepping", "cases") as bar:
        for family, physics in bar.track(cases):
            names = {"family": family, "task": FAMILIES[family], "physics": physics}
            rows.append(names | measure(FAMILIES[family], physics, options))
    report = {
        "processor": processor(),
        "rounds": options.rounds,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    table = Table("family", "physics", "kB a world", *(f"us, {size}" for size in options.sizes), "ratio")
    for row in rows:
        figures = (f"{value:.1f}" for value in row["us_per_world"].values())
        ratio = f"{next(iter(row['over_largest'].values())):.2f}"
        table.add_row(row["family"], row["physics"], f"{row['bytes_per_world'] / 1e3:.1f}", *figures, ratio)
    Console().print(table)


if __name__ == "__main__":
    main()
