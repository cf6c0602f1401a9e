"""Sarcopenia: a healthy and a weak arm move between two angles; who does the work?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import POSITIVE, both, merits, rises, stays
from myowarp.apps.studies.reproduce.arm import (
    CONTROL_DT,
    HEALTHY,
    MUSCLES,
    SARCOPENIC,
    late,
    prime_mover,
    run_groups,
    synergists_share,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.models.conditions import Sarcopenia

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAME = 0.02  # of a share: less counts as nothing
WEAK = 0.5  # of the peak force
PAIRS = ((30.0, 90.0), (20.0, 110.0), (60.0, 120.0))  # deg
PHASE, SETTLED, ROUNDS = 2.0, 1.0, 2  # s, s, times to and fro
ARMS = {"healthy": (1.0, HEALTHY), "weak": (WEAK, HEALTHY), "weak, retrained": (WEAK, SARCOPENIC)}
"""Strength and whose policy."""

GROUPS = tuple((arm, a, b) for a, b in PAIRS for arm in ARMS)
COLORS = {"healthy": "#3f9b63", "weak": "#d9622b", "weak, retrained": "#2f6fb5"}


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    strength = np.repeat([ARMS[arm][0] for arm, _, _ in GROUPS], lab.num_worlds)
    targets = np.array([[a for _, a, _ in GROUPS], [b for _, _, b in GROUPS]] * ROUNDS)
    trainings = [ARMS[arm][1] for arm, _, _ in GROUPS]
    results = run_groups(lab, "move", GROUPS, trainings, lambda: (Sarcopenia(strength),), targets, PHASE)
    return findings(results)


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    primes = [prime_mover(r["activation"][:, GROUPS.index(("healthy", *PAIRS[0]))]) for r in results]
    each = list(zip(results, primes, strict=True))
    error = np.array([r["error"].mean(axis=0) for r in results])
    effort = np.array([r["activation"].mean(axis=(0, 2)) for r in results])
    held = late(2 * ROUNDS, PHASE, SETTLED)
    groups = range(len(GROUPS))
    share, share_held = (
        np.array([[synergists_share(r["activation"][when, g], prime) for g in groups] for r, prime in each])
        for when in (np.full(len(held), True), held)
    )
    mover = np.array([r["activation"][..., prime].mean(axis=0) for r, prime in each])
    flexors = np.array([r["activation"][..., 3:].sum(axis=2).mean(axis=0) for r in results])
    rows = merits(
        [f"{arm}, {a:.0f} to {b:.0f}°" for arm, a, b in GROUPS],
        ("error of the elbow angle", "°", error.T),
        ("effort, mean activation of the six muscles", "1", effort.T),
        ("activation of the prime mover", "1", mover.T),
        ("share of the synergists", "1", share.T),
        ("share of the synergists, held", "1", share_held.T),
        within=POSITIVE,
    )
    healthy, weak, retrained = ([g for g, (name, _, _) in enumerate(GROUPS) if name == arm] for arm in ARMS)
    between = [f"{a:.0f} to {b:.0f}°" for a, b in PAIRS]

    def more(values: np.ndarray, arm: list[int] = weak, than: list[int] = healthy) -> np.ndarray:
        return values[:, arm] - values[:, than]

    differences = {
        "activation of the prime mover, weak minus healthy": ("1", more(mover)),
        "activation of both synergists, weak minus healthy": ("1", more(flexors - mover)),
        "share of the synergists, weak minus healthy": ("1", more(share)),
        "share of the synergists, held, weak minus healthy": ("1", more(share_held)),
        "error, weak minus healthy": ("°", more(error)),
        "error, weak minus weak and retrained": ("°", more(error, weak, retrained)),
    }
    rows += merits(between, *((name, unit, values.T) for name, (unit, values) in differences.items()))
    alone, movers = share[:, healthy[0]], [MUSCLES[prime] for prime in primes]

    def throughout(values: np.ndarray) -> bool | None:
        return both(*(rises(own) for own in values.T))

    holds = {
        "alone": set(movers) == {"BRA"} and bool((alone < 0.5).all()),
        "prime mover": throughout(more(mover)),
        "synergists": throughout(more(flexors - mover)),
        "share": throughout(more(share)),
        "share held": throughout(more(share_held)),
        "unchanged": both(*(stays(own, SAME) for own in more(share).T)),
        "effort and error": both(throughout(more(error)), throughout(more(effort))),
        "retrained": throughout(more(error, weak, retrained)),
    }
    measured = {
        "number": len(results),
        "movers": ", ".join(movers),
        "alone": ", ".join(f"{value:.2f}" for value in alone),
        "share": ", ".join(f"{value:+.3f}" for value in more(share).mean(axis=0)),
        "share_held": ", ".join(f"{value:+.3f}" for value in more(share_held).mean(axis=0)),
        "mover": 100.0 * (mover[:, weak[0]] / mover[:, healthy[0]] - 1.0).mean(),
        "others": 100.0 * ((flexors - mover)[:, weak[0]] / (flexors - mover)[:, healthy[0]] - 1.0).mean(),
        "first": more(share).mean(axis=0)[0],
    }
    late_error = np.array([r["error"][held].mean(axis=0) for r in results])
    return Findings(rows, holds, lambda figure: draw(figure, results, late_error, share), measured)


def draw(figure: Figure, results: list[dict[str, np.ndarray]], error: np.ndarray, share: np.ndarray) -> None:
    """Draw angle and activations over time, the error while an angle is held, the synergists' share."""
    figure.set_size_inches(8.0, 6.8)
    (angles, errors, shares), *below = figure.subplots(3, 3)
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    places = np.arange(len(PAIRS))
    for i, (arm, color) in enumerate(COLORS.items()):
        g = GROUPS.index((arm, *PAIRS[0]))
        panel.band(angles, time, panel.extent([r["angle"][:, g] for r in results]), color=color, label=arm)
        for axes, m in zip(np.ravel(below), (3, 4, 5, 0, 1, 2), strict=True):
            panel.band(axes, time, panel.extent([r["activation"][:, g, m] for r in results]), color=color)
            title = f"{MUSCLES[m]}{'' if m < 3 else ' (flexor)'}"
            axes.set(title=title, ylim=(0.0, 1.0), ylabel="activation")
        columns = [GROUPS.index((arm, *pair)) for pair in PAIRS]
        for axes, values in ((errors, error), (shares, share)):
            panel.bars(axes, places + 0.27 * (i - 1), values[:, columns], 0.25, color=color)
    a, b = PAIRS[0]
    angles.plot(time, results[0]["target"][:, GROUPS.index(("healthy", a, b))], "k--", linewidth=0.8)
    angles.set(title=f"elbow angle, A = {a:.0f}°, B = {b:.0f}°", ylabel="angle [°]")
    errors.set(title="error, last second of a hold", ylabel="error [°]")
    figure.legend(*angles.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    for axes in below[1]:
        axes.set_xlabel("time [s]")
    for axes in (errors, shares):
        axes.set_xticks(places, [f"{a:.0f}–{b:.0f}°" for a, b in PAIRS])
    shares.set(title="share of the synergists")


EXPERIMENT = Experiment("sarcopenia", run)
