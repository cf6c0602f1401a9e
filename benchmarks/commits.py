"""Whole environment steps of this tree beside those of an earlier commit, one shard, in turns.

    python -m benchmarks.commits COMMIT
    python -m benchmarks.commits COMMIT --models OUT/gait2354_simbody --sizes 1 64 1024

Each tree steps in a process of its own with the same random actions, the commit's in a worktree. What counts
is CPU time of the process, and of all rounds the median of the ratio of neighbours, since other work on the
machine slows both.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

HERE = Path(__file__).resolve().parents[1]


@dataclass
class Options:
    """Measure a change of speed."""

    commit: tyro.conf.Positional[str]
    """Commit to compare this tree with."""
    output: Path = Path("out/commits.json")
    """JSON file to write."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-t"])] = (
        "myoHandPoseRandom-v0",
        "myoHandReachRandom-v0",
        "myoElbowPose1D6MRandom-v0",
        "myoFingerPoseRandom-v0",
        "myoHandKeyTurnRandom-v0",
        "myoHandObjHoldRandom-v0",
        "myoHandPenTwirlRandom-v0",
        "myoChallengeBaodingP1-v1",
    )
    """Task names with version."""
    models: tuple[Path, ...] = ()
    """Folders that `myowarp convert` wrote; they step with `parity` alone."""
    sizes: tuple[int, ...] = (64, 1024)
    """Numbers of worlds."""
    physics: tuple[str, ...] = ("parity", "fast")
    """Physics presets."""
    rounds: int = 12
    """Pairs of measurements."""
    seconds: float = 0.25
    """Rough duration of one measurement."""


def serve(case: dict[str, Any]) -> None:
    """Step when told to; for each line with a number of steps, answer with their CPU time."""
    from myowarp.definitions.task import TASKS
    from myowarp.sim.simulation import Simulation
    from myowarp.tasks.from_file import pose_task

    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    spec = TASKS[case["task"]] if case["task"] in TASKS else pose_task(Path(case["task"]) / "model.xml")
    number = case["num_worlds"]
    sim = Simulation(spec, number, device="cpu", physics=case["physics"], shards=1, progress=False)
    sim.reset(seeds=np.arange(number))
    rng = np.random.default_rng(0)
    for line in sys.stdin:
        actions = rng.uniform(-1, 1, (int(line), *sim.action.shape)).astype(np.float32)
        begin = time.process_time()
        for action in actions:
            sim.action.assign(action)
            sim.step()
        print(json.dumps(time.process_time() - begin), file=answers)


class Tree:
    """A process that steps with the code of one tree."""

    def __init__(self, root: Path, case: dict[str, Any], opened: ExitStack) -> None:
        command = [sys.executable, str(Path(__file__)), "--serve", json.dumps(case)]
        environment = os.environ | {"PYTHONPATH": str(root)}
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
        process = opened.enter_context(subprocess.Popen(command, cwd=root, env=environment, **pipes))
        opened.callback(process.kill)
        assert process.stdin is not None
        assert process.stdout is not None
        self.asked: IO[str] = process.stdin
        self.answers: IO[str] = process.stdout

    def run(self, steps: int) -> float:
        """Return the seconds of some steps."""
        print(steps, file=self.asked)
        return float(self.answers.readline())


def measure(case: dict[str, Any], roots: tuple[Path, Path], options: Options) -> dict[str, Any]:
    """Return the ratio of this tree's time to the commit's, and both."""
    with ExitStack() as opened:
        trees = [Tree(root, case, opened) for root in roots]
        warm = max(tree.run(8) for tree in trees) / 8
        steps = max(1, round(options.seconds / warm))
        rounds = []
        for number in range(options.rounds):
            order = (0, 1) if number % 2 else (1, 0)
            taken = {which: trees[which].run(steps) for which in order}
            rounds.append([taken[0], taken[1]])
    seconds = np.array(rounds) / (steps * case["num_worlds"])
    ratios = seconds[:, 0] / seconds[:, 1]
    spread = np.quantile(ratios, (0.25, 0.75)).round(3).tolist()
    names = ("microseconds", "microseconds_before")
    medians = dict(zip(names, (1e6 * np.median(seconds, axis=0)).round(2).tolist(), strict=True))
    return {**case, "ratio": round(float(np.median(ratios)), 3), "quartiles": spread, **medians}


def main() -> None:
    """Measure, print a table, write the JSON."""
    options = tyro.cli(Options, prog="python -m benchmarks.commits")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    console, load, rows = Console(), os.getloadavg()[0], []
    cases = [(task, physics) for task in options.tasks for physics in options.physics]
    cases += [(str(folder.resolve()), "parity") for folder in options.models]
    table = Table("task", "physics", "worlds", "us", "us before", "ratio", "quartiles")
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        git = ["git", "-C", str(HERE), "worktree"]
        subprocess.run(
            [*git, "add", "--detach", str(before), options.commit], check=True, capture_output=True
        )
        try:
            for task, physics in cases:
                for number in options.sizes:
                    case = {"task": task, "physics": physics, "num_worlds": number}
                    rows.append(row := measure(case, (HERE, before), options))
                    figures = (row["microseconds"], row["microseconds_before"], row["ratio"])
                    texts = (f"{value:.3g}" for value in (*figures, *row["quartiles"]))
                    *first, low, high = texts
                    table.add_row(Path(task).name, physics, str(number), *first, f"{low} - {high}")
                    console.print(Path(task).name, physics, number, *first)
        finally:
            subprocess.run([*git, "remove", "--force", str(before)], check=True)
    report = {"commit": options.commit, "load_before": round(load, 2), "rounds": options.rounds, "rows": rows}
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    console.print(table)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--serve"]:
        serve(json.loads(sys.argv[2]))
    else:
        main()
