"""Exoskeleton I: an arm lifts 0, 1 and 2 kg, with and without a powered brace that follows its muscles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import CHANGE, POSITIVE, Merit, both, merits, rises, stays
from myowarp.apps.studies.reproduce.arm import (
    ASSISTANCE,
    ASSISTED,
    CONTROL_DT,
    FLEXORS,
    HEALTHY,
    MOTOR,
    beside,
    late,
    run_groups,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.inks import BLUE, PINK, SKY, VERMILION
from myowarp.models.conditions import Exoskeleton, Load

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CUFF = 0.111  # kg
LOADS = (0.0, 1.0, 2.0)  # kg
ANGLES = (0.0, 30.0, 0.0, 60.0, 0.0, 80.0)  # deg
HOLD, SETTLED = 2.0, 1.0  # s
BRACE, NEW, DRIVEN = "brace that follows", "brace, never worn before", "motor of the policy"
"""Sources of the torque: worn by a policy trained with it, by the healthy one, driven by the policy."""

FOLLOWING = (
    *((BRACE, load, a) for load in LOADS for a in (0.0, ASSISTANCE)),
    *((BRACE, 2.0, 0.5), (BRACE, 2.0, 2.0)),
    *((NEW, load, a) for load in LOADS for a in (0.0, ASSISTANCE)),
)
DRIVING = tuple((DRIVEN, load, a) for load in LOADS for a in (0.0, ASSISTANCE))
GROUPS = (*FOLLOWING, *DRIVING)
"""Wearer, load [kg] and assistance [1] of each group of worlds; a motor's is 0 where it gets no command."""

PAPER_ERROR = {0.0: (4.95, 3.42), 1.0: (4.54, 3.12), 2.0: (4.34, 3.43)}  # deg
SAME = 0.5  # deg: the error may grow by that and count as the same
PAPER_CHANGE = {"activation": (-60.0, -54.0, -66.0), "force": (-60.0, -58.0, -67.0)}  # %, by flexor, 2 kg


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    targets = np.array(ANGLES)[:, None]

    def lift(
        name: str, groups: tuple[tuple[str, float, float], ...], motor: bool
    ) -> list[dict[str, np.ndarray]]:
        load, assistance = (np.repeat([g[i] for g in groups], lab.num_worlds) for i in (1, 2))
        brace = Exoskeleton(assistance, motor=motor, forearm_mass=np.where(assistance > 0.0, CUFF, 0.0))
        trainings = [{BRACE: ASSISTED, NEW: HEALTHY, DRIVEN: MOTOR}[who] for who, _, _ in groups]
        still = [a == 0.0 for _, _, a in groups] if motor else ()
        return run_groups(lab, name, groups, trainings, lambda: (Load(load), brace), targets, HOLD, still)

    return findings(beside(lift("lift", FOLLOWING, False), lift("drive", DRIVING, True)))


def change(
    result: dict[str, np.ndarray], quantity: str, load: float, assistance: float, who: str = BRACE
) -> np.ndarray:
    """Return by how much assistance changes the flexors' activation or force [%], shape (3,)."""
    window = late(len(ANGLES), HOLD, SETTLED) & (result["target"][:, 0] > 1.0)
    means = result[quantity][window].mean(axis=0)
    return relative_change(means, GROUPS.index((who, load, assistance)), GROUPS.index((who, load, 0.0)))


def relative_change(means: np.ndarray, one: int, other: int) -> np.ndarray:
    """Return by how much the flexors' means of one group are above another's [%], of means (groups, 6)."""
    return 100.0 * (means[one, 3:] / means[other, 3:] - 1.0)


def saved_power(means: np.ndarray, one: int, other: int) -> float:
    """Return by how much all muscles' metabolic rate of one group is above another's [%]."""
    return float(100.0 * (means[one].sum() / means[other].sum() - 1.0))


