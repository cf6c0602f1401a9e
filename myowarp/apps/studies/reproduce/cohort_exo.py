"""A cohort with exoskeletons: how much assistance do 1,000 patients need to hold 90 degrees within 5?

Beyond the paper. Every world is a patient of its own: strength, drawn between 20 and 100 % of the peak force,
and fatigability, drawn between a quarter of and four times the fatigue rates of 3CC-r (uniform in its
logarithm). All hold 1 kg at 90 degrees for 10 s, with each of five levels of assistance side by side, 0 to
400 % of the muscles' torque; without assistance the brace is off the arm.

* Each of five seeds has 200 patients and a policy of its own, of a healthy arm: nobody has practised with
  the brace.
* A level holds if the mean of |angle - 90| over the last 2.5 s is at most 5 degrees. What a patient needs is
  the least level that holds.
* With a limit of 10 degrees, about that within which the policies were rewarded, all is judged once more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.studies.reproduce.arm import CONTROL_DT, HEALTHY, MUSCLES, arms, follow
from myowarp.apps.studies.reproduce.exo1 import CUFF
from myowarp.apps.studies.reproduce.experiment import Experiment, Lab, Tick
from myowarp.apps.studies.reproduce.result import Claim, Findings, Merit
from myowarp.models.conditions import Exoskeleton, Fatigue3CCR, Load, Sarcopenia
from myowarp.models.conditions.fatigue_3ccr import rates_of
from myowarp.sim.signals import Signals

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PATIENTS, QUICK_PATIENTS = 200, 24  # of each seed
LEVELS = (0.0, 0.5, 1.0, 2.0, 4.0)
STRENGTH = (0.2, 1.0)
FATIGABILITY = (0.25, 4.0)  # times the fatigue rate
LOAD, ANGLE = 1.0, 90.0  # kg, deg
HOLD, LAST = 10.0, 2.5  # s
LIMIT, WIDER = 5.0, 10.0  # deg


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    number = QUICK_PATIENTS if lab.quick else PATIENTS
    policies = [lab.policy(HEALTHY, seed) for seed in lab.seeds]
    lab.expect(len(lab.seeds))
    results = []
    for seed, policy in zip(lab.seeds, policies, strict=True):
        settings = {"seed": seed, "patients": number, "levels": LEVELS, "load": LOAD, "hold": HOLD}

        def measure(tick: Tick, seed: int = seed, policy: Checkpoint = policy) -> dict[str, np.ndarray]:
            return hold(lab, seed, number, policy, tick)

        results.append(lab.kept(f"cohort-seed{seed}", settings, measure, policy))
    return findings(results)


def hold(lab: Lab, seed: int, number: int, policy: Checkpoint, tick: Tick) -> dict[str, np.ndarray]:
    """Let patients hold the angle with every level; error and assistance torque, shape (patients, levels)."""
    rng = np.random.default_rng(seed)
    strength = rng.uniform(*STRENGTH, number)
    fatigability = FATIGABILITY[0] * (FATIGABILITY[1] / FATIGABILITY[0]) ** rng.uniform(size=number)
    shape = number, len(LEVELS)
    assistance = np.broadcast_to(LEVELS, shape).ravel()
    everyone = np.repeat(np.arange(number), len(LEVELS))
    rates = np.outer(fatigability, [rates_of(muscle).fatigue_rate for muscle in MUSCLES])
    conditions = (
        Sarcopenia(strength[everyone]),
        Fatigue3CCR(fatigue_rate=rates[everyone]),
        Load(LOAD),
        Exoskeleton(assistance, forearm_mass=np.where(assistance > 0.0, CUFF, 0.0)),
    )
    sim = arms(conditions, len(everyone), lab.setup)
    seeds = 1000 * (seed + 1) + everyone  # a patient starts from the same angle at every level
    trace = follow(Signals(sim), [(policy, slice(None))], seeds, np.array([[ANGLE]]), HOLD, tick)
    last = slice(-round(LAST / CONTROL_DT), None)
    return {
        "strength": strength,
        "fatigability": fatigability,
        "error": trace.error[last].mean(axis=0).reshape(shape),
        "torque": trace.shown["exo_torque"][last].mean(axis=0).reshape(shape),
        "fatigue": trace.shown["fatigue"][-1, :, 3:].mean(axis=1).reshape(shape),
    }


def needed(error: np.ndarray, limit: float) -> np.ndarray:
    """Return the least level that holds, infinity if none, of errors (patients, levels)."""
    holds = error <= limit
    return np.where(holds.any(axis=1), np.array(LEVELS)[holds.argmax(axis=1)], np.inf)


def slope(values: np.ndarray, need: np.ndarray) -> float:
    """Return Spearman's rank correlation of what patients are with what they need."""
    ranks = []
    for x in (values, need):
        _, place, counts = np.unique(x, return_inverse=True, return_counts=True)
        ranks.append((np.cumsum(counts) - 0.5 * counts)[place])
    return float(np.corrcoef(ranks)[0, 1])


