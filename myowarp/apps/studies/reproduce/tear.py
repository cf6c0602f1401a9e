"""Tendon tears: a hand that learned to turn a key loses one muscle of its thumb."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import both, merits, rises, stays
from myowarp.apps.studies.reproduce import key
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.inks import SKY
from myowarp.models.conditions import TendonTear

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TORN = ("FPL", "OP", "EPB", "APL")
GROUPS = ("intact", *TORN)
CRITICAL, SPARED = ("FPL", "OP"), ("EPB", "APL")
UNMOVED, UNCHANGED = 0.05, 10.0  # of an activation, percent of the episodes: less counts as nothing

MISSED = {True: "OP is missed more", False: "FPL is missed more", None: "which is missed more is not decided"}


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    lab.expect(len(lab.seeds))
    turns = []
    for seed in lab.seeds:
        policy = lab.policy(key.INTACT, seed)
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
    rows = key.turn_merits(turns, who) + key.change_merits(turns, who)
    for muscle in CRITICAL:
        own = effort(turns, muscle).T
        kept = [g for g, name in enumerate(GROUPS) if name != muscle]
        rows += merits([who[g] for g in kept], (f"activation of {muscle}, mean actions", "1", own[kept]))
    drawn, meant = map(by_group, key.rotations(turns))
    fpl, op = (by_group(effort(turns, muscle)) for muscle in CRITICAL)
    success = by_group(key.success(turns)[:, 1])

    def missed(angle: dict[str, np.ndarray], name: str) -> np.ndarray:
        return angle["intact"] - angle[name]

    holds = {
        **{name: both(*(rises(missed(angle, name)) for angle in (drawn, meant))) for name in CRITICAL},
        "irreplaceable": both(*(rises(missed(a, "OP") - missed(a, "FPL")) for a in (drawn, meant))),
        "spared": both(*(stays(missed(success, name), UNCHANGED) for name in SPARED)),
        "unmoved": both(*(stays(missed(a, name), UNMOVED) for a in (fpl, op) for name in SPARED)),
        "caption, FPL": both(rises(meant["FPL"] - key.THRESHOLDS[0]), rises(op["FPL"] - 0.5 * op["intact"])),
        "caption, OP": both(rises(missed(meant, "OP")), rises(0.5 * fpl["intact"] - fpl["OP"])),
        "exchanged": both(
            *(rises(missed(a, "FPL") - missed(a, "OP")) for a in (drawn, meant)),
            rises(fpl["OP"] - 0.5 * fpl["intact"]),
        ),
        "noise": both(*(rises(missed(meant, name) - missed(drawn, name)) for name in CRITICAL)),
    }
    measured = {
        "number": len(turns),
        "missed": MISSED[holds["irreplaceable"]],
        **{name: means(values) for name, values in (("meant", meant), ("drawn", drawn))},
        **{name: means(values) for name, values in (("fpl", fpl), ("op", op), ("success", success))},
        "each": "; ".join(
            f"{name} {', '.join(f'{angle:.0f}' for angle in meant[name])}" for name in ("intact", *CRITICAL)
        ),
    }
    return Findings(rows, holds, lambda figure: draw(figure, turns), measured)


def by_group(values: np.ndarray) -> dict[str, np.ndarray]:
    """Return the values of the seeds by group, of values (seeds, groups)."""
    return dict(zip(GROUPS, values.T, strict=True))


def means(values: dict[str, np.ndarray]) -> dict[str, float]:
    """Return means over seeds."""
    return {name: float(own.mean()) for name, own in values.items()}


def effort(turns: list[key.Turns], muscle: str) -> np.ndarray:
    """Return a muscle's mean activation, shape (seeds, groups); mean actions, which no noise lifts."""
    return np.array([np.nanmean(t.mean_activation[:, :, t.of(muscle)], axis=0) for t in turns])


def draw(figure: Figure, turns: list[key.Turns]) -> None:
    """Draw success, distribution of rotations, and the courses of FPL and OP."""
    figure.set_figheight(6.4)
    (shares, angles), bottom = figure.subplots(2, 2)
    place, names = np.arange(len(GROUPS)), ["intact", *(f"no {name}" for name in TORN)]
    panel.bars(shares, place, key.success(turns)[:, 1], 0.6, color=SKY)
    shares.set(title="Success at 160°, drawn actions", ylabel="episodes [%]", ylim=(0, 105))
    shares.set_xticks(place, names)
    key.draw_rotations(angles, turns, names)
    angles.set_title("Greatest angle of the key")
    time = key.CONTROL_DT * np.arange(1, key.HORIZON + 1)
    for axes, muscle in zip(bottom, CRITICAL, strict=True):
        for g in [g for g, name in enumerate(GROUPS) if name in ("intact", *CRITICAL)]:
            style = "--" if GROUPS[g] == muscle else "-"
            lines = key.courses(turns, muscle)[:, :, g]
            panel.band(
                axes, time, panel.extent(lines), style, color=key.COLORS[g], alpha=0.12, label=names[g]
            )
        axes.set(title=f"{muscle}, mean actions", xlabel="time [s]", ylabel="activation")
        axes.set(ylim=(0, 1), xlim=(0, 2))
    bottom[1].legend(loc="upper right")


EXPERIMENT = Experiment("tear", run)
