"""A gait: reflexes whose parameters CMA-ES chooses, with a world for every candidate and start.

    out/gait/gait.json       the best so far, a policy
    out/gait/search.npz      candidates and costs of every generation
    out/gait/settings.json   what they depend on

The cost of a candidate is the mean over its starts of

    100 (1 - s) + s^2 (100 |v / v* - 1| + e / v* + 100 b),    s = t (1 + clip(v / v*, 0, 1)) / (2 T)

with the time t until it fell or the horizon T was over, the mean speed v along the start's heading, the
metabolic rate e of the muscles after Bhargava (2004) [W/kg], the rest left out, and b the mean angle by which
joints were beyond their limits [rad]. A broken search goes on: told the same costs, CMA-ES draws the same
candidates again.

Source: Hansen (2016), The CMA evolution strategy: a tutorial, arXiv:1604.00772, as `cma` has it; the order of
the terms, staying up before speed before effort, is that of Song, Geyer (2015), doi:10.1113/JP270228.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from myowarp.apps.policies.checkpoint import versions
from myowarp.apps.policies.reflex import SCALES, Delays, Gait, ReflexControl, gait_of, unscaled
from myowarp.apps.rollouts.run import Step, stepped
from myowarp.apps.studies.parts import check_settings
from myowarp.definitions.body import POINT_JOINTS
from myowarp.definitions.setup import DEFAULTS, Setup
from myowarp.disk import in_place, make_folder
from myowarp.extras import check_installed
from myowarp.laws.metabolics import BASAL_RATE
from myowarp.progress import progress_bar
from myowarp.sim.build import resolve_device
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation
from myowarp.tasks.setups import complete

GAIT, SEARCH, SETTINGS = "gait.json", "search.npz", "settings.json"
FALL, SPEED, LIMITS = 100.0, 100.0, 100.0  # weights of the cost
FREE = ("pitch", "leg_angle", "knee_flexed", "knee_landing", "knee_straight", "ankle", "roll", "leg_spread")
BOUNDS = (-3.0, 10.0)
"""Of scaled parameters; only those of `FREE` may be below 0, where a gain would turn its reflex round."""


@dataclass(frozen=True)
class Search:
    """Plan of a search.

    Attributes:
        setup: The worlds.
        speed: Wanted [m/s].
        population: Candidates of a generation.
        starts: Worlds of each candidate, of different seeds.
        spread: Standard deviation of the first generation's scaled parameters.
        begin: Gait in its middle; None: all scaled parameters are 1.
        delays: Of the nerves.
    """

    setup: Setup
    speed: float = 1.2
    population: int = 64
    starts: int = 1
    spread: float = 0.3
    begin: Gait | None = None
    delays: Delays = field(default_factory=Delays)

    @property
    def middle(self) -> np.ndarray:
        """Scaled parameters of the first generation's middle, shape (48,)."""
        zero, one = np.array(list(SCALES.values())).T
        return np.ones(len(SCALES)) if self.begin is None else (self.begin.values - zero) / one

    def plain(self) -> dict[str, Any]:
        """Return all that costs depend on, as JSON holds it."""
        setup = complete(self.setup)
        sizes = {name: getattr(self, name) for name in ("speed", "population", "starts", "spread")}
        middle = dict(zip(SCALES, self.middle.tolist(), strict=True))
        own = {"task": setup.spec.key, **setup.over(DEFAULTS).plain(), **sizes, "middle": middle}
        return {**own, "delays": vars(self.delays)}


@dataclass(frozen=True)
class Walks:
    """Figures of walks, shape (num_worlds,) each.

    Attributes:
        time: Until the episode ended [s].
        speed: Mean speed along the start's heading [m/s].
        metabolic_rate: Mean of the muscles [W/kg], without rest.
        beyond: Mean sum of the angles by which joints were beyond their limits [rad].
    """

    time: np.ndarray
    speed: np.ndarray
    metabolic_rate: np.ndarray
    beyond: np.ndarray

    def cost(self, speed: float, duration: float) -> np.ndarray:
        """Return costs, shape (num_worlds,), for a wanted speed [m/s] and a duration of episodes [s]."""
        relative = self.speed / speed
        share = self.time / duration * 0.5 * (1.0 + relative.clip(0.0, 1.0))
        effort = np.nan_to_num(self.metabolic_rate) / speed + LIMITS * self.beyond
        return FALL * (1.0 - share) + share**2 * (SPEED * np.abs(relative - 1.0) + effort)


