"""Exoskeleton II: a normal, a weak and a tiring arm hold 90 degrees, with and without a powered brace."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from myowarp.apps.reports import panel
from myowarp.apps.reports.result import Merit, merits
from myowarp.apps.studies.reproduce.arm import ASSISTANCE, ASSISTED, CONTROL_DT, FLEXORS, late, run_groups
from myowarp.apps.studies.reproduce.exo1 import CUFF, assisted, relative_change
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.definitions.body import BODIES
from myowarp.models.conditions import Exoskeleton, FatigueMa2009, Sarcopenia

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANGLE = 90.0  # deg
HOLD, SETTLED = 20.0, 15.0  # s
PER_SECOND = 60.0  # 1/min
ARMS = {
    "normal": (1.0, 0.0),
    "sarcopenia": (0.5, 0.0),
    "fatigue": (1.0, PER_SECOND),
    "fatigue, k = 1/min": (1.0, 1.0),
}
"""Strength [1] and rate of fatigue [1/min]."""

GROUPS = tuple((name, a) for name in ARMS for a in (0.0, ASSISTANCE))
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
    each = lab.num_worlds
    strength, rate = (np.repeat([ARMS[name][i] for name, _ in GROUPS], each) for i in range(2))
    assistance = np.repeat([a for _, a in GROUPS], each)
    conditions = (
        Sarcopenia(strength),
        FatigueMa2009(rate),
        Exoskeleton(assistance, forearm_mass=np.where(assistance > 0.0, CUFF, 0.0)),
    )
    trainings = (ASSISTED,) * len(GROUPS)
    results = run_groups(lab, "hold", GROUPS, trainings, lambda: conditions, np.array([[ANGLE]]), HOLD)
    return findings(results)


def held(result: dict[str, np.ndarray], quantity: str) -> np.ndarray:
    """Return means over the last seconds of the hold, shape (groups, ...)."""
    return result[quantity][late(1, HOLD, SETTLED)].mean(axis=0)


def change(result: dict[str, np.ndarray], quantity: str, arm: str) -> np.ndarray:
    """Return by how much assistance changes the flexors' activation or force [%], shape (3,)."""
    means = held(result, quantity)
    return relative_change(means, GROUPS.index((arm, ASSISTANCE)), GROUPS.index((arm, 0.0)))


def ideal_change() -> float:
    """Return by how much assistance changes the flexors' torque in an ideal hold of the normal arm [%].

    The flexors make p + g / (1 + a): p against the passive pull of all muscles, g against gravity.
    """
    model = BODIES["elbow"].build().compile()
    data = mujoco.MjData(model)
    data.qpos[0] = np.radians(ANGLE)
    mujoco.mj_forward(model, data)
    passive, gravity = -data.qfrc_actuator[0], data.qfrc_bias[0]
    return float(100.0 * ((passive + gravity / (1.0 + ASSISTANCE)) / (passive + gravity) - 1.0))


