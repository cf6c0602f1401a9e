"""Fatigue: an arm that moves to and fro and tires, by two models; and how long 3CC-r can hold a load.

Paper: the healthy policy of the sarcopenia experiment moves the elbow between A and B while the peak force
falls as F_max exp(-k int F / F_max dt), k = 1; the synergists' share grows from one repetition to the next.

Open in the paper, and chosen here:

* A and B: 30 and 90 degrees, 2 s at each, 10 times to and fro (3 times with --quick).
* The unit of k. 1/s is the reading in which 40 s tire an unloaded arm; 1/min, the unit of the model's authors
  (Ma et al. 2009), is run beside it.
* A second model, 3CC-r, with MyoSuite's rates, with an empty hand and with 2 kg.
* An arm that tires at 1/s, with a policy that was trained tired (every muscle at 10 to 100 % of its force).
* First and last repetition are compared: mean error over all of it, share of the synergists (sarcopenia.py).
* Endurance of 3CC-r at 20 to 80 % of the maximum (endurance.py), against people; a factor of two is allowed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.studies.reproduce import endurance
from myowarp.apps.studies.reproduce.arm import (
    CONTROL_DT,
    FATIGUED,
    HEALTHY,
    prime_mover,
    run_groups,
    synergists_share,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Lab
from myowarp.apps.studies.reproduce.result import Claim, Findings, Merit
from myowarp.models.conditions import Fatigue3CCR, FatigueMa2009, Load
from myowarp.models.conditions.fatigue_3ccr import ELBOW_EXTENSOR, ELBOW_FLEXOR

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
        for k in range(rounds):
            share[s, k] = [synergists_share(one[k, g], prime) for g in range(len(GROUPS))]
    column = {name: g for g, name in enumerate(GROUPS)}
    merits = []
    for name, g in column.items():
        merits.append(Merit("error, first repetition", "°", name, tuple(error[:, 0, g])))
        merits.append(Merit("error, last repetition", "°", name, tuple(error[:, -1, g])))
        merits.append(Merit("share of the synergists, first repetition", "1", name, tuple(share[:, 0, g])))
        merits.append(Merit("share of the synergists, last repetition", "1", name, tuple(share[:, -1, g])))
        merits.append(
            Merit("fatigue at the end, mean of the flexors", "%", name, tuple(PERCENT * lost[:, g]))
        )
    ratios = {}
    for load, own in zip(endurance.LOADS, seconds[:, 3], strict=True):
        exact, known = endurance.closed_form(load, ELBOW_FLEXOR), endurance.measured(load)
        ratios[load] = exact / known
        note = "people: Frey Law, Avin (2010)"
        if not np.isfinite(own):
            note += "; ours longer than the simulation" + ("" if np.isfinite(exact) else ", for ever")
        who = f"3CC-r flexors hold {PERCENT * load:.0f} %"
        merits.append(Merit("endurance", "s", who, (float(own),), known, None, note))
    growth = share[:, -1] - share[:, 0]
    early = (error[..., column[RETRAINED]] - error[..., column[SECOND]])[:, : rounds // 2 + 1]

    def more(values: np.ndarray, name: str, than: str = FRESH) -> np.ndarray:
        return values[:, -1, column[name]] - values[:, -1, column[than]]

    claims = (
        Claim(
            "Fatigue raises the error: the last repetition's is larger than fresh (k = 1/s, every seed).",
            bool((more(error, SECOND) > 0.0).all()),
        ),
        Claim(
            "So it does with k = 1/min, and in 3CC-r under 2 kg against a fresh arm with 2 kg (means).",
            bool(more(error, MINUTE).mean() > 0.0 and more(error, LOADED, LOADED_FRESH).mean() > 0.0),
            f"By {more(error, MINUTE).mean():.2f} and {more(error, LOADED, LOADED_FRESH).mean():.2f}°.",
        ),
        Claim(
            "The synergists' share grows from the first to the last repetition (k = 1/s, mean over seeds).",
            bool(growth[:, column[SECOND]].mean() > 0.0),
            "By seed: " + ", ".join(f"{value:+.2f}" for value in growth[:, column[SECOND]]) + ".",
        ),
        Claim(
            "A policy that was trained tired has a smaller error in the last repetition (mean over seeds).",
            bool(more(error, RETRAINED, SECOND).mean() < 0.0),
            f"Smaller by {-more(error, RETRAINED, SECOND).mean():+.1f}° in the last repetition and by "
            f"{-early.mean():+.1f}° in the first half.",
        ),
        Claim(
            "3CC-r's endurance is within a factor of two of people's, at 20 to 80 % of the maximum.",
            all(0.5 <= ratio <= 2.0 for ratio in ratios.values()),
            "Ours over theirs: "
            + ", ".join(
                f"{PERCENT * load:.0f} % {f'{ratio:.2f}' if np.isfinite(ratio) else 'for ever'}"
                for load, ratio in ratios.items()
            )
            + ".",
        ),
        Claim(
            "Simulated and closed form agree to 2 %, for flexors and extensors.",
            endurance.largest_deviation(seconds) < 0.02,
        ),
    )
    return Findings(tuple(merits), claims, TEXT, lambda figure: draw(figure, results, error, share, seconds))


TEXT = """
**The unit of k** decides everything. In 1/s the arm has lost nine tenths of its force after 40 s, errors
grow several times, and the synergists' share grows as in the paper: the prime mover, which works most,
tires most. In 1/min the same arm has lost a twentieth, and shares stay. An unloaded elbow that tires within
a minute is no physiology; the paper's conclusion needs that reading of k, or much longer movements.

