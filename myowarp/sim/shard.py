"""The step loop: action, muscles, physics, observation, reward, termination and reset as one graph.

A step replays a captured graph of kernel launches; nothing in it allocates or reads back. With `graph=False`
the same launches run one by one, with the same numbers.
"""

from __future__ import annotations

import dataclasses
import secrets
from collections.abc import Callable, Iterable
from functools import partial

import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.coordinates.step import step_of
from myowarp.definitions.condition import Condition, Effect, Phase
from myowarp.definitions.muscle import restore_anatomy
from myowarp.definitions.parameter import Clock
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene, Starts
from myowarp.definitions.senses import Sense, bind_senses
from myowarp.definitions.task import Column
from myowarp.disk import is_ours
from myowarp.engine.compile import compile_kernels, quiet, renew_code
from myowarp.engine.graph import Graph, replay_nothing
from myowarp.engine.idle import pruned
from myowarp.engine.patch import engine_kernels_alone
from myowarp.engine.repeat import repeat
from myowarp.engine.stage import STAGES, Stage
from myowarp.engine.step import PATHS, Step
from myowarp.engine.verify import choose_stages
from myowarp.kernels.action import apply_action
from myowarp.kernels.batching import as_rows
from myowarp.kernels.episode import (
    AUTORESET,
    EpisodeState,
    advance_episode,
    count_step,
    detect_faults,
    detect_state_faults,
    keep_final,
    new_episode_state,
    new_masks,
    new_transition,
    open_episode,
    publish_observation,
)
from myowarp.kernels.launch import launch
from myowarp.kernels.random import seed_worlds
from myowarp.kernels.reset import place_start, reset_worlds
from myowarp.kernels.write import write
from myowarp.process import BUILD_LOCK, with_build_lock
from myowarp.sim.build import stepped_of
from myowarp.sim.present import settle_muscles


