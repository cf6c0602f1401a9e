"""Cost of a world, in time and memory, with few worlds and with many.

    python -m benchmarks.worlds --output out/worlds.json

Time is wall time of the vector environment on all cores and, beside it, that of its simulation without
Gymnasium around it, and CPU time of a simulation on one core. What the first takes more than the second is
Python; what the second takes more than its share of the third is that cores meet, and that each launches all
kernels for a part of the worlds only. Batches of every size take turns and run the same number of steps from
a reset on, since what lies in a hand touches more of it later: batches that run for the same time would be
compared in different states. Where others use the cores meanwhile it is measured again, since a step ends
with its slower core, and one that is taken away costs few worlds more than many. Memory is Warp's own count
of all arrays, engine included; machine code, models and Python are there once, whatever the number of worlds.
"""

import gc
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.table import Table

from benchmarks.__main__ import PACKAGES
from benchmarks.machine import disturbances, least_disturbed, processor, timed_here
from benchmarks.rivals import FAMILIES, TASK_OF
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import PHYSICS, TASKS
from myowarp.progress import progress_bar
from myowarp.sim.simulation import Simulation

PARTS = {"environment": "", "simulation": "sim_", "one core": "core_"}  # prefixes of their figures
SHORTEST = 0.5  # s, a measurement: who uses the cores is known in steps of 0.01 s


@dataclass
class Options:
    """Measure what a world costs."""

    output: Path = Path("out/worlds.json")
    """JSON file to write."""
    families: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-f"])] = tuple(FAMILIES)
    """Families or whole bodies of `benchmarks.rivals`."""
    sizes: tuple[int, ...] = (64, 256, 1024)
    """Numbers of worlds, growing."""
    steps: int = 10
    """Control steps with random actions after each reset."""
    rounds: int = 7
    """Rounds; the median counts."""


class Batch:
    """So many worlds: an environment, what it allocated, and a simulation without one."""

    def __init__(self, task: str, physics: str, num_worlds: int) -> None:
        before = allocated()
        self.env = MyoWarpVectorEnv(task, num_worlds, device="cpu", physics=physics)
        self.bytes = allocated() - before
        self.sim = Simulation(TASKS[task], num_worlds, device="cpu", physics=physics)
        self.actions = np.random.default_rng(0)

    def wall_seconds(self, steps: int, episodes: int) -> float:
        """Return what a step of the environment takes."""
        return self._elapsed(self.env.sim, self.env.step, time.perf_counter, steps, episodes)

    def sim_seconds(self, steps: int, episodes: int) -> float:
        """Return what a step of the environment's simulation alone takes."""
        return self._elapsed(self.env.sim, stepped(self.env.sim), time.perf_counter, steps, episodes)

    def core_seconds(self, steps: int, episodes: int) -> float:
        """Return the CPU time of a step of a simulation on one core."""
        return self._elapsed(self.sim, stepped(self.sim), time.thread_time, steps, episodes)

    def _elapsed(
        self,
        sim: Simulation,
        step: Callable[[np.ndarray], object],
        clock: Callable[[], float],
        steps: int,
        episodes: int,
    ) -> float:
        """Return the time of a step with random actions, in episodes that begin in states of their own."""
        elapsed, episode = 0.0, 0
        while episode < episodes or elapsed < SHORTEST:
            sim.reset(seeds=episode % episodes * sim.num_worlds + np.arange(sim.num_worlds))
            episode += 1
            for _ in range(steps):
                actions = self.actions.uniform(-1, 1, self.env.action_space.shape).astype(np.float32)
                begin = clock()
                step(actions)
                elapsed += clock() - begin
        return elapsed / (steps * episode)


def stepped(sim: Simulation) -> Callable[[np.ndarray], None]:
    """Return what steps a simulation under actions on the host, as little as there can be around it."""
    host = sim.action.numpy()  # a view

    def step(actions: np.ndarray) -> None:
        host[:] = actions
        sim.step()

    return step


def allocated() -> int:
    """Return the bytes of all arrays that live."""
    gc.collect()
    return int(wp._src.context.runtime.core.wp_alloc_tracker_get_current_bytes())


def measure(task: str, physics: str, options: Options) -> dict[str, Any]:
    """Return time and memory of a world at each size."""
    batches = {size: Batch(task, physics, size) for size in options.sizes}
    few, *_, many = options.sizes
    episodes = {size: max(1, many // 2 // size) for size in options.sizes}
    for batch in batches.values():
        batch.env.reset(seed=0)
        batch.wall_seconds(1, 1)
        batch.sim_seconds(1, 1)
        batch.core_seconds(1, 1)
    times = np.empty((options.rounds, len(batches), len(PARTS)))
    others = np.empty((options.rounds, len(batches), 2))
    for turn in range(options.rounds):
        for k, (size, batch) in enumerate(batches.items()):
            length = options.steps, episodes[size]
            wall, others[turn, k, 0] = least_disturbed(timed_here(partial(batch.wall_seconds, *length)))
            alone, others[turn, k, 1] = least_disturbed(timed_here(partial(batch.sim_seconds, *length)))
            times[turn, k] = np.array([wall, alone, batch.core_seconds(*length)]) / size
    for batch in batches.values():
        batch.env.close()
    row: dict[str, Any] = {
        "bytes_per_world": round((batches[many].bytes - batches[few].bytes) / (many - few)),
        "cores_busy_with_others": disturbances(others.ravel().tolist()),
    }
    for k, prefix in enumerate(PARTS.values()):
        ratios = np.median(times[:, :, k] / times[:, -1:, k], axis=0).round(3)
        medians = (1e6 * np.median(times[:, :, k], axis=0)).round(2)
        row[f"{prefix}us_per_world"] = dict(zip(options.sizes, medians, strict=True))
        row[f"{prefix}over_largest"] = dict(zip(options.sizes, ratios, strict=True))
    return row


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.worlds")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    report = {
        "processor": processor(),
        "rounds": options.rounds,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
    }
    cases = [(family, physics) for family in options.families for physics in PHYSICS]
    with wp.ScopedMemoryTracker(print=False), progress_bar("Stepping", "cases") as bar:
        for family, physics in bar.track(cases):
            names = {"family": family, "task": TASK_OF[family], "physics": physics}
            rows.append(names | measure(TASK_OF[family], physics, options))
            options.output.write_text(json.dumps(report, indent=1) + "\n")  # an early end loses none
    sizes = [f"us, {size}" for size in options.sizes]
    table = Table("family", "physics", "kB a world", "of a step", *sizes, "few / many")
    for row in rows:
        names = row["family"], row["physics"], f"{row['bytes_per_world'] / 1e3:.1f}"
        for what, prefix in PARTS.items():
            figures = [f"{value:.1f}" for value in row[f"{prefix}us_per_world"].values()]
            ratio = next(iter(row[f"{prefix}over_largest"].values()))
            table.add_row(*names, what, *figures, f"{ratio:.2f}")
            names = "", "", ""
    Console().print(table)


if __name__ == "__main__":
    main()
