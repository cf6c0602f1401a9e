"""Baselines: success over samples of the tasks with fixed and random targets."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.policies.baselines import CURVE, FOLDER, baseline_tasks, load_baseline
from myowarp.apps.reports.intervals import student
from myowarp.apps.reports.result import Merit
from myowarp.apps.reports.table import read_numbers
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.policies import Training

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRPO = Path(__file__).with_name("trpo_curves.json")
EASY, HARD = "Fixed", "Random"
LEARNED = 0.9  # share of successful episodes
PAPER = {  # the authors' NPG: success at the end [%], one number a seed, and samples [million]
    "myoElbowPose1D6MFixed-v0": ((100, 100, 100), 9.6),
    "myoElbowPose1D6MRandom-v0": ((100, 100, 100), 9.6),
    "myoFingerPoseFixed-v0": ((100, 100, 100), 9.6),
    "myoFingerPoseRandom-v0": ((100, 100, 100), 9.6),
    "myoFingerReachFixed-v0": ((100, 100, 100), 9.6),
    "myoFingerReachRandom-v0": ((15, 14, 33), 9.6),
    "myoHandPoseFixed-v0": ((100, 100, 100), 9.6),
    "myoHandPoseRandom-v0": ((0, 0, 0), 9.6),
    "myoHandReachFixed-v0": ((100, 100, 100), 9.5),
    "myoHandReachRandom-v0": ((59, 55, 53), 9.4),
    "myoHandKeyTurnFixed-v0": ((100, 100, 100), 19.2),
    "myoHandKeyTurnRandom-v0": ((0, 0, 2), 19.2),
    "myoHandObjHoldFixed-v0": ((100, 100, 100), 6.3),
    "myoHandObjHoldRandom-v0": ((1, 1, 1), 2.0),
    "myoHandPenTwirlFixed-v0": ((100, 100, 100), 4.3),
    "myoHandPenTwirlRandom-v0": ((88, 91, 40), 3.4),
}
SAMPLES, ENDING = 5_000_000, {"stop_success": 0.995}
QUICK_TASKS = ("myoElbowPose1D6MFixed-v0", "myoElbowPose1D6MRandom-v0")
Curve = tuple[np.ndarray, np.ndarray]
"""Samples, and share of successful episodes."""


@cache
def committed_trpo() -> dict[str, dict[str, Any]]:
    """Return the committed runs of TRPO by task and seed."""
    curves: dict[str, dict[str, Any]] = json.loads(TRPO.read_text())["curves"]
    return curves


def trpo(lab: Lab) -> dict[str, list[Curve]]:
    """Return the curves of TRPO: committed ones, or of trainings that are run here."""
    if not lab.retrain:
        return {
            task: [(np.array(run["samples"]), np.array(run["success"])) for run in runs.values()]
            for task, runs in committed_trpo().items()
        }
    found = {}
    for task in QUICK_TASKS if lab.quick else [task for task in PAPER if task in baseline_tasks()]:
        training = Training(f"trpo_{task}", task, samples=SAMPLES, settings=ENDING, algorithm="trpo")
        found[task] = [read_curve(lab.policy(training, seed).folder / "progress.csv") for seed in lab.seeds]
    return found


def preset() -> dict[str, list[Curve]]:
    """Return the curves of the package's policies."""
    return {task: [read_curve(FOLDER / task / CURVE)] for task in baseline_tasks() if task in PAPER}


def algorithm(task: str) -> str:
    """Return what the package's policy of a task was trained by."""
    return str(load_baseline(task).checkpoint.manifest["algorithm"])


def read_curve(path: Path) -> Curve:
    """Return a curve from a CSV file, from the first finished episode on."""
    columns = read_numbers(path)
    known = np.isfinite(columns["success"])
    return columns["samples"][known], columns["success"][known]


def samples_to(curve: Curve, share: float = LEARNED) -> float:
    """Return after how many samples [million] a share of episodes first succeeded, NaN if never."""
    samples, success = curve
    there = success >= share
    return float(samples[there.argmax()]) / 1e6 if there.any() else float("nan")


def run(lab: Lab) -> Findings:
    """Read or make the curves."""
    return findings({"TRPO": trpo(lab), "preset": preset()})


