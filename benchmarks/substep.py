"""What each stage of ours saves of a physics step, with MuJoCo C beside it in the same run.

    python -m benchmarks.substep

All contestants start from one set of states, reached by random actions, and are timed in turns: all stages of
ours, all but one of them, all with their launches replayed by Warp, mujoco-warp's own step with and without
its idle launches, and `mujoco.mj_step` of the same slim model in float64. What counts is CPU time of this
thread for one world and one physics step, and of all rounds the least, since other work on the machine only
adds. A stage's price is what the step takes longer without it.
"""

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from benchmarks.__main__ import CONTACT_TASKS, PACKAGES
from benchmarks.machine import processor
from myowarp.definitions.task import TASKS
from myowarp.engine.compile import quiet
from myowarp.engine.graph import Graph
from myowarp.engine.idle import idle_kernels
from myowarp.engine.stage import STAGES, applicable_stages
from myowarp.engine.step import physics_step
from myowarp.sim.simulation import Simulation

ALL, BY_WARP, ENGINE, ENGINE_IDLE, MUJOCO_C = (
    "all",
    "replayed by Warp",
    "engine",
    "engine with idle launches",
    "MuJoCo C",
)
STATE = ("qpos", "qvel", "qacc_warmstart", "ctrl")


@dataclass
class Options:
    """Measure physics steps."""

    output: Path = Path("out/substep.json")
    """JSON file to write."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = (
        "myoElbowPose1D6MRandom-v0",
        "myoFingerPoseRandom-v0",
        "myoHandPoseRandom-v0",
        *CONTACT_TASKS,
    )
    """Task names with version."""
    num_worlds: int = 128
    """Worlds stepped together."""
    warmup: int = 100
    """Control steps with random actions before the timed states."""
    steps: int = 4
    """Control steps in one measurement."""
    rounds: int = 10
    """Rounds; the least counts."""


class Physics:
    """The physics of one task, to be timed with any set of stages."""

    def __init__(self, key: str, options: Options) -> None:
        self.sim = Simulation(TASKS[key], options.num_worlds, device="cpu", autoreset="disabled", stages=())
        self.steps, self.scene = options.steps, self.sim.scene
        self.sim.reset(seeds=np.arange(options.num_worlds))
        rng = np.random.default_rng(0)
        for _ in range(options.warmup):
            self.sim.action.assign(rng.uniform(-1, 1, self.sim.action.shape).astype(np.float32))
            self.sim.step()
        self.arrays = {name: getattr(self.scene.data, name) for name in STATE}
        self.arrays["act"] = self.scene.muscles.activation
        self.state = {name: array.numpy().copy() for name, array in self.arrays.items()}
        self.num_steps = self.steps * self.scene.num_substeps

    def contestants(self) -> dict[str, Callable[[], float]]:
        """Return what measures microseconds of one world and step, by name."""
        used = {type(stage).__name__ for stage in applicable_stages(self.scene)}
        names = [name for name, kind in STAGES.items() if kind in used]
        sets = {ALL: names}
        sets |= {f"without {name}": [other for other in names if other != name] for name in names}
        idle = idle_kernels(self.scene.oracle)
        graphs = {name: self.graph(stages, idle) for name, stages in sets.items()}
        graphs |= {ENGINE: self.graph([], idle), ENGINE_IDLE: self.graph([], frozenset())}
        measured = {name: lambda graph=graph: self.run(graph.launch) for name, graph in graphs.items()}
        by_warp = partial(wp.capture_launch, graphs[ALL].recorded)
        return measured | {BY_WARP: lambda: self.run(by_warp), MUJOCO_C: self.run_mujoco_c}

    def graph(self, names: list[str], idle: frozenset[str]) -> Graph:
        """Return a captured control step of physics with some stages of ours."""
        step = physics_step(self.scene, applicable_stages(self.scene, names), idle)

        def launch() -> None:
            for _ in range(self.scene.num_substeps):
                step()

        with quiet(), wp.ScopedDevice(self.scene.device):
            launch()
            return Graph(launch, self.scene.device)

    def run(self, launch: Callable[[], None]) -> float:
        """Time a control step."""
        for name, values in self.state.items():
            self.arrays[name].assign(values)
        begin = time.thread_time()
        for _ in range(self.steps):
            launch()
        return 1e6 * (time.thread_time() - begin) / (self.num_steps * self.scene.num_worlds)

    def run_mujoco_c(self) -> float:
        """Time MuJoCo C, muscles built in."""
        model = self.scene.oracle
        data = mujoco.MjData(model)
        muscles = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_MUSCLE
        total = 0.0
        for world in range(self.scene.num_worlds):
            mujoco.mj_resetData(model, data)
            for name in STATE:
                getattr(data, name)[:] = self.state[name][world]
            data.act[:] = self.state["act"][world][: muscles.sum()]
            begin = time.thread_time()
            mujoco.mj_step(model, data, self.num_steps)
            total += time.thread_time() - begin
        return 1e6 * total / (self.num_steps * self.scene.num_worlds)


def measure(key: str, options: Options, progress: Progress) -> dict[str, object]:
    """Return microseconds of all contestants of a task."""
    contestants = Physics(key, options).contestants()
    task = progress.add_task(key, total=options.rounds)
    rounds = []
    for _ in range(options.rounds):
        rounds.append([run() for run in contestants.values()])
        progress.advance(task)
    least = np.min(rounds, axis=0).round(2).tolist()
    return {"task": key, "microseconds": dict(zip(contestants, least, strict=True))}


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.substep")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    with Progress(console=Console(stderr=True)) as progress:
        rows = [measure(key, options, progress) for key in options.tasks]
    report = {
        "processor": processor(),
        "load_before": round(load, 2),
        "num_worlds": options.num_worlds,
        "rounds": options.rounds,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    columns = [*(f"without {name}" for name in STAGES), BY_WARP, ENGINE, ENGINE_IDLE, MUJOCO_C]
    table = Table(Column("task", no_wrap=True), "all [us]", *(f"{name} / all" for name in columns))
    for row in rows:
        taken = row["microseconds"]
        ratios = (taken[name] / taken[ALL] if name in taken else None for name in columns)
        table.add_row(
            row["task"], f"{taken[ALL]:.1f}", *("-" if ratio is None else f"{ratio:.2f}" for ratio in ratios)
        )
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
