"""Baselines: success over samples of the tasks with fixed and random targets."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.policies.baselines import CURVE, FOLDER, baseline_tasks, load_baseline
from myowarp.apps.reports.curve import CSV
from myowarp.apps.reports.result import PERCENT, Merit
from myowarp.apps.reports.table import read_numbers
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.policies import Training
from myowarp.inks import BLUE, GREEN, ORANGE, PINK, VERMILION
from myowarp.kernels.episode import MYOSUITE

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
MODES = {"deterministic": "mean", "sampled": "drawn"}
"""Kinds of actions, as evaluations and as pages call them."""
SAMPLES, ENDING = 5_000_000, {"stop_success": 0.995}
QUICK_TASKS = ("myoElbowPose1D6MFixed-v0", "myoElbowPose1D6MRandom-v0")
COLORS = {"ppo": BLUE, "sac": GREEN, "flashsac": GREEN, "dagger": PINK, "improve": ORANGE}
"""Of lines by algorithm; `flashsac` is what versions before the trainer of our own called SAC."""
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
        runs = [lab.policy(training, seed).folder.parents[1] for seed in lab.seeds]
        found[task] = [read_curve(folder / CSV) for folder in runs]
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


@dataclass(frozen=True)
class Ours:
    """The package's policies for a task.

    Attributes:
        algorithm: By which the first seed was trained.
        samples: That it took.
        curve: Its training.
        success: Under parity by kind of actions [%], shape (seeds,).
        continued: Whether it started from another policy, whose samples are not counted.
    """

    algorithm: str
    samples: int
    curve: Curve
    success: dict[str, np.ndarray]
    continued: bool

    @property
    def how(self) -> str:
        """Algorithm and samples, for a note."""
        return f"{self.algorithm}, {self.samples / 1e6:.2f} M samples"


def of_package(task: str) -> Ours:
    """Return what the package has for a task."""
    baseline = load_baseline(task)
    manifest, evaluations = baseline.checkpoint.manifest, [run["evaluation"] for run in baseline.runs]
    return Ours(
        algorithm=manifest["algorithm"],
        samples=baseline.runs[0]["training"]["samples"],  # its best policy may be from before its end
        curve=read_curve(FOLDER / task / CURVE),
        success={mode: np.array([100.0 * e[mode][MYOSUITE] for e in evaluations]) for mode in MODES},
        continued=bool(manifest["settings"].get("parent")),
    )


def run(lab: Lab) -> Findings:
    """Read or make the curves."""
    return findings(trpo(lab), curves_of(NPG))


def findings(natural: dict[str, list[Curve]], npg: dict[str, list[Curve]]) -> Findings:
    """Return figures of merit, claims and figure.

    Args:
        natural: Curves of TRPO by task.
        npg: Curves of the paper's natural policy gradient by task.
    """
    ours = {task: of_package(task) for task in TASKS if task in baseline_tasks()}
    easy, hard = ([task for task in TASKS if kind in task] for kind in (EASY, HARD))
    mean = {task: float(own.success["sampled"].mean()) for task, own in ours.items()}
    best = {task: float(max(values.mean() for values in own.success.values())) for task, own in ours.items()}
    learned = [t for t in easy if best.get(t, 0.0) >= SOLVED and ours[t].samples <= SAMPLES]
    hands = [task for task in hard if "Hand" in task]
    hardly = [task for task in hands if mean.get(task, 0.0) < HARDLY]
    pairs = [
        (samples_to(ours[a].curve), samples_to(ours[b].curve))
        for a, b in zip(easy, hard, strict=True)
        if a in ours and b in ours and ours[a].algorithm == ours[b].algorithm and not ours[b].continued
    ]
    elbows = [runs for task, runs in natural.items() if "Elbow" in task]
    both = {task: (runs, ours[task].curve) for task, runs in natural.items() if task in ours}
    apart = [abs(np.mean([c[1][-1] for c in runs]) - own[1][-1]) for runs, own in both.values()]
    ratios = [samples_to(own) / np.nanmean([samples_to(c) for c in runs]) for runs, own in both.values()]
    named = [task for task in easy if "Baoding" not in task]
    holds = {
        "easy": all(task in learned for task in named),
        "hard": len(hardly) == len(hands),
        "longer": all(not a >= b for a, b in pairs),
        "natural gradient": bool(min(c[1].max() for runs in elbows for c in runs) >= LEARNED),
        "same end": all(end < 0.1 for end in apart),
    }
    seeds = {task: len(own.success["sampled"]) for task, own in ours.items()}
    measured = {
        "easy": f"{len(learned)} of {len(named)}",
        "failed": ", ".join(task for task in named if task not in learned) or "none",
        "hands": ", ".join(f"{task} {mean[task]:.0f}" if task in mean else f"{task} -" for task in hands),
        "better": len(hands) - len(hardly),
        "number": len(hands),
        "pairs": len(pairs),
        "continued": ", ".join(task for task, own in ours.items() if own.continued) or "none",
        "elbows": len(elbows),
        "trainings": sum(map(len, elbows)),
        "least": min(ratios),
        "most": max(ratios),
        "natural": len(ratios),
        "seeds": ", ".join(f"{task} {number}" for task, number in seeds.items()),
        "single": sum(number == 1 for number in seeds.values()),
    }
    rows = success_merits(ours, natural, npg)
    return Findings(rows, holds, lambda figure: draw(figure, natural, npg, ours), measured, over="trainings")


def success_merits(
    ours: dict[str, Ours], natural: dict[str, list[Curve]], npg: dict[str, list[Curve]]
) -> list[Merit]:
    """Return rows of success and of samples to it: ours beside the paper's, then TRPO's."""
    rows, needed = [], f"samples to {100 * LEARNED:.0f} % in training"
    for task in TASKS:
        ends = [100.0 * curve[1][-1] for curve in npg.get(task, ())]
        paper, spread = (float(np.mean(ends)), float(np.std(ends))) if ends else (None, None)
        if (own := ours.get(task)) is None:
            note = "no policy; docs/baselines.md says what was tried"
            rows.append(Merit(f"success, {MODES['sampled']} actions", "%", task, (), paper, spread, note))
            continue
        note = own.how + (f"; the paper's after {npg[task][0][0][-1] / 1e6:.1f} M" if ends else "")
        for mode in reversed(MODES):
            known = (paper, spread) if mode == "sampled" else (None, None)
            rows.append(
                Merit(f"success, {MODES[mode]} actions", "%", task, own.success[mode], *known, note, PERCENT)
            )
        rows.append(Merit(needed, "M", task, [samples_to(own.curve)]))
    for task, runs in natural.items():
        values, who = [100.0 * curve[1][-1] for curve in runs], f"{task}, TRPO"
        rows.append(Merit("success at the end of training", "%", who, values, within=PERCENT))
        rows.append(Merit(needed, "M", who, [samples_to(curve) for curve in runs]))
    return rows


def draw(
    figure: Figure,
    natural: dict[str, list[Curve]],
    npg: dict[str, list[Curve]],
    ours: dict[str, Ours],
) -> None:
    """Draw success over samples, a panel for each pair of easy and hard."""
    figure.set_figheight(1.75 * len(FAMILIES) + 0.6)
    panels = figure.subplots(len(FAMILIES), 2, sharex=True, sharey=True, squeeze=False)
    for axes, task in zip(panels.flat, TASKS, strict=True):
        for name, curves, color in (("the paper's NPG", npg, "0.55"), ("TRPO", natural, VERMILION)):
            for samples, success in curves.get(task, ()):
                axes.plot(samples / 1e6, 100.0 * success, color=color, linewidth=0.9, label=name)
        if (own := ours.get(task)) is not None:
            samples, success = own.curve
            color = COLORS[own.algorithm]
            axes.plot(samples / 1e6, 100.0 * success, color=color, linewidth=1.5, label=own.algorithm)
            for mode, filled in (("deterministic", color), ("sampled", "white")):
                values = own.success[mode]
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
