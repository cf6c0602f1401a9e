"""Evaluations of a policy: one episode in each of many worlds, success, return, effort, metabolic rate.

Every world runs one episode from its first reset on, so that short episodes count no more than long ones.
An evaluation is planned first, then run in an environment of its own; torch is not needed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from myowarp.apps.policies.baselines import policy_folder
from myowarp.apps.policies.checkpoint import (
    Checkpoint,
    CheckpointError,
    check_task,
    eval_command,
    is_file,
    load_checkpoint,
    trained_setup,
)
from myowarp.apps.policies.learned import Bound
from myowarp.apps.reports.intervals import wilson
from myowarp.apps.rollouts.episodes import Episodes, are_one
from myowarp.apps.rollouts.ranks import ALONE, Ranks
from myowarp.apps.rollouts.run import Act, Step, Watcher, progress, run, seeds_of
from myowarp.apps.rollouts.targets import in_reach
from myowarp.definitions.registry import check_choice, check_least
from myowarp.definitions.setup import Setup
from myowarp.kernels.episode import MYOSUITE
from myowarp.sim.build import MOST_WORLDS
from myowarp.sim.economy import UNITS as ECONOMY
from myowarp.sim.economy import Economy
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state
from myowarp.tasks.setups import complete

SUCCESSES = {
    "success": "more than 5 solved steps, no failure",
    "success_last": "solved on the last step",
    "success_any": "solved at any step",
}
FAR = 0.25
"""Least share of episodes that succeed and are not solved at the end, from which on it is told."""
EVALUATION_SEED = 1_000_000  # other worlds than those of training
MODES = ("deterministic", "sampled")


@dataclass(frozen=True)
class Evaluation:
    """Figures of episodes.

    Attributes:
        episodes: Number of episodes.
        success: Share of successes: more than 5 solved steps, and no failure.
        success_last: Share solved on the last step.
        success_any: Share solved at any step.
        success_myosuite: Share with more than 5 solved steps, failed or not: MyoSuite's rule, the paper's.
        intervals: 95 % intervals of the four, Wilson's.
        one_episode: Whether all episodes were the same one, so that intervals mean nothing: the task draws
            nothing, and neither does the policy.
        failed: Episodes that the task's failure ended, such as a fall.
        return_mean: Mean return.
        return_std: Standard deviation of the return.
        length_mean: Mean length [control steps].
        mean_activation: Activation [1], mean over muscles and the steps of an episode, then over episodes.
        activation_rate: Mean of |da/dt| [1/s], likewise.
        bhargava2004: Metabolic rate of the whole body after Bhargava 2004 [W], basal rate included, likewise;
            of a free root over the episodes that did not fail. None: there are none, no signals were given,
            or the muscle model does not tell what its fibers do.
        umberger2010: The same after Umberger 2010 [W].
        bhargava2004_per_kg: Over the mass that muscles move [W/kg].
        umberger2010_per_kg: Likewise [W/kg].
        body_mass: That mass [kg]; None: no signals were given.
        speed: Of a free root [m/s], over the episodes that did not fail.
        bhargava2004_per_kg_m: Its cost of transport [J/kg/m], likewise.
        umberger2010_per_kg_m: Likewise.
        faults: Episodes that a fault ended.
        reachable: Episodes whose target the joint ranges allow to meet exactly; None: `in_reach` does
            not judge the task's targets.
        success_reachable: Share of successes among these; its interval is among `intervals`.
    """

    episodes: int
    success: float
    success_last: float
    success_any: float
    success_myosuite: float
    intervals: dict[str, tuple[float, float]]
    return_mean: float
    return_std: float
    length_mean: float
    mean_activation: float | None
    activation_rate: float | None
    failed: int
    faults: int
    one_episode: bool = False
    bhargava2004: float | None = None
    umberger2010: float | None = None
    bhargava2004_per_kg: float | None = None
    umberger2010_per_kg: float | None = None
    body_mass: float | None = None
    speed: float | None = None
    bhargava2004_per_kg_m: float | None = None
    umberger2010_per_kg_m: float | None = None
    reachable: int | None = None
    success_reachable: float | None = None


class Effort(Watcher):
    """Activation, its rate and economy in the first episode of every world, from where they are now.

    Attributes:
        sums: Sums over the steps of an episode of the means over muscles: `effort` [1] and `rate` [1], from
            one step to the next, shape (num_worlds,).
        economy: Metabolic rates, speed and cost of transport; None without signals.
    """

    def __init__(self, sim: Simulation, signals: Signals | None = None) -> None:
        self._muscles = sim.scene.muscles
        self.economy = None if signals is None else Economy(sim, signals)
        self._running = np.ones(sim.num_worlds, dtype=bool)
        self._before = self._muscles.activation.numpy().copy()
        self.sums = {name: np.zeros(sim.num_worlds) for name in ("effort", "rate")}

    def see(self, step: Step) -> None:
        """Count a step; where it ends an episode, its activation is that of the next one already."""
        if self.economy is not None:
            self.economy.see(self._running & (step.fault == 0))
        after = self._muscles.activation.numpy().copy()
        self._running &= ~step.ended
        if after.shape[1]:
            alive = self._running
            self.sums["effort"] += np.where(alive, after.mean(axis=1), 0.0)
            self.sums["rate"] += np.where(alive, np.abs(after - self._before).mean(axis=1), 0.0)
        self._before = after


def evaluate(
    sim: Simulation,
    act: Act,
    *,
    signals: Signals | None = None,
    title: str = "Evaluating",
    console: Console | None = None,
    ranks: Ranks = ALONE,
    drawn: bool = False,
) -> Evaluation:
    """Run one episode in every world.

    Args:
        sim: The worlds, with autoreset in the same step.
        act: Function from observations (num_worlds, obs_size) to actions (num_worlds, num_actions).
        signals: Those of the worlds, where metabolic rates are wanted.
        title: What the progress bar says.
        console: Where it is drawn.
        ranks: This process among those that share the episodes; each gets the figures of all.
        drawn: Whether actions are drawn, so that episodes differ, however little comes of it.
    """
    sim.reset(seeds=seeds_of(sim))
    target = get_state(sim).arrays.get("task.target")
    reachable = None if target is None else in_reach(sim.scene.spec, sim.scene.oracle, target)
    episodes, effort = Episodes(sim.num_worlds), Effort(sim, signals)
    with progress(title, "steps", sim.horizon, console) as bar:
        watchers = effort, episodes, bar
        run(sim, act, sim.horizon, *watchers, fresh=False, until=lambda: bool(episodes.ended_once.all()))
    own = episodes.first() | effort.sums | ({} if reachable is None else {"reachable": reachable})
    if effort.economy is not None:
        own |= effort.economy.means(own["failed"])
    parts = ranks.everyones(own)
    found = {name: np.concatenate([part[name] for part in parts]) for name in own}
    figures = _figures(found, sim.scene.control_dt if len(sim.scene.muscles.names) else None)
    mass = None if signals is None else signals.body_mass
    one_episode = not drawn and are_one(sim.setup, found["length"], found["return"])
    figures = replace(figures, one_episode=one_episode, body_mass=mass)
    return figures if reachable is None else _of_reachable(figures, found["success"], found["reachable"])


def _of_reachable(figures: Evaluation, success: np.ndarray, reachable: np.ndarray) -> Evaluation:
    """Return the figures with those of the episodes whose target can be reached."""
    trials, successes = int(reachable.sum()), int((success & reachable).sum())
    if not trials:
        return replace(figures, reachable=0)
    intervals = figures.intervals | {"success_reachable": wilson(successes, trials)}
    return replace(figures, reachable=trials, success_reachable=successes / trials, intervals=intervals)


def _figures(found: dict[str, np.ndarray], control_dt: float | None) -> Evaluation:
    """Return the figures of finished episodes; without muscles (`control_dt` None) there is no effort."""
    n = len(found["return"])
    steps = np.maximum(found["length"] - 1.0, 1.0)  # activation is not seen in the step that ends an episode
    effort = None if control_dt is None else float((found["effort"] / steps).mean())
    rate = None if control_dt is None else float((found["rate"] / steps).mean() / control_dt)
    shares: dict[str, Any] = {name: float(found[name].mean()) for name in (*SUCCESSES, MYOSUITE)}
    economy = {name: found[name][np.isfinite(found[name])] for name in ECONOMY if name in found}
    rates: dict[str, Any] = {name: float(own.mean()) if own.size else None for name, own in economy.items()}
    return Evaluation(
        episodes=n,
        intervals={name: wilson(int(np.count_nonzero(found[name])), n) for name in shares},
        return_mean=float(found["return"].mean()),
        return_std=float(found["return"].std()),
        length_mean=float(found["length"].mean()),
        mean_activation=effort,
        activation_rate=rate,
        failed=int(np.count_nonzero(found["failed"])),
        faults=int(np.count_nonzero(found["fault"])),
        **shares,
        **rates,
    )


@dataclass(frozen=True)
class EvaluationJob:
    """An evaluation that was checked and can be run.

    Attributes:
        checkpoint: What is evaluated.
        setup: In what.
        episodes: Episodes of each mode, over all ranks.
        modes: Of `MODES`.
        ranks: This process among those that share the episodes.
    """

    checkpoint: Checkpoint
    setup: Setup
    episodes: int
    modes: tuple[str, ...]
    ranks: Ranks


def plan_evaluation(
    checkpoint: Path,
    what: Setup | str = Setup(),
    *,
    episodes: int = 256,
    mode: str = "both",
    **fields: Any,
) -> EvaluationJob:
    """Return the evaluation that is asked for, checked; nothing is built.

    Args:
        checkpoint: Folder of a run or of a checkpoint, or a policy of the package, baselines/<task>.
        what: Where it is evaluated: task (one with the same observation and actuators), muscle, reset and
            conditions are those of the training where it says nothing; physics is "parity" then.
        episodes: Episodes of each mode, and worlds simulated together.
        mode: One of `MODES`, or "both".
        **fields: Fields of `Setup`, in place of those of `what`.

    Raises:
        ValueError: An argument is wrong.
    """
    asked = Setup.of(what, **fields)
    check_least(1, MOST_WORLDS, episodes=episodes)
    check_choice("mode", mode, ("both", *MODES))
    own = asked.task.removeprefix("MyoWarp/") if isinstance(asked.task, str) else None
    loaded = load_checkpoint(policy_folder(str(checkpoint), own) or checkpoint)
    trained = trained_setup(loaded.manifest)
    if asked.task is None and is_file(trained):
        raise CheckpointError(
            f"checkpoint {str(checkpoint)!r} was trained in a task from a file, which a checkpoint does not "
            f"open by itself; try {eval_command(trained, checkpoint)}"
        )
    inherited = replace(trained, physics=None, device=None, seed=EVALUATION_SEED)
    if asked.task is not None:
        inherited = replace(inherited, task=None)
    modes, setup = MODES if mode == "both" else (mode,), complete(asked.over(inherited))
    check_task(loaded, setup.spec)
    return EvaluationJob(loaded, setup, episodes, modes, Ranks.started())


def evaluate_policy(job: EvaluationJob) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Run an evaluation, one episode in every world for each mode.

    Returns:
        Under what the policy was evaluated; and the figures of `Evaluation`, by mode.

    Raises:
        CheckpointError: The policy does not fit the task as it is now.
    """
    checkpoint, ranks, results = job.checkpoint, job.ranks, {}
    number, device = ranks.share("--episodes", job.episodes), ranks.device(job.setup.device)
    console = Console(stderr=True, quiet=not ranks.leads)
    setup = replace(job.setup, device=device, rank=ranks.part)
    with ranks.together(device):
        sim = Simulation(setup, number, autoreset="same_step")
        signals = Signals(sim) if sim.scene.muscles.names else None
        for mode in job.modes:
            drawn = mode == "sampled"
            act = Bound(checkpoint, sim, setup if drawn else None)
            figures = evaluate(
                sim, act, signals=signals, title=mode, console=console, ranks=ranks, drawn=drawn
            )
            results[mode] = dataclasses.asdict(figures)
        sim.close()
    head: dict[str, Any] = {
        "task": setup.spec.env_id,
        "checkpoint": str(checkpoint.folder),
        "seed": setup.seed,
    }
    head |= {"physics": setup.physics, "muscle": setup.muscles.model, "reset": setup.reset}
    head |= {"conditions": list(map(str, setup.conditions or ())), "device": str(sim.scene.device)}
    trained = checkpoint.manifest
    head |= {"trained_under": trained["settings"]["physics"], "samples": trained["samples"]}
    return head, results


def passing(success: float, last: float) -> str:
    """Return, in a sentence, that many successes pass through the goal and leave it; "" where few do.

    Args:
        success: Share of successes.
        last: Share of episodes that are solved on their last step.
    """
    if success - last < FAR:
        return ""
    return (
        f"{100 * success:.0f} % succeed ({SUCCESSES['success']}), but {100 * last:.0f} % are at the goal "
        f"on the last step: at least {100 * (success - last):.0f} % pass through it"
    )


def success_text(figures: Mapping[str, Any], rule: str) -> str:
    """Return a success of an evaluation in percent, with its interval unless all episodes are one."""
    if rule not in figures:  # of an evaluation of before
        return "-"
    if figures["one_episode"]:
        return f"{100 * figures[rule]:.0f} % (one episode)"
    low, high = figures["intervals"][rule]
    return f"{100 * figures[rule]:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