def findings(curves: dict[str, dict[str, list[Curve]]]) -> Findings:
    """Return figures of merit, claims and figure."""
    rows = []
    for task, (paper, samples) in PAPER.items():
        for name, found in curves.items():
            runs, who = found.get(task), f"{task}, {name}"
            if not runs:
                continue
            most = max(curve[0][-1] for curve in runs) / 1e6
            note = f"ours after at most {most:.2f} M samples, the paper's after {samples:g} M"
            success = [100.0 * curve[1][-1] for curve in runs]
            known = float(np.mean(paper)), float(np.std(paper))
            rows.append(Merit("success", "%", who, success, *known, note))
            needed = [samples_to(curve) for curve in runs]
            if np.isfinite(needed).any():
                rows.append(Merit(f"samples to {100 * LEARNED:.0f} %", "M", who, needed))
    ratios = [
        samples_to(curves["preset"][task][0]) / np.nanmean([samples_to(curve) for curve in runs])
        for task, runs in curves["TRPO"].items()
        if task in curves["preset"]
    ]
    natural, default = curves["TRPO"], curves["preset"]
    early = [max(samples_to(curve) for curve in runs) for task, runs in default.items() if EASY in task]
    # A task's fixed variant beside its random one, where one algorithm learned both.
    variants = [(easy, easy.replace(EASY, HARD)) for easy in default if EASY in easy]
    pairs = [
        (samples_to(default[easy][0]), samples_to(default[hard][0]))
        for easy, hard in variants
        if hard in default and algorithm(easy) == algorithm(hard)
    ]
    elbows = [runs for task, runs in natural.items() if "Elbow" in task]
    ends = [
        np.mean([curve[1][-1] for curve in runs]) - default[task][0][1][-1]
        for task, runs in natural.items()
        if task in default
    ]
    holds = {
        "easy": max(early) <= SAMPLES / 1e6,
        "hard": all(not a >= b for a, b in pairs),
        "natural gradient": min(curve[1].max() for runs in elbows for curve in runs) >= LEARNED,
        "same end": all(abs(end) < 0.1 for end in ends),
    }
    measured = {
        "easy": len(early),
        "first": min(early),
        "last": max(early),
        "pairs": len(pairs),
        "elbows": len(elbows),
        "trainings": sum(map(len, elbows)),
        "least": min(ratios),
        "most": max(ratios),
        "number": len(ratios),
        "missing": ", ".join(task for task in PAPER if task not in natural),
    }
    return Findings(rows, holds, lambda figure: draw(figure, curves), measured, over="trainings")


def draw(figure: Figure, curves: dict[str, dict[str, list[Curve]]]) -> None:
    """Draw success over samples, a panel for each pair of easy and hard."""
    families = [
        f
        for f in dict.fromkeys(re.sub(f"{EASY}|{HARD}", "{}", task) for task in PAPER)
        if any(f.format(kind) in found for kind in (EASY, HARD) for found in curves.values())
    ]
    figure.set_figheight(1.9 * len(families) + 0.6)
    panels = figure.subplots(len(families), 2, sharey=True, squeeze=False)
    styles = {"TRPO": ("#b3362b", "-"), "preset": ("#1f5fa8", "-")}
    for row, family in zip(panels, families, strict=True):
        for axes, kind in zip(row, (EASY, HARD), strict=True):
            task = family.format(kind)
            for name, (color, style) in styles.items():
                _band(axes, curves[name].get(task, []), name, color, style)
            paper, samples = PAPER[task]
            most = max(
                (c[0][-1] / 1e6 for found in curves.values() for c in found.get(task, [])), default=1.0
            )
            axes.plot([1.06 * most] * len(paper), paper, "<", color="0.4", ms=5, clip_on=False, zorder=5)
            if not any(task in found for found in curves.values()):
                axes.text(0.5, 0.5, "not trained", color="0.5", ha="center", transform=axes.transAxes)
            axes.set_title(f"{task}; NPG after {samples:g} M", fontsize=8)
            axes.set(xlim=(0, 1.06 * most), ylim=(-3, 104))
        row[0].set_ylabel("success [%]")
    for axes in panels[-1]:
        axes.set_xlabel("samples [million]")
    handles = {
        label: h for p in panels.ravel() for h, label in zip(*p.get_legend_handles_labels(), strict=True)
    }
    handles["the paper's NPG, its three seeds"] = panels[0, 0].lines[-1]
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4)


def _band(axes: Any, runs: list[Curve], name: str, color: str, style: str) -> None:
    """Draw the mean of runs and their 95 % interval; a run that ended holds its last value."""
    if not runs:
        return
    grid = np.unique(np.concatenate([samples for samples, _ in runs]))
    values = 100.0 * np.array([np.interp(grid, samples, success) for samples, success in runs])
    axes.plot(grid / 1e6, values.mean(axis=0), style, color=color, label=name)
    if len(runs) > 1:
        low, high = np.clip(student(values), 0.0, 100.0)
        axes.fill_between(grid / 1e6, low, high, color=color, alpha=0.2, linewidth=0)


EXPERIMENT = Experiment("baselines", run, ignores=("num_worlds", "models"))