class _Walking:
    """Looks at the present episode of every world, up to its end.

    Attributes:
        alive: Worlds whose episode goes on, shape (num_worlds,) bool.
    """

    def __init__(self, sim: Simulation, signals: Signals) -> None:
        self._signals, self._dt, model = signals, sim.scene.control_dt, sim.scene.oracle
        hinges = np.flatnonzero(np.isin(model.jnt_type, POINT_JOINTS) & model.jnt_limited.astype(bool))
        self._address, self._range = model.jnt_qposadr[hinges], model.jnt_range[hinges].T
        self.alive = np.zeros(sim.num_worlds, dtype=bool)
        self._ahead, self._place = np.zeros((2, sim.num_worlds, 2))
        self._steps, self._way, self._spent, self._beyond = np.zeros((4, sim.num_worlds))

    def start(self, mask: np.ndarray) -> None:
        """Remember where worlds stand that begin, (num_worlds,) bool, and which way they look."""
        qpos = self._signals.qpos.numpy()
        w, x, y, z = qpos[:, 3:7].T.astype(float)
        ahead = np.stack([w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)], axis=1)
        self._ahead[mask] = (ahead / np.linalg.norm(ahead, axis=1, keepdims=True))[mask]
        self._place[mask] = qpos[mask, :2]
        self.alive |= mask
        for total in (self._steps, self._way, self._spent, self._beyond):
            total[mask] = 0.0

    def see(self, step: Step) -> None:
        """Add a step of the worlds that are up."""
        self.alive &= step.fault == 0
        alive, qpos = self.alive.copy(), self._signals.qpos.numpy()
        angles = qpos[:, self._address]
        beyond = np.maximum(self._range[0] - angles, angles - self._range[1]).clip(0.0).sum(axis=1)
        way = ((qpos[:, :2] - self._place) * self._ahead).sum(axis=1)
        rate = self._signals.whole_body["bhargava2004_per_kg"].numpy() - BASAL_RATE
        self._steps += alive
        self._way[alive] = way[alive]
        self._spent[alive] += rate[alive]
        self._beyond[alive] += beyond[alive]
        self.alive &= ~step.ended

    def figures(self) -> np.ndarray:
        """Return the figures of `Walks`, shape (4, num_worlds)."""
        steps, dt = self._steps.clip(1.0), self._dt
        return np.stack(
            [self._steps * dt, self._way / (steps * dt), self._spent / steps, self._beyond / steps]
        )


class Trials:
    """Worlds in which gaits are tried; who falls makes room for the next.

    Attributes:
        sim: The worlds.
        duration: Of an episode that no fall ends [s].
    """

    def __init__(self, setup: Setup, num_worlds: int, delays: Delays) -> None:
        """Build them.

        Args:
            setup: What they are.
            num_worlds: Gaits that walk at once, which changes the results by rounding alone.
            delays: Of the nerves.

        Raises:
            ValueError: The setup is wrong, or the body has no two legs.
        """
        self.sim = Simulation(complete(setup), num_worlds, autoreset="disabled")
        self._signals, self._values = Signals(self.sim), np.ones((num_worlds, len(SCALES)))
        self._control = ReflexControl(self._values, delays, self.sim)
        self.duration = self.sim.horizon * self.sim.scene.control_dt

    def walk(self, values: np.ndarray, starts: int = 1) -> Walks:
        """Let gaits walk, each until it falls, or to the horizon.

        Args:
            values: Parameters, shape (n, 48).
            starts: Gaits in a row that have the seeds from that of the setup on.
        """
        watcher, found = _Walking(self.sim, self._signals), np.zeros((4, len(values)))
        first, waiting = self.sim.setup.seed or 0, deque(range(len(values)))
        trial = np.full(self.sim.num_worlds, -1)  # of each world; -1: none
        steps = stepped(self.sim, self._control)
        while True:
            free = ~watcher.alive
            done = free & (trial >= 0)
            found[:, trial[done]] = watcher.figures()[:, done]
            trial[free] = -1
            for world in np.flatnonzero(free)[: len(waiting)]:
                trial[world] = waiting.popleft()
            if (begins := free & (trial >= 0)).any():
                self._values[begins] = values[trial[begins]]
                self._control.change(self._values)
                self.sim.reset(begins, np.array([first + number % starts for number in trial], dtype=object))
                watcher.start(begins)
            if not watcher.alive.any():
                return Walks(*found)
            watcher.see(next(steps))