def assisted(arm: str, assistance: float) -> str:
    """Return an arm's condition."""
    return f"{arm}, {'with' if assistance else 'without'} assistance"


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    window = late(len(ANGLES), HOLD, SETTLED)
    errors = np.array([result["error"][window].mean(axis=0) for result in results])
    whole = np.array([result["error"].mean(axis=0) for result in results])
    rows = []
    for g, (wearer, load, a) in enumerate(GROUPS):
        if a not in (0.0, ASSISTANCE):
            continue
        paper, spread = PAPER_ERROR[load] if a and wearer != NEW else (None, None)
        who = f"{wearer}, {assisted(f'{load:.0f} kg', a)}"
        rows.append(Merit("error of the elbow angle", "°", who, errors[:, g], paper, spread, within=POSITIVE))
        if a:
            note = "the movements are in it"
            what = "error over the whole 2 s"
            rows.append(Merit(what, "°", who, whole[:, g], paper, spread, note, within=POSITIVE))
    heavy = GROUPS.index((BRACE, 2.0, ASSISTANCE))
    for angle in sorted(set(ANGLES)):
        held = window & np.isclose(results[0]["target"][:, 0], angle, atol=1e-3)
        own = [result["error"][held, heavy].mean() for result in results]
        rows.append(Merit(f"error at {angle:.0f}°", "°", "2 kg, with assistance", own, within=POSITIVE))
    changes = {
        (who, q): np.array([change(r, q, 2.0, ASSISTANCE, who) for r in results])
        for who in (BRACE, NEW, DRIVEN)
        for q in PAPER_CHANGE
    }
    for (who, quantity), values in changes.items():
        papers = PAPER_CHANGE[quantity] if who != NEW else (None,) * len(FLEXORS)
        for muscle, own, value in zip(FLEXORS, values.T, papers, strict=True):
            what, where = f"change of {quantity}, {muscle}", f"{who}, 2 kg"
            rows.append(Merit(what, "%", where, own, value, within=CHANGE))
    for a in (0.5, 1.0, 2.0):
        forces = [change(r, "force", 2.0, a).mean() for r in results]
        note = f"the muscles' part of the holding torque changes by {-100.0 * a / (1.0 + a):.0f} %"
        what, who = "change of force, mean of the flexors", f"{BRACE}, 2 kg, assistance {a:g}"
        rows.append(Merit(what, "%", who, forces, note=note, within=CHANGE))
    others = np.array([[change(r, "activation", 2.0, a) for a in (0.5, 2.0)] for r in results])
    force = {who: changes[who, "force"].mean(axis=1) for who in (BRACE, NEW, DRIVEN)}
    grows = {who: errors_of(errors, who)[2.0] - errors_of(errors, who)[0.0] for who in (BRACE, DRIVEN)}
    rows += merits(
        [BRACE, DRIVEN], ("growth of the error from 0 to 2 kg, with assistance", "°", list(grows.values()))
    )
    power = np.array([result["metabolic_rate"][window].mean(axis=0) for result in results])
    for who in (BRACE, NEW, DRIVEN):
        for load in LOADS:
            with_, without = (GROUPS.index((who, load, a)) for a in (ASSISTANCE, 0.0))
            where = f"{who}, {load:.0f} kg"
            own = [saved_power(means, with_, without) for means in power]
            rows.append(Merit("change of metabolic rate, all muscles", "%", where, own, within=CHANGE))
            own = power[:, without].sum(axis=1)
            rows.append(Merit("metabolic rate without assistance", "W", where, own, within=POSITIVE))
    spared = errors[:, GROUPS.index((BRACE, 2.0, 0.0))] - errors[:, heavy]
    rows.append(Merit("error that assistance takes away", "°", f"{BRACE}, 2 kg", spared))

    def relieved(who: str) -> bool | None:
        return both(*(rises(-own) for q in PAPER_CHANGE for own in changes[who, q].T))

    holds = {
        "relieved": relieved(BRACE),
        "error": within_spread(whole, BRACE),
        "error and load": rises(SAME - grows[BRACE]),
        "relieved, motor": relieved(DRIVEN),
        "error, motor": within_spread(whole, DRIVEN),
        "error and load, motor": rises(SAME - grows[DRIVEN]),
        "any level": both(*(rises(-others[:, i, m]) for i in range(2) for m in range(len(FLEXORS)))),
        "error late": within_spread(errors, BRACE),
        "error relieved": rises(spared),
        "unpractised": rises(force[NEW] - force[BRACE]),
        "motor": rises(force[BRACE] - force[DRIVEN]),
    }
    measured = {
        "force": {who: own.mean() for who, own in force.items()},
        "power": {
            who: np.mean(
                [saved_power(m, *(GROUPS.index((who, 2.0, a)) for a in (ASSISTANCE, 0.0))) for m in power]
            )
            for who in (BRACE, DRIVEN)
        },
        "grows": {who: own.mean() for who, own in grows.items()},
        "number": len(results),
        "late": errors_of(errors, BRACE)[2.0].mean(),
    }
    return Findings(rows, holds, lambda figure: draw(figure, results, errors, changes), measured)


