"""Cost of muscle models: whole environment steps under each, in one thread, beside MuJoCo's muscle.

    python -m benchmarks.muscles --output benchmarks/results/muscles.json
    python -m benchmarks.muscles --models OUT/gait2354_simbody

What counts is CPU time of this process; rounds take the models in turn, and of their ratios to MuJoCo's
muscle in the same round the median. The muscles alone are one launch of theirs on the paths of the last step,
in so many worlds that launching weighs nothing. How far a model is ahead of real time is the time that is
simulated in all worlds together over that of whole environment steps.
"""

import json
import os
import statistics
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
import warp as wp

import myowarp
from benchmarks.machine import processor
from myowarp.definitions.muscle import MUSCLES
from myowarp.sim.simulation import Simulation

ROUNDS, STEPS, LAUNCHES, MANY = 12, 10, 20, 1024


@dataclass
class Options:
    """Time every muscle model beside MuJoCo's."""

    models: tuple[Path, ...] = ()
    """Folders of converted models, beside the tasks."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = (
        "myoHandPoseRandom-v1",
        "myoElbowPose1D6MRandom-v0",
    )
    """Task names with version."""
    worlds: int = 64
    """Worlds in one shard."""
    output: Path = Path("out/muscles.json")
    """File to write."""


def cpu(work: Any) -> float:
    """Return the CPU time that something takes [s]."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def simulation(task: Any, worlds: int, muscle: str, physics: str) -> Simulation:
    """Return a simulation in one shard, in the middle of an episode."""
    options = {"device": "cpu", "shards": 1, "autoreset": "same_step", "progress": False}
    sim = Simulation(task, worlds, muscle=muscle, physics=physics, **options)
    sim.reset(seeds=np.arange(worlds))
    return sim


def timed(task: Any, physics: str, worlds: int) -> dict[str, Any]:
    """Return what physics steps take under every model."""
    sims = {name: simulation(task, worlds, name, physics) for name in MUSCLES}
    rng, times = np.random.default_rng(0), {name: list[float]() for name in sims}
    scenes = {name: sim.scene for name, sim in sims.items()}
    steps = {name: float(scene.model.opt.timestep.numpy()[0]) for name, scene in scenes.items()}
    control_dt = scenes["mujoco"].num_substeps * steps["mujoco"]
    for _ in range(ROUNDS):
        actions = rng.uniform(-1.0, 1.0, (STEPS, *sims["mujoco"].action.shape)).astype(np.float32)
        for name, sim in sims.items():

            def stepped(sim: Simulation = sim, actions: np.ndarray = actions) -> None:
                for action in actions:
                    sim.action.assign(action)
                    sim.step()

            times[name].append(cpu(stepped) / STEPS / worlds)
    plain = times["mujoco"]
    return {
        "control step [s]": round(control_dt, 6),
        "worlds": worlds,
        "muscles": len(sims["mujoco"].scene.muscles.names),
        "models": {
            name: {
                "ratio to mujoco": round(statistics.median(np.divide(own, plain).tolist()), 3),
                "physics step [s]": round(steps[name], 6),
                "us per physics step of a world": round(1e6 * min(own) * steps[name] / control_dt, 3),
                "times real time": round(control_dt / min(own), 1),
            }
            for name, own in times.items()
        },
    }


def alone() -> dict[str, float]:
    """Return what one muscle takes in a physics step of the hand [ns]."""
    found = {}
    for name in MUSCLES:
        sim = simulation("myoHandPoseRandom-v1", MANY, name, "parity")
        rng = np.random.default_rng(0)
        for _ in range(STEPS):
            sim.action.assign(rng.uniform(-1.0, 1.0, sim.action.shape).astype(np.float32))
            sim.step()
        scene = sim.shards[0].scene

        def launched(scene: Any = scene) -> None:
            for _ in range(LAUNCHES):
                scene.muscles.launch(scene.model, scene.data)

        with wp.ScopedDevice("cpu"):
            least = min(cpu(launched) for _ in range(ROUNDS))
        found[name] = round(1e9 * least / LAUNCHES / MANY / len(scene.muscles.names), 1)
    return found


def main() -> None:
    """Run, print and write."""
    options = tyro.cli(Options, prog="python -m benchmarks.muscles")
    load, cases = os.getloadavg()[0], {}
    for task in options.tasks:
        for physics in ("parity", "fast"):
            cases[f"{task}, {physics}"] = timed(task, physics, options.worlds)
    for folder in options.models:
        file = next(folder.glob("*.xml"))
        spec = myowarp.from_mjcf(file, f"{file.stem}Pose-v0", control_dt=0.02, replace=True)
        cases[f"{folder.name}, parity"] = timed(spec, "parity", options.worlds)
    report = {
        "processor": processor(),
        "load": [round(load, 2), round(os.getloadavg()[0], 2)],
        "ns per muscle and physics step": alone(),
        "steps": cases,
    }
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
