"""Saving of each stage of ours in a physics step, with MuJoCo C beside it in the same run.

    python -m benchmarks.substep
    python -m benchmarks.substep --models OUT/gait2354_simbody --output out/substep.json

All contestants start from one set of states, reached by random actions, and are timed in turns: all stages of
ours, all but one of them, all with their launches replayed by Warp, mujoco-warp's own step with and without
its idle launches, and `mujoco.mj_step` of the same slim model in float64. What counts is CPU time of this
thread for one world and one physics step, and of all rounds the least, since other work on the machine only
adds. A stage's price is what the step takes longer without it.

There are rows for many worlds and for a single one, for bodies of 35, 44 and 128 degrees of freedom
(`large_bodies`), and for models that `myowarp convert` wrote: these move in free coordinates, beside the same
model with equalities. Rows of shards are of whole environment steps, on all cores: their time is the wall's,
with the replay of ours in native threads, and with Warp's in threads of Python.
"""

import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import tyro
import warp as wp
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from benchmarks.__main__ import CONTACT_TASKS, PACKAGES
from benchmarks.large_bodies import write_large_body
from benchmarks.machine import processor
from myowarp.coordinates.free_coordinates import FreeCoordinates
from myowarp.definitions.task import TASKS, TaskSpec
from myowarp.engine.compile import quiet
from myowarp.engine.graph import Graph
from myowarp.engine.idle import idle_kernels
from myowarp.engine.stage import STAGES
from myowarp.osim.bundle.couplings import Couplings
from myowarp.process import num_cores
from myowarp.sim.build import stepped_of
from myowarp.sim.simulation import Simulation
from myowarp.tasks.from_file import pose_task

