"""Speed: forward simulation beside OpenSim's, with 1 to 64 times the muscles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.reports.result import Merit
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab
from myowarp.inks import BLACK, BLUE, GREEN, ORANGE, SKY, VERMILION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RECORD = Path(__file__).with_name("opensim_speed.json")
PAPER = 60.0, 4000.0  # times as fast as OpenSim, least and greatest
OPENSIM, LOOSE, MUJOCO = "OpenSim", "OpenSim, accuracy 1e-3", "MuJoCo C, 1 thread"
COLORS = (BLACK, SKY, BLUE, GREEN)


def run(lab: Lab) -> Findings:
    """Read what the benchmark measured."""
    return findings(json.loads(RECORD.read_text()))


def contestants(model: dict[str, Any]) -> list[str]:
    """Return who was measured beside OpenSim: MuJoCo, then MyoWarp on ever more."""
    return [who for who in next(iter(model["copies"].values())) if not who.startswith(OPENSIM)]


def ratios(model: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers of muscles (C,), and median, least and greatest ratio to OpenSim (3, C)."""
    rows = list(model["copies"].values())
    over = [[row[name]["over_opensim"][key] for key in ("median", "min", "max")] for row in rows]
    return np.array([row[OPENSIM]["muscles"] for row in rows]), np.array(over).T


def of(row: dict[str, Any], name: str) -> float:
    """Return the median rate of a contestant [simulated s/s]."""
    return float(row[name]["rate"]["median"])


def findings(report: dict[str, Any]) -> Findings:
    """Return figures of merit, claims and figure."""
    rows, grows = [], []
    for name, model in report["models"].items():
        for who in contestants(model):
            muscles, rounds = ratios(model, who)
            # Median, least and greatest are all there is of three rounds.
            rounds = rounds if report["rounds"] == 3 else rounds[:1]
            for place, paper in ((0, PAPER[0]), (-1, PAPER[1])):
                condition = f"{name}, {muscles[place]} muscles, {who}"
                known = paper if name == "arm26" else None
                note = f"median {rounds[0, place]:.0f}"
                rows.append(
                    Merit("times as fast as OpenSim", "", condition, rounds[:, place], known, note=note)
                )
            grows.append(float(rounds[0, -1] / rounds[0, 0]))
    model = report["models"]["arm26"]
    arm = {who: ratios(model, who)[1][0] for who in contestants(model)}
    batches = [ratio.min() for who, ratio in arm.items() if who != MUJOCO]
    holds = {
        "grows": min(grows) > 1.0,
        "one world, 60": arm[MUJOCO].min() >= PAPER[0],
        "batch, 60": min(batches) >= PAPER[0],
        "one world, 4000": arm[MUJOCO].max() >= PAPER[1],
    }
    rates = [of(row, OPENSIM) for row in model["copies"].values()]
    last = list(arm)[-1]
    loose = [
        f"{name}, {row[OPENSIM]['muscles']} muscles: {of(row, LOOSE) / of(row, OPENSIM):.2g}"
        for name, one in report["models"].items()
        for row in (list(one["copies"].values())[place] for place in (0, -1))
    ]
    measured = {
        "report": report,
        "grows": (min(grows), max(grows)),
        "single": arm[MUJOCO][[0, -1]],
        "rate": (rates[0], rates[-1]),
        "batch": arm[last][[0, -1]],
        "last": last,
        "loose": "; ".join(loose),
        "notes": "\n".join(f"* {key}: {value}" for key, value in report["differences"].items()),
    }
    over = "rounds of the benchmark"
    return Findings(rows, holds, lambda figure: draw(figure, report), measured, over)


def draw(figure: Figure, report: dict[str, Any]) -> None:
    """Draw the ratio to OpenSim over the number of muscles, a panel a model."""
    figure.set_figheight(4.0)
    for axes, (name, model) in zip(figure.subplots(1, 2, sharey=True), report["models"].items(), strict=True):
        for who, color in zip(contestants(model), COLORS, strict=False):
            muscles, (median, low, high) = ratios(model, who)
            axes.errorbar(
                muscles, median, (median - low, high - median), color=color, marker="o", ms=4, label=who
            )
        axes.axhspan(*PAPER, color=ORANGE, alpha=0.15, label="paper's range" if name == "arm26" else None)
        axes.axhline(1.0, color=VERMILION, linewidth=1.0, label=OPENSIM)
        axes.set(title=name, xscale="log", yscale="log", xlabel="muscles")
        muscles, _ = ratios(model, OPENSIM)
        axes.set_xticks(muscles, [str(number) for number in muscles])
        axes.minorticks_off()
    figure.axes[0].set_ylabel("times as fast as OpenSim")
    figure.axes[0].legend(loc="upper left")


EXPERIMENT = Experiment("speed", run, ignores=("seeds", "num_worlds", "retrain", "models", "device"))
