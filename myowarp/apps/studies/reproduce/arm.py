"""Parts of the elbow's experiments: five policies, and arms that follow targets over time.

All policies are trained in `myoElbowPose1D6MRandom-v0`: start at a random angle, hold one of 0 to 130
degrees for 2 s, MyoSuite's reward. Their network is the paper's, two layers of 32; PPO takes the place of
its natural policy gradient. They act with the means of their actions.

A target changes by writing the task's own target into the state of the simulation: the policy sees a new
error, as at the begin of an episode, and the arm goes on from where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.policies.learned import Bound
from myowarp.apps.rollouts.run import Each, Step, run
from myowarp.apps.studies.reproduce.experiment import Lab, Tick
from myowarp.apps.studies.reproduce.policies import Training
from myowarp.definitions.condition import Condition
from myowarp.definitions.parameter import Uniform
from myowarp.definitions.setup import Setup
from myowarp.models.conditions import Exoskeleton, FatigueMa2009, Sarcopenia
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import place

TASK = "myoElbowPose1D6MRandom-v0"
MUSCLES = ("TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA")
FLEXORS = MUSCLES[3:]
CONTROL_DT = 0.02  # s
ASSISTANCE = 1.0  # of the muscles' torque, in training; see exo1
PER_SECOND = 60.0  # 1/min: the paper's rate of fatigue, read as 1/s
NO_END = 2**31 - 1  # control steps of an episode

SETTINGS = {"hidden": (32, 32), "num_worlds": 64}
SAMPLES = 300_000


def _trained(name: str, *conditions: Condition) -> Training:
    """Return the training of an elbow's policy."""
    return Training(name, TASK, lambda: conditions, SAMPLES, SETTINGS)


HEALTHY = _trained("healthy")
SARCOPENIC = _trained("sarcopenic", Sarcopenia(strength=0.5))
FATIGUED = _trained("fatigued", FatigueMa2009(PER_SECOND, initial=Uniform(0.0, 0.9, each=True)))
ASSISTED = _trained("assisted", Exoskeleton(assistance=ASSISTANCE))
MOTOR = _trained("motor", Exoskeleton(motor=True))
THRIFTY = Training("thrifty", TASK, tuple, SAMPLES, SETTINGS, task_fields={"effort_weight": 10.0})
"""Fatigued: at 1/s, and every muscle of every episode has lost a share of its force before, between none and
nine tenths. Assisted: the brace adds what the muscles make. Motor: the policy commands the brace's torque,
which costs it nothing. Thrifty: activations cost ten times what they cost in the task."""


@dataclass(frozen=True)
class Trace:
    """Movements of arms; T control steps, N worlds, 6 muscles.

    Attributes:
        angle: Elbow angle after each step [deg], shape (T, N).
        target: Target during it [deg], shape (T, N).
        activation: Activations [1], shape (T, N, 6).
        force: Tendon forces [N], shape (T, N, 6).
        metabolic_rate: Of the muscles after Umberger 2010 [W], shape (T, N, 6).
        shown: What conditions show, such as `fatigue` (T, N, 6).
    """

    angle: np.ndarray
    target: np.ndarray
    activation: np.ndarray
    force: np.ndarray
    metabolic_rate: np.ndarray
    shown: dict[str, np.ndarray]

    @property
    def error(self) -> np.ndarray:
        """Distance of angle and target [deg], shape (T, N)."""
        return np.abs(self.angle - self.target)


def arms(conditions: Sequence[Condition], num_worlds: int, setup: Setup) -> Simulation:
    """Return elbows without an end of episodes, each world a patient of its own."""
    own = Setup(task=TASK, conditions=tuple(conditions), horizon=NO_END).over(setup)
    return Simulation(own, num_worlds, autoreset="disabled")


def follow(
    signals: Signals,
    policies: Sequence[tuple[Checkpoint, slice]],
    seeds: np.ndarray | None,
    targets: np.ndarray,
    seconds: float,
    tick: Tick = lambda share: None,
    still: np.ndarray | None = None,
) -> Trace:
    """Let arms follow targets.

    Args:
        signals: Those of the arms.
        policies: Who acts in which worlds.
        seeds: Seeds of the worlds, which start anew; None: they go on from where they are.
        targets: Target angles of each phase [deg], shape (phases, N) or (phases, 1).
        seconds: Duration of a phase [s].
        tick: Told the share that is done.
        still: Worlds whose motor, the last actuator, gets no command, shape (N,); None: all get theirs.
    """
    sim = signals.sim
    acting = [(Bound(checkpoint, sim), worlds) for checkpoint, worlds in policies]
    if seeds is not None:
        sim.reset(seeds=seeds)
    steps, num_worlds = round(seconds / CONTROL_DT), sim.num_worlds
    total = len(targets) * steps
    each = dict.fromkeys(("activation", "force", "metabolic_rate"), (len(MUSCLES),))
    kept: dict[str, tuple[int, ...]] = {"angle": (), "target": (), **each}
    arrays = {name: np.empty((total, num_worlds, *more), np.float32) for name, more in kept.items()}
    shown = {name: np.empty((total, *array.shape), np.float32) for name, array in signals.info.items()}
    action = np.zeros(sim.action.shape, np.float32)

    def act(obs: np.ndarray) -> np.ndarray:
        for one, worlds in acting:
            action[worlds] = one(obs[worlds])
        if still is not None:
            action[still, -1] = 0.0
        return action

    def keep(step: Step, phase: int, goal: np.ndarray) -> None:
        t = phase * steps + step.number - 1
        arrays["angle"][t] = np.degrees(sim.transition.obs.numpy()[:, 0])
        arrays["target"][t] = np.degrees(goal)
        arrays["activation"][t] = signals.muscles.activation.numpy()
        arrays["force"][t] = signals.muscles.force.numpy()
        arrays["metabolic_rate"][t] = signals.muscles.umberger2010.numpy()
        for name, array in signals.info.items():
            shown[name][t] = array.numpy()
        if (t + 1) % 50 == 0:
            tick((t + 1) / total)

    for phase, angles in enumerate(targets):
        goal = np.broadcast_to(np.radians(angles), num_worlds).astype(np.float32)
        place(sim, {"task.target": goal[:, None]}, np.arange(num_worlds))
        run(sim, act, steps, Each(partial(keep, phase=phase, goal=goal)), fresh=False, again=False)
    return Trace(**arrays, shown=shown)


