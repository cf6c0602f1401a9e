"""Cost of an environment step beyond the engine's: action, muscles, observation, reward, reset, Gymnasium.

    python -m benchmarks.overhead

Two graphs are timed in turns on one core, from the same states: `env.step` of the vector environment as a
learner calls it, and nothing but the `mujoco_warp.step`s in it, the engine's control callback left out. What
counts is CPU time of this thread, the median over rounds of the ratio of neighbours.
"""

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.__main__ import CONTACT_TASKS, PACKAGES
from benchmarks.machine import processor
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import PHYSICS
from myowarp.engine.compile import quiet
from myowarp.engine.graph import Graph
from myowarp.engine.repeat import repeat

STATE = ("qpos", "qvel", "qacc_warmstart", "time")


@dataclass
class Options:
    """Measure what is around the physics."""

    output: Path = Path("out/overhead.json")
    """JSON file to write."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = (
        "myoHandPoseRandom-v0",
        "myoHandReachRandom-v0",
        *CONTACT_TASKS,
    )
    """Task names with version."""
    num_worlds: int = 256
    """Worlds stepped together."""
    warmup: int = 20
    """Control steps with random actions before the timed ones."""
    rounds: int = 40
    """Rounds; the median counts."""


class Pair:
    """An environment, and the physics of its steps alone."""

    def __init__(self, task: str, physics: str, options: Options) -> None:
        self.env = MyoWarpVectorEnv(task, options.num_worlds, device="cpu", shards=1, physics=physics)
        self.sim, self.rng = self.env.sim, np.random.default_rng(0)
        self.env.reset(seed=0)
        for _ in range(options.warmup):
            self.env.step(self._actions())
        self.graph = self._capture_physics()

    def _actions(self) -> np.ndarray:
        return self.rng.uniform(-1, 1, self.sim.action.shape).astype(np.float32)

    def _capture_physics(self) -> Graph:
        """Record the physics steps of a control step, without muscles."""
        sim, model = self.sim, self.sim.scene.model
        callback, model.callback.control = model.callback.control, None
        countdown = wp.zeros(1, dtype=int, device=sim.scene.device)

        def launch() -> None:
            repeat(sim.shards[0].launch_physics, sim.scene.num_substeps, countdown)

        with quiet():
            graph = Graph(launch, sim.scene.device)
        model.callback.control = callback
        return graph

    def shares(self, rounds: int) -> list[float]:
        """Return for each round which part of an environment step is not physics."""
        data, found = self.sim.scene.data, []
        for _ in range(rounds):
            state = [getattr(data, name).numpy().copy() for name in STATE]
            physics = timed(self.graph.launch)
            for name, values in zip(STATE, state, strict=True):
                getattr(data, name).assign(values)
            actions = self._actions()
            found.append(1.0 - physics / timed(lambda actions=actions: self.env.step(actions)))
        return found


def timed(act: Callable[[], object]) -> float:
    """Return the CPU time that this thread takes [s]."""
    begin = time.thread_time()
    act()
    return time.thread_time() - begin


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.overhead")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    load, rows = os.getloadavg()[0], []
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task("environment steps", total=len(options.tasks) * len(PHYSICS))
        for task in options.tasks:
            for physics in PHYSICS:
                share = np.array(Pair(task, physics, options).shares(options.rounds))
                low, median, high = np.quantile(share, (0.25, 0.5, 0.75)).round(4).tolist()
                rows.append({"task": task, "physics": physics, "share": median, "quartiles": [low, high]})
                progress.advance(bar)
    report = {
        "processor": processor(),
        "load_before": round(load, 2),
        "num_worlds": options.num_worlds,
        "rounds": options.rounds,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    table = Table("task", "physics", "around the physics", "quartiles")
    for row in rows:
        low, high = row["quartiles"]
        table.add_row(row["task"], row["physics"], f"{row['share']:.1%}", f"{low:.1%} to {high:.1%}")
    Console().print(table)


if __name__ == "__main__":
    main()
