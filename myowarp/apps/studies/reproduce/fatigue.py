"""Fatigue: an arm that moves to and fro and tires, by two models; and how long 3CC-r can hold a load."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import PERCENT, POSITIVE, Merit, both, merits, rises
from myowarp.apps.studies.reproduce import endurance
from myowarp.apps.studies.reproduce.arm import (
    CONTROL_DT,
    FATIGUED,
    HEALTHY,
    PER_SECOND,
    beside,
    prime_mover,
    run_groups,
    synergists_share,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.inks import BLACK, INKS, VERMILION
from myowarp.models.bodies.arm_muscles import ELBOW_EXTENSOR, ELBOW_FLEXOR
from myowarp.models.conditions import Fatigue3CCR, FatigueMa2009, Load

if TYPE_CHECKING:
    from matplotlib.figure import Figure

A, B, PHASE = 30.0, 90.0, 2.0  # deg, deg, s
ROUNDS, QUICK_ROUNDS = 10, 3
FRESH, SECOND, MINUTE, RETRAINED = "fresh", "k = 1/s", "k = 1/min", "k = 1/s, trained tired"
MA = {
    FRESH: (0.0, HEALTHY),
    SECOND: (PER_SECOND, HEALTHY),
    MINUTE: (1.0, HEALTHY),
    RETRAINED: (PER_SECOND, FATIGUED),
}
"""Rate of the paper's model [1/min] and whose policy."""

EMPTY, LOADED, LOADED_FRESH = "3CC-r", "3CC-r, 2 kg", "fresh, 2 kg"
CCR = {EMPTY: (1.0, 0.0), LOADED: (1.0, 2.0), LOADED_FRESH: (0.0, 2.0)}
"""Share of the muscle that tires, and load [kg]."""

GROUPS = (*MA, *CCR)
COLORS = dict(zip(GROUPS, INKS, strict=True))


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    rounds = QUICK_ROUNDS if lab.quick else ROUNDS
    targets = np.array([[A], [B]] * rounds)
    rate = np.repeat([rate for rate, _ in MA.values()], lab.num_worlds)
    trainings = [training for _, training in MA.values()]
    tiring = run_groups(lab, "ma", list(MA), trainings, lambda: (FatigueMa2009(rate),), targets, PHASE)
    affected, load = (np.repeat([values[i] for values in CCR.values()], lab.num_worlds) for i in range(2))
    conditions = Fatigue3CCR(affected), Load(load)
    others = run_groups(lab, "3ccr", list(CCR), [HEALTHY] * len(CCR), lambda: conditions, targets, PHASE)
    return findings(beside(tiring, others), endurance.simulated(lab), rounds)


def by_round(values: np.ndarray, rounds: int) -> np.ndarray:
    """Return means over each repetition, shape (rounds, ...)."""
    return values.reshape(rounds, -1, *values.shape[1:]).mean(axis=1)


