"""Worlds over the cores of a CPU: each thread steps a part of them, a simulation of its own.

    sim = simulate(TASKS["myoHandPoseRandom-v0"], 256)

A world's numbers depend on its seed alone, so that the split does not show in them: the results are those of
one `Simulation` of all worlds, bit for bit. On CUDA there is nothing to split.
"""

import copy
import dataclasses
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
import warp as wp

from myowarp.engine.compile import can_renew_code, quiet
from myowarp.engine.graph import Graph, Replay
from myowarp.engine.threads import Team, num_cores
from myowarp.engine.turn import in_turn
from myowarp.kernels.episode import EpisodeState, Masks, Transition
from myowarp.kernels.random import RandomKeys
from myowarp.progress import patient_bar
from myowarp.sim.build import checked_num_worlds, resolve_device
from myowarp.sim.simulation import Simulation
from myowarp.sim.starts import find_starts
from myowarp.spec.condition import Condition
from myowarp.spec.muscle import Anatomy
from myowarp.spec.scene import Scene
from myowarp.spec.task import TaskSpec
from myowarp.spec.worlds import Worlds

LEAST_WORLDS = 4  # in a shard, by default: fewer are not worth the time that a shard takes to build
NUM_GRAPHS = 2  # of a part: step and reset
PATIENCE = 2.0  # s without a word


@in_turn
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
    if options.get("reset") == "random":
        options["starts"] = find_starts(spec, options.get("progress", True))
    if shards == 1:
        return Simulation(spec, num_worlds, device=device, **options)
    return Shards(spec, num_worlds, int(shards), device=device, **options)


class Shards:
    """Simulations of a part of the worlds each, seen and used as one `Simulation` of all.

    Attributes:
        parts: The simulations; kernels of others run over their scenes (`Simulation.attach`).
        scene: Names, sizes and settings, and the state of all worlds. What does not belong to a single
            world, such as contacts, or only to the engine is with the parts, and None here.
        action: As in `Simulation`, over all worlds; so are `transition`, `final`, `episode` and `masks`.
        columns: Blocks of the observation.
        terms: Reward terms.
        info: What conditions show of their state.
    """

    @in_turn
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
        self.scene = _joined(parts[0].scene, worlds, parts[0].conditions)
        self.columns, self.terms = parts[0].columns, parts[0].terms
        self.action = worlds.shared["sim.action"]
        self.transition = worlds.join("transition", Transition())
        self.final = worlds.join("final", Transition())
        self.episode = worlds.join("episode", EpisodeState())
        self.masks = worlds.join("masks", Masks())
        self.info = {name: worlds.shared[f"info.{name}"] for name in parts[0].info}
        self._programs: Callable[[tuple[Replay, ...]], Replay] | None = None
        self._process = os.getpid()
        self._failure: str | None = None

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The muscle conditions, in the order in which they act."""
        return self.parts[0].conditions

    @property
    def full_model(self) -> mujoco.MjModel:
        """The unslimmed model with the task's objects, for pictures and comparisons; host."""
        return self.parts[0].full_model

    @property
    def num_worlds(self) -> int:
        """Worlds stepped together."""
        return self.scene.num_worlds

    def step(self) -> None:
        """Advance all worlds by one control step under `action`; results are in `transition`.

        Raises:
            RuntimeError: Without graphs, a part has failed in an earlier step.
        """
        self._together([part.step_graph for part in self.parts], Simulation.step)

    def reset(self, mask: np.ndarray | None = None, seeds: np.ndarray | None = None) -> None:
        """Start new episodes; see `Simulation.reset`.

        Raises:
            RuntimeError: As in `step`.
        """
        for part in self.parts:
            own = part.scene.worlds.own
            part.ask_for_reset(None if mask is None else mask[own], None if seeds is None else seeds[own])
        self._together([part.reset_graph for part in self.parts], Simulation.reset_asked)

    def close(self) -> None:
        """Let the threads end, once no step is under way; the next would start new ones."""
        self._programs = None

    def _together(self, graphs: Sequence[Graph | None], act: Callable[[Simulation], None]) -> None:
        """Replay a graph of each part, all at the same time; without graphs, let them act one by one."""
        if self._failure is not None:
            raise RuntimeError(self._failure)
        replays = tuple(graph.replay for graph in graphs if graph is not None and graph.replay is not None)
        if None in graphs or not can_renew_code():  # else they would share their scratch memory
            self._one_by_one(act)
            return
        if len(replays) < len(self.parts):
            self._in_threads(act)
            return
        programs = self._programs
        if programs is None or self._process != os.getpid():  # threads do not live on in a forked process
            programs = lru_cache(maxsize=NUM_GRAPHS)(Team(len(self.parts)).together)
            self._programs, self._process = programs, os.getpid()
        programs(replays)()

    def _in_threads(self, act: Callable[[Simulation], None]) -> None:
        """Let the parts act at the same time in threads of Python, where Warp replays their graphs."""
        with ThreadPoolExecutor(len(self.parts)) as pool:
            futures = [pool.submit(self._act, act, part) for part in self.parts]
        for future in futures:
            future.result()

    def _one_by_one(self, act: Callable[[Simulation], None]) -> None:
        """Let the parts act one after the other."""
        for part in self.parts:
            self._act(act, part)

    def _act(self, act: Callable[[Simulation], None], part: Simulation) -> None:
        """Let a part act; if it does not get to the end, the parts are no longer at the same step."""
        try:
            act(part)
        except BaseException as error:
            own, reason = part.scene.worlds.own, f"{type(error).__name__}: {error}"
            self._failure = f"worlds {own.start} to {own.stop - 1} stopped ({reason}); make a new simulation"
            error.add_note(self._failure)
            self.close()
            raise


def _joined(scene: Scene, worlds: Worlds, conditions: tuple[Condition, ...]) -> Scene:
    """Return the scene of all worlds, after that of a part."""
    model, data, muscles = copy.copy(scene.model), copy.copy(scene.data), copy.copy(scene.muscles)
    for field in dataclasses.fields(data):
        value = getattr(data, field.name)
        if dataclasses.is_dataclass(value) or (isinstance(value, wp.array) and value.size):
            setattr(data, field.name, None)
    data.nworld = worlds.total
    if conditions:
        muscles.anatomy = worlds.join("anatomy", Anatomy())
    return dataclasses.replace(
        scene,
        worlds=worlds,
        model=worlds.join("model", model),
        data=worlds.join("data", data),
        muscles=worlds.join("muscles", muscles),
        keys=worlds.join("keys", RandomKeys()),
    )
