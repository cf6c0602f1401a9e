"""Training over ranks: samples a second of one rank on one core beside two ranks on two, in turns.

    python -m benchmarks.ranks --output out/ranks.json

One rank is pinned to the first core, two ranks to the first two. `strong`: as many worlds in all; `weak`: as
many worlds a rank. Idle cores are needed: in each iteration two ranks wait some hundred times for the slower
one. The time is that of iterations, without start and compilation.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from benchmarks.machine import disturbances, processor


@dataclass
class Options:
    """Measure training over ranks."""

    output: Path = Path("out/ranks.json")
    """JSON file to write."""
    task: str = "myoHandReachRandom-v0"
    """Task."""
    num_worlds: int = 256
    """Worlds of one rank."""
    iterations: int = 20
    """Iterations of a run."""
    pairs: int = 5
    """Measurements of each, in turns."""


def main() -> None:
    """Measure, print and write."""
    options = tyro.cli(Options, description=__doc__)
    rows = []
    for pair in range(options.pairs):
        one = measured(options, 1, options.num_worlds)
        row: dict[str, dict[str, Any]] = {"one": one}
        for name, worlds in (("strong", options.num_worlds), ("weak", 2 * options.num_worlds)):
            row[name] = two = measured(options, 2, worlds)
            print(f"pair {pair}: {name} {two['rate'] / one['rate']:.2f} times {one['rate']:,.0f} samples/s")
        rows.append(row)
    ratios = {
        name: statistics.median(row[name]["rate"] / row["one"]["rate"] for row in rows)
        for name in ("strong", "weak")
    }
    others = disturbances(run["others"] for row in rows for run in row.values())
    report = {**ratios, "processor": processor(), "task": options.task, "others": others, "pairs": rows}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    print(f"Two ranks beside one: strong {ratios['strong']:.2f}, weak {ratios['weak']:.2f}; others {others}")


def measured(options: Options, ranks: int, worlds: int) -> dict[str, Any]:
    """Return samples a second of a run, its share of time in the learner, and how busy others were."""
    samples = options.iterations * worlds * 24
    with tempfile.TemporaryDirectory() as folder:
        start = ["-m", "torch.distributed.run", "--nproc-per-node", str(ranks)] if ranks > 1 else []
        train = ["-m", "myowarp", "train", options.task, "--output", f"{folder}/run", "--device", "cpu"]
        sizes = ["--samples", samples, "--num-worlds", worlds, "--stop-success", 2, "--save-seconds", 1e9]
        sizes += ["--selections", 0]
        command = [sys.executable, *start, *train, *map(str, sizes)]
        done = subprocess.run(
            command, capture_output=True, text=True, preexec_fn=lambda: os.sched_setaffinity(0, range(ranks))
        )
        if done.returncode:
            raise RuntimeError(done.stderr)
        report = json.loads((Path(folder) / "run" / "report.json").read_text())
    return {
        "rate": report["samples"] / report["training_seconds"],
        "cpu_seconds_of_rank_0": report["training_cpu_seconds"],
        "seconds": report["training_seconds"],
        "learner": report["share_learner"],
        "others": max(
            0.0, report["cores_busy_with_others"] - (ranks - 1)
        ),  # the other rank is no disturbance
    }


if __name__ == "__main__":
    main()
