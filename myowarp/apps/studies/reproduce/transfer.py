"""Tendon transfer: EIP takes the place of a lost EPL in a hand that learned to turn a key."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports.result import merits
from myowarp.apps.studies.reproduce import key
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.policies import Training
from myowarp.definitions.condition import Condition
from myowarp.models.conditions import Reafferentation, TendonTear, TendonTransfer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = ("EPL", "EIP", "EPB", "FPL")
RETRAINING = {  # half of the noise, so that what is learned holds without it
    "num_worlds": 64,
    "rollout_steps": 50,
    "value_first": 5,
    "parent_samples": key.INTACT.samples,
    "initial_std": 0.25,
    "kl": 0.02,
}
TRANSFER = Training(
    "key_turn_transfer", key.TASK, lambda: (TendonTransfer(),), 112_000, RETRAINING, parent=key.INTACT
)
REDIRECT = Training(
    "key_turn_redirect", key.TASK, lambda: (Reafferentation(),), 76_800, RETRAINING, parent=key.INTACT
)
BEFORE = ("intact", "EPL torn", "transfer", "redirected")
AFTER = ("transfer, retrained", "redirected, retrained")
GROUPS = (*BEFORE, *AFTER)


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    lab.expect(2 * len(lab.seeds))
    turns = []
    for seed in lab.seeds:
        first = key.turn(lab, "before", seed, BEFORE, [key.intact(lab, seed)] * len(BEFORE), untrained)
        policies = [lab.policy(training, seed if lab.retrain else 0) for training in (TRANSFER, REDIRECT)]
        turns.append(first.beside(key.turn(lab, "after", seed, AFTER, policies, retrained)))
    return findings(turns)


def untrained(of: Callable[[str], np.ndarray]) -> list[Condition]:
    """Return who has what without retraining."""
    return [
        TendonTear(muscles="EPL", transmission=1.0 - of("EPL torn")),
        TendonTransfer(of("transfer")),
        Reafferentation(of("redirected")),
    ]


def retrained(of: Callable[[str], np.ndarray]) -> list[Condition]:
    """Return who has what with retraining."""
    return [TendonTransfer(of("transfer, retrained")), Reafferentation(of("redirected, retrained"))]


def recruited(turns: key.Turns, group: int) -> np.ndarray:
    """Return when the muscles `SHOWN` are recruited [s], with the policy's means."""
    course = turns.mean_activation[:, group][:, [turns.of(muscle) for muscle in SHOWN]]
    reached = course >= 0.5 * np.nanmax(course, axis=0)
    return key.CONTROL_DT * (1.0 + reached.argmax(axis=0))


def exchanged(first: np.ndarray, second: np.ndarray) -> int:
    """Return how many pairs of muscles are recruited in another order."""
    pairs = combinations(range(len(first)), 2)
    return sum(int(np.sign(first[i] - first[j]) != np.sign(second[i] - second[j])) for i, j in pairs)


def burst(turns: key.Turns) -> np.ndarray:
    """Return the mean activation of FPL while the key turns, 0.4 to 1 s, mean actions, shape (G,)."""
    steps = slice(int(0.4 / key.CONTROL_DT), int(1.0 / key.CONTROL_DT))
    return np.nanmean(turns.mean_activation[steps, :, turns.of("FPL")], axis=0)


def order(turns: key.Turns, group: int) -> str:
    """Return the muscles in the order of their recruitment."""
    times = recruited(turns, group)
    return ", ".join(f"{SHOWN[i]} {times[i]:.2f}" for i in np.argsort(times, kind="stable"))


def findings(turns: list[key.Turns]) -> Findings:
    """Return figures of merit, claims and figure."""
    swaps = np.array(
        [[exchanged(recruited(t, 0), recruited(t, g)) for g in range(len(GROUPS))] for t in turns]
    )
    bursts = np.array([burst(t) for t in turns])
    rows = key.turn_merits(turns, GROUPS, ", drawn actions")
    rows += merits(GROUPS, ("activation of FPL, 0.4 to 1 s, mean actions", "1", key.distinct(bursts)))
    what = "pairs of muscles recruited in another order"
    rows += merits(GROUPS[1:], (what, "of 6", key.distinct(swaps[:, 1:])))
    meant = dict(zip(GROUPS, key.rotations(turns)[1].mean(axis=0), strict=True))
    fpl, swapped = bursts.mean(axis=0), swaps.mean(axis=0)
    holds = {
        "transfer": meant["transfer"] < key.THRESHOLDS[0],
        "redirected": meant["redirected"] < key.THRESHOLDS[0],
        "order redirected": swapped[3] > 0,
        "order": swapped[2] > 0,
        "burst": fpl[2] < 0.5 * fpl[0] and fpl[4] > 0.8 * fpl[0],
        "retrained": meant["transfer, retrained"] > key.THRESHOLDS[1],
        "redirected, retrained": meant["redirected, retrained"] > key.THRESHOLDS[1],
        "surgery": abs(meant["transfer"] - meant["EPL torn"]) < 10.0,
    }
    measured = {
        "rotation": ", ".join(f"{name} {angle:.0f}°" for name, angle in meant.items()),
        "success": key.success(turns).mean(axis=0)[1],
        "eip": np.nanmean(turns[0].mean_activation[..., turns[0].of("EIP")], axis=0),
        "lines": "\n".join(f"* {name}: {order(turns[0], g)}" for g, name in enumerate(GROUPS)),
    }
    return Findings(rows, holds, lambda figure: draw(figure, turns), measured)


def draw(figure: Figure, turns: list[key.Turns]) -> None:
    """Draw rotations, and the courses of the four muscles."""
    figure.set_figheight(7.0)
    parts = figure.add_gridspec(2, 1, height_ratios=(1.1, 1.6))
    axes = figure.add_subplot(parts[0])
    key.draw_rotations(axes, turns, [name.replace(", ", ",\n") for name in GROUPS], 40)
    axes.set_title("Greatest angle of the key; dots: drawn actions, bar: mean actions")
    time = key.CONTROL_DT * np.arange(1, key.HORIZON + 1)
    below: Any = parts[1].subgridspec(2, 3).subplots(sharex=True, sharey=True)
    for g, panel in enumerate(below.ravel()):
        for i, (muscle, color) in enumerate(zip(SHOWN, key.COLORS[1:], strict=False)):
            panel.plot(time, key.course(turns, muscle)[:, g], color=color, label=muscle)
            begin = np.mean([recruited(t, g)[i] for t in turns])
            panel.axvline(begin, color=color, linewidth=0.8, ls=":")
        panel.set(title=GROUPS[g], xlim=(0, 2.0), ylim=(0, 1))
    below[0, 2].legend(loc="upper right")
    for panel in below[-1]:
        panel.set_xlabel("time [s]")
    for panel in below[:, 0]:
        panel.set_ylabel("activation")


EXPERIMENT = Experiment("transfer", run)
