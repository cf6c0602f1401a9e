"""All worlds of a task, stepped together; on a CPU each core steps a shard of them.

    sim = Simulation(TASKS["myoHandPoseRandom-v0"], 256, shards=None)

A world's numbers depend on its seed alone, so that the split does not show in them: results are the same for
any number of shards, bit for bit. On CUDA there is nothing to split.
"""

from __future__ import annotations

import copy
import dataclasses
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cached_property, lru_cache, partial
from typing import Any

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.condition import resolve
from myowarp.definitions.muscle import Anatomy
from myowarp.definitions.registry import check_choice, check_flag, is_integer
from myowarp.definitions.scene import Scene
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TaskSpec
from myowarp.definitions.worlds import Worlds
from myowarp.engine.compile import can_renew_code, quiet
from myowarp.engine.graph import Graph, Replay
from myowarp.engine.stage import STAGES, Stage
from myowarp.engine.threads import Team
from myowarp.kernels.episode import (
    AUTORESET,
    FAULT_OBSERVATION,
    FAULT_REWARD,
    EpisodeState,
    Masks,
    Transition,
    describe_fault,
)
from myowarp.kernels.random import RandomKeys
from myowarp.process import num_cores, with_build_lock
from myowarp.progress import patient_bar
from myowarp.sim.build import (
    checked_horizon,
    checked_num_worlds,
    compile_scene,
    full_model,
    resolve_device,
)
from myowarp.sim.shard import Shard
from myowarp.sim.starts import find_starts

LEAST_WORLDS = 4  # in a shard, by default: fewer are not worth the time that a shard takes to build
NUM_GRAPHS = 2  # of a shard: step and reset
PATIENCE = 2.0  # s without a word


