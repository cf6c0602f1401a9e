"""Gymnasium on top of the simulation: a vector environment, and one world as a plain environment.

    env = gymnasium.make_vec("MyoWarp/myoHandPoseRandom-v1", num_envs=256)
    env = gymnasium.make("MyoWarp/myoHandPoseRandom-v1")

Ids carry upstream's names; importing `myowarp` registers them. World i of `make_vec(...).reset(seed=s)` is
the world of `make(...).reset(seed=s + i)`, as in Gymnasium's own vector environments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from typing import Any, cast

import gymnasium as gym
import numpy as np
import warp as wp
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from myowarp.definitions.condition import Condition
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.registry import check_choice, check_flag, is_integer
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS, TaskSpec
from myowarp.kernels.episode import EpisodeState, Transition
from myowarp.sim.build import checked_horizon, checked_num_worlds
from myowarp.sim.interop import ActionInput, Output
from myowarp.sim.simulation import Simulation
from myowarp.sim.state import State, Worlds, get_state, place, rows_of, set_state, start_arrays
from myowarp.tasks.variants import Variant, find_variant, paper_variants, variants_of
from myowarp.view.drawing.captions import Captions
from myowarp.view.modes import check_render_mode, render_modes
from myowarp.view.pictures import Pictures

RENDER_MODES = render_modes()
# Fields of a transition that `step` returns, that show in its `info`, and that it looks at.
RESULTS = ("obs", "reward", "terminated", "truncated")
ENTRIES = ("success", "solved", "fault", "terms")
RESET_OPTIONS = ("reset_mask", "qpos", "qvel", "state")
SEEN = ("terminated", "truncated", "fault")
SCORED = ("reward", "success")  # what is written on pictures
NO_HORIZON = 2**31 - 1  # steps; a single environment leaves truncation to Gymnasium's TimeLimit
AUTORESET_NAMES = {
    AutoresetMode.DISABLED: "disabled",
    AutoresetMode.NEXT_STEP: "next_step",
    AutoresetMode.SAME_STEP: "same_step",
}


class MyoWarpVectorEnv(VectorEnv):
    """All worlds of a task as one Gymnasium vector environment.

    `step` returns observation (num_envs, n) float32, reward (num_envs,) float32, terminated and truncated
    (num_envs,) bool, and an info dictionary of arrays with one entry a world:

    - `success`: more than 5 steps of the episode were solved so far (MyoSuite's rule), and it has not failed,
    - `solved`: the task is solved in this state,
    - `terms/<name>`: reward terms before weighting,
    - what conditions show of their state, such as `fatigue` (num_envs, num_muscles),
    - `fault`: 0, or bits of `myowarp.kernels.episode.FAULTS`; a faulty world ends with reward 0 and the
      last healthy observation, and is reset by itself,
    - with autoreset in the same step `final_obs` and `final_info` of the worlds that ended.

    `_<key>` masks the worlds to which an entry belongs, as in Gymnasium; several entries may share one mask.

    What is returned may be memory of the simulation: with `copy=False` every array is a view that the next
    `step` or `reset` overwrites.

    Attributes:
        sim: The simulation.
        pictures: What `render` draws with.
        captions: Text on pictures; None: none.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012 (Gymnasium's protocol)

    def __init__(
        self,
        task: str | Setup,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        device: str | None = None,
        shards: int | None = None,
        physics: str | None = None,
        muscle: str | MuscleTable | None = None,
        reset: str | None = None,
        conditions: str | Condition | Iterable[str | Condition] | None = None,
        observe: str | Iterable[str] | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        output: str = "numpy",
        copy: bool | None = None,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (640, 480),
        camera: str | None = None,
        render_worlds: Sequence[int] | None = None,
        muscle_color: str = "activation",
        render_text: bool = False,
        deterministic: bool = False,
        progress: bool = True,
        rank: tuple[int, int] | None = None,
    ) -> None:
        """Compile the task and its kernels; about a minute the first time, seconds later.

        Args:
            task: Name with version, such as "myoHandPoseRandom-v1"; `make_vec` fills it in. Or a whole
                `Setup`, which other arguments are put over.
            num_envs: Worlds stepped together.
            max_episode_steps: Steps after which an episode is truncated; None: the task's horizon.
            device: Warp device, such as "cpu" or "cuda:0"; None: the first CUDA device, else the CPU.
            shards: Threads that share the worlds on the CPU; None: all cores. It changes no result.
            physics: "parity" (MyoSuite's integrator and step) or "fast" (`myowarp.definitions.task.PHYSICS`);
                None: "parity".
            muscle: Muscle model, a name in `myowarp.definitions.muscle.MUSCLES`, or a `MuscleTable` with
                parameters; None: "mujoco".
            reset: What episodes start from: "task", "fixed", "random" or "none"
                (`myowarp.definitions.task.RESETS`); None: "task".
            conditions: Muscle conditions: names in `CONDITIONS`, or `Condition` objects with parameters.
            observe: What is observed besides the task's own: "history=8", the last 8 observations and
                actions; "parameters", what the conditions make of the body now.
            autoreset_mode: When a finished world starts its next episode.
            output: Arrays of this library: "numpy", "torch" or "warp".
            copy: Whether returned arrays are copies; None: copies for numpy, views otherwise.
            render_mode: "rgb_array" or "human"; None: no pictures.
            render_size: Width and height of a picture [px].
            camera: Name of a camera of the model; None frames the limb, tips, targets and objects.
            render_worlds: Worlds of which `render` returns pictures, in this order; None: all, as Gymnasium's
                vector environments do. Human mode shows the first.
            muscle_color: What the colour of a muscle shows, a name in
                `myowarp.view.drawing.muscles.QUANTITIES`.
            render_text: Whether `render` writes time, return and success on pictures, counted since the
                episode began or its state was set; every step then waits for a CUDA device.
            deterministic: Whether CUDA launches in a fixed order, which is slower; rows of constraints get
                their places as threads come, so that last bits may differ. Runs on the CPU agree bit for bit.
            progress: Whether to show a progress bar while kernels compile.
            rank: Which of how many equal ranks, each a process of its own: rank r of R has worlds r num_envs
                to (r + 1) num_envs - 1 of one numbered set. World i of all resets with `seed + i`, and
                parameters that are given per world are given for all R num_envs.

        Raises:
            ValueError: An argument is out of its range; nothing was built.
            ImportError: Output for a library, or a render mode for a viewer, that is not installed.
        """
        self._made_with = {name: value for name, value in locals().items() if name != "self"}  # for pickle
        check_render_mode(render_mode)
        checked_num_worlds(num_envs, "num_envs")
        if max_episode_steps is not None:
            checked_horizon(max_episode_steps, "max_episode_steps")
        flags = {"deterministic": deterministic, "progress": progress, "render_text": render_text}
        for name, flag in (flags if copy is None else flags | {"copy": copy}).items():
            check_flag(name, flag)
        mode = _autoreset_mode(autoreset_mode)
        self.copy = output == "numpy" if copy is None else copy
        self.output, given = output, Output(output, self.copy)
        self.render_mode, self.pictures = render_mode, Pictures(render_size, camera, muscle_color)
        rendered = None if render_worlds is None else rows_of(list(render_worlds), num_envs).tolist()
        said = Setup(
            physics=physics,
            muscle=muscle,
            reset=reset,
            conditions=conditions,  # type: ignore[arg-type]  # which makes a tuple of it
            observe=observe,  # type: ignore[arg-type]  # likewise
            horizon=max_episode_steps,
            device=device,
            shards=shards,
            rank=rank,
        )
        options: dict[str, Any] = {"deterministic": deterministic, "progress": progress}
        options["autoreset"] = AUTORESET_NAMES[mode]
        self.sim = Simulation(said.over(Setup.of(task)), num_envs, **options)
        if render_mode is not None:
            self.pictures.attach(self.sim)
        self._rendered = list(range(self.sim.num_worlds)) if rendered is None else rendered
        self.captions = Captions(self._rendered, self.sim.scene.control_dt) if render_text else None
        self._set_up(mode)
        self._wrap(given)

    def _set_up(self, mode: AutoresetMode) -> None:
        """Fill in what Gymnasium wants to know, and where the worlds stand."""
        self.num_envs = self.sim.num_worlds
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": round(1.0 / self.sim.scene.control_dt),
            "autoreset_mode": mode,
        }
        self._autoreset = mode
        self._was_reset = self._warned = False
        self._resetting = np.zeros(self.num_envs, dtype=bool)
        num_obs, num_actions = self.sim.transition.obs.shape[1], self.sim.action.shape[1]
        self.single_observation_space = Box(-np.inf, np.inf, (num_obs,), np.float32)
        self.single_action_space = Box(-1.0, 1.0, (num_actions,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def _wrap(self, output: Output) -> None:
        """Choose the arrays that `reset` and `step` return, and those that they look at."""
        sim = self.sim

        def arrays(transition: Transition | EpisodeState, *names: str) -> dict[str, wp.array]:
            return {name: getattr(transition, name) for name in names}

        self._act = ActionInput(sim.action)
        self._obs = output.of(arrays(sim.transition, "obs"))
        self._results = output.of(arrays(sim.transition, *RESULTS))
        self._given = output.of(arrays(sim.transition, *ENTRIES) | sim.info)
        self._given_final = output.of(arrays(sim.final, "obs", *ENTRIES))
        on_host = Output("numpy", copy=False)
        self._seen = on_host.of(arrays(sim.transition, *SEEN))
        self._over = on_host.of(arrays(sim.episode, "ended"))
        self._scored = on_host.of(arrays(sim.transition, *SCORED) | arrays(sim.episode, "step_count"))
        self._terms = tuple(f"terms/{term.name}" for term in sim.terms)
        self._masks = tuple(f"_{key}" for key in self._entries(self._given))

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of the muscles, in the order of the `act` columns."""
        return self.sim.scene.muscles.names

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: World i gets `seed + i`, or the i-th of a sequence; None lets the random streams go on. With
                ranks, i counts the worlds of all, and a sequence is for those of this rank.
            options: By name, each may be left out:
                `reset_mask`: Only these worlds, (num_envs,) bool.
                `qpos`: Start configuration, (nq,) for all or (num_envs, nq), in the order of
                `env.sim.scene.oracle`; goals, and what conditions draw, are those of any reset.
                `qvel`: Start velocity, (nv,) or (num_envs, nv); else the worlds start at rest.
                `state`: A `State` of one world, or of as many as are reset; instead of a reset's own start,
                goal and random numbers, so that there is nothing to seed.

        Returns:
            Observations of all worlds, and an empty dictionary.

        Raises:
            ValueError: A seed or an option is not as described; no world was reset.
        """
        options = self._options(options)
        mask = self._reset_mask(options.get("reset_mask"))
        if "state" in options:
            if seed is not None or len(options.keys() - {"reset_mask"}) > 1:
                raise ValueError("reset option 'state' is all that a world is; leave out seed, qpos and qvel")
            return self.set_state(options["state"], mask), {}
        start = start_arrays(self.sim, options)
        seeds, seeded = self._seeds(seed)
        if seeds is None:
            self.sim.reset(mask)
        else:
            self.sim.reset(mask & seeded, seeds)
            if not seeded.all():
                self.sim.reset(mask & ~seeded)
        if start:
            place(self.sim, {name: rows[mask] for name, rows in start.items()}, np.flatnonzero(mask))
        self._was_reset = self._was_reset or bool(mask.all())
        self._resetting[mask] = False
        if self.captions is not None:
            self.captions.begin(mask)
        self._show()
        return self._obs()["obs"], {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Advance every world by one control step.

        Args:
            actions: Shape (num_envs, num_actions), floating point, clipped to [-1, 1]; NumPy array, or a
                torch tensor or Warp array on the device of the environment.

        Raises:
            ValueError: Wrong shape or dtype, or an action on the host is NaN or infinite; no world was
                stepped. On other devices such a world gets a fault instead.
            gymnasium.error.ResetNeeded: Not reset yet, or, without autoreset, a world has ended; to know it,
                such a step waits for a CUDA device.
        """
        if not self._was_reset:
            raise ResetNeeded("step needs an environment that was reset; call reset() first")
        if self._autoreset == AutoresetMode.DISABLED and (ended := self._over()["ended"]).any():
            worlds = np.flatnonzero(ended).tolist()
            raise ResetNeeded(
                f"worlds {worlds} have ended; reset them with reset(options={{'reset_mask': mask}}) first"
            )
        self._act(actions)
        self.sim.step()
        info = self._entries(self._given)
        self._complete(info)
        self._count_on_pictures()
        self._show()
        obs, reward, terminated, truncated = self._results().values()
        return obs, reward, terminated, truncated, info

    def get_state(self, worlds: Worlds = None) -> State:
        """Return all that worlds are: body, goal, conditions, counters, random numbers to come.

        Args:
            worlds: A number, numbers in any order, or a mask (num_envs,) bool; None: all.

        Raises:
            ValueError: There are no such worlds.
            gymnasium.error.ResetNeeded: Not reset yet.
        """
        if not self._was_reset:
            raise ResetNeeded("get_state needs an environment that was reset; call reset() first")
        return get_state(self.sim, worlds)

    def set_state(self, state: State, worlds: Worlds = None, *, conditions: bool = True) -> Any:
        """Make worlds what others were, in this environment or in another one of the task.

        What follows is what followed there, bit for bit, over any number of worlds and shards.

        Args:
            state: One world, which is given to all that are named, or as many as are named.
            worlds: As in `get_state`.
            conditions: Whether what the conditions remember and have drawn is set, too; False lets the same
                movement go on in another patient.

        Returns:
            Observations of all worlds, as `reset` does.

        Raises:
            ValueError: The state does not fit; nothing was set.
        """
        rows = set_state(self.sim, state, worlds, conditions=conditions)
        self._was_reset = self._was_reset or len(rows) == self.num_envs
        ended = self.sim.episode.ended.numpy()[rows]
        self._resetting[rows] = ended & (self._autoreset == AutoresetMode.NEXT_STEP)
        if self.captions is not None:
            self.captions.begin(np.isin(np.arange(self.num_envs), rows))
        self._show()
        return self._obs()["obs"]

    def __getstate__(self) -> dict[str, Any]:
        """Return what makes the same environment again: `pickle` and `copy.deepcopy` build it anew."""
        kept = {"made_with": self._made_with, "state": self.get_state() if self._was_reset else None}
        return kept | {"spec": self.spec}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        """Build an environment of the same options, in the same state."""
        self.__init__(**kept["made_with"])  # type: ignore[misc]  # as Gymnasium's EzPickle does
        self.spec = kept["spec"]
        if kept["state"] is not None:
            self.set_state(kept["state"])

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of each of `render_worlds`, (height, width, 3) uint8; None in human mode.

        Raises:
            ValueError: The environment was made without a render mode.
            myowarp.view.drawing.render.NoGraphicsError: No OpenGL was found.
        """
        if self.render_mode is None:
            raise ValueError("render needs a render mode; pass render_mode='rgb_array' to make_vec")
        if self.render_mode == "human":
            self._show()
            return None
        captions = [()] * len(self._rendered) if self.captions is None else self.captions.lines()
        shown = zip(self._rendered, captions, strict=True)
        return tuple(self.pictures.frame(self.sim, world, lines) for world, lines in shown)

    def close_extras(self, **kwargs: Any) -> None:
        """Close windows and drawing contexts, and end all threads."""
        self.pictures.close()
        self.sim.close()

    def _count_on_pictures(self) -> None:
        """Count a step in the text on pictures; it begins anew where the step was, or led to, a reset."""
        if self.captions is None:
            return
        reward, success, step_count = self._scored().values()
        self.captions.add(reward, success)
        self.captions.begin(step_count == 0)

    def _show(self) -> None:
        """Update the window of human mode."""
        if self.render_mode == "human":
            self.pictures.show(self.sim, self._rendered[0])

    def _options(self, options: dict[str, Any] | None) -> dict[str, Any]:
        """Return the options of a reset, their names checked."""
        if options is not None and not isinstance(options, Mapping):
            raise ValueError(f"reset options must be a dictionary, got {options!r}")
        for name in options or {}:
            check_choice("reset option", name, RESET_OPTIONS)
        return {name: value for name, value in (options or {}).items() if value is not None}

    def _reset_mask(self, mask: Any) -> np.ndarray:
        """Return the worlds to reset."""
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        mask = np.asarray(mask)
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset_mask must be a bool array of shape ({self.num_envs},) with a True entry, "
                f"got {mask.dtype} of shape {mask.shape} with {np.count_nonzero(mask)} true entries"
            )
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None) -> tuple[np.ndarray | None, np.ndarray]:
        """Return a seed for every world and which of them to use."""
        if seed is None:
            return None, np.zeros(self.num_envs, dtype=bool)
        given = seed
        if is_integer(seed):
            first = int(seed) + self.sim.scene.worlds.offset
            seed = [first + i for i in range(self.num_envs)]
        several = isinstance(seed, Iterable) and getattr(seed, "ndim", 1) > 0
        ordered = several and not isinstance(seed, (str, bytes, Set, Mapping))
        seeds: list[Any] = list(seed) if ordered else self.num_envs * [seed]  # type: ignore[arg-type]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed must have one entry for each of {self.num_envs} worlds, got {len(seeds)}")
        if not all(s is None or _is_seed(s) for s in seeds):
            raise ValueError(f"seeds must be integers from 0 to 2**64 - 1 or None, got {given!r}")
        seeded = np.array([s is not None for s in seeds])
        return np.array([s or 0 for s in seeds], dtype=object), seeded

    def _entries(self, given: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return arrays by name, the reward terms one by one."""
        entries = given()
        terms = entries.pop("terms")
        return entries | {name: terms[:, k] for k, name in enumerate(self._terms)}

    def _complete(self, info: dict[str, Any]) -> None:
        """Add to the info dictionary of a step how episodes ended, and masks where arrays are on the host."""
        same_step = self._autoreset == AutoresetMode.SAME_STEP
        if self.output != "numpy" and not self.sim.scene.device.is_cpu:
            # No masks and no look at what ended: that would wait for the device.
            if same_step:
                info["final_info"] = self._entries(self._given_final)
                info["final_obs"] = info["final_info"].pop("obs")
            return
        terminated, truncated, fault = self._seen().values()
        ended = terminated | truncated
        stepped = ~ended if same_step else ~self._resetting
        if self._autoreset == AutoresetMode.NEXT_STEP:
            self._resetting = ended
        info |= dict.fromkeys(self._masks, stepped)
        if not np.count_nonzero(ended):
            return
        self._warn_of_faults(fault)
        if same_step:
            final = self._entries(self._given_final)
            info |= {"final_obs": final.pop("obs"), "_final_obs": ended}
            info["final_info"] = final | dict.fromkeys([f"_{key}" for key in final], ended)
            info["_final_info"] = ended

    def _warn_of_faults(self, fault: np.ndarray) -> None:
        """Say once that worlds had to be reset."""
        if self._warned or not fault.any():
            return
        self._warned = True
        world = int(np.flatnonzero(fault)[0])
        reason = self.sim.describe_fault(world)
        gym.logger.warn(f"world {world} was reset after a fault ({reason}); later ones show in info['fault']")


class MyoWarpEnv(gym.Env):
    """One world of a task as a plain Gymnasium environment.

    Observation, reward and info are those of `MyoWarpVectorEnv` for one world. Truncation at the horizon is
    left to the `TimeLimit` wrapper that `gymnasium.make` adds.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012 (Gymnasium's protocol)

    def __init__(self, task: str, **options: Any) -> None:
        """Compile the task; options are those of `MyoWarpVectorEnv` that make sense for one world.

        Raises:
            TypeError: An option is unknown.
            ValueError: An option is out of its range, or makes sense for many worlds only.
        """
        many = (
            "num_envs",
            "shards",
            "autoreset_mode",
            "output",
            "copy",
            "max_episode_steps",
            "render_worlds",
            "rank",
        )
        for option in many:
            if option in options:
                raise ValueError(f"option {option!r} is for make_vec; a single environment has none")
        self._vector = MyoWarpVectorEnv(
            task, 1, max_episode_steps=NO_HORIZON, autoreset_mode=AutoresetMode.DISABLED, **options
        )
        self.metadata = {k: v for k, v in self._vector.metadata.items() if k != "autoreset_mode"}
        self.render_mode = self._vector.render_mode
        self.observation_space = self._vector.single_observation_space
        self.action_space = self._vector.single_action_space

    @property
    def sim(self) -> Simulation:
        """The simulation of this one world."""
        return self._vector.sim

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of the muscles, in the order of the `act` columns."""
        return self._vector.muscle_names

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start a new episode; see `MyoWarpVectorEnv.reset`."""
        super().reset(seed=seed)
        obs, info = self._vector.reset(seed=seed, options=options)
        return obs[0], info

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one control step; see `MyoWarpVectorEnv.step`."""
        shape = self.action_space.shape
        if np.shape(action) != shape:
            raise ValueError(f"action must be floating point of shape {shape}, got shape {np.shape(action)}")
        one = action.detach() if hasattr(action, "detach") else np.asarray(action)
        obs, reward, terminated, truncated, info = self._vector.step(one[None])
        info = {k: v[0].item() if v.ndim == 1 else v[0] for k, v in info.items() if not k.startswith("_")}
        return obs[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def get_state(self) -> State:
        """Return all that the world is; see `MyoWarpVectorEnv.get_state`."""
        return self._vector.get_state()

    def set_state(self, state: State, *, conditions: bool = True) -> np.ndarray:
        """Make the world what another was, and return its observation; see `MyoWarpVectorEnv.set_state`."""
        return self._vector.set_state(state, conditions=conditions)[0]

    def render(self) -> np.ndarray | None:
        """Return a picture (height, width, 3) uint8; None in human mode."""
        frames = self._vector.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close windows and drawing contexts."""
        self._vector.close()


def _is_seed(seed: object) -> bool:
    """Whether it is an integer of which every bit counts (`myowarp.kernels.random.seed_worlds`)."""
    return is_integer(seed) and 0 <= int(seed) < 2**64


def _autoreset_mode(mode: str | AutoresetMode) -> AutoresetMode:
    """Return Gymnasium's enum member for a mode or its name."""
    if isinstance(mode, AutoresetMode):
        return mode
    named = {name: m for m, name in AUTORESET_NAMES.items()}
    key = {m.value.lower(): name for m, name in AUTORESET_NAMES.items()}.get(str(mode).lower(), mode)
    check_choice("autoreset_mode", key, tuple(named))
    return named[key]


def _register(ids: Mapping[str, Variant]) -> None:
    """Register ids with Gymnasium; an id of the same task is replaced.

    Raises:
        ValueError: An id is another task's; none is registered.
    """
    for env_id, variant in ids.items():
        if env_id in gym.registry and gym.registry[env_id].kwargs.get("task") != variant.task:
            owner = gym.registry[env_id].kwargs.get("task")
            raise ValueError(f"id {env_id!r} is a variant of task {owner!r}; choose another name")
    for env_id, variant in ids.items():
        gym.registry.pop(env_id, None)
        gym.register(
            id=env_id,
            entry_point="myowarp.bridge_gym:MyoWarpEnv",
            vector_entry_point="myowarp.bridge_gym:MyoWarpVectorEnv",
            max_episode_steps=TASKS[variant.task].horizon,
            kwargs=vars(variant).copy(),
        )


def register_all() -> None:
    """Register every id with Gymnasium, those of later tasks too; called by `import myowarp`."""
    TASKS.watch(lambda key: _register(variants_of(key)))
    _register(paper_variants())


def env_id(task: str | TaskSpec) -> str:
    """Return the Gymnasium id of a task or of an id, in which "MyoWarp/" may be left out.

    Raises:
        ValueError: There is no such id, or the task is not registered.
    """
    if isinstance(task, TaskSpec):
        if task.key not in TASKS or TASKS[task.key] != task:
            raise ValueError(f"task {task.key!r} is not registered; call myowarp.register(task) first")
        return task.env_id
    find_variant(task)
    return f"MyoWarp/{task.removeprefix('MyoWarp/')}"


def make(task: str | TaskSpec, **options: Any) -> gym.Env:
    """Return one world of a task as a plain Gymnasium environment, `gymnasium.make` of its id.

    Args:
        task: Id, with or without "MyoWarp/", or a registered task.
        **options: Those of `gymnasium.make` and of `MyoWarpVectorEnv`.

    Raises:
        ValueError: There is no such task, or an option is out of its range.
    """
    return gym.make(env_id(task), **options)


def make_vec(task: str | TaskSpec, num_envs: int = 1, **options: Any) -> MyoWarpVectorEnv:
    """Return all worlds of a task as one vector environment, `gymnasium.make_vec` of its id.

    Args:
        task: Id, with or without "MyoWarp/", or a registered task.
        num_envs: Worlds stepped together.
        **options: Those of `MyoWarpVectorEnv`.

    Raises:
        ValueError: There is no such task, or an option is out of its range.
    """
    return cast(MyoWarpVectorEnv, gym.make_vec(env_id(task), num_envs=num_envs, **options))
