"""Baselines: success over samples of the tasks with fixed and random targets."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.policies.baselines import CURVE, FOLDER, baseline_tasks, load_baseline
from myowarp.apps.reports.result import PERCENT, Merit
from myowarp.apps.reports.table import read_numbers
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.policies import Training

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRPO = Path(__file__).with_name("trpo_curves.json")
NPG = Path(__file__).with_name("npg_curves.json")
FAMILIES = (
    *("myoElbowPose1D6M", "myoFingerPose", "myoFingerReach", "myoHandPose", "myoHandReach"),
    *("myoHandKeyTurn", "myoHandObjHold", "myoHandPenTwirl", "myoHandBaoding"),
)
EASY, HARD = "Fixed", "Random"
TASKS = tuple(f"{family}{kind}-v0" for family in FAMILIES for kind in (EASY, HARD))
LEARNED, SOLVED = 0.9, 95.0  # share of episodes in a training, percent of them in an evaluation
HARDLY = 50.0  # percent of the episodes
MODES = ("deterministic", "sampled")
SAMPLES, ENDING = 5_000_000, {"stop_success": 0.995}
QUICK_TASKS = ("myoElbowPose1D6MFixed-v0", "myoElbowPose1D6MRandom-v0")
COLORS = {"ppo": "#1f5fa8", "flashsac": "#3f9b63", "dagger": "#7d5ba6"}
Curve = tuple[np.ndarray, np.ndarray]
"""Samples, and share of successful episodes."""


@cache
def committed(path: Path) -> dict[str, dict[str, Any]]:
    """Return committed curves by task and seed."""
    curves: dict[str, dict[str, Any]] = json.loads(path.read_text())["curves"]
    return curves


def curves_of(path: Path) -> dict[str, list[Curve]]:
    """Return committed curves by task, a curve a seed."""
    return {
        task: [(np.array(run["samples"]), np.array(run["success"])) for run in runs.values()]
        for task, runs in committed(path).items()
    }


def trpo(lab: Lab) -> dict[str, list[Curve]]:
    """Return the curves of TRPO: committed ones, or of trainings that are run here."""
    if not lab.retrain:
        return curves_of(TRPO)
    found = {}
    for task in QUICK_TASKS if lab.quick else baseline_tasks():
        training = Training(f"trpo_{task}", task, samples=SAMPLES, settings=ENDING, algorithm="trpo")
        found[task] = [read_curve(lab.policy(training, seed).folder / "progress.csv") for seed in lab.seeds]
    return found


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


def evaluated(task: str) -> dict[str, np.ndarray]:
    """Return success under parity [%] by kind of actions, shape (seeds,)."""
    runs = load_baseline(task).runs
    return {mode: np.array([100.0 * run["evaluation"][mode]["success"] for run in runs]) for mode in MODES}


def run(lab: Lab) -> Findings:
    """Read or make the curves."""
    return findings(trpo(lab), curves_of(NPG))


def findings(natural: dict[str, list[Curve]], npg: dict[str, list[Curve]]) -> Findings:
    """Return figures of merit, claims and figure.

    Args:
        natural: Curves of TRPO by task.
        npg: Curves of the paper's natural policy gradient by task.
    """
    ours = {task: evaluated(task) for task in TASKS if task in baseline_tasks()}
    manifests = {task: load_baseline(task).checkpoint.manifest for task in ours}
    first = {task: read_curve(FOLDER / task / CURVE) for task in ours}
    rows = []
    for task in TASKS:
        ends = [100.0 * curve[1][-1] for curve in npg.get(task, ())]
        paper, spread = (float(np.mean(ends)), float(np.std(ends))) if ends else (None, None)
        if task not in ours:
            note = "no policy; docs/baselines.md says what was tried"
            rows.append(Merit("success, sampled actions", "%", task, (), paper, spread, note))
            continue
        manifest = manifests[task]
        note = f"{manifest['algorithm']}, {manifest['samples'] / 1e6:.2f} M samples"
        if ends:
            note += f"; the paper's after {npg[task][0][0][-1] / 1e6:.1f} M"
        for mode in MODES[::-1]:
            known = (paper, spread) if mode == "sampled" else (None, None)
            rows.append(Merit(f"success, {mode} actions", "%", task, ours[task][mode], *known, note, PERCENT))
        rows.append(
            Merit(f"samples to {100 * LEARNED:.0f} % in training", "M", task, [samples_to(first[task])])
        )
    for task, runs in natural.items():
        values = [100.0 * curve[1][-1] for curve in runs]
        rows.append(Merit("success at the end of training", "%", f"{task}, TRPO", values, within=PERCENT))
        needed = [samples_to(curve) for curve in runs]
        rows.append(Merit(f"samples to {100 * LEARNED:.0f} % in training", "M", f"{task}, TRPO", needed))
    easy, hard = ([task for task in TASKS if kind in task] for kind in (EASY, HARD))
    mean = {task: float(own["sampled"].mean()) for task, own in ours.items()}
    best = {task: float(max(own[mode].mean() for mode in MODES)) for task, own in ours.items()}
    learned = [t for t in easy if best.get(t, 0.0) >= SOLVED and manifests[t]["samples"] <= SAMPLES]
    hands = [task for task in hard if "Hand" in task]
    hardly = [task for task in hands if mean.get(task, 0.0) < HARDLY]
    pairs = [
        (samples_to(first[a]), samples_to(first[b]))
        for a, b in zip(easy, hard, strict=True)
        if a in ours and b in ours and manifests[a]["algorithm"] == manifests[b]["algorithm"]
    ]
    elbows = [runs for task, runs in natural.items() if "Elbow" in task]
    ends = [
        abs(np.mean([curve[1][-1] for curve in runs]) - first[task][1][-1])
        for task, runs in natural.items()
        if task in first
    ]
    ratios = [
        samples_to(first[task]) / np.nanmean([samples_to(curve) for curve in runs])
        for task, runs in natural.items()
        if task in first
    ]
    named = [task for task in easy if "Baoding" not in task]
    holds = {
        "easy": all(task in learned for task in named),
        "hard": len(hardly) == len(hands),
        "longer": all(not a >= b for a, b in pairs),
        "natural gradient": bool(min(c[1].max() for runs in elbows for c in runs) >= LEARNED),
        "same end": all(end < 0.1 for end in ends),
    }
    measured = {
        "easy": f"{len(learned)} of {len(named)}",
        "failed": ", ".join(task for task in named if task not in learned) or "none",
        "hands": ", ".join(f"{task} {mean[task]:.0f}" if task in mean else f"{task} -" for task in hands),
        "better": len(hands) - len(hardly),
        "number": len(hands),
        "pairs": len(pairs),
        "elbows": len(elbows),
        "trainings": sum(map(len, elbows)),
        "least": min(ratios),
        "most": max(ratios),
        "natural": len(ratios),
        "seeds": ", ".join(f"{task} {len(own['sampled'])}" for task, own in ours.items()),
        "single": sum(len(own["sampled"]) == 1 for own in ours.values()),
    }
    return Findings(rows, holds, lambda figure: draw(figure, natural, npg, first), measured, over="trainings")


def draw(
    figure: Figure,
    natural: dict[str, list[Curve]],
    npg: dict[str, list[Curve]],
    first: dict[str, Curve],
) -> None:
    """Draw success over samples, a panel for each pair of easy and hard."""
    figure.set_figheight(1.75 * len(FAMILIES) + 0.6)
    panels = figure.subplots(len(FAMILIES), 2, sharex=True, sharey=True, squeeze=False)
    for axes, task in zip(panels.flat, TASKS, strict=True):
        for name, curves, color in (("the paper's NPG", npg, "0.55"), ("TRPO", natural, "#b3362b")):
            for samples, success in curves.get(task, ()):
                axes.plot(samples / 1e6, 100.0 * success, color=color, linewidth=0.9, label=name)
        if task in first:
            samples, success = first[task]
            algorithm = load_baseline(task).checkpoint.manifest["algorithm"]
            color = COLORS[algorithm]
            axes.plot(samples / 1e6, 100.0 * success, color=color, linewidth=1.5, label=algorithm)
            for mode, filled in (("deterministic", color), ("sampled", "white")):
                values = evaluated(task)[mode]
                look: dict[str, Any] = {"mec": color, "mfc": filled, "ms": 4.5, "zorder": 5, "clip_on": False}
                label = f"{mode}, parity, each seed"
                axes.plot(np.full(len(values), samples[-1] / 1e6), values, "o", label=label, **look)
        else:
            axes.text(0.5, 0.5, "no policy", color="0.5", ha="center", transform=axes.transAxes)
        axes.set_title(task, fontsize=8)
        axes.set(xscale="log", xlim=(0.005, 30.0), ylim=(-3, 104))
    for axes in panels[:, 0]:
        axes.set_ylabel("success [%]")
    for axes in panels[-1]:
        axes.set_xlabel("samples [million]")
    handles = {
        label: h for p in panels.ravel() for h, label in zip(*p.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4)


EXPERIMENT = Experiment("baselines", run, ignores=("num_worlds", "models"))