class Simulation:
    """All worlds of a task, stepped together.

    Every array is written in place and never replaced; read them through `numpy()`.

    Attributes:
        shards: What steps the worlds, in their order: one shard, or one for each core.
        conditions: The muscle conditions, in the order in which they act.
        scene: The compiled task. Over several shards it holds names, sizes, settings and the state of all
            worlds; what does not belong to a single world, such as contacts, or only to the engine is with
            the shards, and None here.
        setup: What the worlds are.
        autoreset: Gymnasium's mode, a key of `AUTORESET`.
        columns: Blocks of the observation.
        terms: Reward terms.
        horizon: Control steps in an episode.
        action: Policy actions in [-1, 1], to be written before `step`, shape (num_worlds, num_actuators).
        transition: What the last step led to.
        final: What finished episodes ended with; only with autoreset "same_step".
        episode: Counters of the present episodes.
        masks: Which worlds were stepped and are healthy (`live`), and which were reset.
        info: What conditions show of their state after the step, by name, (num_worlds, ...).
        info_units: Units of those that are no pure numbers, by name.
    """

    @with_build_lock
    def __init__(
        self,
        setup: Setup | TaskSpec,
        num_worlds: int,
        *,
        autoreset: str = "next_step",
        graph: bool = True,
        deterministic: bool = False,
        stages: Iterable[str | type[Stage]] | None = None,
        progress: bool = True,
        adjustable: bool = False,
        **fields: Any,
    ) -> None:
        """Compile scene and kernels, and capture the step; kernels are compiled once for all shards.

        Args:
            setup: What the worlds are; a task alone is stepped by one thread unless `shards` says otherwise.
            num_worlds: Worlds to step together.
            autoreset: Gymnasium's mode, a key of `AUTORESET`.
            graph: Whether to capture the step as a graph.
            deterministic: Whether CUDA launches in a fixed order, as in `MyoWarpVectorEnv`.
            stages: Names in `engine.stage.STAGES`, or classes, to use where they apply; None: all those.
            progress: Whether to show progress bars while kernels compile and random starts are found.
            adjustable: Whether conditions can be changed later, as `myowarp.sim.patient` does.
            **fields: Fields of `Setup`, in place of those of `setup`. Rank r of R has worlds r num_worlds to
                (r + 1) num_worlds - 1 of one numbered set, and their rows of parameters that are given per
                world for all R num_worlds.

        Raises:
            ValueError: An argument is out of its range.
        """
        alone = {} if isinstance(setup, Setup) else {"shards": 1}
        setup = Setup.of(setup, **alone | fields).finished()
        self.setup, self.autoreset, spec = setup, autoreset, setup.spec
        rank = _checked_rank(setup.rank)
        worlds = Worlds.all(checked_num_worlds(num_worlds), adjustable, rank)
        check_choice("autoreset", autoreset, AUTORESET)
        for name, flag in (("graph", graph), ("deterministic", deterministic), ("progress", progress)):
            check_flag(name, flag)
        self.horizon = checked_horizon(setup.episode_steps)
        stages = tuple(STAGES if stages is None else stages)
        shards: list[Shard] = []
        with quiet():
            where = resolve_device(setup.device)
            number = _checked_shards(setup.shards, worlds.total, where)
            self.conditions = resolve(setup.conditions or (), spec)
            show = progress and number > 1
            with patient_bar("Preparing cores", "shards", number, patience=PATIENCE, show=show) as advance:
                for own in worlds.split(number):
                    scene = compile_scene(setup, own, device=where.alias, conditions=self.conditions)
                    # Sums on the CPU have one order anyway.
                    scene.model.opt.deterministic = bool(deterministic) and not where.is_cpu
                    shard = Shard(
                        scene,
                        self.conditions,
                        autoreset=autoreset,
                        horizon=self.horizon,
                        observe=setup.observe or (),
                        graph=graph,
                        stages=stages,
                        progress=progress,
                        find_starts=partial(find_starts, spec, progress),
                        like=shards[0] if shards else None,
                    )
                    shards.append(shard)
                    advance(1)
        self.shards, (first, *others) = tuple(shards), shards
        self.scene = _joined(first.scene, worlds) if others else first.scene
        self.columns, self.terms = first.columns, first.terms
        self.action = worlds.whole["action"]
        self.transition = worlds.join("transition", Transition())
        self.final = worlds.join("final", Transition())
        self.episode = worlds.join("episode", EpisodeState())
        self.masks = worlds.join("masks", Masks())
        self.info = {name: worlds.whole[f"info.{name}"] for name in first.info}
        self.info_units = first.info_units
        self._together: Callable[[tuple[Replay, ...]], Replay] | None = None
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()
        self._failure: str | None = None

    @property
    def num_worlds(self) -> int:
        """Worlds stepped together."""
        return self.scene.num_worlds

    @property
    def blocks(self) -> dict[str, slice]:
        """Columns of the observation that each block has, by its name."""
        ends = np.cumsum([column.size for column in self.columns]).tolist()
        return {c.name: slice(end - c.size, end) for c, end in zip(self.columns, ends, strict=True)}

    @cached_property
    def full_model(self) -> mujoco.MjModel:
        """The unslimmed model with the task's objects, for pictures and comparisons; host."""
        return full_model(self.scene.spec, self.conditions)

    def step(self) -> None:
        """Advance all worlds by one control step under `action`; results are in `transition`.

        Raises:
            RuntimeError: Without graphs, a shard has failed in an earlier step.
        """
        if len(self.shards) == 1:
            self.shards[0].step()
        else:
            self._at_once(Shard.step, [shard.step_graph for shard in self.shards])

    def reset(self, mask: np.ndarray | None = None, seeds: np.ndarray | None = None) -> None:
        """Start new episodes; their first observation is in `transition.obs`.

        Args:
            mask: Worlds to reset, shape (num_worlds,) bool; None: all.
            seeds: New seeds of these worlds, shape (num_worlds,), any integers; None: the random streams
                go on, after the first call with fresh entropy.

        Raises:
            RuntimeError: As in `step`.
        """
        for shard in self.shards:
            own = shard.scene.worlds.own
            shard.ask_for_reset(None if mask is None else mask[own], None if seeds is None else seeds[own])
        if len(self.shards) == 1:
            self.shards[0].reset_asked()
        else:
            self._at_once(Shard.reset_asked, [shard.reset_graph for shard in self.shards])

    def describe_fault(self, world: int) -> str:
        """Return what was wrong in a world in the last step, empty if nothing was; waits for the device."""
        transition = self.transition
        bits, index = (int(array.numpy()[world]) for array in (transition.fault, transition.fault_index))
        text = describe_fault(bits)
        if bits & int(FAULT_REWARD):
            text += f": term {self.terms[index].name!r}"
        if bits & int(FAULT_OBSERVATION):
            ends = np.cumsum([column.size for column in self.columns])
            text += f": column {index}, of {self.columns[np.searchsorted(ends, index, 'right')].name!r}"
        return text

    def close(self) -> None:
        """Let the threads end, once no step is under way; the next would start new ones."""
        self._together = self._pool = None

    def _at_once(self, act: Callable[[Shard], None], graphs: list[Graph | None]) -> None:
        """Let all shards act at the same time, by replaying a graph of each; without graphs, one by one."""
        if self._failure is not None:
            raise RuntimeError(self._failure)
        if self._process != os.getpid():  # threads do not live on in a forked process
            self.close()
            self._process = os.getpid()
        replays = tuple(graph.replay for graph in graphs if graph is not None and graph.replay is not None)
        if None in graphs or not can_renew_code():  # else they would share their scratch memory
            for shard in self.shards:
                self._act(act, shard)
        elif len(replays) < len(self.shards):
            self._in_threads(act)
        else:
            together = self._together  # which another thread may close
            if together is None:
                self._together = together = lru_cache(NUM_GRAPHS)(Team(len(self.shards)).together)
            together(replays)()

    def _in_threads(self, act: Callable[[Shard], None]) -> None:
        """Let the shards act at the same time in threads of Python, where Warp replays their graphs."""
        pool = self._pool
        if pool is None:
            self._pool = pool = ThreadPoolExecutor(len(self.shards))
        futures = [pool.submit(self._act, act, shard) for shard in self.shards]
        try:
            for future in futures:
                future.result()
        finally:
            wait(futures)

    def _act(self, act: Callable[[Shard], None], shard: Shard) -> None:
        """Let a shard act; if it does not get to the end, the shards are no longer at the same step."""
        try:
            act(shard)
        except BaseException as error:  # an interrupt, too, leaves the shards apart
            own, reason = shard.scene.worlds.own, f"{type(error).__name__}: {error}"
            self._failure = f"worlds {own.start} to {own.stop - 1} stopped ({reason}); make a new simulation"
            error.add_note(self._failure)
            self.close()
            raise


