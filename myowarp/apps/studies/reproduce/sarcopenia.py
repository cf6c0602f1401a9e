"""Sarcopenia: a healthy and a weak arm move between two angles; who does the work?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import POSITIVE, Merit, both, merits, rises, stays
from myowarp.apps.studies.reproduce.arm import (
    CONTROL_DT,
    FLEXORS,
    HEALTHY,
    MUSCLES,
    SARCOPENIC,
    THRIFTY,
    late,
    run_groups,
    synergists_share,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.validation import curves
from myowarp.definitions.body import BODIES
from myowarp.inks import BLUE, GREEN, ORANGE, SKY, VERMILION
from myowarp.models.conditions import Sarcopenia

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAME = 0.02  # of a share: less counts as nothing
WEAK = 0.5  # of the peak force
PAIRS = ((30.0, 90.0), (20.0, 110.0), (60.0, 120.0))  # deg
PHASE, SETTLED, ROUNDS = 2.0, 1.0, 2  # s, s, times to and fro
DEAR = "effort × 10"
ARMS = {
    "healthy": (1.0, HEALTHY),
    "weak": (WEAK, HEALTHY),
    "weak, retrained": (WEAK, SARCOPENIC),
    f"healthy, {DEAR}": (1.0, THRIFTY),
    f"weak, {DEAR}": (WEAK, THRIFTY),
}
"""Strength and whose policy."""

GROUPS = tuple((arm, a, b) for a, b in PAIRS for arm in ARMS)
COLORS = dict(zip(ARMS, (GREEN, VERMILION, BLUE, SKY, ORANGE), strict=True))
FIRST = "{:.0f} to {:.0f}°".format(*PAIRS[0])


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    strength = np.repeat([ARMS[arm][0] for arm, _, _ in GROUPS], lab.num_worlds)
    targets = np.array([[a for _, a, _ in GROUPS], [b for _, _, b in GROUPS]] * ROUNDS)
    trainings = [ARMS[arm][1] for arm, _, _ in GROUPS]
    results = run_groups(lab, "move", GROUPS, trainings, lambda: (Sarcopenia(strength),), targets, PHASE)
    return findings(results)


def least_norm() -> np.ndarray:
    """Return each flexor's share of their activation where its norm is least for a torque, mean from A to B.

    min |a| for c a = torque has a = c torque / |c|^2: each in proportion to the torque c that it makes when
    fully active.
    """
    model = BODIES["elbow"].build().compile()
    angles = np.radians(np.linspace(*PAIRS[0], 13))
    _, arm, force = curves(model, 0, angles, (0.0, 1.0))
    flexors = [model.actuator(name).id for name in FLEXORS]
    torque = (arm * (force[:, 1] - force[:, 0]))[:, flexors]
    share: np.ndarray = (torque / torque.sum(axis=1, keepdims=True)).mean(axis=0)
    return share


def flexors_shares(results: list[dict[str, np.ndarray]], arm: str) -> np.ndarray:
    """Return each flexor's share of the flexors' activation between A and B, shape (seeds, 3)."""
    g = GROUPS.index((arm, *PAIRS[0]))
    each = np.array([r["activation"][:, g, 3:].mean(axis=0) for r in results])
    return each / each.sum(axis=1, keepdims=True)


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    divided = {arm: flexors_shares(results, arm) for arm in ("healthy", f"healthy, {DEAR}")}
    # A row a seed, a column a group: the healthy arm of the same policy says who is the prime mover.
    primes = np.array(
        [3 + divided[f"healthy, {DEAR}" if DEAR in arm else "healthy"].argmax(axis=1) for arm, *_ in GROUPS]
    ).T
    each = list(zip(results, primes, strict=True))
    error = np.array([r["error"].mean(axis=0) for r in results])
    effort = np.array([r["activation"].mean(axis=(0, 2)) for r in results])
    held = late(2 * ROUNDS, PHASE, SETTLED)
    groups = range(len(GROUPS))
    share, share_held = (
        np.array(
            [[synergists_share(r["activation"][when, g], prime[g]) for g in groups] for r, prime in each]
        )
        for when in (np.full(len(held), True), held)
    )
    mover = np.array([r["activation"][:, groups, prime].mean(axis=0) for r, prime in each])
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
    healthy, weak, retrained, dear, dear_weak = (
        [g for g, (name, _, _) in enumerate(GROUPS) if name == arm] for arm in ARMS
    )
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
    spread = {arm: own.std(axis=0, ddof=1).mean() if len(own) > 1 else np.nan for arm, own in divided.items()}
    ideal = least_norm()
    for arm, own in divided.items():
        for muscle, values in zip(FLEXORS, own.T, strict=True):
            rows.append(Merit(f"share of {muscle}", "1", f"{arm}, {FIRST}", values, within=POSITIVE))
        rows.append(Merit("standard deviation of a flexor's share over seeds", "1", arm, [spread[arm]]))
    away = {arm: np.abs(own - ideal).mean(axis=1) for arm, own in divided.items()}
    rows += merits(list(away), ("distance of the shares from those of least norm", "1", list(away.values())))
    alone = share[:, healthy[0]]
    movers, dear_movers = ([MUSCLES[prime] for prime in primes[:, of[0]]] for of in (healthy, dear))

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
        "dear mover": len(set(dear_movers)) == 1 if len(results) > 1 else None,
        "dear spread": bool(spread[f"healthy, {DEAR}"] < 0.5 * spread["healthy"])
        if len(results) > 1
        else None,
        "dear norm": rises(away["healthy"] - away[f"healthy, {DEAR}"]),
        "dear share": throughout(more(share, dear_weak, dear)),
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
        "dear_movers": ", ".join(dear_movers),
        "dear_share": ", ".join(f"{value:+.3f}" for value in more(share, dear_weak, dear).mean(axis=0)),
        "spread": list(spread.values()),
        "away": [float(values.mean()) for values in away.values()],
        "ideal": ", ".join(f"{muscle} {value:.2f}" for muscle, value in zip(FLEXORS, ideal, strict=True)),
        "dear_error": [error[:, of].mean() for of in (healthy, dear)],
        "dear_effort": 100.0 * (effort[:, dear].mean() / effort[:, healthy].mean() - 1.0),
    }
    late_error = np.array([r["error"][held].mean(axis=0) for r in results])
    bars = {"error": late_error, "share": share, "ideal": ideal, **divided}
    return Findings(rows, holds, lambda figure: draw(figure, results, bars), measured)


def draw(figure: Figure, results: list[dict[str, np.ndarray]], bars: dict[str, np.ndarray]) -> None:
    """Draw angle and activations over time, the error while an angle is held, and shares."""
    figure.set_size_inches(8.0, 8.8)
    grid = figure.add_gridspec(4, 3)
    panels: Any = [[figure.add_subplot(grid[row, column]) for column in range(3)] for row in range(3)]
    (angles, errors, shares), *below = panels
    whose = figure.add_subplot(grid[3, :])
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    places = np.arange(len(PAIRS))
    for i, (arm, color) in enumerate(COLORS.items()):
        g = GROUPS.index((arm, *PAIRS[0]))
        columns = [GROUPS.index((arm, *pair)) for pair in PAIRS]
        for axes, what in ((errors, "error"), (shares, "share")):
            own, label = bars[what][:, columns], arm if axes is errors else None
            panel.bars(axes, places + 0.16 * (i - 2), own, 0.15, color=color, label=label)
        if arm in bars:
            panel.bars(whose, np.arange(3) + 0.2 * (1 if DEAR in arm else -1), bars[arm], 0.38, color=color)
        if DEAR in arm:
            continue
        panel.band(angles, time, panel.extent([r["angle"][:, g] for r in results]), color=color)
        for axes, m in zip(np.ravel(below), (3, 4, 5, 0, 1, 2), strict=True):
            panel.band(axes, time, panel.extent([r["activation"][:, g, m] for r in results]), color=color)
            title = f"{MUSCLES[m]}{'' if m < 3 else ' (flexor)'}"
            axes.set(title=title, ylim=(0.0, 1.0), ylabel="activation")
    a, b = PAIRS[0]
    angles.plot(time, results[0]["target"][:, GROUPS.index(("healthy", a, b))], "k--", linewidth=0.8)
    angles.set(title=f"elbow angle, A = {a:.0f}°, B = {b:.0f}°", ylabel="angle [°]")
    errors.set(title="error, last second of a hold", ylabel="error [°]")
    figure.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    for place, value in enumerate(bars["ideal"]):
        whose.plot([place - 0.45, place + 0.45], [value, value], "k:", linewidth=1.5)
    whose.set_xticks(range(3), FLEXORS)
    whose.set(title=f"share of the flexors' activation, healthy arm, {FIRST}", ylim=(0.0, 1.0))
    for axes in below[1]:
        axes.set_xlabel("time [s]")
    for axes in (errors, shares):
        axes.set_xticks(places, [f"{a:.0f}–{b:.0f}°" for a, b in PAIRS])
    shares.set(title="share of the synergists")


EXPERIMENT = Experiment("sarcopenia", run)
