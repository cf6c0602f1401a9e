"""Time to success: one trainer and one set of settings, on MyoWarp and on its rivals; our SAC beside it.

    make learning

The loop and the PPO of `myowarp train` with a task's preset learn in MyoWarp, in EnvPool and in MyoSuite with
Gymnasium's AsyncVectorEnv, on the same cores, one training at a time. Time counts from the start of the
process to the share of successes that ends a training, of the last 256 episodes with sampled actions. What
passed before the first step, compilation from a warm cache included, is `start`. Linux only.
"""

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from benchmarks.machine import processor
from myowarp.apps.reports.machine import used_seconds
from myowarp.disk import plain
from myowarp.inks import BLUE, ORANGE, SKY

ROOT = Path(__file__).parents[1]
TASKS = {
    "elbow pose": "myoElbowPose1D6MRandom-v0",
    "finger pose": "myoFingerPoseRandom-v0",
    "hand reach": "myoHandReachFixed-v0",
    "key turn": "myoHandKeyTurnFixed-v0",
    "object hold": "myoHandObjHoldRandom-v0",
}
GOALS = {"elbow pose": 5.0, "hand reach": 3.0, "key turn": 3.0}
"""Ratios of time to the better rival's that we want to reach."""
CONTESTANTS = {
    "myowarp": "MyoWarp",
    "myowarp_sac": "MyoWarp, SAC",
    "envpool": "EnvPool",
    "myosuite_async": "MyoSuite async",
}
COLORS = {"myowarp": BLUE, "myowarp_sac": SKY, "envpool": ORANGE, "myosuite_async": "#777777"}
DIFFERENCES = {
    "MyoWarp": "the preset's physics, as in the training of the baselines; success under parity is in "
    "docs/baselines.md",
    "MyoWarp, SAC": "the preset's settings for SAC, or its defaults; all others learn by PPO",
    "EnvPool": "EnvPool 1.2.5: MyoSuite 2.11.6, its models and observations; one thread a core; every "
    "environment starts every episode alike, so that its Random ids are easier",
    "MyoSuite async": "MyoSuite 3.0.0 in AsyncVectorEnv, one worker a core, with as many steps more in an "
    "iteration as there are fewer environments",
}


@dataclass
class Options:
    """Measure the time to success beside rivals."""

    myosuite: Path = ROOT / ".venv-parity/bin/python"
    """Python of an environment with myosuite==3.0.0."""
    envpool: Path = ROOT / ".venv-envpool/bin/python"
    """Python of an environment with envpool==1.2.5."""
    output: Path = Path("out/learning.json")
    """JSON file to write; the plot goes beside it."""
    tasks: tuple[str, ...] = tuple(TASKS)
    """Tasks to learn."""
    share: float = 0.95
    """Share of successes that ends a training."""
    seconds: float = 1800.0
    """Most seconds of a training."""
    rounds: int = 3
    """Trainings of each; the median counts."""
    quick: bool = False
    """The elbow, one training of three minutes at most: does everything run?"""

    def __post_init__(self) -> None:
        """Check the names, and cut down to what is quick."""
        unknown = sorted(set(self.tasks) - set(TASKS))
        if unknown:
            raise ValueError(f"task {unknown[0]!r} unknown; available: {', '.join(TASKS)}")
        if self.quick:
            self.tasks, self.rounds, self.seconds = ("elbow pose",), 1, 180.0


def train(kind: str, task: str, options: Options, log: Any) -> dict[str, Any]:
    """Return how a training went: its curve, and how many cores others kept busy."""
    pythons = {"envpool": options.envpool, "myosuite_async": options.myosuite}
    python = str(pythons.get(kind, sys.executable))
    begin, (busy, stolen) = time.time(), used_seconds()
    arguments = {"kind": kind, "task": task, "python": python, "cores": len(os.sched_getaffinity(0))}
    arguments |= {"share": options.share, "seconds": options.seconds, "begin": begin}
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.learner", json.dumps(arguments)],
        stdout=subprocess.PIPE,
        stderr=log,
        cwd=ROOT,
        env=dict(os.environ, PYTHONPATH=str(ROOT)),
        text=True,
    )
    assert process.stdout
    curve = [json.loads(line) for line in process.stdout if line.startswith("{")]  # Warp greets on it, too
    if process.wait() or not curve:
        raise RuntimeError(f"{CONTESTANTS[kind]} ended with exit code {process.returncode}; see the log")
    wall, (busy_after, stolen_after) = time.time() - begin, used_seconds()
    last = curve[-1]
    others = max(0.0, busy_after - busy - last["cpu"]) + stolen_after - stolen
    return {"reached": last["reached"], "curve": curve, "others": round(others / wall, 2)}