def errors_of(errors: np.ndarray, who: str) -> dict[float, np.ndarray]:
    """Return errors with assistance by load, of errors (seeds, groups)."""
    return {load: errors[:, GROUPS.index((who, load, ASSISTANCE))] for load in LOADS}


def within_spread(errors: np.ndarray, who: str) -> bool | None:
    """Return whether the mean errors with assistance lie within the paper's ±, of errors (seeds, groups)."""
    own = errors_of(errors, who)
    return both(*(stays(own[load] - mean, sd) for load, (mean, sd) in PAPER_ERROR.items()))


def draw(
    figure: Figure,
    results: list[dict[str, np.ndarray]],
    errors: np.ndarray,
    changes: dict[tuple[str, str], np.ndarray],
) -> None:
    """Draw angle and activation over time at 2 kg, errors over the load, and changes beside the paper's."""
    figure.set_size_inches(8.0, 8.4)
    (angles, efforts), middle, (levels, legend) = figure.subplots(3, 2)
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    angles.plot(time, results[0]["target"][:, 0], color="0.6", linestyle="--", label="target")
    for a, label, color in ((0.0, "without", VERMILION), (ASSISTANCE, "with", BLUE)):
        g = GROUPS.index((BRACE, 2.0, a))
        angle = panel.extent([result["angle"][:, g] for result in results])
        effort = panel.extent([result["activation"][:, g, 3:].mean(axis=1) for result in results])
        panel.band(angles, time, angle, color=color, label=f"{label} assistance")
        panel.band(efforts, time, effort, color=color, label=f"{label} assistance")
    angles.set(title="2 kg, brace that follows: elbow angle", xlabel="time [s]", ylabel="angle [°]")
    efforts.set(title="mean activation of the flexors", xlabel="time [s]", ylabel="activation")
    angles.legend(loc="upper left")
    places = np.arange(len(FLEXORS))
    looks = {BRACE: (0.0, BLUE), NEW: (0.2, SKY), DRIVEN: (0.4, PINK)}
    for axes, quantity in zip(middle, PAPER_CHANGE, strict=True):
        axes.bar(places - 0.25, PAPER_CHANGE[quantity], 0.2, color="0.75", label="paper")
        for who, (shift, color) in looks.items():
            panel.bars(axes, places - 0.05 + shift, changes[who, quantity], 0.18, color=color, label=who)
        axes.axhline(-50.0, color="k", linewidth=0.8, linestyle=":", label="half, an ideal hold")
        axes.set_xticks(places + 0.08, FLEXORS)
        axes.set(title=f"2 kg: change of {quantity}", ylabel="%")
    for who, (_, color) in looks.items():
        own = np.array([values for values in errors_of(errors, who).values()])
        levels.plot(LOADS, own.mean(axis=1), "-", color=color)
        levels.plot(np.repeat(LOADS, own.shape[1]), own.ravel(), ".", color=color, markersize=4)
    means, spreads = zip(*PAPER_ERROR.values(), strict=True)
    levels.errorbar(LOADS, means, spreads, fmt="s", color="0.6", capsize=3)
    levels.set(title="error with assistance, last second", xlabel="load [kg]", ylabel="error [°]")
    levels.set_ylim(0.0, None)
    legend.axis("off")
    legend.legend(*middle[0].get_legend_handles_labels(), loc="center left")


EXPERIMENT = Experiment("exo1", run)
