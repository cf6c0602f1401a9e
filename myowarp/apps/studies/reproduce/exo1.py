"""Exoskeleton I: an arm lifts 0, 1 and 2 kg, with and without a powered brace that follows its muscles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import Merit
from myowarp.apps.studies.reproduce.arm import ASSISTANCE, ASSISTED, CONTROL_DT, FLEXORS, late, run_groups
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.models.conditions import Exoskeleton, Load

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CUFF = 0.111  # kg
LOADS = (0.0, 1.0, 2.0)  # kg
ANGLES = (0.0, 30.0, 0.0, 60.0, 0.0, 80.0)  # deg
HOLD, SETTLED = 2.0, 1.0  # s
GROUPS = (*((load, a) for load in LOADS for a in (0.0, ASSISTANCE)), (2.0, 0.5), (2.0, 2.0))
"""Load [kg] and assistance [1] of each group of worlds."""

PAPER_ERROR = {0.0: (4.95, 3.42), 1.0: (4.54, 3.12), 2.0: (4.34, 3.43)}  # deg
PAPER_CHANGE = {"activation": (-60.0, -54.0, -66.0), "force": (-60.0, -58.0, -67.0)}  # %, by flexor, 2 kg


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    load, assistance = (np.repeat(values, lab.num_worlds) for values in zip(*GROUPS, strict=True))
    mass = np.where(assistance > 0.0, CUFF, 0.0)
    conditions = Load(load), Exoskeleton(assistance, forearm_mass=mass)
    trainings = (ASSISTED,) * len(GROUPS)
    targets = np.array(ANGLES)[:, None]
    results = run_groups(lab, "lift", GROUPS, trainings, lambda: conditions, targets, HOLD)
    return findings(results)


def change(result: dict[str, np.ndarray], quantity: str, load: float, assistance: float) -> np.ndarray:
    """Return by how much assistance changes the flexors' activation or force [%], shape (3,)."""
    window = late(len(ANGLES), HOLD, SETTLED) & (result["target"][:, 0] > 1.0)
    means = result[quantity][window].mean(axis=0)
    return relative_change(means, GROUPS.index((load, assistance)), GROUPS.index((load, 0.0)))


def relative_change(means: np.ndarray, one: int, other: int) -> np.ndarray:
    """Return by how much the flexors' means of one group are above another's [%], of means (groups, 6)."""
    return 100.0 * (means[one, 3:] / means[other, 3:] - 1.0)


def assisted(arm: str, assistance: float) -> str:
    """Return an arm's condition."""
    return f"{arm}, {'with' if assistance else 'without'} assistance"


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    window = late(len(ANGLES), HOLD, SETTLED)
    errors = np.array([result["error"][window].mean(axis=0) for result in results])
    whole = np.array([result["error"].mean(axis=0) for result in results])
    rows = []
    for g, (load, a) in enumerate(GROUPS[:6]):
        paper, spread = PAPER_ERROR[load] if a else (None, None)
        who = assisted(f"{load:.0f} kg", a)
        rows.append(Merit("error of the elbow angle", "°", who, errors[:, g], paper, spread))
        if a:
            note = "the movements are in it"
            rows.append(Merit("error over the whole 2 s", "°", who, whole[:, g], paper, spread, note))
    changes = {q: np.array([change(r, q, 2.0, ASSISTANCE) for r in results]) for q in PAPER_CHANGE}
    for quantity, values in changes.items():
        for muscle, own, known in zip(FLEXORS, values.T, PAPER_CHANGE[quantity], strict=True):
            rows.append(Merit(f"change of {quantity}, {muscle}", "%", "2 kg", own, known))
    for a in (0.5, 1.0, 2.0):
        forces = [change(r, "force", 2.0, a).mean() for r in results]
        note = f"the muscles' part of the holding torque changes by {-100.0 * a / (1.0 + a):.0f} %"
        what, who = "change of force, mean of the flexors", f"2 kg, assistance {a:g}"
        rows.append(Merit(what, "%", who, forces, note=note))
    others = np.array([[change(r, "activation", 2.0, a) for a in (0.5, 2.0)] for r in results])
    holds = {
        "relieved": all((values < 0.0).all() for values in changes.values()),
        "any level": (others < 0.0).all(),
        "error late": within_spread(errors),
        "error": within_spread(whole),
        "error and load": errors[:, 5].mean() <= errors[:, 1].mean() + 0.5,
        "error relieved": errors[:, 5].mean() < errors[:, 4].mean(),
    }
    return Findings(rows, holds, lambda figure: draw(figure, results, changes))


def within_spread(errors: np.ndarray) -> bool:
    """Return whether errors with assistance, (seeds, groups), are the paper's within its ±, on average."""
    means = [errors[:, GROUPS.index((load, ASSISTANCE))].mean() for load in LOADS]
    return all(abs(own - paper) <= sd for own, (paper, sd) in zip(means, PAPER_ERROR.values(), strict=True))


def draw(figure: Figure, results: list[dict[str, np.ndarray]], changes: dict[str, np.ndarray]) -> None:
    """Draw angle and activation over time at 2 kg, and the changes beside the paper's."""
    figure.set_size_inches(8.0, 6.2)
    (angles, efforts), below = figure.subplots(2, 2)
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    angles.plot(time, results[0]["target"][:, 0], color="0.6", linestyle="--", label="target")
    for a, label, color in ((0.0, "without", "#d9622b"), (ASSISTANCE, "with", "#2f6fb5")):
        g = GROUPS.index((2.0, a))
        angle = panel.extent([result["angle"][:, g] for result in results])
        effort = panel.extent([result["activation"][:, g, 3:].mean(axis=1) for result in results])
        panel.band(angles, time, angle, color=color, label=f"{label} assistance")
        panel.band(efforts, time, effort, color=color, label=f"{label} assistance")
    angles.set(title="2 kg: elbow angle", xlabel="time [s]", ylabel="angle [°]")
    efforts.set(title="2 kg: mean activation of the flexors", xlabel="time [s]", ylabel="activation")
    angles.legend(loc="upper left")
    efforts.legend(loc="upper left")
    places, look = np.arange(len(FLEXORS)), {"color": "#2f6fb5", "label": "ours, assistance 100 %"}
    for axes, (quantity, values) in zip(below, changes.items(), strict=True):
        axes.bar(places - 0.2, PAPER_CHANGE[quantity], 0.36, color="0.75", label="paper")
        panel.bars(axes, places + 0.2, values, 0.36, "seeds", **look)
        axes.axhline(-50.0, color="k", linewidth=0.8, linestyle=":", label="half, an ideal hold")
        axes.set_xticks(places, FLEXORS)
        axes.set(
            title=f"2 kg: change of {quantity}", ylabel="%", ylim=(min(-100.0, 1.05 * values.min()), 5.0)
        )
    below[0].legend(loc="lower left", fontsize=7)


EXPERIMENT = Experiment("exo1", run)