def _checked_shards(shards: int | None, num_worlds: int, device: wp.Device) -> int:
    """Return in how many shards to step worlds on a device.

    Raises:
        ValueError: The number is out of its range, or the device is not the CPU.
    """
    if shards is None:
        return max(1, min(num_cores(), num_worlds // LEAST_WORLDS)) if device.is_cpu else 1
    if not is_integer(shards) or not 1 <= shards <= num_worlds:
        raise ValueError(
            f"shards must be an integer from 1 to the number of worlds, {num_worlds}, got {shards!r}"
        )
    if shards > 1 and not device.is_cpu:
        raise ValueError(f"shards are for the CPU; leave them out on device {device.alias!r}, got {shards}")
    return int(shards)


def _checked_rank(rank: object) -> tuple[int, int]:
    """Return which of how many ranks this is, as plain integers.

    Raises:
        ValueError: It is no pair (r, R) with 0 <= r < R.
    """
    if not (isinstance(rank, (tuple, list)) and len(rank) == 2 and all(map(is_integer, rank))):
        raise ValueError(f"rank must be a pair of integers (r, R), got {rank!r}")
    if not 0 <= rank[0] < rank[1]:
        raise ValueError(f"rank (r, R) must have 0 <= r < R, got {tuple(rank)}")
    return int(rank[0]), int(rank[1])


def _joined(scene: Scene, worlds: Worlds) -> Scene:
    """Return the scene of all worlds, after that of a shard."""
    model, data, muscles = copy.copy(scene.model), copy.copy(scene.data), copy.copy(scene.muscles)
    for field in dataclasses.fields(data):
        value = getattr(data, field.name)
        if dataclasses.is_dataclass(value) or (isinstance(value, wp.array) and value.size):
            setattr(data, field.name, None)
    data.nworld = worlds.total
    worlds.join("condition.model", model)
    if "condition.anatomy.strength" in worlds.whole:
        muscles.anatomy = worlds.join("condition.anatomy", Anatomy())
    return dataclasses.replace(
        scene,
        worlds=worlds,
        model=worlds.join("model", model),
        data=worlds.join("data", data),
        muscles=worlds.join("muscles", muscles),
        keys=worlds.join("keys", RandomKeys()),
        state={name: worlds.whole[name] for name in scene.state},
    )
