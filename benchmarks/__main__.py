"""Steps per second of every scene at several batch sizes, beside plain MuJoCo C in the same run.

    python -m benchmarks --output out/bench.json

The rival is `mujoco.mj_step` of the unslimmed model on one thread, which is what MyoSuite's own physics costs
without its Python. Rounds of all contestants are interleaved, so that a busy machine slows all of them; the
median over rounds counts. Tasks that share a scene cost the same, so each scene is measured once.
"""

import json
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
import tyro
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.machine import processor
from myowarp.definitions.task import TASKS
from myowarp.sim.build import full_spec
from myowarp.sim.simulation import Simulation

CONTACT_TASKS = (
    "myoHandKeyTurnRandom-v0",
    "myoHandObjHoldRandom-v0",
    "myoHandPenTwirlRandom-v0",
    "myoChallengeBaodingP1-v1",
)
"""One of each family with contacts."""

PACKAGES = ("mujoco", "mujoco-warp", "warp-lang", "numpy")


@dataclass
class Options:
    """Measure speed."""

    output: Path = Path("out/bench.json")
    """JSON file to write."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = ()
    """Task names with version; none means one of every scene."""
    sizes: tuple[int, ...] = (1, 16, 256, 1024)
    """Numbers of worlds."""
    physics: str = "parity"
    """Physics preset."""
    device: str = "cpu"
    """Warp device."""
    rounds: int = 5
    """Rounds; the median counts."""
    seconds: float = 1.0
    """Rough duration of one measurement."""


class Timed:
    """A simulation, timed over whole environment steps with fresh random actions."""

    def __init__(self, sim: Simulation, clock: Callable[[], float] = time.perf_counter) -> None:
        self.sim, self.clock, self.rng = sim, clock, np.random.default_rng(0)
        self.run(2)

    def run(self, steps: int) -> float:
        """Return seconds for one environment step of all worlds."""
        shape = self.sim.action.shape
        actions = self.rng.uniform(-1, 1, (steps, *shape)).astype(np.float32)
        begin = self.clock()
        for action in actions:
            self.sim.action.assign(action)
            self.sim.step()
            self.sim.transition.reward.numpy()  # wait for the device
        return (self.clock() - begin) / steps


class Batch(Timed):
    """A simulation whose speed is measured."""

    def __init__(self, key: str, num_worlds: int, options: Options) -> None:
        super().__init__(Simulation(TASKS[key], num_worlds, device=options.device, physics=options.physics))
        self.num_substeps = self.sim.scene.num_substeps
        self.steps = max(2, round(options.seconds / self.run(2)))

    def measure(self) -> float:
        """Return environment steps per second, all worlds together."""
        return self.sim.num_worlds / self.run(self.steps)


class MujocoC:
    """Plain `mj_step` of the full model, random controls held for one control step."""

    def __init__(self, key: str, options: Options) -> None:
        spec = TASKS[key]
        self.model = full_spec(spec).compile()
        self.data = mujoco.MjData(self.model)
        self.num_substeps = spec.num_substeps
        self.horizon = spec.horizon
        self.start = spec.start(self.model)
        self.rng = np.random.default_rng(0)
        self.steps = max(10, round(options.seconds / self.run(10)))

    def run(self, steps: int) -> float:
        """Return wall seconds for one control step."""
        controls = self.rng.uniform(*self.model.actuator_ctrlrange.T, (steps, self.model.nu))
        begin = time.perf_counter()
        for step, control in enumerate(controls):
            if step % self.horizon == 0:
                mujoco.mj_resetData(self.model, self.data)
                self.data.qpos[:] = self.start
            self.data.ctrl[:] = control
            mujoco.mj_step(self.model, self.data, self.num_substeps)
        return (time.perf_counter() - begin) / steps

    def measure(self) -> float:
        """Return control steps per second."""
        return 1.0 / self.run(self.steps)


def measure_scene(key: str, options: Options, progress: Progress) -> list[dict[str, object]]:
    """Return one row a batch size, each with its ratio to MuJoCo C in the same rounds."""
    rival = MujocoC(key, options)
    batches = [Batch(key, size, options) for size in options.sizes]
    task = progress.add_task(key, total=options.rounds)
    rates: list[list[float]] = []
    for _ in range(options.rounds):
        rates.append([contestant.measure() for contestant in (rival, *batches)])
        progress.advance(task)
    rows = []
    for i, batch in enumerate(batches, start=1):
        ratios = [row[i] / row[0] for row in rates]
        rate = statistics.median(row[i] for row in rates)
        rows.append(
            {
                "task": TASKS[key].env_id,
                "num_worlds": batch.sim.num_worlds,
                "env_steps_per_s": round(rate, 1),
                "physics_steps_per_s": round(rate * batch.num_substeps, 1),
                "mujoco_c_env_steps_per_s": round(statistics.median(row[0] for row in rates), 1),
                "ratio_to_mujoco_c": round(statistics.median(ratios), 3),
                "ratio_spread": [round(min(ratios), 3), round(max(ratios), 3)],
            }
        )
    return rows


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks")
    keys = options.tasks or tuple({TASKS[key].scene_key: key for key in TASKS}.values())
    options.output.parent.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    with Progress(console=Console(stderr=True)) as progress:
        rows = [row for key in keys for row in measure_scene(key, options, progress)]
    report = {
        "processor": processor(),
        "cores_used": 1,
        "load_before": round(load, 2),
        "device": options.device,
        "physics": options.physics,
        "rounds": options.rounds,
        "versions": {name: version(name) for name in PACKAGES},
        "rows": rows,
    }
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    table = Table("task", "worlds", "env steps/s", "physics steps/s", "MuJoCo C env steps/s", "ratio")
    for row in rows:
        rates = (row[name] for name in ("env_steps_per_s", "physics_steps_per_s", "mujoco_c_env_steps_per_s"))
        cells = (f"{rate:,.0f}" for rate in rates)
        table.add_row(str(row["task"]), str(row["num_worlds"]), *cells, f"{row['ratio_to_mujoco_c']:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
