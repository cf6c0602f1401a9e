"""Speed: forward simulation beside OpenSim's, with 1 to 64 times the muscles.

Paper: the elbow with its six muscles, each replicated; MuJoCo is 60 to 4,000 times faster than OpenSim, and
the more so the more muscles there are.

Open in the paper, and chosen here: accuracy and step of OpenSim, the duration of an episode and the
excitation. The benchmark (`make opensim`, `benchmarks/opensim_speed.py`) says its own and what else differs.
It needs OpenSim and the models; this command draws what it measured, `opensim_speed.json`, which is
committed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.apps.studies.reproduce.experiment import Experiment, Lab
from myowarp.apps.studies.reproduce.result import Claim, Findings, Merit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULT = Path(__file__).parents[4] / "benchmarks/results/opensim_speed.json"
PAPER = 60.0, 4000.0  # times as fast as OpenSim, least and greatest
OPENSIM, MUJOCO = "OpenSim", "MuJoCo C, 1 thread"
COLORS = ("#6b6b6b", "#7aa6c9", "#1f5fa8", "#0b2f57")


def run(lab: Lab) -> Findings:
    """Read what the benchmark measured.

    Raises:
        ValueError: The result is not there.
    """
    if not RESULT.is_file():
        raise ValueError(
            f"speed draws {RESULT.name}: a checkout of the repository has it, the installed package does not"
        )
    return findings(json.loads(RESULT.read_text()))


def contestants(model: dict[str, Any]) -> list[str]:
    """Return who was measured beside OpenSim: MuJoCo, then MyoWarp on ever more."""
    return [who for who in next(iter(model["copies"].values())) if not who.startswith(OPENSIM)]


def ratios(model: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers of muscles (C,), and median, least and greatest ratio to OpenSim (3, C)."""
    rows = list(model["copies"].values())
    over = [[row[name]["over_opensim"][key] for key in ("median", "min", "max")] for row in rows]
    return np.array([row[OPENSIM]["muscles"] for row in rows]), np.array(over).T


def findings(report: dict[str, Any]) -> Findings:
    """Return figures of merit, claims and figure."""
    merits, grows = [], []
    for name, model in report["models"].items():
        for who in contestants(model):
            muscles, rounds = ratios(model, who)
            for place, paper in ((0, PAPER[0]), (-1, PAPER[1])):
                condition = f"{name}, {muscles[place]} muscles, {who}"
                known = paper if name == "arm26" else None
                # Median, least and greatest are all there is of three rounds.
                values = rounds[:, place] if report["rounds"] == 3 else rounds[:1, place]
                merits.append(Merit("times as fast as OpenSim", "", condition, tuple(values), known))
            grows.append(float(rounds[0, -1] / rounds[0, 0]))
    arm = {
        who: ratios(report["models"]["arm26"], who)[1][0] for who in contestants(report["models"]["arm26"])
    }
    claims = (
        Claim(
            "The advantage over OpenSim grows with the number of muscles, for every contestant and model.",
            min(grows) > 1.0,
            f"From 1 to 64 times the muscles by a factor of {min(grows):.1f} to {max(grows):.1f}.",
        ),
        Claim(
            "One world in MuJoCo is at least 60 times as fast on arm26.", bool(arm[MUJOCO].min() >= PAPER[0])
        ),
        Claim(
            "A batch of worlds is at least 60 times as fast on arm26.",
            bool(min(ratio.min() for who, ratio in arm.items() if who != MUJOCO) >= PAPER[0]),
        ),
        Claim("One world in MuJoCo comes to 4,000 times on arm26.", bool(arm[MUJOCO].max() >= PAPER[1])),
    )
    return Findings(
        tuple(merits),
        claims,
        text(report, arm),
        lambda figure: draw(figure, report),
        over="rounds of the benchmark",
    )


def text(report: dict[str, Any], arm: dict[str, np.ndarray]) -> str:
    """Return where ours differs from the paper, and why."""
    rate = {
        n: list(report["models"]["arm26"]["copies"].values())[n][OPENSIM]["rate"]["median"] for n in (0, -1)
    }
    last = list(arm)[-1]
    notes = "\n".join(f"* {key}: {value}" for key, value in report["differences"].items())
    return f"""
**Less than the paper's 60 to 4,000.** One world of MuJoCo is {arm[MUJOCO][0]:.0f} times as fast as OpenSim
with six muscles and {arm[MUJOCO][-1]:.0f} times with 384; {report["models"]["arm26"]["duration"]:g} s of
arm26, {rate[0]:g} and {rate[-1]:g} simulated seconds a second in OpenSim {report["versions"]["opensim"]}. The
sign and the growth are the paper's. The size depends on what is asked of OpenSim, and the paper gives neither
the accuracy of its integrator nor its release. What a user of MyoWarp gains is the batch: {arm[last][0]:.0f}
to {arm[last][-1]:.0f} times ({last}).

{notes}

Measured on {report["processor"]}, {report["cores"]} cores; `cores_busy_with_others` in the JSON says who else
used them. The benchmark took {report["rounds"]} rounds.
"""


def draw(figure: Figure, report: dict[str, Any]) -> None:
    """Draw the ratio to OpenSim over the number of muscles, a panel a model."""
    figure.set_figheight(4.0)
    for axes, (name, model) in zip(figure.subplots(1, 2, sharey=True), report["models"].items(), strict=True):
        for who, color in zip(contestants(model), COLORS, strict=False):
            muscles, (median, low, high) = ratios(model, who)
            axes.errorbar(
                muscles, median, (median - low, high - median), color=color, marker="o", ms=4, label=who
            )
        axes.axhspan(*PAPER, color="#e09f3e", alpha=0.15, label="paper's range" if name == "arm26" else None)
        axes.axhline(1.0, color="#b3362b", linewidth=1.0)
        axes.set(title=name, xscale="log", yscale="log", xlabel="muscles")
        muscles, _ = ratios(model, OPENSIM)
        axes.set_xticks(muscles, [str(number) for number in muscles])
        axes.minorticks_off()
    figure.axes[0].set_ylabel("times as fast as OpenSim")
    figure.axes[0].legend(loc="upper left")


EXPERIMENT = Experiment(
    "speed",
    "Forward simulation beside OpenSim's, with 1 to 64 times the muscles",
    "Figure of speed: MuJoCo is 60 to 4,000 times as fast as OpenSim, growing with the number of muscles.",
    run,
    ignores=("seeds", "num_worlds", "retrain", "models", "device"),
)
