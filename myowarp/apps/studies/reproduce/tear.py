"""Tendon tears: a hand that learned to turn a key loses one muscle of its thumb."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.reports.intervals import student
from myowarp.apps.reports.result import merits
from myowarp.apps.studies.reproduce import key
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.models.conditions import TendonTear

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TORN = ("FPL", "OP", "EPB", "APL")
GROUPS = ("intact", *TORN)
CRITICAL, SPARED = ("FPL", "OP"), ("EPB", "APL")


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    lab.expect(len(lab.seeds))
    turns = []
    for seed in lab.seeds:
        policy = key.intact(lab, seed)
        turns.append(
            key.turn(
                lab,
                "turn",
                seed,
                GROUPS,
                [policy] * len(GROUPS),
                lambda of: [TendonTear(muscles=name, transmission=1.0 - of(name)) for name in TORN],
            )
        )
    return findings(turns)


def findings(turns: list[key.Turns]) -> Findings:
    """Return figures of merit, claims and figure."""
    who = ["all muscles", *(f"without {name}" for name in TORN)]
    rows = key.turn_merits(turns, who)
    for muscle in CRITICAL:
        own = key.distinct(effort(turns, muscle))
        kept = [g for g, name in enumerate(GROUPS) if name != muscle]
        rows += merits(
            [who[g] for g in kept], (f"activation of {muscle}, mean actions", "1", [own[g] for g in kept])
        )
    drawn, meant = map(by_group, key.rotations(turns))
    fpl, op = (by_group(effort(turns, muscle)) for muscle in CRITICAL)
    holds = {
        "critical": all(
            angle[name] < min(angle[other] for other in SPARED)
            for angle in (drawn, meant)
            for name in CRITICAL
        ),
        "spared": all(min(drawn[name], meant[name]) > key.THRESHOLDS[1] for name in SPARED),
        "unmoved": all(abs(a[name] - a["intact"]) < 0.05 for a in (fpl, op) for name in SPARED),
        "caption, FPL": meant["FPL"] > key.THRESHOLDS[0] and op["FPL"] > 0.5 * op["intact"],
        "caption, OP": meant["OP"] < meant["intact"] and fpl["OP"] < 0.5 * fpl["intact"],
        "exchanged": meant["OP"] > key.THRESHOLDS[0] > meant["FPL"] and fpl["OP"] > 0.5 * fpl["intact"],
    }
    angles = np.concatenate([t.rotation[GROUPS.index("FPL")] for t in turns])
    measured = {
        "meant": meant,
        "rotation": ", ".join(f"{name} {angle:.0f}°" for name, angle in meant.items()),
        "fpl": fpl,
        "op": op,
        "success": by_group(key.success(turns)[:, 1]),
        "slipped": 100.0 * (angles < 90.0).mean(),
    }
    return Findings(rows, holds, lambda figure: draw(figure, turns), measured)


def by_group(values: np.ndarray) -> dict[str, float]:
    """Return means over seeds by group, of values (seeds, groups)."""
    return dict(zip(GROUPS, values.mean(axis=0), strict=True))


def effort(turns: list[key.Turns], muscle: str) -> np.ndarray:
    """Return a muscle's mean activation, shape (seeds, groups); mean actions, which no noise lifts."""
    return np.array([np.nanmean(t.mean_activation[:, :, t.of(muscle)], axis=0) for t in turns])


def draw(figure: Figure, turns: list[key.Turns]) -> None:
    """Draw success, distribution of rotations, and the courses of FPL and OP."""
    figure.set_figheight(6.0)
    (shares, angles), bottom = figure.subplots(2, 2)
    place, names = np.arange(len(GROUPS)), ["intact", *(f"no {name}" for name in TORN)]
    for i, (threshold, color) in enumerate(zip(key.THRESHOLDS, ("#9ab8cc", key.COLORS[3]), strict=True)):
        own, at = key.success(turns)[:, i], place + 0.2 * (2 * i - 1)
        mean = own.mean(axis=0)
        half = np.nan_to_num(student(own)[1] - mean)
        shares.bar(at, mean, 0.36, yerr=half, color=color, label=f"{threshold:.0f}°")
    shares.set(title="Success with drawn actions", ylabel="episodes [%]", ylim=(0, 105))
    shares.legend(title="key beyond", loc="center", bbox_to_anchor=(0.3, 0.6))
    shares.set_xticks(place, names)
    key.draw_rotations(angles, turns, names, 26)
    angles.set_title("Greatest angle of the key; bar: mean actions")
    time = key.CONTROL_DT * np.arange(1, key.HORIZON + 1)
    for axes, muscle in zip(bottom, CRITICAL, strict=True):
        for g, line in enumerate(key.course(turns, muscle).T):
            axes.plot(time, line, "--" if GROUPS[g] == muscle else "-", color=key.COLORS[g], label=names[g])
        axes.set(title=f"{muscle}, mean actions", xlabel="time [s]", ylabel="activation")
        axes.set(ylim=(0, 1), xlim=(0, 4))
    bottom[1].legend(ncols=2)


EXPERIMENT = Experiment("tear", run)
