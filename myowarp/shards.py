"""Worlds over the cores of a CPU: each thread steps a part of them, a simulation of its own.

    sim = simulate(TASKS["myoHandPoseRandom-v0"], 256)

A world's numbers depend on its seed alone, so that the split does not show in them: the results are those of
one `Simulation` of all worlds, bit for bit. On CUDA there is nothing to split.
"""

import copy
import dataclasses
import operator
import os
import threading
import weakref
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeAlias

import numpy as np
import warp as wp

from myowarp.kernels.episode import EpisodeState, Masks, Transition
from myowarp.kernels.random import RandomKeys
from myowarp.look import Look
from myowarp.models.muscles import Anatomy
from myowarp.progress import patient_bar
from myowarp.scene import Scene, checked_num_worlds, resolve_device
from myowarp.sim import Simulation
from myowarp.spec import TaskSpec
from myowarp.warmup import quiet
from myowarp.worlds import Worlds

Task: TypeAlias = Callable[[], None]

LEAST_WORLDS = 4  # in a shard, by default: fewer are not worth the time that a shard takes to build
PATIENCE = 2.0  # s without a word


def simulate(
    spec: TaskSpec, num_worlds: int, *, shards: int | None = None, device: str | None = None, **options: Any
) -> "Simulation | Shards":
    """Return a simulation of all worlds, over all cores where the device is the CPU.

    Args:
        spec: The task.
        num_worlds: Worlds to step together.
        shards: Threads that share them; None: one for each core that this process may use, but none with
            fewer than 4 worlds.
        device: Warp device; None: the first CUDA device if there is one, else the CPU.
        **options: Those of `Simulation`.

    Raises:
        ValueError: An argument is out of its range.
    """
    num_worlds = checked_num_worlds(num_worlds)
    with quiet():
        where = resolve_device(device)
    if shards is None:
        shards = max(1, min(num_cores(), num_worlds // LEAST_WORLDS)) if where.is_cpu else 1
    if isinstance(shards, bool) or not isinstance(shards, (int, np.integer)) or not 1 <= shards <= num_worlds:
        raise ValueError(
            f"shards must be an integer from 1 to the number of worlds, {num_worlds}, got {shards!r}"
        )
    if shards > 1 and not where.is_cpu:
        raise ValueError(f"shards are for the CPU; leave them out on device {where.alias!r}, got {shards}")
    if shards == 1:
        return Simulation(spec, num_worlds, device=device, **options)
    return Shards(spec, num_worlds, int(shards), device=device, **options)


def num_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Shards:
    """Simulations of a part of the worlds each, seen and used as one `Simulation` of all.

    Attributes:
        parts: The simulations; kernels of others run over their scenes (`Simulation.attach`).
        scene: Names, sizes and settings, and the state of all worlds. What does not belong to a single
            world, such as contacts, is with the parts, and None here.
        action: As in `Simulation`, over all worlds; so are `transition`, `final`, `episode` and `masks`.
        columns: Blocks of the observation.
        terms: Reward terms.
        info: What conditions show of their state.
    """

    def __init__(self, spec: TaskSpec, num_worlds: int, shards: int, **options: Any) -> None:
        """Build the parts one after the other; kernels are compiled once.

        Args:
            spec: The task.
            num_worlds: Worlds to step together.
            shards: Number of parts, from 2 to `num_worlds`.
            **options: Those of `Simulation`.

        Raises:
            ValueError: An argument is out of its range.
        """
        worlds = Worlds.all(num_worlds)
        parts: list[Simulation] = []
        show = options.get("progress", True)
        with patient_bar("Preparing cores", "shards", shards, patience=PATIENCE, show=show) as advance:
            for part in worlds.split(shards):
                parts.append(Simulation(spec, part, like=parts[0] if parts else None, **options))
                advance(1)
        self.parts = tuple(parts)
        self.scene = _joined(parts[0].scene, worlds)
        self.columns, self.terms = parts[0].columns, parts[0].terms
        self.action = worlds.shared["sim.action"]
        self.transition = worlds.join("transition", Transition())
        self.final = worlds.join("final", Transition())
        self.episode = worlds.join("episode", EpisodeState())
        self.masks = worlds.join("masks", Masks())
        self.info = {name: worlds.shared[f"info.{name}"] for name in parts[0].info}
        self._threads: list[_Thread] = []
        self._process = os.getpid()
        self._failure: str | None = None

    @property
    def num_worlds(self) -> int:
        """Worlds stepped together."""
        return self.scene.num_worlds

    def step(self) -> None:
        """Advance all worlds by one control step under `action`; results are in `transition`.

        Raises:
            RuntimeError: A part has failed; its worlds are named, and no thread is left.
        """
        self._together(operator.methodcaller("step"))

    def reset(self, mask: np.ndarray | None = None, seeds: np.ndarray | None = None) -> None:
        """Start new episodes; see `Simulation.reset`.

        Raises:
            RuntimeError: As in `step`.
        """

        def reset(part: Simulation) -> None:
            own = part.scene.worlds.own
            part.reset(None if mask is None else mask[own], None if seeds is None else seeds[own])

        self._together(reset)

    def look(self, world: int) -> Look:
        """Return what a picture of one world shows."""
        part = next(part for part in reversed(self.parts) if part.scene.worlds.first <= world)
        return part.look(world - part.scene.worlds.first)

    def close(self) -> None:
        """End the threads; the next step would start new ones."""
        for thread in self._threads:
            thread.end()
        self._threads = []

    def _together(self, act: Callable[[Simulation], None]) -> None:
        """Let every part act, the first in this thread and the others in threads of their own."""
        if self._failure is not None:
            raise RuntimeError(self._failure)
        first, *others = self.parts
        if not self._threads or self._process != os.getpid():  # threads do not live on in a forked process
            self._threads, self._process = [_Thread() for _ in others], os.getpid()
        self._wait()  # they may still be at work where Ctrl-C broke off the waiting below
        for thread, part in zip(self._threads, others, strict=True):
            thread.begin(partial(act, part))
        try:
            act(first)
        except BaseException as error:
            self._wait(error)
            raise
        self._wait()

    def _wait(self, first_error: BaseException | None = None) -> None:
        """Wait for the threads, and raise RuntimeError if a part has failed; Ctrl-C is no failure.

        Args:
            first_error: What the first part has raised.
        """
        errors = [first_error, *[thread.error() for thread in self._threads]]
        if all(error is None for error in errors):
            return
        for part, error in zip(self.parts, errors, strict=True):
            if isinstance(error, Exception):
                own = part.scene.worlds.own
                self._failure = (
                    f"worlds {own.start} to {own.stop - 1} stopped ({type(error).__name__}: {error})"
                )
                self.close()
                raise RuntimeError(self._failure) from error


class _Thread:
    """A thread for one part; it ends with this object.

    Queues, not futures: waking a thread and waiting for it is half of what a step of 64 elbows costs beside
    its kernels.
    """

    def __init__(self) -> None:
        asked, self._errors = SimpleQueue[Task | None](), SimpleQueue[BaseException | None]()
        thread = threading.Thread(target=_work, args=(asked, self._errors), name="myowarp", daemon=True)
        self._asked, self._running = asked, False
        self._error: BaseException | None = None
        self.end = weakref.finalize(self, _end, thread, asked)
        thread.start()

    def begin(self, task: Task) -> None:
        """Let it work; what the last task has raised is forgotten."""
        self._error = None
        self._asked.put(task)
        self._running = True

    def error(self) -> BaseException | None:
        """Wait until it has done its task, if it has one, and return what was raised."""
        if self._running:
            self._error = self._errors.get()
            self._running = False
        return self._error


class _HandOver:
    """Hands over what a block raises, None if nothing, to the thread that waits for it."""

    def __init__(self, errors: SimpleQueue[BaseException | None]) -> None:
        self._errors = errors

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> bool:
        self._errors.put(error)
        return True


def _work(asked: SimpleQueue[Task | None], errors: SimpleQueue[BaseException | None]) -> None:
    """Do tasks until there is None; in between nothing is held that would keep a simulation alive."""
    while (task := asked.get()) is not None:
        with _HandOver(errors):
            task()
        del task


def _end(thread: threading.Thread, asked: SimpleQueue[Task | None]) -> None:
    """Let a thread end; wherever the garbage is collected, even in itself."""
    asked.put(None)
    if thread is not threading.current_thread():
        thread.join()


def _joined(scene: Scene, worlds: Worlds) -> Scene:
    """Return the scene of all worlds, after that of a part."""
    model, data, muscles = copy.copy(scene.model), copy.copy(scene.data), copy.copy(scene.muscles)
    for field in dataclasses.fields(data):
        value = getattr(data, field.name)
        if dataclasses.is_dataclass(value) or (isinstance(value, wp.array) and value.size):
            setattr(data, field.name, None)
    data.nworld = worlds.total
    if scene.conditions:
        muscles.anatomy = worlds.join("anatomy", Anatomy())
    return dataclasses.replace(
        scene,
        worlds=worlds,
        model=worlds.join("model", model),
        data=worlds.join("data", data),
        muscles=worlds.join("muscles", muscles),
        keys=worlds.join("keys", RandomKeys()),
    )
