"""Rollouts of policies that know nothing, and what is counted on the way.

Zero, random and extreme actions show what a task does to whom it meets first: an untrained policy.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import repeat

import numpy as np

from myowarp.apps.rollouts.episodes import Episodes
from myowarp.apps.rollouts.run import Each, Step, Watcher, run, seeds_of
from myowarp.kernels.episode import FAULTS
from myowarp.sim.simulation import Simulation

EARLY_STEPS = 5  # control steps within which a failure is none of the policy's
HOLD_STEPS = 10  # control steps for which an extreme action is held
RESETS_PROBED = 5  # of every world, with zero actions

Actions = Iterator[np.ndarray | None]
"""Actions in [-1, 1], shape (num_worlds, num_actuators), step by step; None: the last ones."""


def _zero(shape: tuple[int, ...], rng: np.random.Generator) -> Actions:
    """No action."""
    yield np.zeros(shape)
    yield from repeat(None)


def _random(shape: tuple[int, ...], rng: np.random.Generator) -> Actions:
    """U(-1, 1) in every step."""
    while True:
        yield rng.uniform(-1.0, 1.0, shape)


def _extreme(shape: tuple[int, ...], rng: np.random.Generator) -> Actions:
    """-1 or 1, drawn again every `HOLD_STEPS` steps."""
    while True:
        yield rng.choice((-1.0, 1.0), shape)
        yield from repeat(None, HOLD_STEPS - 1)


POLICIES: dict[str, Callable[[tuple[int, ...], np.random.Generator], Actions]] = {
    "zero": _zero,
    "random": _random,
    "extreme": _extreme,
}
"""The policies of an audit by name."""


@dataclass(frozen=True)
class Score:
    """Scores of a policy over `episodes` episodes; all others are None where there are none.

    Counted are the episodes that began at least a horizon before the end of the run. All of them have
    finished, so that short ones are no more likely to be counted than long ones.

    Attributes:
        episodes: Number of episodes counted.
        return_mean: Mean of their returns.
        return_std: Standard deviation of their returns.
        success: Share that counts as a success.
        failed: Share that ended by failure.
        failed_early: Share that ended by failure within `EARLY_STEPS` steps.
        length_mean: Mean length [control steps].
        returns: Returns, one an episode.
        failures: How many failed in their first, second, ... step, up to the horizon.
    """

    episodes: int
    return_mean: float | None
    return_std: float | None
    success: float | None
    failed: float | None
    failed_early: float | None
    length_mean: float | None
    returns: tuple[float, ...] = field(repr=False)
    failures: tuple[int, ...] = field(repr=False)


@dataclass(frozen=True)
class ColumnRange:
    """Smallest and largest value of an observation column, named `block[index]`, in the block's unit."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class TermRange:
    """A reward term before weighting: its extremes, and its mean over all steps without fault.

    Attributes:
        name: Name of the term.
        weight: What it counts in the reward; 0: it is only logged.
        low: Smallest value.
        mean: Mean over the steps of all policies.
        high: Largest value.
        means: Mean over the steps of each policy, by its name.
    """

    name: str
    weight: float
    low: float
    mean: float
    high: float
    means: dict[str, float]


@dataclass(frozen=True)
class Failing:
    """Whether it pays to fail; over all policies.

    Attributes:
        return_failed: Mean return of counted episodes that failed; None: none did.
        return_lasted: Mean return of counted episodes that lasted to the horizon; None: none did.
        living_reward: Mean reward of a step in which the task does not fail; None: no such step.
        failing_reward: Mean reward of a step in which the task fails; None: no such step.
        failure_gain: `failing_reward - living_reward * horizon`: what an episode that fails in its first
            step has over one that lives to the end; positive: failing early pays. None: a part is.
    """

    return_failed: float | None
    return_lasted: float | None
    living_reward: float | None
    failing_reward: float | None
    failure_gain: float | None


