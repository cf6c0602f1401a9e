"""Sarcopenia: a healthy and a weak arm move between two angles; who does the work?

Paper: a policy trained in a healthy elbow moves it to and fro between two angles A and B, healthy, and with
every muscle at half of its peak isometric force. Healthy, the brachialis (BRA) alone nearly suffices; weak,
it works harder and both heads of the biceps (BIClong, BICshort) join.

Open in the paper, and chosen here:

* A and B: 30 and 90 degrees. 20 and 110, and 60 and 120, are run beside them.
* 2 s at each, twice to and fro, from a random angle; activations and errors are means over all of it. The
  synergists' share is taken once more over the last second at each angle, without the bursts of the movement.
* A third arm is weak and acts with a policy that was trained weak.
* The prime mover is, for each seed, the flexor with the largest activation in the healthy arm: three flexors
  about one joint are redundant, the reward hardly tells them apart, and so their shares are each seed's own.
  The other two are its synergists. In the paper's single policy the prime mover is BRA.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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
from myowarp.apps.studies.reproduce.experiment import Experiment, Lab
from myowarp.apps.studies.reproduce.result import Claim, Findings, Merit
from myowarp.models.conditions import Sarcopenia

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    error = np.array([r["error"].mean(axis=0) for r in results])
    effort = np.array([r["activation"].mean(axis=(0, 2)) for r in results])
    held = late(2 * ROUNDS, PHASE, SETTLED)
    share, share_held = (
        np.array(
            [
                [synergists_share(r["activation"][when, g], prime) for g in range(len(GROUPS))]
                for r, prime in zip(results, primes, strict=True)
            ]
        )
        for when in (np.full(len(held), True), held)
    )
    mover = np.array(
        [r["activation"][:, :, prime].mean(axis=0) for r, prime in zip(results, primes, strict=True)]
    )
    merits = []
    for pair in PAIRS:
        for arm in ARMS:
            g = GROUPS.index((arm, *pair))
            who = f"{arm}, {pair[0]:.0f} to {pair[1]:.0f}°"
            merits.append(Merit("error of the elbow angle", "°", who, tuple(error[:, g])))
            merits.append(Merit("effort, mean activation of the six muscles", "1", who, tuple(effort[:, g])))
            merits.append(Merit("activation of the prime mover", "1", who, tuple(mover[:, g])))
            merits.append(Merit("share of the synergists", "1", who, tuple(share[:, g])))
            merits.append(Merit("share of the synergists, held", "1", who, tuple(share_held[:, g])))
    columns = {arm: [GROUPS.index((arm, *pair)) for pair in PAIRS] for arm in ARMS}

    def rises(values: np.ndarray, arm: str, pairs: slice = slice(None)) -> np.ndarray:
        return values[:, columns[arm][pairs]] - values[:, columns["healthy"][pairs]]

    brachialis = sum(prime == MUSCLES.index("BRA") for prime in primes)
    movers = ", ".join(MUSCLES[prime] for prime in primes)
    claims = (
        Claim(
            "BRA alone nearly suffices in the healthy arm.",
            brachialis == len(primes) and bool((share[:, columns["healthy"][0]] < 0.5).all()),
            f"Prime movers by seed: {movers}; share of the others: "
            f"{', '.join(f'{value:.2f}' for value in share[:, columns['healthy'][0]])}.",
        ),
        Claim(
            "The prime mover works harder in the weak arm, in every seed, between all angles.",
            bool((rises(mover, "weak") > 0.0).all()),
        ),
        Claim(
            "Its synergists work harder, too, in every seed, between all angles.",
            bool((rises(synergists_sum(results, primes), "weak") > 0.0).all()),
        ),
        Claim(
            "Their share of the flexors' activation grows from healthy to weak, between all angles (means).",
            bool((rises(share, "weak").mean(axis=0) > 0.0).all()),
            by_angles(rises(share, "weak")),
        ),
        Claim(
            "It grows, too, while the angles are held (means).",
            bool((rises(share_held, "weak").mean(axis=0) > 0.0).all()),
            by_angles(rises(share_held, "weak")),
        ),
        Claim(
            "Weakness raises effort and error, in every seed, between all angles.",
            bool((rises(error, "weak") > 0.0).all() and (rises(effort, "weak") > 0.0).all()),
        ),
        Claim(
            "A policy that is trained weak has a smaller error in the weak arm (means).",
            bool(rises(error, "weak, retrained").mean() < rises(error, "weak").mean()),
        ),
    )
    return Findings(tuple(merits), claims, TEXT, lambda figure: draw(figure, results, share))


def by_angles(rises: np.ndarray) -> str:
    """Return means over seeds of what each pair of angles gives."""
    return "By angles: " + ", ".join(f"{value:+.3f}" for value in rises.mean(axis=0)) + "."


def synergists_sum(results: list[dict[str, np.ndarray]], primes: list[int]) -> np.ndarray:
    """Return the synergists' summed activation, shape (seeds, groups)."""
    flexors = np.array([r["activation"][..., 3:].sum(axis=2).mean(axis=0) for r in results])
    mover = [r["activation"][..., prime].mean(axis=0) for r, prime in zip(results, primes, strict=True)]
    return flexors - np.array(mover)


