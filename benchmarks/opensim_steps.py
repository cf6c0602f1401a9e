"""Cost of a physics step of a converted model: in free coordinates, with equalities, and in MuJoCo C.

    python -m benchmarks.opensim_steps OUT/gait2354_simbody OUT/gait2392_millard2012muscle

Folders are those that `myowarp convert` wrote. All start from one set of states, reached by random
actions, and are timed in turns, one thread each, so that a round compares what ran at nearly the same time:
our step in free coordinates, our step of the model without couplings.json (equality rows hold the joints that
follow), and
`mujoco.mj_step` of model.xml, slim, in float64. Microseconds are CPU time of a world and a step. A ratio is
the median of the rounds' ratios. Writes benchmarks/results/opensim_steps.json, with the machine's load.
"""

import argparse
import json
import os
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.__main__ import PACKAGES
from benchmarks.machine import processor
from benchmarks.substep import EQUALITIES, MUJOCO_C, Options, Physics
from myowarp.tasks.from_file import pose_task

RESULT = Path(__file__).parent / "results" / "opensim_steps.json"
ROUNDS, WORLDS, WARMUP = 15, 32, 10
FREE = "free coordinates"


def measure(folder: Path) -> dict[str, Any]:
    """Return microseconds of a world and step, and ratios over those in free coordinates."""
    load = os.getloadavg()[0]
    options = Options(warmup=WARMUP)
    physics = Physics(pose_task(folder / "model.xml"), WORLDS, options)
    held = physics.held(folder, options)
    contestants = {FREE: physics.all_stages(), EQUALITIES: held, MUJOCO_C: physics.run_mujoco_c}
    rounds = np.array([[run() for run in contestants.values()] for _ in range(ROUNDS)])
    ratios = rounds / rounds[:, :1]
    low, middle, high = np.percentile(ratios, (10, 50, 90), axis=0).round(2).tolist()
    least = rounds.min(axis=0).round(1).tolist()
    return {
        "microseconds_least": dict(zip(contestants, least, strict=True)),
        "over_free_coordinates": {
            name: {"median": middle[number], "p10_p90": [low[number], high[number]]}
            for number, name in enumerate(contestants)
            if name != FREE
        },
        "load_before_and_after": [round(load, 2), round(os.getloadavg()[0], 2)],
    }


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    options = parser.parse_args()
    result = json.loads(RESULT.read_text()) if RESULT.is_file() else {"models": {}}
    result |= {"processor": processor(), "cores": os.cpu_count(), "rounds": ROUNDS, "num_worlds": WORLDS}
    result["versions"] = {name: version(name) for name in PACKAGES}
    for folder in options.folders:
        result["models"][folder.name] = measure(folder)
        print(folder.name, json.dumps(result["models"][folder.name]), flush=True)
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