def world_seeds(seed: int, num_worlds: int, groups: int) -> np.ndarray:
    """Return seeds of the worlds: the same starts in every group of `num_worlds`, others for every seed."""
    return np.tile(1000 * (seed + 1) + np.arange(num_worlds), groups)


def grouped(trace: Trace, groups: int) -> dict[str, np.ndarray]:
    """Return means over the worlds of each group, shape (T, groups, ...)."""

    def mean(array: np.ndarray) -> np.ndarray:
        shape = (len(array), groups, -1, *array.shape[2:])
        return array.reshape(shape).mean(axis=2).astype(np.float32)

    arrays = {"angle": trace.angle, "target": trace.target, "error": trace.error}
    arrays |= {"activation": trace.activation, "force": trace.force, "metabolic_rate": trace.metabolic_rate}
    return {name: mean(array) for name, array in (arrays | trace.shown).items()}


def beside(
    first: list[dict[str, np.ndarray]], second: list[dict[str, np.ndarray]]
) -> list[dict[str, np.ndarray]]:
    """Return the groups of two runs of the same seeds, one after the other, of the arrays that both have."""
    return [
        {name: np.concatenate((one[name], other[name]), axis=1) for name in one if name in other}
        for one, other in zip(first, second, strict=True)
    ]


def late(phases: int, seconds: float, settled: float) -> np.ndarray:
    """Return which control steps lie `settled` seconds or more after the begin of their phase, shape (T,)."""
    one = np.arange(1, round(seconds / CONTROL_DT) + 1) * CONTROL_DT > settled
    return np.tile(one, phases)


def prime_mover(activation: np.ndarray) -> int:
    """Return which flexor works most, by its column in activations (..., 6): 3, 4 or 5."""
    return 3 + int(activation.reshape(-1, len(MUSCLES))[:, 3:].mean(axis=0).argmax())


def synergists_share(activation: np.ndarray, prime: int) -> float:
    """Return the share of the other two flexors in the flexors' activation, of activations (..., 6)."""
    flexors = activation.reshape(-1, len(MUSCLES)).mean(axis=0)[3:]
    return float(1.0 - flexors[prime - 3] / flexors.sum())


def run_groups(
    lab: Lab,
    name: str,
    groups: Sequence[Any],
    trainings: Sequence[Training],
    conditions: Callable[[], Sequence[Condition]],
    targets: np.ndarray,
    seconds: float,
    still: Sequence[bool] = (),
) -> list[dict[str, np.ndarray]]:
    """Let groups of arms follow targets, once for each seed; runs that are done are not repeated.

    Args:
        lab: Seeds, worlds and finished runs.
        name: Name of the runs; the seed is added.
        groups: What each group is, plain values: part of the settings.
        trainings: Whose policy acts in each group.
        conditions: Returns the conditions of all worlds, `lab.num_worlds` of one group after the other.
        targets: Target angles [deg], shape (phases, groups) or (phases, 1).
        seconds: Duration of a phase [s].
        still: Groups whose motor, the last actuator, gets no command; empty: there is no motor.

    Returns:
        What `grouped` makes of each seed.
    """
    number, n = len(groups), lab.num_worlds
    policies = {
        seed: {training.name: lab.policy(training, seed) for training in trainings} for seed in lab.seeds
    }
    lab.expect(len(lab.seeds))
    built: list[Signals] = []
    goals = np.broadcast_to(targets, (len(targets), number)).repeat(n, axis=1)
    settings = {"num_worlds": n, "groups": groups, "targets": targets.tolist(), "seconds": seconds}
    settings["metabolic_rate"] = "umberger2010"  # runs of before have none

    def measure(tick: Tick, seed: int) -> dict[str, np.ndarray]:
        if not built:
            built.append(Signals(arms(conditions(), number * n, lab.setup)))
        acting = [
            (policies[seed][training.name], slice(g * n, (g + 1) * n)) for g, training in enumerate(trainings)
        ]
        seeds, off = world_seeds(seed, n, number), np.repeat(still, n).astype(bool) if still else None
        return grouped(follow(built[0], acting, seeds, goals, seconds, tick, off), number)

    results = []
    for seed in lab.seeds:
        used = policies[seed].values()
        own = settings | {"seed": seed, "policies": [training.name for training in trainings]}
        results.append(lab.kept(f"{name}-seed{seed}", own, partial(measure, seed=seed), *used))
    return results