TEXT = """
**Who is the prime mover** is each seed's own, and is not always BRA. Three flexors about one joint can
share a torque in any way. The reward takes little notice: the bonus for being near the target is 8 a step,
the effort at most 0.4. And what notice it takes favours sharing: the norm of the activations is least if
every flexor works in proportion to the torque that it can give. The paper shows one policy; with five, BRA
is one possibility of three.

**What does not depend on the seed** is the paper's conclusion: with half of the force, prime mover and
synergists both work harder, between all pairs of angles. The synergists' share of the activation changes
much less than their activation: the policy sees a larger error and drives all flexors by more, nearly in
proportion, and a muscle near its largest activation leaves the rest to the others.

**The error** grows, as the policy has no memory and no integral part: half of the force needs a larger
error to be called for. A policy that is trained weak needs a smaller one.
"""


def draw(figure: Figure, results: list[dict[str, np.ndarray]], share: np.ndarray) -> None:
    """Draw angle and the six activations over time, and the synergists' share."""
    figure.set_size_inches(8.0, 6.6)
    axes = figure.subplots(3, 3)
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    for arm in ARMS:
        g = GROUPS.index((arm, *PAIRS[0]))
        angle = np.mean([r["angle"][:, g] for r in results], axis=0)
        error = np.mean([r["error"][:, g] for r in results], axis=0)
        axes[0, 0].plot(time, angle, color=COLORS[arm], label=arm)
        axes[0, 1].plot(time, error, color=COLORS[arm])
        for panel, m in zip(axes[1:].ravel(), (3, 4, 5, 0, 1, 2), strict=True):
            lines = np.array([r["activation"][:, g, m] for r in results])
            panel.plot(time, lines.mean(axis=0), color=COLORS[arm])
            panel.fill_between(
                time, lines.min(axis=0), lines.max(axis=0), color=COLORS[arm], alpha=0.15, linewidth=0
            )
            panel.set(
                title=f"{MUSCLES[m]}{'' if m < 3 else ' (flexor)'}", ylim=(0.0, 1.0), ylabel="activation"
            )
    axes[0, 0].plot(time, results[0]["target"][:, GROUPS.index(("healthy", *PAIRS[0]))], "k--", linewidth=0.8)
    axes[0, 0].set(title="elbow angle", ylabel="angle [°]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    axes[0, 1].set(title="|angle - target|", ylabel="error [°]")
    for panel in axes[2]:
        panel.set_xlabel("time [s]")
    panel, places = axes[0, 2], np.arange(len(PAIRS))
    for i, arm in enumerate(ARMS):
        own = share[:, [GROUPS.index((arm, *pair)) for pair in PAIRS]]
        panel.bar(places + 0.27 * (i - 1), own.mean(axis=0), 0.25, color=COLORS[arm])
        panel.plot(np.tile(places + 0.27 * (i - 1), len(own)), own.ravel(), "k.", markersize=3)
    panel.set_xticks(places, [f"{a:.0f}–{b:.0f}°" for a, b in PAIRS])
    panel.set(title="share of the synergists")


EXPERIMENT = Experiment(
    "sarcopenia",
    "Sarcopenia: who moves a weak elbow",
    "healthy, BRA alone nearly suffices; with half of the force BRA works harder and BIClong and BICshort "
    "join. No numbers are given.",
    run,
)
