"""CPU time of a physics step with kernels of ours on and off, MuJoCo C beside it in the same run.

    python -m benchmarks.substep

All contestants start from one set of states, reached by random actions, and are timed in turns: stock
mujoco-warp without its idle launches, each fusion alone, all of them, and `mujoco.mj_step` of the same slim
model in float64. What counts is CPU time of this thread for one world and one physics step, and of all
rounds the least, since other work on the machine only adds.
"""

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import mujoco
import mujoco_warp as mjw
import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from benchmarks.__main__ import CONTACT_TASKS, PACKAGES
from benchmarks.machine import processor
from myowarp.engine.compile import quiet
from myowarp.engine.graph import Graph
from myowarp.engine.idle import idle_kernels, pruned
from myowarp.engine.stages import FUSIONS, applicable_fusions, installed
from myowarp.sim.simulation import Simulation
from myowarp.spec.task import TASKS

STOCK, ALL, MUJOCO_C = "stock", "all", "MuJoCo C"
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
    """The physics of one task, to be timed with any set of fusions."""

    def __init__(self, key: str, options: Options) -> None:
        self.sim = Simulation(TASKS[key], options.num_worlds, device="cpu", autoreset="disabled", fusions=())
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
        names = [name for name in FUSIONS if FUSIONS[name].obstacle(self.scene) is None]
        sets = {STOCK: [], **{name: [name] for name in names}, ALL: names}
        graphs = {name: self.graph(fusions) for name, fusions in sets.items()}
        measured = {name: lambda graph=graph: self.run(graph) for name, graph in graphs.items()}
        return measured | {MUJOCO_C: self.run_mujoco_c}

    def graph(self, names: list[str]) -> Graph:
        """Return a captured control step of physics with some fusions."""
        fusions = applicable_fusions(self.scene, names)

        def launch() -> None:
            with pruned(idle_kernels(self.scene.oracle)), installed(fusions):
                for _ in range(self.scene.num_substeps):
                    mjw.step(self.scene.model, self.scene.data)

        with quiet(), wp.ScopedDevice(self.scene.device):
            launch()
            return Graph(launch, self.scene.device)

    def run(self, graph: Graph) -> float:
        """Time a graph."""
        for name, values in self.state.items():
            self.arrays[name].assign(values)
        begin = time.thread_time()
        for _ in range(self.steps):
            graph.launch()
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
    columns = list(dict.fromkeys([STOCK, *FUSIONS, ALL, MUJOCO_C]))
    table = Table(Column("task [us]", no_wrap=True), *columns, "all / C")
    for row in rows:
        cells = [row["microseconds"].get(name) for name in columns]
        ratio = row["microseconds"][ALL] / row["microseconds"][MUJOCO_C]
        table.add_row(row["task"], *("-" if c is None else f"{c:.1f}" for c in cells), f"{ratio:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
