"""Motor: a finger with muscles and one with motors, trained alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint, check_contract
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.reports import panel
from myowarp.apps.reports.result import PERCENT, Merit, both, merits, rises
from myowarp.apps.rollouts.run import Step, Watcher
from myowarp.apps.rollouts.run import run as roll
from myowarp.apps.studies.reproduce.experiment import Experiment, Findings, Lab, Tick
from myowarp.apps.studies.reproduce.policies import Training
from myowarp.definitions.setup import Setup
from myowarp.inks import BLUE, VERMILION
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state, set_state

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("PoseFixed", "PoseRandom", "ReachFixed", "ReachRandom")
QUICK_KINDS = ("PoseFixed",)
FINGERS = {"muscles": ("myoFinger{}-v0", 0.95), "motors": ("motorFinger{}-v1", 0.95**0.5)}
"""Task of each kind, and discount of a control step: 20 ms with muscles, 10 ms with motors."""

SAMPLES, ENDING = 3_000_000, 0.995
LEARNER = {
    **{"num_worlds": 64, "rollout_steps": 32, "hidden": (64, 64), "physics": "parity", "trace_decay": 0.9},
    **{"epochs": 5, "minibatches": 4, "initial_std": 0.6, "stop_success": ENDING},
    **{"stop_rule": "success_last"},
}
GRID = 0.02  # s, at which both are compared
KICK = 10.0  # rad/s, standard deviation of what is added to each joint's velocity halfway
SEED = 3_000_000
SEEDS = (0, 1, 2)
COLORS = {"muscles": VERMILION, "motors": BLUE}
MEASURED = ("success", "kicked", "acceleration", "work")


def training(finger: str, kind: str) -> Training:
    """Return how a finger is trained; both have the same settings, and a discount over the same time."""
    task, discount = FINGERS[finger]
    settings = LEARNER | {"discount": discount}
    return Training(f"finger_{finger}_{kind}", task.format(kind), samples=SAMPLES, settings=settings)


class Movement(Watcher):
    """Joints of every world on a grid of 20 ms: their velocity, and the work of the actuators on them.

    Attributes:
        velocity: [rad/s], an array (num_worlds, num_joints) for each point of the grid.
        work: Positive work so far, over all joints [J], shape (num_worlds,).
        solved: Whether the last step was solved, shape (num_worlds,).
    """

    def __init__(self, sim: Simulation, tick: Tick) -> None:
        self._sim, self._tick = sim, tick
        self._every = round(GRID / sim.scene.spec.control_dt)
        self.velocity: list[np.ndarray] = []
        self.work = np.zeros(sim.num_worlds)
        self.solved = np.zeros(sim.num_worlds, dtype=bool)

    def see(self, step: Step) -> None:
        """Add a step; the torque is that of its last physics step."""
        data = self._sim.scene.data
        torque, velocity = data.qfrc_actuator.numpy(), data.qvel.numpy()
        self.work += np.maximum(torque * velocity, 0.0).sum(axis=1) * self._sim.scene.spec.control_dt
        if step.number % self._every == 0:
            self.velocity.append(velocity.copy())
        self.solved = step.solved.copy()
        self._tick(step.number / self._sim.horizon)


def run(lab: Lab) -> Findings:
    """Run the protocol."""
    kinds = QUICK_KINDS if lab.quick else KINDS
    seeds = SEEDS[:2] if lab.quick else SEEDS
    cells = [(kind, finger) for kind in kinds for finger in FINGERS]
    policies = {cell: [lab.policy(training(*cell[::-1]), seed) for seed in seeds] for cell in cells}
    lab.expect(len(cells) * len(seeds))
    found = {}
    for cell, own in policies.items():
        runs = [move(lab, *cell, seed, policy) for seed, policy in zip(seeds, own, strict=True)]
        found[cell] = {name: np.array([float(one[name]) for one in runs]) for name in MEASURED}
        found[cell]["samples"] = np.array([policy.manifest["samples"] / 1e6 for policy in own])
    return findings(found)


def move(lab: Lab, kind: str, finger: str, seed: int, policy: Checkpoint) -> dict[str, np.ndarray]:
    """Let a policy's means move a finger for an episode, undisturbed and with a kick halfway.

    Returns:
        Means over worlds: `success` and `kicked`, solved in the last step [%]; `acceleration`, root mean
        square over joints and time [rad/s^2], and `work` [J], both undisturbed.
    """
    task = FINGERS[finger][0].format(kind)

    def measure(tick: Tick) -> dict[str, np.ndarray]:
        setup = Setup(task=task, physics="parity", seed=SEED).over(lab.setup)
        sim = Simulation(setup, lab.num_worlds, autoreset="disabled", progress=False)
        check_contract(policy, sim)
        act = LearnedPolicy(policy)
        calm = Movement(sim, lambda share: tick(share / 2))
        roll(sim, act, sim.horizon, calm, again=False)
        roll(sim, act, sim.horizon // 2, again=False)
        state = get_state(sim)
        kicks = np.random.default_rng(SEED).normal(0.0, KICK, state.arrays["data.qvel"].shape)
        state.arrays["data.qvel"] = (state.arrays["data.qvel"] + kicks).astype(np.float32)
        set_state(sim, state)
        kicked = Movement(sim, lambda share: tick(0.5 + share / 2))
        roll(sim, act, sim.horizon - sim.horizon // 2, kicked, fresh=False, again=False)
        sim.close()
        acceleration = np.diff(calm.velocity, axis=0) / GRID
        return {
            "success": np.array(100.0 * calm.solved.mean()),
            "kicked": np.array(100.0 * kicked.solved.mean()),
            "acceleration": np.sqrt((acceleration**2).mean()),
            "work": calm.work.mean(),
        }

    settings = {"task": task, "seed": SEED, "num_worlds": lab.num_worlds, "kick": KICK, "policy": seed}
    return lab.kept(f"{finger}_{kind}-seed{seed}", settings, measure, policy)


def findings(found: dict[tuple[str, str], dict[str, np.ndarray]]) -> Findings:
    """Return figures of merit, claims and figure, from values of the seeds by kind and finger."""
    kinds = list(dict.fromkeys(kind for kind, _ in found))
    groups = [f"{kind}, {finger}" for kind, finger in found]
    of = {name: [own[name] for own in found.values()] for name in (*MEASURED, "samples")}
    rows: list[Merit] = merits(
        groups,
        ("success, last step, means", "%", of["success"]),
        ("success after a kick", "%", of["kicked"]),
        within=PERCENT,
    )
    rows += merits(
        groups,
        ("samples of the training", "M", of["samples"]),
        ("angular acceleration, root mean square", "rad/s²", of["acceleration"]),
        ("positive work at the joints in an episode", "J", of["work"]),
    )

    def differs(name: str, sign: float) -> bool | None:
        """Whether muscles have more of it than motors in every kind, or less; None where that is open."""
        apart = (found[kind, "muscles"][name] - found[kind, "motors"][name] for kind in kinds)
        return both(*(rises(sign * own) for own in apart))

    holds = {
        "learned": all(own["success"].min() >= 90.0 for own in found.values()),
        "samples": differs("samples", 1.0),
        "smooth": differs("acceleration", -1.0),
        "work": differs("work", -1.0),
        "robust": differs("kicked", 1.0),
    }
    means = {
        name: np.array([[found[kind, finger][name].mean() for kind in kinds] for finger in FINGERS])
        for name in MEASURED
    }
    ratios = {name: np.exp(-np.diff(np.log(means[name]), axis=0).mean()) for name in ("acceleration", "work")}
    measured = {
        "kinds": len(kinds),
        **{finger: f"{own:.0f}" for finger, own in zip(FINGERS, means["success"].mean(axis=1), strict=True)},
        **{name: f"{ratio:.2g}" for name, ratio in ratios.items()},
        "seeds": len(next(iter(found.values()))["success"]),
        "kick": KICK,
        "lines": "\n".join(_line(kind, found) for kind in kinds),
    }
    return Findings(rows, holds, lambda figure: draw(figure, kinds, found), measured)


def _line(kind: str, found: dict[tuple[str, str], dict[str, np.ndarray]]) -> str:
    """Return what was measured of a kind, a line of a list."""
    parts = []
    for finger in FINGERS:
        own = {name: float(values.mean()) for name, values in found[kind, finger].items()}
        parts.append(
            f"{finger} {own['samples']:.2f} M samples, {own['success']:.0f} %, {own['kicked']:.0f} % after a "
            f"kick, {own['acceleration']:.1f} rad/s², {own['work']:.3f} J"
        )
    return f"* {kind}: {'; '.join(parts)}"


def draw(figure: Figure, kinds: list[str], found: dict[tuple[str, str], dict[str, np.ndarray]]) -> None:
    """Draw a panel for each quantity: a bar for each kind and finger, a dot for each seed."""
    figure.set_size_inches(8.0, 5.4)
    names = {
        "samples": "samples of the training [M]",
        "success": "solved in the last step [%]",
        "kicked": "the same after a kick [%]",
        "acceleration": "angular acceleration [rad/s²]",
        "work": "positive work [J]",
    }
    panels = figure.subplots(2, 3).ravel()
    for axes, (name, title) in zip(panels, names.items(), strict=False):
        for side, finger in zip((-0.2, 0.2), FINGERS, strict=True):
            places = np.arange(len(kinds)) + side
            values = [found[kind, finger][name] for kind in kinds]
            means = [own.mean() for own in values]
            axes.bar(places, means, width=0.38, color=COLORS[finger], alpha=0.55, label=finger)
            for place, own in zip(places, values, strict=True):
                axes.plot(np.full(len(own), place), own, "o", color=panel.INK, markersize=2.5)
        axes.set_xticks(range(len(kinds)), kinds, rotation=25, ha="right")
        axes.set_title(title)
        axes.set_ylim(bottom=0.0)
    panels[-1].axis("off")
    handles, labels = panels[0].get_legend_handles_labels()
    panels[-1].legend(handles, labels, loc="center")


EXPERIMENT = Experiment("motor", run, ignores=("models", "seeds"))