def findings(results: list[dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure."""
    errors, forces, drives, lost = (
        np.array([held(result, quantity) for result in results])
        for quantity in ("error", "force", "activation", "fatigue")
    )
    error = {group: errors[:, g] for g, group in enumerate(GROUPS)}
    who = [assisted(arm, a) for arm, a in GROUPS]
    rows = []
    for (arm, a), name in zip(GROUPS, who, strict=True):
        paper = PAPER_ERROR.get(arm, (None, None)) if a else (None, None)
        rows.append(Merit("error of the elbow angle", "°", name, error[arm, a], *paper))
    changes = {(q, arm): np.array([change(r, q, arm) for r in results]) for q in PAPER_CHANGE for arm in ARMS}
    for (quantity, arm), values in changes.items():
        known = PAPER_CHANGE[quantity].get(arm, (None,) * len(FLEXORS))
        for muscle, own, value in zip(FLEXORS, values.T, known, strict=True):
            rows.append(Merit(f"change of {quantity}, {muscle}", "%", arm, own, value))
    note = f"an ideal hold: {ideal_change():.0f} %, see below"
    for arm in ("normal", "sarcopenia"):
        means = [change(r, "force", arm).mean() for r in results]
        rows.append(Merit("change of force, mean of the flexors", "%", arm, means, note=note))
    ratio = forces[..., :3].sum(axis=2) / forces[..., 3:].sum(axis=2)
    rows += merits(
        who,
        ("force of the extensors over that of the flexors", "1", ratio.T),
        ("activation of the extensors", "1", drives[..., :3].mean(axis=2).T),
    )
    lost = lost[..., 3:].mean(axis=2)
    tiring = [g for g, (arm, _) in enumerate(GROUPS) if arm.startswith("fatigue")]
    rows += merits(
        [who[g] for g in tiring], ("peak force lost, mean of the flexors", "%", 100.0 * lost[:, tiring].T)
    )
    with_, without = ({arm: error[arm, a] for arm in ARMS} for a in (ASSISTANCE, 0.0))
    tired = changes["force", "fatigue"]
    holds = {
        "relieved": all(
            (changes[q, arm] < 0.0).all() for q in PAPER_CHANGE for arm in ("normal", "sarcopenia")
        ),
        "tired force": (tired < 0.0).all(),
        "tired mean force": (tired.mean(axis=1) < 0.0).all(),
        "error grows": with_["normal"].mean() < with_["sarcopenia"].mean() < with_["fatigue"].mean(),
        "error": all(abs(with_[arm].mean() - mean) <= sd for arm, (mean, sd) in PAPER_ERROR.items()),
        "error unassisted": without["normal"].mean()
        < min(without["sarcopenia"].mean(), without["fatigue"].mean()),
        "error relieved": all((with_[arm] < without[arm]).all() for arm in ("sarcopenia", "fatigue")),
        "fatigue": (lost[:, tiring[::2]] > lost[:, tiring[1::2]]).all(),
    }
    said = ", ".join(f"{value:+.0f} %" for value in tired.max(axis=1))
    return Findings(rows, holds, lambda figure: draw(figure, results, errors), {"tired": said})


def draw(figure: Figure, results: list[dict[str, np.ndarray]], errors: np.ndarray) -> None:
    """Draw error over time, errors beside the paper's, and activations."""
    figure.set_size_inches(8.0, 5.6)
    top, (levels, changes) = figure.subplots(2, 2)
    time = CONTROL_DT * np.arange(1, len(results[0]["angle"]) + 1)
    colors = dict(zip(ARMS, ("#3f9b63", "#2f6fb5", "#b5446e", "#d9a441"), strict=True))
    for axes, quantity in zip(top, ("error", "activation"), strict=True):
        for g, (arm, a) in enumerate(GROUPS):
            if arm not in PAPER_ERROR:
                continue
            values = np.array([r[quantity][:, g] for r in results])
            values = values[..., 3:].mean(axis=2) if quantity == "activation" else values
            label = f"{arm}, {'with' if a else 'without'}"
            axes.plot(time, values.mean(axis=0), "-" if a else "--", color=colors[arm], label=label)
        axes.set_xlabel("time [s]")
    top[0].set(title="|angle - 90°|", ylabel="error [°]", xlim=(1.0, HOLD))
    top[0].set_ylim(0.0, 1.3 * errors.mean(axis=0).max())
    top[1].set(title="mean activation of the flexors", ylabel="activation")
    places = np.arange(len(PAPER_ERROR))
    means, spreads = zip(*PAPER_ERROR.values(), strict=True)
    levels.bar(places - 0.27, means, 0.25, yerr=spreads, color="0.75", label="paper, with assistance")
    for shift, a, color in ((0.0, ASSISTANCE, "#2f6fb5"), (0.27, 0.0, "#d9622b")):
        own = errors[:, [GROUPS.index((arm, a)) for arm in PAPER_ERROR]]
        label = f"ours, {'with' if a else 'without'}"
        panel.bars(levels, places + shift, own, 0.25, color=color, label=label)
    levels.set(title="error in the last 5 s, dots are seeds", ylabel="error [°]")
    for shift, quantity, color in ((-0.2, "activation", "#2f6fb5"), (0.2, "force", "#7d5ba6")):
        own = np.array([[change(r, quantity, arm).mean() for r in results] for arm in PAPER_ERROR])
        paper = [np.mean(PAPER_CHANGE[quantity][arm]) for arm in PAPER_ERROR]
        changes.bar(places + shift, own.mean(axis=1), 0.36, color=color, label=f"{quantity}, ours")
        changes.plot(places + shift, paper, "kD", markersize=5, label=None if shift > 0 else "paper")
    changes.axhline(ideal_change(), color="k", linewidth=0.8, linestyle=":", label="ideal hold, normal arm")
    changes.set(title="change by assistance, mean of the flexors", ylabel="%")
    for axes in (levels, changes):
        axes.set_xticks(places, list(PAPER_ERROR))
    for axes in (top[1], levels, changes):
        axes.legend(fontsize=7)


EXPERIMENT = Experiment("exo2", run)
