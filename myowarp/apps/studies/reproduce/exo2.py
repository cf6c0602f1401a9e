"""Exoskeleton II: a normal, a weak and a tiring arm hold 90 degrees, with and without a powered brace."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import CHANGE, PERCENT, POSITIVE, Merit, both, merits, rises, stays
from myowarp.apps.studies.reproduce.arm import (
    ASSISTANCE,
    ASSISTED,
    CONTROL_DT,
    FLEXORS,
    MOTOR,
    PER_SECOND,
    beside,
    late,
    run_groups,
)
from myowarp.apps.studies.reproduce.exo1 import (
    BRACE,
    CUFF,
    DRIVEN,
    assisted,
    relative_change,
    saved_power,
)
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.apps.studies.reproduce.validation import passive_torque
from myowarp.definitions.body import BODIES
from myowarp.inks import BLUE, GREEN, PINK, VERMILION
from myowarp.models.conditions import Exoskeleton, FatigueMa2009, Sarcopenia

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANGLE = 90.0  # deg
HOLD, SETTLED = 20.0, 15.0  # s
ARMS = {
    "normal": (1.0, 0.0),
    "sarcopenia": (0.5, 0.0),
    "fatigue": (1.0, PER_SECOND),
    "fatigue, k = 1/min": (1.0, 1.0),
}
"""Strength [1] and rate of fatigue [1/min]."""

EACH = tuple((name, a) for name in ARMS for a in (0.0, ASSISTANCE))
GROUPS = tuple((who, name, a) for who in (BRACE, DRIVEN) for name, a in EACH)
TIRED = [g for g, (_, arm, _) in enumerate(GROUPS) if arm.startswith("fatigue")]
PAPER_ERROR = {"normal": (4.12, 2.97), "sarcopenia": (6.03, 2.97), "fatigue": (11.89, 4.03)}  # deg
PAPER_CHANGE = {  # %, by flexor
    "activation": {
        "normal": (-40.0, -30.0, -41.0),
        "sarcopenia": (-52.0, -44.0, -54.0),
        "fatigue": (-61.0, -56.0, -62.0),
    },
    "force": {
        "normal": (-41.0, -34.0, -43.0),
        "sarcopenia": (-55.0, -50.0, -56.0),
        "fatigue": (-98.0, -98.0, -88.0),
    },
}


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    strength, rate = (np.repeat([ARMS[name][i] for name, _ in EACH], lab.num_worlds) for i in range(2))
    assistance = np.repeat([a for _, a in EACH], lab.num_worlds)
    muscles = Sarcopenia(strength), FatigueMa2009(rate)

    def hold(name: str, motor: bool) -> list[dict[str, np.ndarray]]:
        brace = Exoskeleton(assistance, motor=motor, forearm_mass=np.where(assistance > 0.0, CUFF, 0.0))
        still = [a == 0.0 for _, a in EACH] if motor else ()
        trainings = [MOTOR if motor else ASSISTED] * len(EACH)
        target = np.array([[ANGLE]])
        return run_groups(lab, name, EACH, trainings, lambda: (*muscles, brace), target, HOLD, still)

    return findings(beside(hold("hold", False), hold("drive", True)))


def held(result: dict[str, np.ndarray], quantity: str) -> np.ndarray:
    """Return means over the last seconds of the hold, shape (groups, ...)."""
    return result[quantity][late(1, HOLD, SETTLED)].mean(axis=0)


def change(result: dict[str, np.ndarray], quantity: str, arm: str, who: str = BRACE) -> np.ndarray:
    """Return by how much assistance changes the flexors' activation or force [%], shape (3,)."""
    means = held(result, quantity)
    return relative_change(means, GROUPS.index((who, arm, ASSISTANCE)), GROUPS.index((who, arm, 0.0)))


def gravity_torque() -> float:
    """Return what the forearm weighs about the elbow at the angle that is held [N m]."""
    model = BODIES["elbow"].build().compile()
    data = mujoco.MjData(model)
    data.qpos[0] = np.radians(ANGLE)
    mujoco.mj_forward(model, data)
    return float(data.qfrc_bias[0])


def ideal_change(passive: float, gravity: float) -> float:
    """Return by how much assistance changes the flexors' torque in an ideal hold of the normal arm [%].

    The flexors make p + g / (1 + a): p against the passive pull of all muscles, g against gravity.

    Args:
        passive: The pull p, away from flexion [N m].
        gravity: The weight's torque g [N m].
    """
    return 100.0 * ((passive + gravity / (1.0 + ASSISTANCE)) / (passive + gravity) - 1.0)


