"""How good a policy is: one episode in each of many worlds, success, return, effort, metabolic rate.

Every world runs one episode from its first reset on, so that short episodes count no more than long ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console

from myowarp.apps.reports.intervals import wilson
from myowarp.apps.rollouts.episodes import Episodes, are_one
from myowarp.apps.rollouts.run import Act, Step, Watcher, progress, run, seeds_of
from myowarp.apps.rollouts.targets import in_reach
from myowarp.apps.train.ranks import ALONE, Ranks
from myowarp.apps.train.settings import SUCCESSES
from myowarp.kernels.episode import MYOSUITE
from myowarp.sim.economy import UNITS as ECONOMY
from myowarp.sim.economy import Economy
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import get_state


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
) -> Evaluation:
    """Run one episode in every world.

    Args:
        sim: The worlds, with autoreset in the same step.
        act: Function from observations (num_worlds, obs_size) to actions (num_worlds, num_actions).
        signals: Those of the worlds, where metabolic rates are wanted.
        title: What the progress bar says.
        console: Where it is drawn.
        ranks: This process among those that share the episodes; each gets the figures of all.
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
    figures = replace(figures, one_episode=are_one(sim.setup, found["length"], found["return"]))
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
    economy = {name: found[name][np.isfinite(found[name])] for name in ECONOMY if name in found}
    rates: dict[str, Any] = {name: float(own.mean()) if own.size else None for name, own in economy.items()}
    return Evaluation(
        episodes=n,
        success=float(found["success"].mean()),
        success_last=float(found["success_last"].mean()),
        success_any=float(found["success_any"].mean()),
        success_myosuite=float(found["success_myosuite"].mean()),
        intervals={name: wilson(int(np.count_nonzero(found[name])), n) for name in (*SUCCESSES, MYOSUITE)},
        return_mean=float(found["return"].mean()),
        return_std=float(found["return"].std()),
        length_mean=float(found["length"].mean()),
        mean_activation=effort,
        activation_rate=rate,
        failed=int(np.count_nonzero(found["failed"])),
        faults=int(np.count_nonzero(found["fault"])),
        **rates,
    )