@dataclass(frozen=True)
class Load:
    """Use of the arrays of contacts and constraint rows, at the ends of control steps.

    Attributes:
        contacts: Largest number of contacts in all worlds together.
        candidates: Largest number of pairs of the broad phase in all worlds together; they share the pool.
        pool: Contacts allocated for all worlds together.
        pool_margin: Share of the pool that was never used [percent]; None: the task has no contacts.
        rows: Largest number of constraint rows in a world.
        rows_allocated: Rows allocated for each world.
        rows_margin: Share of the rows that was never used [percent].
    """

    contacts: int
    candidates: int
    pool: int
    pool_margin: float | None
    rows: int
    rows_allocated: int
    rows_margin: float


def mean_or_none(values: Iterable[float]) -> float | None:
    """Return the mean as a plain number, None of nothing."""
    held = list(values)
    return float(np.mean(held)) if held else None


class Run(Watcher):
    """Runs policies one after the other in one simulation and counts.

    Attributes:
        episodes: What is known of the finished episodes that are counted, by policy (`Episodes.arrays`).
    """

    def __init__(self, sim: Simulation, steps: int) -> None:
        """Start counting.

        Args:
            sim: Simulation with autoreset "same_step"; the policies draw from its setup's seed.
            steps: Control steps of each policy.
        """
        self.sim, self.steps = sim, steps
        self.episodes: dict[str, dict[str, np.ndarray]] = {}
        size, terms = sim.transition.obs.shape[1], len(sim.terms)
        self._low, self._high = np.full(size, np.inf), np.full(size, -np.inf)
        self._term_low, self._term_high = np.full(terms, np.inf), np.full(terms, -np.inf)
        self._term_sum: dict[str, np.ndarray] = {}
        self._healthy: dict[str, int] = {}
        self._rewards = {True: np.zeros(2), False: np.zeros(2)}  # failing or not: sum, number
        self._fault_bits = dict.fromkeys(FAULTS, 0)
        self._peak = np.zeros(3, dtype=int)
        self._policy = ""

    def run(self, name: str, watch: Callable[[], None], tick: Callable[[float], None]) -> None:
        """Run a policy from fresh episodes.

        Args:
            name: Key of `POLICIES`.
            watch: Called after the resets and after every step, to look at the state.
            tick: Called with the share of the steps done.
        """
        rng = np.random.default_rng((self.sim.setup.seed or 0, list(POLICIES).index(name)))
        actions = POLICIES[name](self.sim.action.shape, rng)
        self._policy = name
        self._term_sum[name], self._healthy[name] = np.zeros(len(self.sim.terms)), 0
        episodes, look = Episodes(self.sim.num_worlds), _Look(watch)
        told = Each(lambda step: tick(step.number / self.steps))
        run(self.sim, lambda obs: next(actions), self.steps, look, told, self, episodes)
        found = episodes.arrays()
        counted = found["begin"] <= self.steps - self.sim.horizon
        self.episodes[name] = {key: array[counted] for key, array in found.items()}

    def start(self, mask: np.ndarray) -> None:
        """See what worlds observe where they start."""
        self._see(self.sim.transition.obs.numpy()[mask])

    def _see(self, obs: np.ndarray) -> None:
        """Widen the ranges of the observation by rows that may be none."""
        self._low = np.fmin(self._low, np.fmin.reduce(obs, axis=0, initial=np.inf))
        self._high = np.fmax(self._high, np.fmax.reduce(obs, axis=0, initial=-np.inf))

    def see(self, step: Step) -> None:
        """Count a step."""
        transition, final, data = self.sim.transition, self.sim.final, self.sim.scene.data
        faulty, ended = step.fault != 0, step.ended
        failed = step.terminated & ~faulty
        self._see(transition.obs.numpy())
        self._see(final.obs.numpy()[ended & ~faulty])
        terms = np.where(ended[:, None], final.terms.numpy(), transition.terms.numpy())[~faulty]
        self._term_low = np.minimum(self._term_low, terms.min(axis=0, initial=np.inf))
        self._term_high = np.maximum(self._term_high, terms.max(axis=0, initial=-np.inf))
        self._term_sum[self._policy] += terms.sum(axis=0, dtype=float)
        self._healthy[self._policy] += len(terms)
        for failing, where in ((True, failed), (False, ~failed & ~faulty)):
            self._rewards[failing] += step.reward[where].sum(dtype=float), np.count_nonzero(where)
        for bit in self._fault_bits:
            self._fault_bits[bit] += int(np.count_nonzero(step.fault & bit))
        peak = (data.nacon.numpy().max(), data.ncollision.numpy().max(), data.nefc.numpy().max())
        self._peak = np.maximum(self._peak, peak)

    def score(self, name: str) -> Score:
        """Return what a policy got."""
        episodes = self.episodes[name]
        returns, failed = episodes["return"], episodes["failed"]
        lengths = episodes["length"][failed]
        return Score(
            episodes=len(returns),
            return_mean=mean_or_none(returns),
            return_std=float(returns.std()) if len(returns) else None,
            success=mean_or_none(episodes["success"]),
            failed=mean_or_none(failed),
            failed_early=mean_or_none(failed & (episodes["length"] <= EARLY_STEPS)),
            length_mean=mean_or_none(episodes["length"]),
            returns=tuple(returns.tolist()),
            failures=tuple(np.bincount(lengths, minlength=self.sim.horizon + 1)[1:].tolist()),
        )

    def columns(self) -> tuple[ColumnRange, ...]:
        """Return the range of every observation column."""
        names = [(f"{c.name}[{i}]", c.unit) for c in self.sim.columns for i in range(c.size)]
        ranges = zip(names, self._low.tolist(), self._high.tolist(), strict=True)
        return tuple(ColumnRange(*name, low, high) for name, low, high in ranges)

    def terms(self) -> tuple[TermRange, ...]:
        """Return the range of every reward term."""
        sums, steps = sum(self._term_sum.values()), sum(self._healthy.values())
        return tuple(
            TermRange(
                term.name,
                term.weight,
                float(self._term_low[k]),
                float(np.asarray(sums)[k] / max(steps, 1)),
                float(self._term_high[k]),
                {
                    name: float(self._term_sum[name][k] / max(self._healthy[name], 1))
                    for name in self._healthy
                },
            )
            for k, term in enumerate(self.sim.terms)
        )

    def failing(self) -> Failing:
        """Return what failing brings."""
        every = {
            name: np.concatenate([episodes[name] for episodes in self.episodes.values()])
            for name in ("return", "failed", "fault")
        }
        lasted = ~every["failed"] & (every["fault"] == 0)
        (dead, num_dead), (alive, num_alive) = self._rewards[True], self._rewards[False]
        failing = float(dead / num_dead) if num_dead else None
        living = float(alive / num_alive) if num_alive else None
        both = failing is not None and living is not None
        return Failing(
            return_failed=mean_or_none(every["return"][every["failed"]]),
            return_lasted=mean_or_none(every["return"][lasted]),
            living_reward=living,
            failing_reward=failing,
            failure_gain=failing - living * self.sim.horizon if both else None,  # type: ignore[operator]
        )

    def faults(self) -> dict[str, int]:
        """Return how many steps of a world had each fault, by the fault's meaning."""
        return {FAULTS[bit]: int(number) for bit, number in self._fault_bits.items()}

    def load(self) -> Load:
        """Return how full the arrays were."""
        data, (contacts, candidates, rows) = self.sim.scene.data, self._peak.tolist()
        pool, allocated = int(data.naconmax), int(data.njmax)
        free = 100.0 * (1.0 - max(contacts, candidates) / pool) if pool else None
        return Load(contacts, candidates, pool, free, rows, allocated, 100.0 * (1.0 - rows / allocated))


class _Look(Watcher):
    """Calls a function where episodes start and after every step."""

    def __init__(self, look: Callable[[], None]) -> None:
        self._look = look

    def start(self, mask: np.ndarray) -> None:
        """Look."""
        self._look()

    def see(self, step: Step) -> None:
        """Look."""
        self._look()


def early_failures(sim: Simulation) -> float:
    """Return the share of starts from which zero actions fail within `EARLY_STEPS` steps."""
    lost, rest = 0, np.zeros(sim.action.shape)
    for again in range(RESETS_PROBED):
        sim.reset(seeds=seeds_of(sim) if again == 0 else None)
        episodes = Episodes(sim.num_worlds)
        run(sim, lambda obs: rest, EARLY_STEPS, episodes, fresh=False)
        lost += int(np.count_nonzero(episodes.first()["failed"]))
    return float(lost / (RESETS_PROBED * sim.num_worlds))