def crossing(result: dict[str, np.ndarray], group: int, error: float) -> float:
    """Return when the error of a group rises above a value for good [s]; NaN if never."""
    course = result["error"][:, group]
    below = np.flatnonzero(course <= error)
    first = below[-1] + 1 if below.size else 0
    return CONTROL_DT * (first + 1.0) if first < len(course) else float("nan")


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    errors = np.array([held(result, "error") for result in results])
    error = {group: errors[:, g] for g, group in enumerate(GROUPS)}
    lost = 100.0 * np.array([held(result, "fatigue")[:, 3:].mean(axis=1) for result in results])
    changes = {
        (who, q, arm): np.array([change(r, q, arm, who) for r in results])
        for who in (BRACE, DRIVEN)
        for q in PAPER_CHANGE
        for arm in ARMS
    }
    gravity, torques = gravity_torque(), passive_torque(np.radians(ANGLE))
    ideal, theirs = (ideal_change(-torque, gravity) for torque in torques)

    def with_(arm: str, who: str = BRACE) -> np.ndarray:
        return error[who, arm, ASSISTANCE]

    def without(arm: str, who: str = BRACE) -> np.ndarray:
        return error[who, arm, 0.0]

    def relieved(who: str) -> bool | None:
        return both(
            *(rises(-own) for q in PAPER_CHANGE for arm in PAPER_ERROR for own in changes[who, q, arm].T)
        )

    def grows(who: str) -> bool | None:
        steps = (("normal", "sarcopenia"), ("sarcopenia", "fatigue"))
        return both(*(rises(with_(more, who) - with_(less, who)) for less, more in steps))

    def near(who: str) -> bool | None:
        return both(*(stays(with_(arm, who) - mean, sd) for arm, (mean, sd) in PAPER_ERROR.items()))

    holds = {
        "relieved": relieved(BRACE),
        "error grows": grows(BRACE),
        "error": near(BRACE),
        "relieved, motor": relieved(DRIVEN),
        "error grows, motor": grows(DRIVEN),
        "error, motor": near(DRIVEN),
        "error unassisted": both(
            *(rises(without(arm) - without("normal")) for arm in ("sarcopenia", "fatigue"))
        ),
        "error relieved": both(*(rises(without(arm) - with_(arm)) for arm in ("sarcopenia", "fatigue"))),
        "fatigue": both(*(rises(lost[:, g] - lost[:, g + 1]) for g in TIRED[: len(TIRED) // 2 : 2])),
    }
    power = [held(result, "metabolic_rate") for result in results]
    measured = {
        "power": {
            arm: np.mean(
                [saved_power(m, *(GROUPS.index((BRACE, arm, a)) for a in (ASSISTANCE, 0.0))) for m in power]
            )
            for arm in PAPER_ERROR
        },
        "number": len(results),
        "passive": torques,
        "gravity": gravity,
        "ideal": ideal,
        "theirs": theirs,
        "error": {arm: with_(arm).mean() for arm in PAPER_ERROR},
        "driven": {arm: with_(arm, DRIVEN).mean() for arm in PAPER_ERROR},
        "force": {arm: changes[BRACE, "force", arm].mean() for arm in PAPER_ERROR},
        "force_driven": {arm: changes[DRIVEN, "force", arm].mean() for arm in PAPER_ERROR},
    }
    rows = hold_merits(results, errors, changes, lost, ideal)
    return Findings(rows, holds, lambda figure: draw(figure, results, errors, measured), measured)


def hold_merits(
    results: list[dict[str, np.ndarray]],
    errors: np.ndarray,
    changes: dict[tuple[str, str, str], np.ndarray],
    lost: np.ndarray,
    ideal: float,
) -> list[Merit]:
    """Return rows of errors, changes and what muscles do.

    Args:
        results: Of the seeds.
        errors: In the last seconds [deg], shape (seeds, groups).
        changes: By assistance [%], by wearer, quantity and arm, shape (seeds, flexors).
        lost: Share of the flexors' peak force [%], shape (seeds, groups).
        ideal: Change of force in an ideal hold [%].
    """
    names = [f"{who}, {assisted(arm, a)}" for who, arm, a in GROUPS]
    rows = []
    for (_, arm, a), name, own in zip(GROUPS, names, errors.T, strict=True):
        paper, spread = PAPER_ERROR.get(arm, (None, None)) if a else (None, None)
        rows.append(Merit("error of the elbow angle", "°", name, own, paper, spread, within=POSITIVE))
    tiring, limit = GROUPS.index((BRACE, "fatigue", ASSISTANCE)), PAPER_ERROR["fatigue"][0]
    when = [crossing(result, tiring, limit) for result in results]
    what = f"when the error passes the paper's {limit:g}°"
    rows.append(Merit(what, "s", names[tiring], when, within=POSITIVE))
    for (who, quantity, arm), values in changes.items():
        known = PAPER_CHANGE[quantity].get(arm, (None,) * len(FLEXORS))
        for muscle, own, value in zip(FLEXORS, values.T, known, strict=True):
            what, where = f"change of {quantity}, {muscle}", f"{who}, {arm}"
            rows.append(Merit(what, "%", where, own, value, within=CHANGE))
    note = f"an ideal hold: {ideal:.0f} %, see below"
    for arm in ("normal", "sarcopenia"):
        means = changes[BRACE, "force", arm].mean(axis=1)
        what, who = "change of force, mean of the flexors", f"{BRACE}, {arm}"
        rows.append(Merit(what, "%", who, means, note=note, within=CHANGE))
    power = np.array([held(result, "metabolic_rate") for result in results])
    for who in (BRACE, DRIVEN):
        for arm in ARMS:
            with_, without = (GROUPS.index((who, arm, a)) for a in (ASSISTANCE, 0.0))
            own = [saved_power(means, with_, without) for means in power]
            what, where = "change of metabolic rate, all muscles", f"{who}, {arm}"
            rows.append(Merit(what, "%", where, own, within=CHANGE))
            watts = power[:, without].sum(axis=1)
            rows.append(Merit("metabolic rate without assistance", "W", where, watts, within=POSITIVE))
    forces, drives = (np.array([held(r, q) for r in results]) for q in ("force", "activation"))
    ratio = forces[..., :3].sum(axis=2) / forces[..., 3:].sum(axis=2)
    rows += merits(
        names,
        ("force of the extensors over that of the flexors", "1", ratio.T),
        ("activation of the extensors", "1", drives[..., :3].mean(axis=2).T),
        within=POSITIVE,
    )
    tired = "peak force lost, mean of the flexors", "%", lost[:, TIRED].T
    return rows + merits([names[g] for g in TIRED], tired, within=PERCENT)


def draw(
    figure: Figure, results: list[dict[str, np.ndarray]], errors: np.ndarray, measured: dict[str, Any]
) -> None:
    """Draw error and activation over time, errors and changes beside the paper's."""
    figure.set_size_inches(8.0, 6.4)
    top, (levels, changes) = figure.subplots(2, 2)
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    colors = dict(zip(PAPER_ERROR, (GREEN, BLUE, VERMILION), strict=True))
    for axes, quantity in zip(top, ("error", "activation"), strict=True):
        for g, (who, arm, a) in enumerate(GROUPS):
            if arm not in PAPER_ERROR or who != BRACE:
                continue
            values = np.array([r[quantity][:, g] for r in results])
            values = values[..., 3:].mean(axis=2) if quantity == "activation" else values
            label = f"{arm}, {'with' if a else 'without'}"
            style = "-" if a else "--"
            panel.band(axes, time, panel.extent(values), style, color=colors[arm], alpha=0.12, label=label)
        axes.set_xlabel("time [s]")
    top[0].set(title="brace that follows: |angle - 90°|", ylabel="error [°]", xlim=(0.0, HOLD))
    top[0].set_ylim(0.0, 1.3 * errors.mean(axis=0).max())
    top[1].set(title="mean activation of the flexors", ylabel="activation", ylim=(0.0, None))
    places = np.arange(len(PAPER_ERROR))
    means, spreads = zip(*PAPER_ERROR.values(), strict=True)
    levels.bar(places - 0.3, means, 0.19, yerr=spreads, color="0.75", label="paper, with")
    looks = (
        (-0.1, BRACE, ASSISTANCE, BLUE, "brace, with"),
        (0.1, BRACE, 0.0, VERMILION, "brace, without"),
        (0.3, DRIVEN, ASSISTANCE, PINK, "motor, with"),
    )
    for shift, who, a, color, label in looks:
        own = errors[:, [GROUPS.index((who, arm, a)) for arm in PAPER_ERROR]]
        panel.bars(levels, places + shift, own, 0.19, color=color, label=label)
    levels.set(title="error in the last 5 s", ylabel="error [°]")
    for shift, who, color, label in ((-0.1, BRACE, BLUE, "brace"), (0.2, DRIVEN, PINK, "motor")):
        own = np.array([[change(r, "force", arm, who).mean() for arm in PAPER_ERROR] for r in results])
        panel.bars(changes, places + shift, own, 0.28, color=color, label=label)
    paper = [np.mean(PAPER_CHANGE["force"][arm]) for arm in PAPER_ERROR]
    changes.plot(places - 0.35, paper, "kD", markersize=5, linestyle="none", label="paper")
    changes.axhline(measured["ideal"], color="k", linewidth=0.8, linestyle=":", label="ideal, our triceps")
    changes.axhline(measured["theirs"], color="k", linewidth=0.8, linestyle="--", label="ideal, OpenSim's")
    changes.set(title="change of force, mean of the flexors", ylabel="%")
    for axes in (levels, changes):
        axes.set_xticks(places, list(PAPER_ERROR))
    changes.set_ylim(-105.0, 40.0)
    for axes in (top[1], levels, changes):
        axes.legend(fontsize=7, loc="upper left", ncols=2 if axes is changes else 1)


EXPERIMENT = Experiment("exo2", run)
