"""Fatigue: an arm that moves to and fro and tires, by two models; and how long 3CC-r can hold a load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.reports.result import Merit, merits
from myowarp.apps.studies.reproduce import endurance
from myowarp.apps.studies.reproduce.arm import (
    CONTROL_DT,
    FATIGUED,
    HEALTHY,
    prime_mover,
    run_groups,
    synergists_share,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.models.bodies.arm_muscles import ELBOW_EXTENSOR, ELBOW_FLEXOR
from myowarp.models.conditions import Fatigue3CCR, FatigueMa2009, Load

if TYPE_CHECKING:
    from matplotlib.figure import Figure

A, B, PHASE = 30.0, 90.0, 2.0  # deg, deg, s
ROUNDS, QUICK_ROUNDS = 10, 3
PER_SECOND = 60.0  # 1/min
FRESH, SECOND, MINUTE, RETRAINED = "fresh", "k = 1/s", "k = 1/min", "k = 1/s, retrained"
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
COLORS = dict(
    zip(GROUPS, ("#3f9b63", "#d9622b", "#d9a441", "#2f6fb5", "#7d5ba6", "#b5446e", "#7f7f7f"), strict=True)
)
PERCENT = 100.0


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
    results = [
        {name: np.concatenate([one[name], other[name]], axis=1) for name in one}
        for one, other in zip(tiring, others, strict=True)
    ]
    return findings(results, endurance.simulated(lab), rounds)


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
        ("share of the synergists, first repetition", "1", share[:, 0].T),
        ("share of the synergists, last repetition", "1", share[:, -1].T),
        ("fatigue at the end, mean of the flexors", "%", PERCENT * lost.T),
    )
    ratios = {}
    for load, own in zip(endurance.LOADS, seconds[:, 3], strict=True):
        exact, known = endurance.closed_form(load, ELBOW_FLEXOR), endurance.measured(load)
        ratios[load] = exact / known
        note = "people: Frey Law, Avin (2010)"
        if not np.isfinite(own):
            note += "; ours longer than the simulation" + ("" if np.isfinite(exact) else ", for ever")
        who = f"3CC-r flexors hold {PERCENT * load:.0f} %"
        rows.append(Merit("endurance", "s", who, [own], known, note=note))
    column = {name: g for g, name in enumerate(GROUPS)}
    growth = (share[:, -1] - share[:, 0])[:, column[SECOND]]
    gain = error[..., column[SECOND]] - error[..., column[RETRAINED]]

    def more(name: str, than: str = FRESH) -> np.ndarray:
        return error[:, -1, column[name]] - error[:, -1, column[than]]

    said = [f"{PERCENT * f:.0f} % {f'{r:.2f}' if np.isfinite(r) else 'for ever'}" for f, r in ratios.items()]
    minute, loaded = more(MINUTE).mean(), more(LOADED, LOADED_FRESH).mean()
    holds = {
        "error": (more(SECOND) > 0.0).all(),
        "error otherwise": minute > 0.0 and loaded > 0.0,
        "synergists": growth.mean() > 0.0,
        "retrained": gain[:, -1].mean() > 0.0,
        "endurance": all(0.5 <= ratio <= 2.0 for ratio in ratios.values()),
        "closed form": endurance.largest_deviation(seconds) < 0.02,
    }
    measured = {
        "minute": minute,
        "loaded": loaded,
        "growth": ", ".join(f"{value:+.2f}" for value in growth),
        "late": gain[:, -1].mean(),
        "early": gain[:, : rounds // 2 + 1].mean(),
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
    figure.set_size_inches(8.0, 6.2)
    (errors, shares), (tired, held) = figure.subplots(2, 2)
    repetition = np.arange(1, error.shape[1] + 1)
    for g, (name, color) in enumerate(COLORS.items()):
        for axes, values in ((errors, error), (shares, share)):
            axes.plot(repetition, values[:, :, g].mean(axis=0), "o-", markersize=3, color=color, label=name)
        fatigue = np.mean([r["fatigue"][:, g, 3:].mean(axis=1) for r in results], axis=0)
        tired.plot(CONTROL_DT * np.arange(1, len(fatigue) + 1), PERCENT * fatigue, color=color)
    errors.set(title="mean |angle - target|", xlabel="repetition", ylabel="error [°]", ylim=(0.0, None))
    shares.set(title="share of the synergists", xlabel="repetition")
    figure.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7)
    tired.set(title="lost force (Ma) or fatigued units (3CC-r), flexors", xlabel="time [s]", ylabel="%")
    fine = np.linspace(0.15, 0.9, 151)
    known = np.array([endurance.measured(f) for f in fine])
    held.plot(PERCENT * fine, known, "k", label="people (Frey Law, Avin 2010)")
    held.fill_between(PERCENT * fine, 0.5 * known, 2.0 * known, color="0.85", label="factor of two")
    for rates, muscle, label, color in (
        (ELBOW_FLEXOR, 3, "flexors", "#2f6fb5"),
        (ELBOW_EXTENSOR, 0, "extensors", "#d9622b"),
    ):
        exact = [endurance.closed_form(f, rates) for f in fine]
        held.plot(PERCENT * fine, exact, color=color, label=f"3CC-r, {label}")
        held.plot(PERCENT * np.array(endurance.LOADS), seconds[:, muscle], "o", color=color, markersize=4)
    held.set(title="endurance; dots are simulated", xlabel="% of the maximum", ylabel="s", yscale="log")
    held.set_ylim(5.0, 2000.0)
    held.legend(fontsize=7)


EXPERIMENT = Experiment("fatigue", run)