def slope_at_equal(values: np.ndarray, need: np.ndarray, other: np.ndarray) -> float:
    """Return the partial rank correlation of values and need, with another property held fixed."""
    a, b, c = slope(values, need), slope(values, other), slope(other, need)
    return (a - b * c) / float(np.sqrt((1.0 - b * b) * (1.0 - c * c)))


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    need = [needed(r["error"], LIMIT) for r in results]
    wider = [needed(r["error"], WIDER) for r in results]
    weak = [r["strength"] < 0.5 * sum(STRENGTH) for r in results]
    merits = []
    for limit, found in ((LIMIT, need), (WIDER, wider)):
        who = f"within {limit:.0f}°"
        shares = {
            "share that needs no assistance": [float((n == 0.0).mean()) for n in found],
            "share that 100 % suffices for": [float((n <= 1.0).mean()) for n in found],
            "share that no level suffices for": [float(np.isinf(n).mean()) for n in found],
        }
        for what, values in shares.items():
            merits.append(Merit(what, "%", who, tuple(100.0 * value for value in values)))
    by_strength = [slope(r["strength"], n) for r, n in zip(results, need, strict=True)]
    by_rate = [
        slope_at_equal(r["fatigability"], n, r["strength"]) for r, n in zip(results, need, strict=True)
    ]
    merits.append(Merit("rank correlation of need and strength", "1", "all patients", tuple(by_strength)))
    tiring = Merit("rank correlation of need and fatigability", "1", "at equal strength", tuple(by_rate))
    merits.append(tiring)
    fall = [r["error"][:, 0] - r["error"][:, LEVELS.index(1.0)] for r in results]
    merits.append(
        Merit(
            "error saved by 100 % assistance",
            "°",
            "the weaker half",
            tuple(float(f[w].mean()) for f, w in zip(fall, weak, strict=True)),
        )
    )
    claims = (
        Claim("Weaker patients need more assistance, in every seed.", max(by_strength) < 0.0),
        Claim(
            "Of equally strong patients, those who tire faster need more assistance (interval above 0).",
            tiring.interval[0] > 0.0,
        ),
        Claim(
            "Assistance lowers the error of the weaker half, in every seed.",
            all(float(f[w].mean()) > 0.0 for f, w in zip(fall, weak, strict=True)),
        ),
        Claim(
            "Judged by 10 instead of 5 degrees, fewer need assistance, and the weaker still need more.",
            all(
                (b == 0.0).mean() >= (a == 0.0).mean() and slope(r["strength"], b) < 0.0
                for r, a, b in zip(results, need, wider, strict=True)
            ),
        ),
    )
    return Findings(tuple(merits), claims, TEXT, lambda figure: draw(figure, results, need), in_worlds=False)


TEXT = """
The paper has nothing to compare with. What a patient needs is a property of body, policy and demand
together: the policy is like a spring and stops short of the target by more, the more hangs on it, so that a
wider limit lowers the need of all. The order of the patients does not depend on the limit: strength
decides, since it scales the spring. In 10 s at 1 kg fatigability decides nothing, at four times the
published rates either.

Where no level suffices, the flexors are near their largest activation against the passive pull of the
triceps (exo2), which a share of the net torque does not lighten. A brace with a torque of its own (`motor`)
would.

More is not always better: the strongest patients have the smallest error with 200 %, and 400 % throws some of
them about.
"""


def draw(figure: Figure, results: list[dict[str, np.ndarray]], need: list[np.ndarray]) -> None:
    """Draw the map of what each patient needs, and the error by assistance for groups of strength."""
    from matplotlib.colors import BoundaryNorm

    figure.set_size_inches(8.0, 3.9)
    axes = figure.subplots(1, 2, gridspec_kw={"width_ratios": (1.25, 1.0)})
    strength, rate = (np.concatenate([r[name] for r in results]) for name in ("strength", "fatigability"))
    level, error = np.concatenate(need), np.concatenate([r["error"] for r in results])
    index = np.searchsorted(LEVELS, np.minimum(level, LEVELS[-1]))
    known = np.isfinite(level)
    norm = BoundaryNorm(np.arange(len(LEVELS) + 1) - 0.5, 256)
    size = 9.0 if len(level) > 200 else 20.0
    dots = axes[0].scatter(
        100.0 * strength[known], rate[known], c=index[known], cmap="viridis", norm=norm, s=size, linewidths=0
    )
    axes[0].scatter(
        100.0 * strength[~known], rate[~known], marker="x", color="#b3261e", s=1.3 * size, linewidths=0.9
    )
    bar = figure.colorbar(dots, ax=axes[0], ticks=range(len(LEVELS)))
    bar.ax.set_yticklabels([f"{100 * value:.0f} %" for value in LEVELS])
    axes[0].set(title="assistance needed (x: no level suffices)")
    axes[0].set(xlabel="strength [% of peak force]", ylabel="fatigue rate, times the published", yscale="log")
    ticks = (0.25, 0.5, 1.0, 2.0, 4.0)
    axes[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes[0].minorticks_off()
    bounds = np.linspace(*STRENGTH, 5)
    for low, high, color in zip(
        bounds, bounds[1:], ("#b5446e", "#d9822b", "#4a90c8", "#0d3d6e"), strict=False
    ):
        chosen = error[(strength >= low) & (strength < high)]
        if not len(chosen):
            continue
        label = f"{100 * low:.0f} to {100 * high:.0f} % strength"
        axes[1].plot(
            100.0 * np.array(LEVELS), np.median(chosen, axis=0), "o-", color=color, markersize=3, label=label
        )
        quarters = np.quantile(chosen, (0.25, 0.75), axis=0)
        axes[1].fill_between(100.0 * np.array(LEVELS), *quarters, color=color, alpha=0.15, linewidth=0)
    axes[1].axhline(LIMIT, color="k", linestyle=":", linewidth=0.8)
    axes[1].set(title="error, median and middle half", xlabel="assistance [%]", ylabel="error [°]")
    axes[1].legend(fontsize=7)


EXPERIMENT = Experiment(
    "cohort-exo",
    "A cohort with exoskeletons: the assistance that each of 1,000 patients needs",
    "beyond the paper, which has one patient a simulation.",
    run,
    ignores=("num_worlds", "models"),
)
