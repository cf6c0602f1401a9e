"""Tendon tears: a hand that learned to turn a key loses one muscle of its thumb.

Paper: a policy is trained on key turn with all muscles. Then one muscle of the thumb at a time is removed
(FPL, OP, EPB, APL), 10 repetitions each, without further training. Success is reported at 126 and 160 degrees
of the key.

Open in the paper, and chosen here: what `key` says, and that a torn tendon transmits nothing, active or
passive, from the start of the episode, while its muscle still activates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.studies.reproduce.experiment import Experiment, Lab
from myowarp.apps.studies.reproduce.key import (
    COLORS,
    CONTROL_DT,
    HORIZON,
    THRESHOLDS,
    Turns,
    distinct,
    intact,
    turn,
)
from myowarp.apps.studies.reproduce.result import Claim, Findings, Merit
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
        policy = intact(lab, seed)
        turns.append(
            turn(
                lab,
                "turn",
                seed,
                GROUPS,
                [policy] * len(GROUPS),
                lambda of: [TendonTear(muscles=name, transmission=1.0 - of(name)) for name in TORN],
            )
        )
    return findings(turns)


def findings(turns: list[Turns]) -> Findings:
    """Return figures of merit, claims and figure."""
    success = 100.0 * np.array([t.success.mean(axis=2) for t in turns])  # (seeds, thresholds, groups)
    rotation = np.array([t.rotation.mean(axis=1) for t in turns])
    meant = np.array([t.mean_rotation for t in turns])
    who = ["all muscles", *(f"without {name}" for name in TORN)]
    merits = [
        Merit(f"success at {threshold:.0f}°", "%", who[g], tuple(success[:, i, g]))
        for i, threshold in enumerate(THRESHOLDS)
        for g in range(len(GROUPS))
    ]
    for name, values in (("drawn actions", rotation), ("mean actions", meant)):
        merits += [
            Merit(f"rotation of the key, {name}", "°", who[g], distinct(values[:, g]))
            for g in range(len(GROUPS))
        ]
    merits += [
        Merit(f"activation of {muscle}, mean actions", "1", who[g], distinct(effort(turns, muscle)[:, g]))
        for muscle in CRITICAL
        for g in range(len(GROUPS))
        if GROUPS[g] != muscle
    ]
    return Findings(tuple(merits), claims(turns), text(turns), lambda figure: draw(figure, turns))


def effort(turns: list[Turns], muscle: str) -> np.ndarray:
    """Return a muscle's mean activation, shape (seeds, groups); mean actions, which no noise lifts."""
    return np.array([np.nanmean(t.mean_activation[:, :, t.of(muscle)], axis=0) for t in turns])


def claims(turns: list[Turns]) -> tuple[Claim, ...]:
    """Return the paper's conclusions, and whether ours agree."""
    drawn = np.array([t.rotation.mean(axis=1) for t in turns]).mean(axis=0)
    meant = np.array([t.mean_rotation for t in turns]).mean(axis=0)
    of = GROUPS.index
    fpl, op = effort(turns, "FPL").mean(axis=0), effort(turns, "OP").mean(axis=0)
    means = ", ".join(f"{name} {meant[of(name)]:.0f}°" for name in GROUPS)
    both = np.minimum(drawn, meant)
    return (
        Claim(
            "FPL and OP are critical: without either the key turns less than without EPB or APL.",
            all(
                angle[of(name)] < min(angle[of(other)] for other in SPARED)
                for angle in (drawn, meant)
                for name in CRITICAL
            ),
            f"With drawn actions and with means. Rotation with mean actions: {means}.",
        ),
        Claim(
            "Tearing EPB or APL leaves the key turned beyond 160°.",
            all(both[of(name)] > THRESHOLDS[1] for name in SPARED),
        ),
        Claim(
            "Tearing EPB or APL changes the activation of FPL and OP by less than 0.05.",
            all(abs(a[of(name)] - a[0]) < 0.05 for a in (fpl, op) for name in SPARED),
        ),
        Claim(
            "As the caption has it: without FPL, OP keeps working and the key still turns beyond 126°.",
            bool(meant[of("FPL")] > THRESHOLDS[0] and op[of("FPL")] > 0.5 * op[0]),
            f"Activation of OP {op[0]:.2f} before, {op[of('FPL')]:.2f} without FPL.",
        ),
        Claim(
            "As the caption has it: without OP, FPL stays silent and the rotation shrinks.",
            bool(meant[of("OP")] < meant[0] and fpl[of("OP")] < 0.5 * fpl[0]),
            f"Activation of FPL {fpl[0]:.2f} before, {fpl[of('OP')]:.2f} without OP.",
        ),
        Claim(
            "With both names exchanged, as one sentence of the text has them: without OP, FPL keeps "
            "working and the key still turns beyond 126°; without FPL, the rotation shrinks.",
            bool(
                meant[of("OP")] > THRESHOLDS[0]
                and fpl[of("OP")] > 0.5 * fpl[0]
                and meant[of("FPL")] < THRESHOLDS[0]
            ),
        ),
    )


