"""Exoskeleton I: an arm lifts 0, 1 and 2 kg, with and without a powered brace that follows its muscles.

Paper: a policy of muscles and exoskeleton together is trained without load, with targets of 0 to 130 degrees.
It flexes and extends the elbow between 0 and 30, 60 and 80 degrees, holds each for 2 s, with 0, 1 and 2 kg in
the hand, with and without assistance.

Open in the paper, and chosen here:

* Assistance. The torque is "a percentage" of the muscles' torque, which is not given. We take 100 %: a hold
  then costs the muscles half of their torque, 1 - 1 / (1 + a), and the paper's changes of force lie on both
  sides of one half (-34 to -67 %). 50 % and 200 % are run beside it.
* Without assistance the brace is off the arm: no torque, no 0.111 kg. The policy is the same.
* Order: 0, 30, 0, 60, 0, 80 degrees, 2 s each, from a random angle.
* Error: mean of |angle - target| over the last second of every hold; the arm gets there within the first.
  Over the whole 2 s it is in the table, too.
* Change: mean activation and force over the last second at 30, 60 and 80 degrees, with over without.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.studies.reproduce.arm import (
    ASSISTANCE,
    ASSISTED,
    CONTROL_DT,
    FLEXORS,
    late,
    run_groups,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Lab
from myowarp.apps.studies.reproduce.result import Claim, Findings, Merit
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
    means = result[quantity][window].mean(axis=0)[:, 3:]
    return 100.0 * (means[GROUPS.index((load, assistance))] / means[GROUPS.index((load, 0.0))] - 1.0)


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    window = late(len(ANGLES), HOLD, SETTLED)
    errors = np.array([result["error"][window].mean(axis=0) for result in results])
    whole = np.array([result["error"].mean(axis=0) for result in results])
    merits = []
    for g, (load, a) in enumerate(GROUPS[:6]):
        paper, spread = PAPER_ERROR[load] if a else (None, None)
        who = f"{load:.0f} kg, {'with' if a else 'without'} assistance"
        merits.append(Merit("error of the elbow angle", "°", who, tuple(errors[:, g]), paper, spread))
        if a:
            what, note = "error over the whole 2 s", "the movements are in it"
            merits.append(Merit(what, "°", who, tuple(whole[:, g]), paper, spread, note))
    changes = {q: np.array([change(r, q, 2.0, ASSISTANCE) for r in results]) for q in PAPER_CHANGE}
    for quantity, values in changes.items():
        for m, muscle in enumerate(FLEXORS):
            what = f"change of {quantity}, {muscle}"
            merits.append(Merit(what, "%", "2 kg", tuple(values[:, m]), PAPER_CHANGE[quantity][m]))
    for a in (0.5, 1.0, 2.0):
        forces = tuple(float(change(r, "force", 2.0, a).mean()) for r in results)
        ideal = -100.0 * a / (1.0 + a)
        note = f"the muscles' part of the holding torque changes by {ideal:.0f} %"
        merits.append(
            Merit(
                "change of force, mean of the flexors",
                "%",
                f"2 kg, assistance {a:g}",
                forces,
                None,
                None,
                note,
            )
        )
    lower = all((values < 0.0).all() for values in changes.values())
    others = np.array([[change(r, "activation", 2.0, a) for a in (0.5, 2.0)] for r in results])
    claims = (
        Claim("Assistance lowers activation and force of every flexor at 2 kg, in every seed.", lower),
        Claim(
            "So does an assistance of 50 % and of 200 %: the choice does not carry the conclusion.",
            bool((others < 0.0).all()),
        ),
        Claim(
            "The error with assistance is within the paper's spread for every load, in the last second.",
            within_spread(errors),
        ),
        Claim(
            "It is within the paper's spread for every load over the whole 2 s.",
            within_spread(whole),
        ),
        Claim(
            "The error with assistance does not grow with the load.",
            bool(errors[:, 5].mean() <= errors[:, 1].mean() + 0.5),
            "Half a degree is allowed for.",
        ),
        Claim(
            "Assistance lowers the error under 2 kg.",
            bool(errors[:, 5].mean() < errors[:, 4].mean()),
        ),
    )
    return Findings(tuple(merits), claims, TEXT, lambda figure: draw(figure, results, changes))


def within_spread(errors: np.ndarray) -> bool:
    """Return whether errors with assistance, (seeds, groups), are the paper's within its ±, on average."""
    means = [errors[:, GROUPS.index((load, ASSISTANCE))].mean() for load in LOADS]
    return all(abs(own - paper) <= sd for own, (paper, sd) in zip(means, PAPER_ERROR.values(), strict=True))


