"""A cohort with exoskeletons: how much assistance do 1,000 patients need to hold 90 degrees within 5?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.reports import panel
from myowarp.apps.reports.result import PERCENT, Merit, rises
from myowarp.apps.studies.reproduce.arm import CONTROL_DT, HEALTHY, MUSCLES, arms, follow
from myowarp.apps.studies.reproduce.exo1 import CUFF
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab, Tick
from myowarp.inks import BLUE, ORANGE, SKY, VERMILION
from myowarp.models.bodies.arm_muscles import FATIGUE_RATES
from myowarp.models.conditions import Exoskeleton, Fatigue3CCR, Load, Sarcopenia
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
    rates = np.outer(fatigability, [FATIGUE_RATES[muscle].fatigue_rate for muscle in MUSCLES])
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
    from scipy import stats

    return float(stats.spearmanr(values, need).statistic)


def slope_at_equal(values: np.ndarray, need: np.ndarray, other: np.ndarray) -> float:
    """Return the partial rank correlation of values and need, with another property held fixed."""
    a, b, c = slope(values, need), slope(values, other), slope(other, need)
    return (a - b * c) / float(np.sqrt((1.0 - b * b) * (1.0 - c * c)))


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    need = [needed(r["error"], LIMIT) for r in results]
    wider = [needed(r["error"], WIDER) for r in results]
    weak = [r["strength"] < 0.5 * sum(STRENGTH) for r in results]
    rows = []
    for limit, found in ((LIMIT, need), (WIDER, wider)):
        shares = {
            "share that needs no assistance": [(n == 0.0).mean() for n in found],
            "share that 100 % suffices for": [(n <= 1.0).mean() for n in found],
            "share that no level suffices for": [np.isinf(n).mean() for n in found],
        }
        for what, values in shares.items():
            own = 100.0 * np.array(values)
            rows.append(Merit(what, "%", f"within {limit:.0f}°", own, within=PERCENT))
    by_strength = [slope(r["strength"], n) for r, n in zip(results, need, strict=True)]
    by_rate = [
        slope_at_equal(r["fatigability"], n, r["strength"]) for r, n in zip(results, need, strict=True)
    ]
    tiring = Merit("rank correlation of need and fatigability", "1", "at equal strength", by_rate)
    saved = [
        (r["error"][:, 0] - r["error"][:, LEVELS.index(1.0)])[w].mean()
        for r, w in zip(results, weak, strict=True)
    ]
    rows += (
        Merit("rank correlation of need and strength", "1", "all patients", by_strength),
        tiring,
        Merit("error saved by 100 % assistance", "°", "the weaker half", saved),
    )
    holds = {
        "strength": max(by_strength) < 0.0,
        "fatigability": rises(by_rate),
        "relieved": min(saved) > 0.0,
        "limit": all(
            (b == 0.0).mean() >= (a == 0.0).mean() and slope(r["strength"], b) < 0.0
            for r, a, b in zip(results, need, wider, strict=True)
        ),
    }
    level = np.concatenate(need)
    measured = {
        "patients": len(level),
        "number": len(results),
        "none": 100.0 * (level == 0.0).mean(),
        "full": 100.0 * (level <= 1.0).mean(),
        "never": 100.0 * np.isinf(level).mean(),
        "strength": np.mean(by_strength),
        "rate": np.mean(by_rate),
        "each": ", ".join(f"{100.0 * (n == 0.0).mean():.0f}" for n in need),
    }
    return Findings(rows, holds, lambda figure: draw(figure, results, need), measured)


def draw(figure: Figure, results: list[dict[str, np.ndarray]], need: list[np.ndarray]) -> None:
    """Draw the map of what each patient needs, and the error by assistance for groups of strength."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm

    number = len(results)
    figure.set_size_inches(8.0, 4.8)
    charts, errors = np.ravel(figure.subfigures(2, 1, height_ratios=(1.0, 1.15)))  # type: ignore[arg-type]
    panels = list(charts.subplots(1, number, sharey=True, squeeze=False).flat)
    percent = 100.0 * np.array(LEVELS)
    colours = ScalarMappable(BoundaryNorm(np.arange(len(LEVELS) + 1) - 0.5, 256), "viridis")
    ticks = (0.25, 0.5, 1.0, 2.0, 4.0)
    for seed, (chart, result, level) in enumerate(zip(panels, results, need, strict=True)):
        index, known = np.searchsorted(LEVELS, np.minimum(level, LEVELS[-1])), np.isfinite(level)
        strength, rate = 100.0 * result["strength"], result["fatigability"]
        chart.scatter(strength[known], rate[known], s=9, c=colours.to_rgba(index[known]), linewidths=0)
        chart.scatter(strength[~known], rate[~known], s=12, marker="x", color=VERMILION, linewidths=0.9)
        chart.set(title=f"policy {seed}", xlabel="strength [%]", yscale="log")
        chart.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        chart.minorticks_off()
    panels[0].set_ylabel("fatigue rate,\ntimes the published")
    bar = charts.colorbar(colours, ax=panels, ticks=range(len(LEVELS)), label="assistance needed")
    bar.ax.set_yticklabels([f"{value:.0f} %" for value in percent])
    axes = errors.subplots()
    strength, error = (np.concatenate([r[name] for r in results]) for name in ("strength", "error"))
    bounds, colors = np.linspace(*STRENGTH, 5), (VERMILION, ORANGE, SKY, BLUE)
    for low, high, color in zip(bounds[:-1], bounds[1:], colors, strict=True):
        chosen = error[(strength >= low) & (strength < high)]
        if len(chosen):
            label = f"{100 * low:.0f} to {100 * high:.0f} % strength"
            panel.band(axes, percent, panel.quarters(chosen), "o-", color=color, markersize=3, label=label)
    axes.axhline(LIMIT, color="k", linestyle=":", linewidth=0.8)
    axes.set(title="error, median and middle half", xlabel="assistance [%]", ylabel="error [°]")
    axes.legend(fontsize=7)


EXPERIMENT = Experiment("cohort-exo", run, ignores=("num_worlds", "models"))