def search(plan: Search, output: Path, generations: int, console: Console) -> Gait:
    """Search a gait, or go on with the search of a folder.

    Args:
        plan: Its plan.
        output: Folder of the search.
        generations: How many there are to be in it.
        console: Where progress is shown.

    Raises:
        ImportError: `cma` is not installed.
        ValueError: The folder holds another search, or the body has no two legs.
        OSError: The folder cannot be written.
    """
    check_installed("searching a gait", "cma", "gait")
    import cma

    make_folder(output)
    settings = plan.plain()
    solutions, costs = _read(output, settings)
    low = [BOUNDS[0] if name in FREE else 0.0 for name in SCALES]
    options = {"popsize": plan.population, "bounds": [low, BOUNDS[1]], "verbose": -9}
    options |= {"seed": (plan.setup.seed or 0) + 1}  # 0 would be the clock's
    strategy = cma.CMAEvolutionStrategy(plan.middle, plan.spread, options)
    for told, cost in zip(solutions, costs, strict=True):
        if not np.allclose(strategy.ask(), told):
            raise ValueError(f"folder {str(output)!r} holds a search of another cma; choose another --output")
        strategy.tell(list(told), cost.tolist())
    gait = _best(plan, solutions, costs)
    if len(costs) < generations:
        trials = Trials(plan.setup, _at_once(plan), plan.delays)
        with progress_bar("Searching", "generations, {task.fields[best]}", console) as bar:
            task = bar.add_task("", total=generations, completed=len(costs), best="")
            while len(costs) < generations:
                asked = np.array(strategy.ask())
                walks = trials.walk(unscaled(np.repeat(asked, plan.starts, 0)), plan.starts)
                cost = walks.cost(plan.speed, trials.duration).reshape(-1, plan.starts).mean(axis=1)
                strategy.tell(list(asked), cost.tolist())
                solutions, costs = [*solutions, asked], [*costs, cost]
                gait = _best(plan, solutions, costs)
                _write(output, settings, solutions, costs, gait)
                longest = walks.time.reshape(-1, plan.starts).mean(axis=1).max()
                bar.update(task, advance=1, best=f"cost {np.min(costs):.1f}, {longest:.1f} s up")
    return gait


def _at_once(plan: Search) -> int:
    """Return how many gaits walk at once: all on a GPU, a quarter on cores, for which those that lie cost."""
    number = plan.population * plan.starts
    return -(-number // 4) if resolve_device(plan.setup.device).is_cpu else number


def _best(plan: Search, solutions: list[np.ndarray], costs: list[np.ndarray]) -> Gait:
    """Return the cheapest candidate so far, or the middle."""
    said = {"source": "CMA-ES", "versions": versions(), "search": plan.plain(), "generations": len(costs)}
    if not costs:
        return gait_of(plan.middle, plan.delays, said)
    generation, candidate = np.unravel_index(np.argmin(costs), np.shape(costs))
    said |= {"cost": float(np.min(costs))}
    return gait_of(solutions[int(generation)][int(candidate)], plan.delays, said)


def _read(output: Path, settings: dict[str, Any]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return candidates and costs of the generations that a folder has.

    Raises:
        ValueError: It is of another search.
    """
    if not (output / SEARCH).exists():
        return [], []
    recorded = json.loads((output / SETTINGS).read_text())
    wanted = json.loads(json.dumps(settings))
    check_settings(f"folder {str(output)!r} holds a search of", recorded, wanted)
    with np.load(output / SEARCH) as arrays:
        return list(arrays["solutions"]), list(arrays["costs"])


def _write(
    output: Path,
    settings: dict[str, Any],
    solutions: list[np.ndarray],
    costs: list[np.ndarray],
    gait: Gait,
) -> None:
    """Write the folder; the search comes last."""
    with in_place(output / SETTINGS) as scratch:
        scratch.write_text(json.dumps(settings, indent=1) + "\n")
    gait.save(output / GAIT)
    with in_place(output / SEARCH) as scratch:
        np.savez(scratch, solutions=np.array(solutions), costs=np.array(costs))
