"""How good a policy is: one episode in each of many worlds, three success rules, return and effort.

Every world runs one episode from its first reset on, so that short episodes count no more than long ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console

from myowarp.apps.rollouts.targets import in_reach
from myowarp.apps.train.ranks import ALONE, Ranks
from myowarp.apps.train.settings import SUCCESSES
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.progress import progress_bar

Z = 1.959963984540054  # quantile of the normal distribution for 95 %


@dataclass(frozen=True)
class Evaluation:
    """Figures of episodes.

    Attributes:
        episodes: Number of episodes.
        success: Share with more than 5 solved steps (the paper's rule).
        success_last: Share solved on the last step.
        success_any: Share solved at any step.
        intervals: 95 % intervals of the three, Wilson's.
        return_mean: Mean return.
        return_std: Standard deviation of the return.
        length_mean: Mean length [control steps].
        mean_activation: Activation [1], mean over muscles and the steps of an episode, then over episodes.
        activation_rate: Mean of |da/dt| [1/s], likewise.
        faults: Episodes that a fault ended.
        reachable: Episodes whose target the joint ranges allow to meet exactly; None: `in_reach` does
            not judge the task's targets.
        success_reachable: Share of these with more than 5 solved steps; its interval is among `intervals`.
    """

    episodes: int
    success: float
    success_last: float
    success_any: float
    intervals: dict[str, tuple[float, float]]
    return_mean: float
    return_std: float
    length_mean: float
    mean_activation: float | None
    activation_rate: float | None
    faults: int
    reachable: int | None = None
    success_reachable: float | None = None


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a proportion. Source: Wilson 1927, JASA 22:209."""
    share, z2 = successes / trials, Z * Z / trials
    middle = share + z2 / 2.0
    half = Z * math.sqrt(share * (1.0 - share) / trials + z2 / (4.0 * trials))
    return max(0.0, (middle - half) / (1.0 + z2)), min(1.0, (middle + half) / (1.0 + z2))


def evaluate(
    env: MyoWarpVectorEnv,
    act: Callable[[np.ndarray], np.ndarray],
    seed: int,
    *,
    title: str = "Evaluating",
    console: Console | None = None,
    ranks: Ranks = ALONE,
) -> Evaluation:
    """Run one episode in every world.

    Args:
        env: Environment with NumPy output and autoreset in the same step.
        act: Observations (num_worlds, obs_size) to actions (num_worlds, num_actions).
        seed: World i resets with seed + i.
        title: What the progress bar says.
        console: Where it is drawn.
        ranks: This process among those that share the episodes; each gets the figures of all.
    """
    sim, n = env.sim, env.num_envs
    horizon = sim.horizon
    muscles = sim.scene.muscles
    running, sums = (
        np.ones(n, dtype=bool),
        {name: np.zeros(n) for name in ("return", "length", "effort", "rate")},
    )
    solved = {name: np.zeros(n, dtype=bool) for name in SUCCESSES}
    faults = 0
    obs, _ = env.reset(seed=seed)
    target = env.get_state().arrays.get("task.target")
    reachable = None if target is None else in_reach(sim.scene.spec, sim.scene.oracle, target)
    before = muscles.activation.numpy().copy()
    with progress_bar(title, "steps", console) as bar:
        task = bar.add_task("", total=horizon)
        while running.any():
            obs, reward, terminated, truncated, info = env.step(act(obs))
            after = muscles.activation.numpy().copy()
            ended = running & (terminated | truncated)
            now = _with_final(info, ended)
            alive = (
                running & ~ended
            )  # where a world was reset in this step, its activation is the next episode's
            sums["return"] += np.where(running, reward, 0.0)
            sums["length"] += running
            if after.shape[1]:
                sums["effort"] += np.where(alive, after.mean(axis=1), 0.0)
                sums["rate"] += np.where(alive, np.abs(after - before).mean(axis=1), 0.0)
            solved["success_any"] |= running & now["solved"]
            solved["success"] |= ended & now["success"]
            solved["success_last"] |= ended & now["solved"]
            faults += int(np.count_nonzero(info["fault"][ended]))
            running &= ~ended
            before = after
            bar.advance(task)
    parts = ranks.everyones((solved, sums, faults, reachable))
    solved = {name: np.concatenate([part[0][name] for part in parts]) for name in solved}
    sums = {name: np.concatenate([part[1][name] for part in parts]) for name in sums}
    faults = sum(part[2] for part in parts)
    reachable = None if reachable is None else np.concatenate([part[3] for part in parts])
    figures = _figures(solved, sums, faults, sim.scene.control_dt if len(muscles.names) else None)
    return figures if reachable is None else _of_reachable(figures, solved["success"], reachable)


def _of_reachable(figures: Evaluation, success: np.ndarray, reachable: np.ndarray) -> Evaluation:
    """Return the figures with those of the episodes whose target can be reached."""
    trials, successes = int(reachable.sum()), int((success & reachable).sum())
    if not trials:
        return replace(figures, reachable=0)
    intervals = figures.intervals | {"success_reachable": wilson(successes, trials)}
    return replace(figures, reachable=trials, success_reachable=successes / trials, intervals=intervals)


def _with_final(info: dict[str, Any], ended: np.ndarray) -> dict[str, np.ndarray]:
    """Return `success` and `solved` of the present step, of what ended too."""
    if "final_info" not in info:
        return {name: info[name] for name in ("success", "solved")}
    final = info["final_info"]
    return {name: np.where(ended, final[name], info[name]) for name in ("success", "solved")}


def _figures(
    solved: dict[str, np.ndarray], sums: dict[str, np.ndarray], faults: int, control_dt: float | None
) -> Evaluation:
    """Return the figures of finished episodes; without muscles (`control_dt` None) there is no effort."""
    n = len(sums["return"])
    steps = np.maximum(sums["length"] - 1.0, 1.0)  # activation is not seen in the step that ends an episode
    effort = None if control_dt is None else float((sums["effort"] / steps).mean())
    rate = None if control_dt is None else float((sums["rate"] / steps).mean() / control_dt)
    return Evaluation(
        episodes=n,
        success=float(solved["success"].mean()),
        success_last=float(solved["success_last"].mean()),
        success_any=float(solved["success_any"].mean()),
        intervals={name: wilson(int(np.count_nonzero(solved[name])), n) for name in SUCCESSES},
        return_mean=float(sums["return"].mean()),
        return_std=float(sums["return"].std()),
        length_mean=float(sums["length"].mean()),
        mean_activation=effort,
        activation_rate=rate,
        faults=faults,
    )