def findings(results: list[dict[str, np.ndarray]], seconds: np.ndarray, rounds: int) -> Findings:
    """Return figures of merit, claims and figure."""
    error = np.array([by_round(r["error"], rounds) for r in results])
    effort = np.array([by_round(r["activation"], rounds) for r in results])
    lost = np.array([r["fatigue"][-1, :, 3:].mean(axis=1) for r in results])
    share = np.empty(error.shape)  # (seeds, rounds, groups)
    for s, one in enumerate(effort):
        prime = prime_mover(one[:, 0])
        for k, g in np.ndindex(share.shape[1:]):
            share[s, k, g] = synergists_share(one[k, g], prime)
    rows = merits(
        GROUPS,
        ("error, first repetition", "°", error[:, 0].T),
        ("error, last repetition", "°", error[:, -1].T),
        within=POSITIVE,
    )
    rows += merits(
        GROUPS,
        ("share of the synergists, first repetition", "1", share[:, 0].T),
        ("share of the synergists, last repetition", "1", share[:, -1].T),
        within=(0.0, 1.0),
    )
    tired = ("fatigue at the end, mean of the flexors", "%", 100.0 * lost.T)
    rows += merits(GROUPS, tired, within=PERCENT)
    ratios = {}
    for load, own in zip(endurance.LOADS, seconds[:, 3], strict=True):
        exact, known = endurance.closed_form(load, ELBOW_FLEXOR), endurance.measured(load)
        ratios[load] = exact / known
        note = f"people: {known:.0f} s (Frey Law, Avin 2010)"
        if not np.isfinite(own):
            note += "; ours longer than the simulation" + ("" if np.isfinite(exact) else ", for ever")
        rows.append(Merit("endurance of 3CC-r", "s", f"flexors hold {100.0 * load:.0f} %", [own], note=note))
    column = {name: g for g, name in enumerate(GROUPS)}

    def more(name: str, than: str = FRESH) -> np.ndarray:
        return error[:, -1, column[name]] - error[:, -1, column[than]]

    growth = (share[:, -1] - share[:, 0])[:, column[SECOND]]
    gain = error[..., column[SECOND]] - error[..., column[RETRAINED]]
    pairs = {
        f"{SECOND} against {FRESH}": more(SECOND),
        f"{MINUTE} against {FRESH}": more(MINUTE),
        f"{LOADED} against {LOADED_FRESH}": more(LOADED, LOADED_FRESH),
        f"{SECOND} against {RETRAINED}": gain[:, -1],
    }
    rows += merits(list(pairs), ("error, last repetition, paired difference", "°", list(pairs.values())))
    rows += merits([SECOND], ("share of the synergists, growth", "1", [growth]))
    said = [f"{100.0 * f:.0f} % {f'{r:.2f}' if np.isfinite(r) else 'for ever'}" for f, r in ratios.items()]
    holds = {
        "synergists": rises(growth),
        "error": rises(more(SECOND)),
        "error otherwise": both(rises(more(MINUTE)), rises(more(LOADED, LOADED_FRESH))),
        "retrained": rises(gain[:, -1]),
        "endurance": all(0.5 <= ratio <= 2.0 for ratio in ratios.values()),
        "closed form": endurance.largest_deviation(seconds) < 0.02,
    }
    measured = {
        "number": len(results),
        "rounds": rounds,
        "minute": more(MINUTE).mean(),
        "loaded": more(LOADED, LOADED_FRESH).mean(),
        "second": more(SECOND).mean(),
        "growth": ", ".join(f"{value:+.2f}" for value in growth),
        "mean_growth": growth.mean(),
        "late": gain[:, -1].mean(),
        "early": gain[:, : rounds // 2 + 1].mean(),
        "lost": 100.0 * lost.mean(axis=0)[column[SECOND]],
        "ratios": ", ".join(said),
    }
    return Findings(rows, holds, lambda figure: draw(figure, results, error, share, seconds), measured)


def draw(
    figure: Figure,
    results: list[dict[str, np.ndarray]],
    error: np.ndarray,
    share: np.ndarray,
    seconds: np.ndarray,
) -> None:
    """Draw errors, shares and fatigue by repetition, and the endurance."""
    figure.set_size_inches(8.0, 6.6)
    (errors, shares), (tired, held) = figure.subplots(2, 2)
    repetition = np.arange(1, error.shape[1] + 1)
    for g, (name, color) in enumerate(COLORS.items()):
        form = "o-" if name in MA else "s--"
        look: dict[str, Any] = {"markersize": 3, "alpha": 0.1, "color": color}
        panel.band(errors, repetition, panel.extent(error[:, :, g]), form, label=name, **look)
        panel.band(shares, repetition, panel.extent(share[:, :, g]), form, **look)
        fatigue = 100.0 * np.array([r["fatigue"][:, g, 3:].mean(axis=1) for r in results])
        time = CONTROL_DT * np.arange(1, fatigue.shape[1] + 1)
        panel.band(tired, time, panel.extent(fatigue), form[1:], alpha=0.1, color=color)
    errors.set(title="mean |angle - target|", xlabel="repetition", ylabel="error [°]", yscale="log")
    errors.set_yticks((2, 5, 10, 20, 40), ("2", "5", "10", "20", "40"))
    errors.minorticks_off()
    shares.set(title="share of the synergists", xlabel="repetition")
    figure.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7)
    tired.set(title="lost force (Ma) or fatigued units (3CC-r), flexors", xlabel="time [s]", ylabel="%")
    fine = np.linspace(0.15, 0.9, 151)
    known = np.array([endurance.measured(f) for f in fine])
    held.plot(100.0 * fine, known, color="0.55", linewidth=3, label="people (Frey Law, Avin 2010)")
    held.fill_between(100.0 * fine, 0.5 * known, 2.0 * known, color="0.85", label="factor of two")
    for rates, muscle, label, color in (
        (ELBOW_FLEXOR, 3, "flexors", BLACK),
        (ELBOW_EXTENSOR, 0, "extensors", VERMILION),
    ):
        exact = [endurance.closed_form(f, rates) for f in fine]
        held.plot(100.0 * fine, exact, color=color, label=f"3CC-r, {label}")
        held.plot(100.0 * np.array(endurance.LOADS), seconds[:, muscle], "o", color=color, markersize=4)
    held.set(title="endurance; dots are simulated", xlabel="% of the maximum", ylabel="s", yscale="log")
    held.set_ylim(5.0, 2000.0)
    held.legend(fontsize=7)


EXPERIMENT = Experiment("fatigue", run)
