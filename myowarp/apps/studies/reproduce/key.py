"""Patients turn the key: one episode of key turn in every world, groups of worlds side by side.

Open in the paper, and chosen here for `tear` and `transfer`:

* Repetitions. The task starts the same way every time, so that ten repetitions without noise would be one.
  Actions are drawn as in the training; one world of each group takes the policy's means instead.
* Rotation: the greatest angle of the key in an episode. Success at a threshold: more than 5 steps beyond it,
  the paper's rule.
* Each seed has a policy of its own, trained with that seed until 98 % of its episodes succeed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint, check_contract
from myowarp.apps.policies.learned import LearnedPolicy
from myowarp.apps.reports.result import PERCENT, Merit, merits
from myowarp.apps.rollouts.run import Each, Step, run
from myowarp.apps.studies.reproduce.experiment import Lab, Tick
from myowarp.apps.studies.reproduce.policies import Training
from myowarp.definitions.condition import Condition
from myowarp.definitions.setup import Setup
from myowarp.inks import BLACK, BLUE, GREEN, ORANGE, PINK, SKY, VERMILION
from myowarp.sim.simulation import Simulation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TASK = "myoHandKeyTurnFixed-v0"
INTACT = Training("key_turn", TASK, samples=4_000_000, settings={"stop_success": 0.98})
HORIZON, CONTROL_DT = 200, 0.02  # steps, s
THRESHOLDS = (126.0, 160.0)  # deg
LEAST_STEPS = 5  # beyond a threshold, more than this is success
COLORS = (BLACK, VERMILION, ORANGE, BLUE, GREEN, PINK, SKY)


@dataclass(frozen=True)
class Turns:
    """Key turns of one seed: G groups of N worlds with drawn actions, T steps, M muscles.

    Attributes:
        rotation: Greatest angle of the key [deg], shape (G, N).
        success: Whether the angle exceeded a threshold for more than 5 steps, shape (2, G, N).
        activation: Mean over a group's worlds that still run, shape (T, G, M).
        effort: Mean of activation over an episode, shape (G, N, M).
        mean_rotation: As `rotation`, with the policy's means as actions, shape (G,).
        mean_activation: As `activation`, of these worlds, shape (T, G, M).
        muscles: Names without the suffix of the side.
    """

    rotation: np.ndarray
    success: np.ndarray
    activation: np.ndarray
    effort: np.ndarray
    mean_rotation: np.ndarray
    mean_activation: np.ndarray
    muscles: tuple[str, ...]

    def beside(self, other: Turns) -> Turns:
        """Return the groups of both."""
        axes = {"rotation": 0, "success": 1, "activation": 1, "effort": 0, "mean_rotation": 0}
        axes["mean_activation"] = 1
        both = {n: np.concatenate((getattr(self, n), getattr(other, n)), axis) for n, axis in axes.items()}
        return Turns(muscles=self.muscles, **both)

    def of(self, muscle: str) -> int:
        """Return the place of a muscle."""
        return self.muscles.index(muscle)


def turn(
    lab: Lab,
    name: str,
    seed: int,
    groups: Sequence[str],
    policies: Sequence[Checkpoint],
    conditions: Callable[[Callable[[str], np.ndarray]], Sequence[Condition]],
) -> Turns:
    """Return the key turns of a seed.

    Args:
        lab: Where finished runs are kept.
        name: Name of the run.
        seed: Of the actions and worlds.
        groups: Names.
        policies: The policy of each group.
        conditions: Returns conditions; what it is given returns where a group is, 1 in its worlds and 0 in
            the others.
    """
    worlds = lab.num_worlds + 1  # the last one of a group takes the policy's means

    def mask(group: str) -> np.ndarray:
        return np.repeat([float(name == group) for name in groups], worlds)

    def measure(tick: Tick) -> dict[str, np.ndarray]:
        return _measure(lab, seed, worlds, policies, conditions(mask), tick)

    settings = {"seed": seed, "num_worlds": lab.num_worlds, "groups": list(groups)}
    found = lab.kept(f"{name}_{seed}", settings, measure, *policies)
    return Turns(muscles=tuple(found.pop("muscles").tolist()), **found)


def _measure(
    lab: Lab,
    seed: int,
    worlds: int,
    policies: Sequence[Checkpoint],
    conditions: Sequence[Condition],
    tick: Tick,
) -> dict[str, np.ndarray]:
    """Run one episode in every world; see `Turns`."""
    groups, n = len(policies), len(policies) * worlds
    own = Setup(task=TASK, conditions=tuple(conditions), seed=1_000_000 + 1000 * seed)
    sim = Simulation(own.over(lab.setup), n, autoreset="disabled", progress=False)
    for policy in policies:
        check_contract(policy, sim)
    drawn = [LearnedPolicy(p, Setup(seed=seed * groups + g)) for g, p in enumerate(policies)]
    meant = [LearnedPolicy(policy) for policy in policies]
    muscles = [name.removesuffix("_r") for name in sim.scene.muscles.names]
    angle_column = [c.name for c in sim.columns].index("key_qpos")
    angle_column = sum(c.size for c in sim.columns[:angle_column])
    rotation, running = np.full(n, -np.inf), np.ones(n, dtype=bool)
    steps, beyond = np.zeros(n), np.zeros((len(THRESHOLDS), n), dtype=int)
    effort, course = np.zeros((n, len(muscles))), []

    def act(obs: np.ndarray) -> np.ndarray:
        rows = obs.reshape(groups, worlds, -1)
        action = [np.vstack((d(r[:-1]), m(r[-1:]))) for d, m, r in zip(drawn, meant, rows, strict=True)]
        return np.concatenate(action)

    def look(step: Step) -> None:
        nonlocal beyond, effort, steps
        obs = sim.transition.obs.numpy()
        angle, activation = np.degrees(obs[:, angle_column]), obs[:, -len(muscles) :]
        rotation[running] = np.maximum(rotation, angle)[running]
        beyond += running & (angle > np.array(THRESHOLDS)[:, None])
        effort += np.where(running[:, None], activation, 0.0)
        steps += running
        course.append(np.where(running[:, None], activation, np.nan).reshape(groups, worlds, -1))
        running[step.ended] = False  # their episode counts as far as it went
        tick(step.number / HORIZON)

    run(sim, act, HORIZON, Each(look))
    sim.close()
    effort /= steps[:, None]
    angles, success = rotation.reshape(groups, worlds), (beyond > LEAST_STEPS).reshape(-1, groups, worlds)
    activations = np.array(course, dtype=float)
    return {
        "rotation": angles[:, :-1],
        "success": success[:, :, :-1],
        "activation": _mean(activations[:, :, :-1]),
        "effort": effort.reshape(groups, worlds, -1)[:, :-1],
        "mean_rotation": angles[:, -1],
        "mean_activation": activations[:, :, -1],
        "muscles": np.array(muscles),
    }


def _mean(course: np.ndarray) -> np.ndarray:
    """Return the mean over the worlds of a group that still run, NaN where none does."""
    count = np.isfinite(course).sum(axis=2)
    return np.where(count > 0, np.nansum(course, axis=2) / np.maximum(count, 1), np.nan)


def success(turns: Sequence[Turns]) -> np.ndarray:
    """Return the share of successes [%], shape (seeds, 2, G)."""
    return 100.0 * np.array([t.success.mean(axis=2) for t in turns])


def rotations(turns: Sequence[Turns]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean rotation with drawn actions, and that with mean actions [deg], shapes (seeds, G)."""
    return np.array([t.rotation.mean(axis=1) for t in turns]), np.array([t.mean_rotation for t in turns])


