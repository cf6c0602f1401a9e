"""What muscle models cost: the hand's pose task under each, in one thread, beside MuJoCo's muscle.

    python -m benchmarks.muscles --output benchmarks/results/muscles.json

CPU time of this process; rounds take the models in turn, and the least of them counts. The muscles alone are
one launch of theirs on the paths of the last step, over muscles and worlds.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from benchmarks.machine import processor
from myowarp.definitions.muscle import MUSCLES
from myowarp.sim.simulation import Simulation

TASK, WORLDS, STEPS, ROUNDS, LAUNCHES = "myoHandPoseRandom-v1", 256, 10, 5, 20


def cpu(work: Any) -> float:
    """Return the CPU time that something takes [s]."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=Path("out/muscles.json"), help="file to write")
    options = parser.parse_args()
    sims = {}
    for name in MUSCLES:
        sims[name] = Simulation(
            TASK, WORLDS, device="cpu", shards=1, muscle=name, autoreset="same_step", progress=False
        )
        sims[name].reset(seeds=np.arange(WORLDS))
    rng, steps, alone = np.random.default_rng(0), {n: [] for n in sims}, {n: [] for n in sims}
    for _ in range(ROUNDS):
        actions = rng.uniform(-1.0, 1.0, (STEPS, *sims["mujoco"].action.shape)).astype(np.float32)
        for name, sim in sims.items():

            def stepped(sim: Simulation = sim, actions: np.ndarray = actions) -> None:
                for action in actions:
                    sim.action.assign(action)
                    sim.step()

            steps[name].append(cpu(stepped) / STEPS / WORLDS / sim.scene.num_substeps)
            scene = sim.shards[0].scene

            def launched(scene: Any = scene) -> None:
                for _ in range(LAUNCHES):
                    scene.muscles.launch(scene.model, scene.data)

            with wp.ScopedDevice("cpu"):
                alone[name].append(cpu(launched) / LAUNCHES / WORLDS / len(scene.muscles.names))
    least = min(steps["mujoco"])
    report = {
        "processor": processor(),
        "task": TASK,
        "worlds": WORLDS,
        "physics step [s]": sims["mujoco"].scene.oracle.opt.timestep,
        "models": {
            name: {
                "ns per muscle and physics step": round(1e9 * min(alone[name]), 1),
                "physics step over that with mujoco": round(min(steps[name]) / least, 3),
                "us per physics step of a world": round(1e6 * min(steps[name]), 2),
            }
            for name in sims
        },
    }
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