class Shard:
    """The worlds of one scene, stepped together: all worlds of a `Simulation`, or those of a core.

    Attributes that a `Simulation` has, too, are as there, for these worlds.

    Attributes:
        scene: The compiled task.
        program: The task's kernels.
        clock: Time of the worlds, which parameters follow.
        effects: The conditions' kernels, in the order in which they act.
        senses: What is observed besides, in the order in which it was named.
        physics_step: The physics step.
        stages: Stages of it that kernels of ours do.
        idle_kernels: Kernels of the engine's that do nothing for this model, and are left out.
        launch_physics: Launches a physics step.
        weights: Weights of the reward terms, shape (num_terms,).
        shown: What conditions show of their state, by name, (num_worlds, ...).
        info: The same after the step, resets included.
        info_units: Units of those that are no pure numbers.
        starts: Random starts, shape (num_starts, num_coordinates); None where episodes start otherwise.
        start_address: Which of `qpos` they are, shape (num_coordinates,).
        step_graph: What `step` replays; None without a graph.
        reset_graph: What `reset_asked` replays.
    """

    _modules: tuple[wp.Module, ...]
    idle_kernels = frozenset[str]()
    _bring_settling: Callable[[], None] | None = None
    stages: tuple[Stage, ...] = ()
    starts: wp.array | None = None
    start_address: wp.array | None = None

    @with_build_lock
    def __init__(
        self,
        scene: Scene,
        conditions: tuple[Condition, ...] = (),
        *,
        autoreset: str = "disabled",
        horizon: int | None = None,
        observe: Iterable[str] = (),
        graph: bool = True,
        stages: Iterable[str | type[Stage]] = STAGES,
        progress: bool = True,
        find_starts: Callable[[], Starts] | None = None,
        like: Shard | None = None,
    ) -> None:
        """Compile the kernels and capture the step.

        Args:
            scene: The compiled task, with these conditions.
            conditions: Muscle conditions, as `resolve` returns them.
            autoreset: Gymnasium's mode, a key of `AUTORESET`.
            horizon: Control steps in an episode; None: the task's.
            observe: Names of senses.
            graph: Whether to capture the step as a graph.
            stages: Names in `engine.stage.STAGES`, or classes, to use where they apply.
            progress: Whether to show a progress bar while kernels compile.
            find_starts: Returns random starts, for a scene whose `reset` is "random"; called once all else of
                the scene is known to be right.
            like: Another shard of the worlds, whose kernels and starts are taken over.

        Raises:
            ValueError: A condition does not fit the scene, or there are too few random starts.
        """
        self.scene, self.conditions, self.autoreset = scene, conditions, AUTORESET[autoreset]
        self._progress = progress
        with quiet(), wp.ScopedDevice(scene.device):
            self.program: Program = scene.spec.program(scene.spec, scene)
            self.episode, self.clock, self.effects = bind_conditions(scene, conditions)
            scene.model.callback.control = self._launch_control
            self._allocate(scene.spec.horizon if horizon is None else horizon, tuple(observe))
            if like is not None:
                self._take_over(like)
            else:
                self._load_starts(find_starts)
                self._choose_kernels(stages)
            self.step_graph = self._capture(self._launch_step) if graph else None
            self.reset_graph = self._capture(self._launch_asked_reset) if graph else None
        self.reset()

    @property
    def num_worlds(self) -> int:
        """Worlds stepped together."""
        return self.scene.num_worlds

    def _load_starts(self, find_starts: Callable[[], Starts] | None) -> None:
        """Find the random starts, where episodes start from them."""
        if self.scene.reset != "random":
            return
        if find_starts is None:
            raise ValueError("a scene with reset 'random' needs find_starts, got None")
        starts = find_starts()
        self.starts = wp.array(starts.values, dtype=float)
        self.start_address = wp.array(starts.address, dtype=int)

    def _choose_kernels(self, kinds: Iterable[str | type[Stage]]) -> None:
        """Find out which stages of the physics step are to be ours, and compile all kernels."""
        self.stages, self.idle_kernels = choose_stages(
            self.physics_step, kinds, self._launch_all, self._progress, self.conditions
        )
        self._take_stages()
        self._modules = compile_kernels(self._launch_all, self.scene.device, show=self._progress)

    def _take_over(self, like: Shard) -> None:
        """Use the kernels and the starts of another shard."""
        self.starts, self.start_address = like.starts, like.start_address
        self._modules, self.idle_kernels = like._modules, like.idle_kernels
        self.stages = self.physics_step.same(like.stages)
        self._take_stages()

    def _take_stages(self) -> None:
        """Step, and look at the present state, with the stages that were chosen."""
        self.launch_physics = self.physics_step.launches(self.stages, self.idle_kernels)
        bring = partial(self.physics_step.launches, self.stages, self.idle_kernels)
        self._bring_settling = bring(only=PATHS, mask=self._settling)
        # `refresh` has brought bodies before; a stage of ours does them in the launch that follows paths.
        with_paths = any("kinematics" in stage.replaces for stage in self.stages)
        fresh = self.scene.spec.uses_kinematics and not with_paths
        self.program.bring_paths = bring(only=PATHS - {"kinematics"} if fresh else PATHS)
        for stage in self.stages:  # the engine's own step has run, to verify them
            stage.begin()

    def _allocate(self, horizon: int, observe: tuple[str, ...]) -> None:
        """Allocate every array of the step."""
        n, scene, spec = self.num_worlds, self.scene, self.scene.spec
        columns = observed(scene, self.effects)
        self.action = scene.worlds.rows("action", wp.zeros((n, scene.num_actions), dtype=float))
        self.senses: tuple[Sense, ...] = bind_senses(observe, scene, self.clock, self.action, columns)
        columns += tuple(sense.column for sense in self.senses)
        self.columns = tuple(column for column in columns if column.size)
        self.terms = spec.reward_terms() + tuple(term for effect in self.effects for term in effect.terms)
        self.weights = wp.array([term.weight for term in self.terms], dtype=float)
        self.horizon = wp.array([horizon], dtype=int)
        sizes = n, sum(column.size for column in self.columns), len(self.terms)
        self.transition, self.final, self.masks = new_transition(*sizes), new_transition(*sizes), new_masks(n)
        for owner in ("transition", "final", "masks"):
            scene.adopt(owner, getattr(self, owner), state=False)
        self._draft = wp.zeros_like(self.transition.obs)  # observations, checked before anyone sees them
        self.shown = {name: array for effect in self.effects for name, array in effect.info.items()}
        self.info = {name: scene.worlds.rows(f"info.{name}", array) for name, array in self.shown.items()}
        self.info_units = {name: unit for effect in self.effects for name, unit in effect.info_units.items()}
        self._asked, self._seeded = wp.zeros(n, dtype=bool), False
        self._settling = wp.zeros(n, dtype=bool)
        self._countdown = wp.zeros(1, dtype=int)
        self._probes: list[Callable[[wp.array | None], None]] = []
        stepped = stepped_of(scene)
        if is_ours(type(scene.muscles), *map(type, self.effects)):
            stepped = dataclasses.replace(stepped, remaining=self._countdown)
        self.physics_step: Step = step_of(stepped)
        self.launch_physics = self.physics_step.launches()

    def _launch_all(self) -> None:
        """Every launch there is, for the compiler."""
        self._launch_step()
        self._launch_asked_reset()
        replay_nothing(self.scene.device)

    def _launch_step(self) -> None:
        """One control step of all worlds."""
        self.launch_action()
        self.launch_conditions()
        for stage in self.stages:
            stage.begin()
        repeat(self.launch_physics, self.scene.num_substeps, self._countdown)
        self.refresh()
        wp.launch(count_step, dim=self.num_worlds, outputs=[self.episode])
        self.program.advance(self.episode.step_count)
        self.launch_scoring()
        self._launch_probes(None)
        if self.autoreset == AUTORESET["same_step"]:
            wp.launch(keep_final, dim=self.num_worlds, outputs=[self.transition, self.final])
        self._launch_reset(self.masks.renew, self.masks.reset, self.masks.fresh, asked=False)

    def _launch_control(self, model: mjw.Model, data: mjw.Data) -> None:
        """Engine callback: the muscles, and what conditions do in a physics step."""
        self.scene.muscles.launch(model, data)
        for effect in self.effects:
            effect.act_in_substep()

    def _launch_observation(self, mask: wp.array) -> None:
        """Observe the worlds of a mask: the task, the conditions that show something, the senses."""
        transition, draft = self.transition, self._draft
        self.program.observe(mask, draft)
        column = draft.shape[1]
        for sense in reversed(self.senses):
            column -= sense.column.size
            sense.observe(mask, draft, column)
        for effect in reversed(self.effects):
            column -= sum(block.size for block in effect.columns)
            effect.observe(mask, draft, column)
        launch(publish_observation, self.num_worlds, transition, mask=mask, draft=draft)

    def launch_conditions(self) -> None:
        """Let the conditions change excitations, muscles and body, for one control step."""
        self._launch_anatomy()
        for effect in self.effects:
            effect.act()

    def _launch_anatomy(self) -> None:
        """Make the muscles healthy, from where the conditions start."""
        if self.effects:
            anatomy = self.scene.muscles.anatomy
            wp.launch(restore_anatomy, dim=anatomy.strength.shape, outputs=[anatomy])

    def launch_action(self) -> None:
        """Map actions to controls."""
        scene, transition = self.scene, self.transition
        launch(apply_action, self.num_worlds, scene, scene.model, self, scene.data, transition)

    def launch_scoring(self) -> None:
        """Judge the present state: faults, reward terms, observation, reward, and what ends."""
        data, transition = self.scene.data, self.transition
        for state in self.scene.muscles.state.values():
            launch(detect_state_faults, self.num_worlds, transition, state=as_rows(state))
        launch(detect_faults, self.num_worlds, data, self.episode, self, transition, self.masks)
        column = len(self.scene.spec.reward_terms())
        terms = transition.terms[:, :column]
        self.program.score(self.episode.step_count, terms, transition.solved, transition.failed)
        for effect in self.effects:
            effect.score(transition.terms, column)
            column += len(effect.terms)
        for sense in self.senses:
            sense.remember(self.masks.live, transition.obs)
        self._launch_observation(self.masks.live)
        launch(advance_episode, self.num_worlds, self, keep_state=self.scene.reset == "none")

    def _launch_asked_reset(self) -> None:
        """Reset that the user asked for; the state is reset in every mode."""
        self._launch_reset(self._asked, self._asked, self._asked, asked=True)
        if self._probes:
            self._launch_transmission()
            self._launch_probes(self._asked)

    def _launch_transmission(self) -> None:
        """Let tendons be torn and rerouted already, so that a probe sees them before the first step."""
        self._launch_anatomy()
        for condition, effect in zip(self.conditions, self.effects, strict=True):
            if condition.PHASE == Phase.TRANSMISSION:
                effect.act()

    def _launch_probes(self, mask: wp.array | None) -> None:
        """Let probes look at the present state, in all worlds or a mask."""
        with pruned(self.idle_kernels):
            for launch in self._probes:
                launch(mask)

    def _launch_reset(self, renew: wp.array, reset: wp.array, fresh: wp.array, asked: bool) -> None:
        """Open episodes in the worlds of `renew`, reset the state of `reset`, observe those of `fresh`."""
        scene = self.scene
        wp.launch(
            open_episode, dim=self.num_worlds, inputs=[renew, asked], outputs=[self.episode, scene.keys]
        )
        reset_worlds(reset, scene.qpos_start, scene.data)
        scene.muscles.reset(reset)
        for effect in self.effects:
            effect.sample(renew)
            effect.reset(reset)
        for sense in self.senses:
            sense.forget(renew)
        self.program.sample_start(reset)
        if self.starts is not None:
            launch(place_start, self.num_worlds, self, scene, scene.data, reset=reset)
        self.physics_step.follow()
        self.program.sample_goal(renew)
        self._launch_settling(reset)
        self._show(reset, fresh)

    def _launch_settling(self, mask: wp.array) -> None:
        """Let muscles with elastic tendons find their equilibrium, on the paths that they will pull."""
        if self.scene.muscles.settles:
            if any(condition.PHASE == Phase.TRANSMISSION for condition in self.conditions):
                self._launch_transmission()
            wp.copy(self._settling, mask)
            with pruned(self.idle_kernels):
                settle_muscles(self.scene, mask, self._bring_settling)

    def _show(self, changed: wp.array, fresh: wp.array) -> None:
        """Make poses those of the present state where it was `changed`, and observe the worlds of `fresh`."""
        self.refresh(changed)
        self._launch_observation(fresh)
        for name, array in self.shown.items():
            if self.info[name] is not array:
                wp.copy(self.info[name], array)

    def refresh(self, mask: wp.array | None = None) -> None:
        """Make poses those of the present state, in all worlds or a mask: a step leaves them old."""
        if not self.scene.spec.uses_kinematics:
            return
        model, data = self.scene.model, self.scene.data
        for stage in self.stages:
            if stage.refresh(model, data, mask):
                return
        with engine_kernels_alone():
            mjw.kinematics(model, data)

    def _capture(self, launches: Callable[[], None]) -> Graph:
        """Record launches as a graph, which no other graph shares its code with."""
        renew_code(self._modules)
        return Graph(launches, self.scene.device)

    def step(self) -> None:
        """Advance all worlds by one control step under `action`; results are in `transition`."""
        if self.step_graph is not None:
            self.step_graph.launch()
        else:
            self._launch_now(self._launch_step)

    @with_build_lock
    def attach(self, launch: Callable[[wp.array | None], None]) -> None:
        """Launch more in every step, after observation and before what ended is reset, and after resets.

        Args:
            launch: Launches kernels that only look, in the worlds of a mask (num_worlds,) bool, None for all:
                they may write their own arrays, and what the next physics step computes anew. With sums and
                sorts of Warp's, Warp replays the step.
        """
        self._probes.append(launch)

        def launch_both() -> None:
            launch(None)
            self._launch_asked_reset()

        with quiet(), wp.ScopedDevice(self.scene.device):
            self._modules += compile_kernels(launch_both, self.scene.device, show=self._progress)
            if self.step_graph is not None:
                self.step_graph = self._capture(self._launch_step)
                self.reset_graph = self._capture(self._launch_asked_reset)

    def reset(self, mask: np.ndarray | None = None, seeds: np.ndarray | None = None) -> None:
        """Start new episodes; their first observation is in `transition.obs`.

        Args:
            mask: Worlds to reset, shape (num_worlds,) bool; None: all.
            seeds: New seeds of these worlds, shape (num_worlds,), any integers; None: the random streams
                go on, after the first call with fresh entropy.
        """
        self.ask_for_reset(mask, seeds)
        self.reset_asked()

    def ask_for_reset(self, mask: np.ndarray | None, seeds: np.ndarray | None) -> None:
        """Choose what `reset_asked` resets, with the arguments of `reset`."""
        mask = np.ones(self.num_worlds, dtype=bool) if mask is None else mask
        if seeds is None and not self._seeded:
            seeds = secrets.randbits(32) + np.arange(self.num_worlds)
        if seeds is not None:
            self._seeded = True
            seed_worlds(self.scene.keys, mask, seeds)
        write(self._asked, mask)

    def reset_asked(self) -> None:
        """Reset the worlds that `ask_for_reset` has chosen."""
        if self.reset_graph is not None:
            self.reset_graph.launch()
        else:
            self._launch_now(self._launch_asked_reset)

    def bring_up(self, mask: np.ndarray, *, settle: bool = False) -> None:
        """Compute what is seen of the state - poses, observation, probes - after it was overwritten.

        Args:
            mask: The worlds where it was, shape (num_worlds,) bool.
            settle: Whether muscles find their equilibrium anew, because their own state was not given.
        """
        write(self._asked, mask)
        with BUILD_LOCK, wp.ScopedDevice(self.scene.device):
            if settle:
                self._launch_settling(self._asked)
            self._show(self._asked, self._asked)
            self._launch_probes(self._asked)

    def _launch_now(self, launches: Callable[[], None]) -> None:
        """Launch what is in no graph."""
        with BUILD_LOCK, wp.ScopedDevice(self.scene.device):
            launches()


def bind_conditions(
    scene: Scene, conditions: Iterable[Condition]
) -> tuple[EpisodeState, Clock, tuple[Effect, ...]]:
    """Return the counters of the episodes, their time, and the conditions' effects, on the Warp device.

    Raises:
        ValueError: A condition does not fit the scene, or another condition.
    """
    episode = new_episode_state(scene.num_worlds)
    scene.adopt("episode", episode)
    clock = Clock()
    clock.step_count, clock.life_count = episode.step_count, episode.life_count
    clock.control_dt = scene.control_dt
    effects = tuple(condition.bind(scene, clock) for condition in conditions)
    for effect in effects:
        effect.check_beside(effects)
    return episode, clock, effects


def observed(scene: Scene, effects: Iterable[Effect]) -> tuple[Column, ...]:
    """Return what the task and its conditions observe."""
    model = scene.oracle
    columns = scene.spec.columns(model.nq, model.nv, len(scene.muscles.names))
    return columns + tuple(column for effect in effects for column in effect.columns)