def courses(turns: Sequence[Turns], muscle: str) -> np.ndarray:
    """Return a muscle's activation with mean actions over time, shape (seeds, T, G)."""
    return np.array([t.mean_activation[..., t.of(muscle)] for t in turns])


def turn_merits(turns: Sequence[Turns], who: Sequence[str]) -> list[Merit]:
    """Return rows of success and of rotation."""
    (drawn, meant), shares = rotations(turns), success(turns)
    rows = []
    for i, threshold in enumerate(THRESHOLDS):
        name = f"success at {threshold:.0f}°, drawn actions"
        rows += merits(who, (name, "%", shares[:, i].T), within=PERCENT)
    rows += merits(who, ("rotation of the key, drawn actions", "°", drawn.T))
    return rows + merits(who, ("rotation of the key, mean actions", "°", meant.T))


def change_merits(turns: Sequence[Turns], who: Sequence[str]) -> list[Merit]:
    """Return rows of what conditions change in the rotation: paired differences to the first of them."""
    rows = []
    for name, values in zip(("drawn", "mean"), rotations(turns), strict=True):
        label = f"rotation, change to {who[0]}, {name} actions"
        rows += merits(who[1:], (label, "°", (values[:, 1:] - values[:, :1]).T))
    return rows


def draw_rotations(axes: Axes, turns: Sequence[Turns], names: Sequence[str]) -> None:
    """Draw the greatest angles of the key: a column of dots for each seed, a bar for its mean actions."""
    width = 0.7 / len(turns)
    for g, color in zip(range(len(names)), COLORS, strict=False):
        for s, t in enumerate(turns):
            middle = g + width * (s - 0.5 * (len(turns) - 1))
            places = middle + 0.35 * width * np.linspace(-1.0, 1.0, len(t.rotation[g]))
            axes.plot(places, t.rotation[g], ".", color=color, markersize=2.5, alpha=0.5)
            axes.plot(
                [middle - 0.4 * width, middle + 0.4 * width], [t.mean_rotation[g]] * 2, "k", linewidth=1.6
            )
    for threshold in THRESHOLDS:
        axes.axhline(threshold, color="0.5", linewidth=0.8, linestyle=":")
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("angle of the key [°]")
