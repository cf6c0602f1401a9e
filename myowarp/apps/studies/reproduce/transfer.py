"""Tendon transfer: EIP takes the place of a lost EPL in a hand that learned to turn a key."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import POSITIVE, both, merits, rises, stays
from myowarp.apps.studies.reproduce import key
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.policies import Training
from myowarp.definitions.condition import Condition
from myowarp.models.conditions import Reafferentation, TendonTear, TendonTransfer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = ("EPL", "EIP", "EPB", "FPL")
LEAST = 0.05  # of an activation: a muscle that stays below is not recruited
FAILS = 20.0  # points of success: a smaller loss is none
GAIN = 10.0  # deg
RETRAINING = {  # half of the noise, so that what is learned holds without it
    "num_worlds": 64,
    "rollout_steps": 50,
    "value_first": 5,
    "initial_std": 0.25,
    "kl": 5e-4,  # of each of the hand's 39 actions
}
TRANSFER = Training(
    "key_turn_transfer", key.TASK, lambda: (TendonTransfer(),), 112_000, RETRAINING, parent=key.INTACT
)
REDIRECT = Training(
    "key_turn_redirect", key.TASK, lambda: (Reafferentation(),), 76_800, RETRAINING, parent=key.INTACT
)
RETRAINED = ", retrained"
BEFORE = ("intact", "EPL torn", "transfer", "redirected")
AFTER = ("transfer" + RETRAINED, "redirected" + RETRAINED)
GROUPS = (*BEFORE, *AFTER)


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    lab.expect(2 * len(lab.seeds))
    turns, samples = [], []
    for seed in lab.seeds:
        samples.append(lab.policy(key.INTACT, seed).manifest["samples"])
        before = [lab.policy(key.INTACT, seed)] * len(BEFORE)
        after = [lab.policy(training, seed) for training in (TRANSFER, REDIRECT)]
        first = key.turn(lab, "before", seed, BEFORE, before, untrained)
        turns.append(first.beside(key.turn(lab, "after", seed, AFTER, after, retrained)))
    return findings(turns, samples)


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
    """Return when the muscles `SHOWN` are recruited [s], NaN if never, with the policy's means."""
    course = turns.mean_activation[:, group][:, [turns.of(muscle) for muscle in SHOWN]]
    most = np.nanmax(course, axis=0)
    reached = course >= 0.5 * most
    return np.where(most >= LEAST, key.CONTROL_DT * (1.0 + reached.argmax(axis=0)), np.nan)


def exchanged(first: np.ndarray, second: np.ndarray) -> int:
    """Return how many pairs of muscles that both recruit are recruited in another order."""
    signs = (
        (np.sign(first[i] - first[j]), np.sign(second[i] - second[j]))
        for i, j in combinations(range(len(first)), 2)
    )
    return sum(bool(a != b) for a, b in signs if np.isfinite(a + b))


def burst(turns: key.Turns) -> np.ndarray:
    """Return the mean activation of FPL while the key turns, 0.4 to 1 s, mean actions, shape (G,)."""
    steps = slice(int(0.4 / key.CONTROL_DT), int(1.0 / key.CONTROL_DT))
    return np.nanmean(turns.mean_activation[steps, :, turns.of("FPL")], axis=0)


def order(turns: key.Turns, group: int) -> str:
    """Return the muscles in the order of their recruitment."""
    times = recruited(turns, group)
    return ", ".join(f"{SHOWN[i]} {times[i]:.2f}" for i in np.argsort(times) if np.isfinite(times[i]))


def findings(turns: list[key.Turns], samples: list[int]) -> Findings:
    """Return figures of merit, claims and figure; `samples` are those of the intact policies."""
    swaps = np.array(
        [[exchanged(recruited(t, 0), recruited(t, g)) for g in range(len(GROUPS))] for t in turns]
    )
    bursts = np.array([burst(t) for t in turns])
    rows = key.turn_merits(turns, GROUPS) + key.change_merits(turns, GROUPS)
    rows += merits(GROUPS, ("activation of FPL, 0.4 to 1 s, mean actions", "1", bursts.T), within=POSITIVE)
    what = "pairs of muscles recruited in another order"
    rows += merits(GROUPS[1:], (what, "of 6", swaps[:, 1:].T), within=(0.0, 6.0))
    meant = dict(zip(GROUPS, key.rotations(turns)[1].T, strict=True))
    success = dict(zip(GROUPS, key.success(turns)[:, 1].T, strict=True))
    fpl = dict(zip(GROUPS, bursts.T, strict=True))

    def fails(name: str) -> bool | None:
        return both(rises(success["intact"] - success[name] - FAILS), rises(key.THRESHOLDS[0] - meant[name]))

    def restored(name: str) -> bool | None:
        again = name + RETRAINED
        return both(rises(success[again] - success[name]), stays(success["intact"] - success[again], FAILS))

    holds = {
        "transfer": fails("transfer"),
        "order": rises(swaps[:, GROUPS.index("transfer")] - 0.5),
        "retrained": restored("transfer"),
        "redirected": fails("redirected"),
        "order redirected": rises(swaps[:, GROUPS.index("redirected")] - 0.5),
        "redirected, retrained": restored("redirected"),
        "with means": rises(key.THRESHOLDS[0] - meant["transfer"]),
        "burst": both(
            rises(0.5 * fpl["intact"] - fpl["transfer"]),
            rises(fpl["transfer" + RETRAINED] - 0.8 * fpl["intact"]),
        ),
        "surgery": rises(GAIN - np.abs(meant["transfer"] - meant["EPL torn"])),
    }
    eip = np.array([np.nanmean(t.mean_activation[..., t.of("EIP")], axis=0) for t in turns]).mean(axis=0)
    measured = {
        "number": len(turns),
        "stuck": [int((values < key.THRESHOLDS[0]).sum()) for values in meant.values()],
        "meant": [values.mean() for values in meant.values()],
        "success": [values.mean() for values in success.values()],
        "eip": eip,
        "share": 100.0 * TRANSFER.samples / np.mean(samples),
        "samples": (TRANSFER.samples, REDIRECT.samples),
        "lines": "\n".join(
            f"* {name}: " + "; ".join(order(t, g) for t in turns) for g, name in enumerate(GROUPS)
        ),
    }
    return Findings(rows, holds, lambda figure: draw(figure, turns), measured)


def draw(figure: Figure, turns: list[key.Turns]) -> None:
    """Draw rotations, and the courses of the four muscles."""
    figure.set_figheight(7.0)
    parts = figure.add_gridspec(2, 1, height_ratios=(1.1, 1.6))
    axes = figure.add_subplot(parts[0])
    key.draw_rotations(axes, turns, [name.replace(", ", ",\n") for name in GROUPS])
    axes.set_title("Greatest angle of the key")
    time = key.CONTROL_DT * np.arange(1, key.HORIZON + 1)
    below: Any = parts[1].subgridspec(2, 3).subplots(sharex=True, sharey=True)
    for g, axes in enumerate(below.ravel()):
        for muscle, color in zip(SHOWN, key.COLORS[1:], strict=False):
            lines = panel.extent(key.courses(turns, muscle)[:, :, g])
            panel.band(axes, time, lines, color=color, alpha=0.12, label=muscle)
        axes.set(title=GROUPS[g], xlim=(0, 2.0), ylim=(0, 1))
    below[0, 2].legend(loc="upper right")
    for axes in below[-1]:
        axes.set_xlabel("time [s]")
    for axes in below[:, 0]:
        axes.set_ylabel("activation")


EXPERIMENT = Experiment("transfer", run)