def summary(rows: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Return medians over the trainings of each contestant, and how much sooner MyoWarp is."""
    found: dict[str, Any] = {}
    for kind, trainings in rows.items():
        last = [training["curve"][-1] for training in trainings]
        figures = {
            name: round(statistics.median(row[name] for row in last), 2)
            for name in ("seconds", "start", "cpu")
        }
        found[kind] = figures | {
            "samples": statistics.median(row["samples"] for row in last),
            "success": round(statistics.median(row["success"] for row in last), 3),
            "simulation": round(statistics.median(row["simulation"] for row in last), 3),
            "reached": sum(training["reached"] for training in trainings),
            "trainings": len(trainings),
            "cores_busy_with_others": max(training["others"] for training in trainings),
        }
    ours = found["myowarp"]
    rivals = [row for kind, row in found.items() if not kind.startswith("myowarp")]
    for name in ("seconds", "cpu"):  # a rival that has not succeeded yet would take longer still
        found[f"times_better_{name}"] = round(min(row[name] for row in rivals) / max(ours[name], 1e-9), 2)
    return found


def draw(report: dict[str, Any], path: Path) -> None:
    """Draw success over wall time, a panel for each task."""
    from matplotlib.figure import Figure

    tasks = report["tasks"]
    figure = Figure(figsize=(3.2 * len(tasks) + 1.0, 3.0), layout="constrained")
    panels = list(figure.subplots(1, len(tasks), sharey=True, squeeze=False).flat)
    for panel, (task, entry) in zip(panels, tasks.items(), strict=True):
        for kind, trainings in entry["trainings"].items():
            for i, training in enumerate(trainings):
                points = [row for row in training["curve"] if row["success"] == row["success"]]
                times, shares = [row["seconds"] for row in points], [100 * row["success"] for row in points]
                panel.plot(times, shares, color=COLORS[kind], label=None if i else CONTESTANTS[kind])
        panel.set_title(task, fontsize="medium")
        panel.set(xscale="log", ylim=(-2, 102))
    figure.supxlabel("wall time from process start [s]", fontsize="medium")
    panels[0].set_ylabel("success [%]")
    panels[0].legend(frameon=False, fontsize="small")
    figure.savefig(path, dpi=120)


def print_table(report: dict[str, Any]) -> None:
    """Print the summaries."""
    figures = ("seconds", r"start \[s]", r"CPU \[s]", "samples", "success", "simulation", "others")
    table = Table("task", "contestant", *figures)  # rich would take [s] for a tag
    for task, entry in report["tasks"].items():
        for kind in entry["trainings"]:
            row = entry["summary"][kind]
            bound = "" if row["reached"] == row["trainings"] else "> "
            cells = [f"{bound}{row['seconds']:.1f}", f"{row['start']:.1f}", f"{bound}{row['cpu']:.1f}"]
            cells += [f"{row['samples']:,.0f}"]
            cells += [f"{100 * row['success']:.0f} %", f"{100 * row['simulation']:.0f} %"]
            table.add_row(task, CONTESTANTS[kind], *cells, f"{row['cores_busy_with_others']:.2f} cores")
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def measure(task: str, options: Options, log: Any, say: Any) -> dict[str, list[dict[str, Any]]]:
    """Train all contestants in turns."""
    rows: dict[str, list[dict[str, Any]]] = {kind: [] for kind in CONTESTANTS}
    order: Sequence[str] = list(CONTESTANTS)
    for turn in range(options.rounds):
        for kind in order if turn % 2 == 0 else reversed(order):
            with say(f"{task}: {CONTESTANTS[kind]}, training {turn + 1}"):
                rows[kind].append(train(kind, TASKS[task], options, log))
    return rows


def main() -> None:
    """Train, print a table, write JSON and plot."""
    options = tyro.cli(Options, prog="python -m benchmarks.learning")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    console, load = Console(stderr=True), os.getloadavg()[0]
    report: dict[str, Any] = {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "load_before": round(load, 2),
        "share": options.share,
        "seconds_at_most": options.seconds,
        "quick": options.quick,
        "differences": DIFFERENCES,
        "goals": GOALS,
        "tasks": {},
    }
    with options.output.with_suffix(".log").open("w") as log:
        for task in options.tasks:
            rows = measure(task, options, log, console.status)
            report["tasks"][task] = {"id": TASKS[task], "summary": summary(rows), "trainings": rows}
            options.output.write_text(json.dumps(plain(report)) + "\n")  # so far
    worst = max(
        entry["summary"][kind]["cores_busy_with_others"]
        for entry in report["tasks"].values()
        for kind in CONTESTANTS
    )
    report["shared_cores"] = worst > 0.1
    options.output.write_text(json.dumps(plain(report)) + "\n")
    draw(report, options.output.with_suffix(".png"))
    print_table(report)
    if report["shared_cores"]:
        console.print(f"[yellow]Others kept up to {worst:.2f} cores busy; do not quote these times.[/yellow]")


if __name__ == "__main__":
    main()