ALL, BY_WARP, ENGINE, ENGINE_IDLE, EQUALITIES, MUJOCO_C = (
    "all",
    "replayed by Warp",
    "engine",
    "engine with idle launches",
    "equalities",
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
    models: tuple[Path, ...] = ()
    """Folders that `myowarp convert` wrote."""
    dofs: tuple[int, ...] = (35, 44, 128)
    """Degrees of freedom of large bodies."""
    num_worlds: int = 128
    """Worlds stepped together; there are rows for a single one, too."""
    warmup: int = 100
    """Control steps with random actions before the timed states."""
    steps: int = 4
    """Control steps in one measurement."""
    rounds: int = 10
    """Rounds; the least counts."""


class Physics:
    """The physics of one task, to be timed with any set of stages."""

    def __init__(self, spec: TaskSpec, num_worlds: int, options: Options) -> None:
        self.sim = Simulation(spec, num_worlds, device="cpu", autoreset="disabled", stages=())
        self.steps, self.scene = options.steps, self.sim.scene
        self.sim.reset(seeds=np.arange(num_worlds))
        rng = np.random.default_rng(0)
        for _ in range(options.warmup):
            self.sim.action.assign(rng.uniform(-1, 1, self.sim.action.shape).astype(np.float32))
            self.sim.step()
        self.arrays = {name: getattr(self.scene.data, name) for name in STATE}
        self.arrays["act"] = self.scene.muscles.activation
        self.state = {name: array.numpy().copy() for name, array in self.arrays.items()}
        self.num_steps = self.steps * self.scene.num_substeps
        if not all(np.isfinite(values).all() for values in self.state.values()):
            raise ValueError(
                f"random actions led {spec.key} to a state that is not finite; nothing was timed"
            )

    @property
    def names(self) -> list[str]:
        """Names of the stages that apply."""
        used = {type(stage).__name__ for stage in self.sim.shards[0].physics_step.stages()}
        return [name for name, kind in STAGES.items() if kind in used]

    def contestants(self) -> dict[str, Callable[[], float]]:
        """Return what measures microseconds of one world and step, by name."""
        names, idle = self.names, idle_kernels(stepped_of(self.scene))
        sets = {ALL: names}
        sets |= {f"without {name}": [other for other in names if other != name] for name in names}
        graphs = {name: self.graph(stages, idle) for name, stages in sets.items()}
        graphs |= {ENGINE: self.graph([], idle), ENGINE_IDLE: self.graph([], frozenset())}
        measured = {name: lambda graph=graph: self.run(graph.launch) for name, graph in graphs.items()}
        by_warp = partial(wp.capture_launch, graphs[ALL].recorded)
        return measured | {BY_WARP: lambda: self.run(by_warp), MUJOCO_C: self.run_mujoco_c}

    def all_stages(self) -> Callable[[], float]:
        """Return what measures the step with all stages of ours."""
        graph = self.graph(self.names, idle_kernels(stepped_of(self.scene)))
        return lambda: self.run(graph.launch)

    def held(self, folder: Path, options: Options) -> Callable[[], float]:
        """Return what measures a model whose joints follow exactly with equalities instead.

        Raises:
            ValueError: Its joints do not follow exactly.
        """
        if not isinstance(self.sim.shards[0].physics_step, FreeCoordinates):
            raise ValueError(f"{folder} must have joints that follow exactly; see the line logged above")
        with tempfile.TemporaryDirectory() as other:
            shutil.copytree(folder, other, dirs_exist_ok=True, ignore=shutil.ignore_patterns(Couplings.FILE))
            held = Physics(pose_task(Path(other) / "model.xml"), self.scene.num_worlds, options)
        held.state = self.state
        return held.all_stages()

    def graph(self, names: list[str], idle: frozenset[str]) -> Graph:
        """Return a captured control step of physics with some stages of ours."""
        physics_step = self.sim.shards[0].physics_step
        step = physics_step.launches(physics_step.stages(names), idle)

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


def measure(
    spec: TaskSpec, num_worlds: int, options: Options, progress: Progress, folder: Path | None
) -> dict[str, Any]:
    """Return microseconds of all contestants of a task; `folder` is that of a converted model."""
    physics = Physics(spec, num_worlds, options)
    measured = physics.contestants()
    if folder is not None:
        measured[EQUALITIES] = physics.held(folder, options)
    least = least_of(spec.key, list(measured.values()), options, progress)
    row = {"task": spec.key, "num_worlds": num_worlds, "degrees_of_freedom": int(physics.scene.oracle.nv)}
    return row | {"microseconds": dict(zip(measured, least, strict=True))}


def measure_shards(spec: TaskSpec, options: Options, progress: Progress) -> dict[str, Any]:
    """Return wall microseconds of a world and environment step on all cores, and on one."""
    shards = max(2, num_cores())
    sims = {}
    for name, parts in ((ALL, shards), (BY_WARP, shards), ("one shard", 1)):
        sims[name] = sim = Simulation(spec, options.num_worlds, shards=parts, device="cpu")
        sim.reset(seeds=np.arange(options.num_worlds))
    for part in sims[BY_WARP].shards:
        part.step_graph.replay = None

    def run(sim: Simulation) -> float:
        begin = time.perf_counter()
        for _ in range(options.steps):
            sim.step()
        return 1e6 * (time.perf_counter() - begin) / (options.steps * options.num_worlds)

    least = least_of(spec.key, [partial(run, sim) for sim in sims.values()], options, progress)
    row = {"task": spec.key, "num_worlds": options.num_worlds, "shards": shards}
    return row | {"microseconds": dict(zip(sims, least, strict=True))}


def least_of(
    name: str, contestants: list[Callable[[], float]], options: Options, progress: Progress
) -> list[float]:
    """Return the least of all rounds of each contestant."""
    task, rounds = progress.add_task(name, total=options.rounds), []
    for _ in range(options.rounds):
        rounds.append([run() for run in contestants])
        progress.advance(task)
    least: list[float] = np.min(rounds, axis=0).round(2).tolist()
    return least


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.substep")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    load, rows = os.getloadavg()[0], []
    specs: dict[TaskSpec, Path | None] = {TASKS[key]: None for key in options.tasks}
    with tempfile.TemporaryDirectory() as folder:
        specs |= {pose_task(write_large_body(Path(folder), dofs)): None for dofs in options.dofs}
    specs |= {pose_task(folder / "model.xml"): folder for folder in options.models}
    with Progress(console=Console(stderr=True)) as progress:
        for spec, model in specs.items():
            rows += [measure(spec, number, options, progress, model) for number in (options.num_worlds, 1)]
        shards = [measure_shards(spec, options, progress) for spec in specs]
    report = {
        "processor": processor(),
        "load_before": round(load, 2),
        "num_worlds": options.num_worlds,
        "rounds": options.rounds,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
        "shards": shards,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    columns = [*(f"without {name}" for name in STAGES), BY_WARP, ENGINE, ENGINE_IDLE, EQUALITIES, MUJOCO_C]
    table = Table(Column("task", no_wrap=True), "worlds", "all [us]", *(f"{name} / all" for name in columns))
    for row in rows:
        taken = row["microseconds"]
        ratios = (taken[name] / taken[ALL] if name in taken else None for name in columns)
        numbers = ("-" if ratio is None else f"{ratio:.2f}" for ratio in ratios)
        table.add_row(row["task"], str(row["num_worlds"]), f"{taken[ALL]:.1f}", *numbers)
    Console(width=180).print(table)


if __name__ == "__main__":
    main()