TEXT = """
**Errors.** The paper does not say which part of a hold its error is taken from. Ours in the last second is
what is left once the arm is still; over the whole 2 s it has the movement in it, and is close to the
paper's. Three of the six holds are at 0°, where the joint's stop carries the arm and the error is nil.

**Error and load.** The paper's error falls a little with the load, by a fifth of its own spread; ours
grows. The policy sees the error, but no load, and was trained without one: like a spring it stops short of
the target by more, the more hangs on it. Assistance multiplies its torque by 1 + a, so that the arm stops
shorter by about half as much.

**Changes.** An assistance of 100 % halves the torque that muscles must make for a given hold, cuff aside.
That a single flexor differs from one half has two reasons, which the seeds show: the arm is held closer to
its target, where other flexors are used, and three flexors share one joint in ways that the reward hardly
tells apart. The means of the three flexors follow the share a / (1 + a) of the assistance, and fall behind
it, as part of what flexors do is against the passive pull of the triceps (exo2). The paper's 54 to 67 % are
nearest to ours with an assistance of 200 %.
"""


def draw(figure: Figure, results: list[dict[str, np.ndarray]], changes: dict[str, np.ndarray]) -> None:
    """Draw angle and activation over time at 2 kg, and the changes beside the paper's."""
    figure.set_size_inches(8.0, 6.2)
    axes = figure.subplots(2, 2)
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    looks = (((2.0, 0.0), "without", "#d9622b"), ((2.0, ASSISTANCE), "with", "#2f6fb5"))
    axes[0, 0].plot(time, results[0]["target"][:, 0], color="0.6", linestyle="--", label="target")
    for group, label, color in looks:
        g = GROUPS.index(group)
        angle = np.array([result["angle"][:, g] for result in results])
        effort = np.array([result["activation"][:, g, 3:].mean(axis=1) for result in results])
        axes[0, 0].plot(time, angle.mean(axis=0), color=color, label=f"{label} assistance")
        axes[0, 0].fill_between(
            time, angle.min(axis=0), angle.max(axis=0), color=color, alpha=0.2, linewidth=0
        )
        axes[0, 1].plot(time, effort.mean(axis=0), color=color, label=f"{label} assistance")
        axes[0, 1].fill_between(
            time, effort.min(axis=0), effort.max(axis=0), color=color, alpha=0.2, linewidth=0
        )
    axes[0, 0].set(title="2 kg: elbow angle", xlabel="time [s]", ylabel="angle [°]")
    axes[0, 1].set(title="2 kg: mean activation of the flexors", xlabel="time [s]", ylabel="activation")
    axes[0, 0].legend(loc="upper left")
    axes[0, 1].legend(loc="upper left")
    for panel, (quantity, values) in zip(axes[1], changes.items(), strict=True):
        places = np.arange(len(FLEXORS))
        panel.bar(places - 0.2, PAPER_CHANGE[quantity], 0.36, color="0.75", label="paper")
        panel.bar(places + 0.2, values.mean(axis=0), 0.36, color="#2f6fb5", label="ours, assistance 100 %")
        panel.plot(np.repeat(places + 0.2, len(values)), values.T.ravel(), "k.", markersize=4, label="seeds")
        panel.axhline(-50.0, color="k", linewidth=0.8, linestyle=":", label="half, an ideal hold")
        panel.set_xticks(places, FLEXORS)
        panel.set(title=f"2 kg: change of {quantity}", ylabel="%")
        panel.set_ylim(min(-100.0, 1.05 * values.min()), 5.0)
    axes[1, 0].legend(loc="lower left", fontsize=7)


EXPERIMENT = Experiment(
    "exo1",
    "Exoskeleton I: lifting 0, 1 and 2 kg with and without assistance",
    "error with assistance 4.95 ± 3.42, 4.54 ± 3.12 and 4.34 ± 3.43° at 0, 1 and 2 kg; at 2 kg activation "
    "falls by 60, 54 and 66 % and force by 60, 58 and 67 % (BIClong, BICshort, BRA).",
    run,
)
