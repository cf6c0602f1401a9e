"""Adaptation: what policies do once a patient has changed in mid-episode.

All policies act in the same episodes: the same seeds draw the same targets, patients and moments of change,
so that what one policy does in an episode stands beside what another does in it. With s(k) the share of the
episodes that are solved k control steps after the change,

    before    = mean of s over the last tenth of a second before the change
    drop      = before - least of s after it
    recovery  = time from the least to where s has come back by half of the drop
    after     = share of the steps from the change to the end that are solved, a mean over episodes

`after` has Student's interval over episodes, and so has its difference from the first policy's, in pairs; the
others have a bootstrap's over episodes. s(k) counts the episodes that last so long; it ends where fewer than
half of them do.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from myowarp.apps.policies.checkpoint import trained_setup
from myowarp.apps.policies.find import Policy, acting
from myowarp.apps.policies.learned import Act
from myowarp.apps.reports import panel
from myowarp.apps.reports.intervals import mean_interval
from myowarp.apps.rollouts.run import Step, Watcher, progress, run
from myowarp.definitions.senses import PARAMETERS
from myowarp.definitions.setup import Setup
from myowarp.disk import in_place, make_folder, plain, write_rows
from myowarp.inks import INKS
from myowarp.models.conditions import TendonTear
from myowarp.sim.patient_table import population_of
from myowarp.sim.simulation import Simulation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULT = "adaptation.json"
EPISODES = 1024
SHOWN = 1.0  # s before the change from which on s is told
BEFORE = 0.1  # s of it over which success is taken: earlier, episodes are on the way to their targets
WIDTH, HEIGHT = 6.4, 3.6  # inches
LEAST_SHARE = 0.5  # of the episodes that must last for s(k) to be counted
RESAMPLES = 1999  # of the bootstrap
TAILS = 2.5, 97.5  # percentiles of it

Interval = tuple[float, float]


@dataclass(frozen=True)
class Adapted:
    """The figures of a policy.

    Attributes:
        policy: Its name.
        episodes: Episodes in which the patient changed while they lasted.
        before, before_interval: Share solved before the change.
        drop, drop_interval: By how much it fell.
        recovery, recovery_interval: Time to half of the drop [s], 0 where nothing fell, infinite where it did
            not come back that far.
        after, after_interval: Share of the steps from the change on that are solved.
        gain, gain_interval: Difference of `after` from the first policy's; None for the first.
    """

    policy: str
    episodes: int
    before: float
    before_interval: Interval
    drop: float
    drop_interval: Interval
    recovery: float
    recovery_interval: Interval
    after: float
    after_interval: Interval
    gain: float | None = None
    gain_interval: Interval | None = None


@dataclass(frozen=True)
class Adaptation:
    """A study.

    Attributes:
        setup: The environment, but for what each policy observes.
        seconds: Time after the change [s], shape (num_steps,); negative before it.
        curves: s of every policy, shape (num_policies, num_steps).
        shares: Share of solved steps after the change, shape (num_policies, num_episodes).
        policies: Figures of every policy.
    """

    setup: Setup
    seconds: np.ndarray
    curves: np.ndarray
    shares: np.ndarray
    policies: tuple[Adapted, ...]


@dataclass(frozen=True)
class Relieved:
    """A policy that another one relieves as soon as the patient has changed.

    Attributes:
        name: What the two are called.
        before: Acts until then.
        after: Acts from then on.
    """

    name: str
    before: Policy
    after: Policy

    def acting(self, sim: Simulation) -> Act:
        """Return the function that acts in a simulation which observes the parameters of the conditions."""
        before, after = (acting(own, sim) for own in (self.before, self.after))
        told, first = sim.blocks[PARAMETERS], list[np.ndarray]()

        def act(obs: np.ndarray) -> np.ndarray:
            if not first:
                first.append(obs[:, told].copy())
            changed = (obs[:, told] != first[0]).any(axis=1, keepdims=True)
            return np.where(changed, after(obs), before(obs))

        return act


class Trail(Watcher):
    """Remembers when worlds changed and when they were solved, in the first episode of each.

    Attributes:
        changed: Control step that the change came with, from 0 on; -1: none came, shape (num_worlds,).
        length: Control steps of the episode, shape (num_worlds,).
    """

    def __init__(self, sim: Simulation) -> None:
        self.changed, self.length = np.full(sim.num_worlds, -1), np.zeros(sim.num_worlds, dtype=int)
        self._solved: list[np.ndarray] = []
        self._running = np.ones(sim.num_worlds, dtype=bool)
        self._told, self._first = sim.blocks[PARAMETERS], np.empty(0)

    def see(self, step: Step) -> None:
        """Take a step down."""
        told = step.obs[:, self._told]
        if step.number == 1:
            self._first = told.copy()
        new = self._running & (self.changed < 0) & (told != self._first).any(axis=1)
        self.changed[new] = step.number - 1
        self._solved.append(step.solved & self._running)
        self.length += self._running
        self._running &= ~step.ended

    def of(self, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return of some worlds whether each step was solved, false after the end; `changed`, `length`.

        Args:
            worlds: A mask, shape (num_worlds,).
        """
        return np.array(self._solved)[:, worlds], self.changed[worlds], self.length[worlds]

    def all_ended(self) -> bool:
        """Whether every world has had its episode."""
        return not self._running.any()