def text(turns: list[Turns]) -> str:
    """Return where ours differs from the paper, and why."""
    success = 100.0 * np.array([t.success.mean(axis=2) for t in turns]).mean(axis=0)
    meant = np.array([t.mean_rotation for t in turns]).mean(axis=0)
    fpl, op, g = effort(turns, "FPL").mean(axis=0), effort(turns, "OP").mean(axis=0), GROUPS.index
    split = np.concatenate([t.rotation[g("FPL")] for t in turns])
    slipped = 100.0 * float((split < 90.0).mean())
    return f"""
**The paper contradicts itself.** One sentence of its text has FPL and OP exchanged against the caption of the
figure. The caption says that OP goes on without FPL and the key still turns, and that FPL falls silent
without OP. Our hand does what the exchanged sentence says: without FPL the key reaches
{meant[g("FPL")]:.0f}°, without OP {meant[g("OP")]:.0f}° (mean actions; {meant[0]:.0f}° before). FPL does not
fall silent without OP: its activation goes from {fpl[0]:.2f} to {fpl[g("OP")]:.2f}. OP goes from {op[0]:.2f}
to {op[g("FPL")]:.2f} without FPL. Which of the two muscles is missed more is a property of the grip that a
policy found, and the paper's policies are not published.

**Noise hides part of it.** With drawn actions, success at 160° is {success[1, 0]:.0f} % before,
{success[1, g("FPL")]:.0f} % without FPL and {success[1, g("OP")]:.0f} % without OP. The noise of the training
lifts every activation, and with it the fingers jerk the key past the place where the even pull of the mean
actions stops. Without FPL the result is all or nothing: {slipped:.0f} % of the episodes end below 90°, the
others turn it fully.

**What is not in the paper:** the share of successes as numbers. It shows bars, so that there is no difference
to state. All seeds here play one policy; the intervals are those of its actions, not of the training.
`--retrain` trains one for each seed.
"""


def draw(figure: Figure, turns: list[Turns]) -> None:
    """Draw success, distribution of rotations, and the courses of FPL and OP."""
    figure.set_figheight(6.0)
    top, bottom = figure.subplots(2, 2)
    success = 100.0 * np.array([t.success.mean(axis=2) for t in turns])
    place = np.arange(len(GROUPS))
    for i, threshold in enumerate(THRESHOLDS):
        merits = [Merit("", "", "", tuple(success[:, i, g])) for g in place]
        means = [m.mean for m in merits]
        half = [np.nan_to_num(m.interval[1] - m.mean) for m in merits]
        shift = 0.2 * (2 * i - 1)
        top[0].bar(
            place + shift, means, 0.36, yerr=half, color=("#9ab8cc", COLORS[3])[i], label=f"{threshold:.0f}°"
        )
    top[0].set(title="Success with drawn actions", ylabel="episodes [%]", ylim=(0, 105))
    top[0].legend(title="key beyond", loc="center", bbox_to_anchor=(0.3, 0.6))
    angles = [np.concatenate([t.rotation[g] for t in turns]) for g in place]
    for g in place:
        jitter = np.linspace(-0.25, 0.25, len(angles[g]))
        top[1].plot(g + jitter, angles[g], ".", color=COLORS[g], markersize=3, alpha=0.5)
        top[1].plot(g, np.mean([t.mean_rotation[g] for t in turns]), "_", color="k", markersize=26)
    for threshold in THRESHOLDS:
        top[1].axhline(threshold, color="0.5", linewidth=0.8, linestyle=":")
    top[1].set(title="Greatest angle of the key; bar: mean actions", ylabel="angle [°]")
    for axes in top:
        axes.set_xticks(place, ["intact", *(f"no {name}" for name in TORN)])
    time = CONTROL_DT * np.arange(1, HORIZON + 1)
    for axes, muscle in zip(bottom, CRITICAL, strict=True):
        for g in place:
            course = np.nanmean([t.mean_activation[:, g, t.of(muscle)] for t in turns], axis=0)
            style = "--" if GROUPS[g] == muscle else "-"
            axes.plot(time, course, style, color=COLORS[g], label=GROUPS[g] if g == 0 else f"no {GROUPS[g]}")
        axes.set(
            title=f"{muscle}, mean actions", xlabel="time [s]", ylabel="activation", ylim=(0, 1), xlim=(0, 4)
        )
    bottom[1].legend(ncols=2)


EXPERIMENT = Experiment(
    "tear",
    "Tendon tears on key turn: success without FPL, OP, EPB or APL",
    "Section on tendon tears: FPL and OP are critical. Without FPL, OP keeps working and the key still "
    "turns; without OP, FPL stays silent and the rotation shrinks. Torn extensors change nothing.",
    run,
)