**3CC-r** tires an arm with an empty hand by little in 40 s, since its muscles work at a tenth of their
maximum, and with 2 kg by twice as much. Tired motor units are replaced by rested ones as long as there are
any, so that the error barely grows.

**The policy that was trained tired** errs less while there is force to spend, and works harder for it. So
it tires faster, and where nearly all force is lost it has less left than the other.

**Endurance.** 3CC-r holds medium loads nearly as long as people do, and 80 % half as long. Its flexors
recover so fast that they never tire below R / (F + R) = 22 % of their maximum, where people give up within
ten minutes. The rates are MyoSuite's (Rakshit et al. 2021); the extensors' recover more slowly and have no
such limit above 7 %.
"""


def draw(
    figure: Figure,
    results: list[dict[str, np.ndarray]],
    error: np.ndarray,
    share: np.ndarray,
    seconds: np.ndarray,
) -> None:
    """Draw errors, shares and fatigue by repetition, and the endurance."""
    figure.set_size_inches(8.0, 6.2)
    axes = figure.subplots(2, 2)
    repetition = np.arange(1, error.shape[1] + 1)
    for g, name in enumerate(GROUPS):
        for panel, values in ((axes[0, 0], error), (axes[0, 1], share)):
            panel.plot(
                repetition, values[:, :, g].mean(axis=0), "o-", markersize=3, color=COLORS[name], label=name
            )
        fatigue = np.mean([r["fatigue"][:, g, 3:].mean(axis=1) for r in results], axis=0)
        axes[1, 0].plot(CONTROL_DT * np.arange(1, len(fatigue) + 1), PERCENT * fatigue, color=COLORS[name])
    axes[0, 0].set(title="mean |angle - target|", xlabel="repetition", ylabel="error [°]", ylim=(0.0, None))
    axes[0, 1].set(title="share of the synergists", xlabel="repetition")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7)
    axes[1, 0].set(title="lost force (Ma) or fatigued units (3CC-r), flexors", xlabel="time [s]", ylabel="%")
    panel, fine = axes[1, 1], np.linspace(0.15, 0.9, 151)
    panel.plot(
        PERCENT * fine, [endurance.measured(f) for f in fine], "k", label="people (Frey Law, Avin 2010)"
    )
    known = np.array([endurance.measured(f) for f in fine])
    panel.fill_between(PERCENT * fine, 0.5 * known, 2.0 * known, color="0.85", label="factor of two")
    for rates, label, color in (
        (ELBOW_FLEXOR, "flexors", "#2f6fb5"),
        (ELBOW_EXTENSOR, "extensors", "#d9622b"),
    ):
        m = 3 if rates is ELBOW_FLEXOR else 0
        panel.plot(
            PERCENT * fine,
            [endurance.closed_form(f, rates) for f in fine],
            color=color,
            label=f"3CC-r, {label}",
        )
        panel.plot(PERCENT * np.array(endurance.LOADS), seconds[:, m], "o", color=color, markersize=4)
    panel.set(title="endurance; dots are simulated", xlabel="% of the maximum", ylabel="s", yscale="log")
    panel.set_ylim(5.0, 2000.0)
    panel.legend(fontsize=7)


EXPERIMENT = Experiment(
    "fatigue",
    "Fatigue: an arm that tires while it moves",
    "the synergists' share grows over the repetitions. No numbers are given.",
    run,
)