def with_patients(setup: Setup, table: Path, episodes: int) -> Setup:
    """Return a setup with the patients of a table, each in as many episodes.

    Raises:
        ValueError: The table is wrong, or the episodes cannot be divided among its patients.
        ImportError: Parquet without pandas and pyarrow.
    """
    population = population_of(table, setup.spec)
    return population.joined(setup, population.each(episodes, "--episodes"))


def study(
    setup: Setup,
    policies: Sequence[Policy | Relieved],
    episodes: int = EPISODES,
    console: Console | None = None,
) -> Adaptation:
    """Let policies act in patients who change.

    Args:
        setup: A complete setup whose conditions change within an episode.
        policies: Of different names; the first is what the others are compared with.
        episodes: Episodes of each, and worlds simulated together.
        console: Where progress is drawn.

    Raises:
        ValueError: A policy is there twice, there is no condition, or no patient changes in an episode.
    """
    names = [policy.name for policy in policies]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"adapt compares different policies, got {repeated[0]!r} twice")
    trails = [_follow(setup, policy, episodes, console) for policy in policies]
    for trail in trails:
        # A fault ends an episode of one policy alone; what counts is when all of them could see the change.
        trail.changed[trail.changed >= trail.length] = -1
    counted = np.all([trail.changed > 0 for trail in trails], axis=0)
    if not counted.any():
        torn = any(isinstance(condition, TendonTear) for condition in setup.conditions or ())
        such = "tendon_tear(transmission=Ramp(1.0, 0.0" if torn else "sarcopenia(strength=Ramp(1.0, 0.5"
        raise ValueError(
            f"adapt needs conditions whose values change in an episode of {setup.spec.key!r}, such as "
            f"'{such}, onset=0.5))'; of {episodes} episodes none had a change"
        )
    seen = [trail.of(counted) for trail in trails]
    dt, shares = setup.spec.control_dt, [_share_after(*own) for own in seen]
    span = max(1, round(SHOWN / dt))
    steps = np.arange(-span, setup.episode_steps)
    counts = [_counts(steps, *own) for own in seen]
    curves, found = [_curve(*own) for own in counts], []
    for policy, share, curve, own in zip(policies, shares, curves, counts, strict=True):
        first = share is shares[0]
        paired = share - shares[0]
        before, drop, recovery = _fall(curve, span, dt)
        before_interval, drop_interval, recovery_interval = fall_intervals(*own, span, dt)
        found.append(
            Adapted(
                policy.name,
                int(counted.sum()),
                before=before,
                before_interval=before_interval,
                drop=drop,
                drop_interval=drop_interval,
                recovery=recovery,
                recovery_interval=recovery_interval,
                after=float(share.mean()),
                after_interval=mean_interval(share, 0.0, 1.0),
                gain=None if first else float(paired.mean()),
                gain_interval=None if first else mean_interval(paired, -1.0, 1.0),
            )
        )
    return Adaptation(setup, steps * dt, np.array(curves), np.array(shares), tuple(found))


def _follow(setup: Setup, policy: Policy | Relieved, episodes: int, console: Console | None) -> Trail:
    """Return what one policy did in all worlds."""
    parts = (policy,) if isinstance(policy, Policy) else (policy.before, policy.after)
    trained = [trained_setup(part.checkpoint.manifest) for part in parts if part.checkpoint]
    senses = dict.fromkeys(sense for own in trained for sense in own.observe or ())
    observe = (PARAMETERS, *(sense for sense in senses if sense != PARAMETERS))
    sim = Simulation(dataclasses.replace(setup, observe=observe), episodes, autoreset="same_step")
    act = acting(policy, sim) if isinstance(policy, Policy) else policy.acting(sim)
    trail = Trail(sim)
    with progress(policy.name, "steps", sim.horizon, console) as bar:
        run(sim, act, sim.horizon, trail, bar, until=trail.all_ended)
    sim.close()
    return trail


