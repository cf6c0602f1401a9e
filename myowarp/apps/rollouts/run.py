"""The one loop: act, step, watch, and start again what has ended.

    episodes = Episodes(sim)
    run(sim, acting(find_policy("zero", spec), sim), 500, episodes)
    print(episodes.arrays()["return"].mean())

What a step led to is said here once; what is made of it, each watcher says.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count, islice

import numpy as np
from rich.console import Console

from myowarp.progress import progress_bar
from myowarp.sim.interop import ActionInput
from myowarp.sim.simulation import Simulation

Act = Callable[[np.ndarray], np.ndarray | None]
"""Observations (num_worlds, obs_size) to actions (num_worlds, num_actions) in [-1, 1]; None: as before."""


@dataclass(frozen=True)
class Step:
    """A step of all worlds and what it led to, the ends of episodes included, each (num_worlds, ...).

    Arrays may be memory of the simulation that the next step overwrites.

    Attributes:
        number: Steps so far, this one included.
        obs: What was observed before it.
        action: What was done.
        reward: Reward.
        terminated: Whether the task or a fault ended the episode.
        truncated: Whether the horizon ended it.
        solved: Whether the task is solved in the state that it led to.
        success: Whether the episode counts as a success so far: `myowarp.kernels.episode.SUCCESS_RULE`.
        fault: 0, or bits of `myowarp.kernels.episode.FAULTS`.
        seconds: What stepping has taken so far [s], without acting and watching.
    """

    number: int
    obs: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    solved: np.ndarray
    success: np.ndarray
    fault: np.ndarray
    seconds: float

    @property
    def ended(self) -> np.ndarray:
        """Whether the episode is over."""
        return self.terminated | self.truncated


class Watcher:
    """Looks at a run; what it does not write does nothing."""

    def start(self, mask: np.ndarray) -> None:
        """The worlds of the mask (num_worlds,) bool stand where an episode starts."""

    def see(self, step: Step) -> np.ndarray | None:
        """A step was made.

        Returns:
            Worlds that are to start again though their episode has not ended, (num_worlds,) bool; None: none.
        """


class Each(Watcher):
    """Calls a function after every step."""

    def __init__(self, function: Callable[[Step], object]) -> None:
        self._function = function

    def see(self, step: Step) -> None:
        """Call it."""
        self._function(step)


@contextmanager
def progress(title: str, unit: str, steps: int, console: Console | None) -> Iterator[Watcher]:
    """Draw a progress bar in the block; yield what moves it with every step of a run."""
    with progress_bar(title, unit, console) as bar:
        task = bar.add_task("", total=steps)
        yield Each(lambda step: bar.advance(task))


def seeds_of(sim: Simulation) -> np.ndarray:
    """Return the seed of every world, shape (num_worlds,): that of the setup + i, i over all ranks."""
    first = (sim.setup.seed or 0) + sim.scene.worlds.offset
    return np.array([first + i for i in range(sim.num_worlds)], dtype=object)


def run(
    sim: Simulation,
    act: Act,
    steps: int,
    *watchers: Watcher,
    seeds: np.ndarray | None = None,
    fresh: bool = True,
    again: bool = True,
    until: Callable[[], bool] = lambda: False,
) -> None:
    """Let a policy act in all worlds.

    Args:
        sim: The worlds; with autoreset "same_step" they start again by themselves, with "disabled" here.
        act: The policy.
        steps: Control steps.
        watchers: Who looks, in this order.
        seeds: Seeds of the worlds, shape (num_worlds,); None: those of the setup.
        fresh: Whether all worlds start anew; else they go on from where they are.
        again: Whether what has ended starts again; else it goes on as it is.
        until: Whether to stop before; asked after every step.

    Raises:
        ValueError: Actions have a wrong shape or value.
    """
    if fresh:
        sim.reset(seeds=seeds_of(sim) if seeds is None else seeds)
        for watcher in watchers:
            watcher.start(np.ones(sim.num_worlds, dtype=bool))
    for step in islice(stepped(sim, act), steps):
        restart = step.ended
        for watcher in watchers:
            if (more := watcher.see(step)) is not None:
                restart = restart | more
        if step.number == steps or until():
            return
        if sim.autoreset == "disabled":
            if not again:
                continue
            if restart.any():
                sim.reset(restart)
        if restart.any():
            for watcher in watchers:
                watcher.start(restart)


def stepped(sim: Simulation, act: Act) -> Iterator[Step]:
    """Step a simulation for ever, under a policy; yield every step.

    Raises:
        ValueError: Actions have a wrong shape or value.
    """
    take, action, seconds = ActionInput(sim.action), sim.action.numpy(), 0.0
    for number in count(1):
        obs = sim.transition.obs.numpy().copy()
        asked = act(obs.copy())  # which a policy may keep, or write into
        begin = time.perf_counter()
        if asked is not None:
            take(asked)
            action = np.array(asked)  # which a policy may use again
        sim.step()
        led_to = _outcome(sim)
        seconds += time.perf_counter() - begin
        yield Step(number, obs, action, **led_to, seconds=seconds)


def _outcome(sim: Simulation) -> dict[str, np.ndarray]:
    """Return what the last step led to; with autoreset in the same step, what ended is in `sim.final`."""
    seen = sim.transition
    names = ("reward", "terminated", "truncated", "fault", "solved", "success")
    found = {name: getattr(seen, name).numpy() for name in names}
    ended = found["terminated"] | found["truncated"]
    if sim.autoreset == "same_step" and ended.any():
        for name in ("solved", "success"):
            found[name] = np.where(ended, getattr(sim.final, name).numpy(), found[name])
    return found