def _share_after(solved: np.ndarray, changed: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return the share of solved steps after the change, of each episode."""
    after = np.arange(len(solved))[:, None] >= changed
    return (solved & after).sum(axis=0) / (length - changed)


def _counts(
    steps: np.ndarray, solved: np.ndarray, changed: np.ndarray, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return for all k of `steps` which episodes are solved and which last, each (num_steps, episodes)."""
    at = steps[:, None] + changed
    lasts = (at >= 0) & (at < length)
    return lasts & solved[np.clip(at, 0, len(solved) - 1), np.arange(len(changed))], lasts


def _curve(solved: np.ndarray, lasts: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Return s(k); NaN where too few episodes last.

    Args:
        solved: As of `_counts`.
        lasts: As of `_counts`.
        weight: How often each episode counts, shape (episodes, any); None: once.
    """
    weight = np.ones(lasts.shape[1]) if weight is None else weight
    number = lasts @ weight
    enough = number >= LEAST_SHARE * lasts.shape[1]
    return np.where(enough, (solved @ weight) / np.maximum(number, 1), np.nan)


def _fall(curve: np.ndarray, change: int, dt: float) -> tuple[float, float, float]:
    """Return success before the change, the drop and the time to half of it; the change is at an index."""
    last = curve[max(0, change - max(1, round(BEFORE / dt))) : change]
    before = float(np.nanmean(last)) if np.isfinite(last).any() else math.nan
    after = curve[change:][np.isfinite(curve[change:])]
    least = int(np.argmin(after))
    drop = before - float(after[least])
    back = np.flatnonzero(after[least:] >= after[least] + 0.5 * drop)
    return before, drop, 0.0 if drop <= 0.0 else float(back[0] * dt) if back.size else math.inf


def fall_intervals(solved: np.ndarray, lasts: np.ndarray, change: int, dt: float) -> list[Interval]:
    """Return the 95 % intervals of success before, its drop and its recovery, by a bootstrap over episodes.

    Args:
        solved: Whether steps are solved, shape (steps, episodes).
        lasts: Whether an episode goes on, same shape.
        change: Steps before the change.
        dt: Control step [s].
    """
    number = lasts.shape[1]
    drawn = np.random.default_rng(0).multinomial(number, np.full(number, 1.0 / number), size=RESAMPLES)
    falls = np.array([_fall(curve, change, dt) for curve in _curve(solved, lasts, drawn.T).T])
    low, high = np.percentile(falls, TAILS, axis=0, method="inverted_cdf").tolist()
    return list(zip(low, high, strict=True))


def save(result: Adaptation, folder: Path) -> tuple[Path, ...]:
    """Write adaptation.json, curves.csv and, where matplotlib is installed, adaptation.png; returns them."""
    make_folder(folder)
    files = [folder / RESULT, folder / "curves.csv"]
    found = {"task": result.setup.spec.env_id, "policies": list(map(dataclasses.asdict, result.policies))}
    with in_place(files[0]) as scratch:
        scratch.write_text(json.dumps(plain(result.setup.plain() | found), indent=1) + "\n")
    head = ["seconds_after_change", *(policy.policy for policy in result.policies)]
    rows = zip(result.seconds, *result.curves, strict=True)
    write_rows(files[1], [head, *(["" if math.isnan(x) else f"{x:.6g}" for x in row] for row in rows)])
    if importlib.util.find_spec("matplotlib"):
        files.append(folder / "adaptation.png")
        with panel.style():
            panel.save(_figure(result), files[2])
    return tuple(files)


def _figure(result: Adaptation) -> Figure:
    """Return s(k) of all policies over time."""
    figure = panel.blank(WIDTH, HEIGHT)
    axes = figure.subplots()
    for policy, curve, color in zip(result.policies, result.curves, cycle(INKS), strict=False):
        axes.plot(result.seconds, 100.0 * curve, color=color, label=policy.policy)
    axes.axvline(0.0, color=panel.INK, linewidth=0.8, linestyle=":")
    axes.set_xlim(result.seconds[0], result.seconds[np.isfinite(result.curves).any(axis=0)][-1])
    axes.set_xlabel("Time after the change [s]")
    axes.set_ylabel("Episodes that are solved [%]")
    axes.set_title(f"{result.setup.spec.key}, {result.policies[0].episodes} episodes")
    axes.legend(loc="lower right")
    return figure
