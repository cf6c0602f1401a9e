"""The main job: run a policy in many worlds, measure, and keep what happened.

A policy is a function of the observations, shape (num_worlds, obs_size), that returns actions in [-1, 1],
shape (num_worlds, num_actions).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from myowarp.apps.policies.baselines import policy_folder
from myowarp.apps.policies.checkpoint import Checkpoint
from myowarp.apps.policies.hold import Hold, check_hold
from myowarp.apps.policies.learned import bind, read_policy
from myowarp.apps.policies.replay import Replay, is_replay
from myowarp.apps.rollouts.film import Film
from myowarp.apps.rollouts.recording import SignalRecorder
from myowarp.bridge_gym import MyoWarpVectorEnv
from myowarp.definitions.task import TaskSpec
from myowarp.disk import in_place
from myowarp.motion.storage import Storage, read_storage
from myowarp.progress import progress_bar
from myowarp.sim.simulation import Simulation
from myowarp.tasks.outside import load

Act = Callable[[np.ndarray], np.ndarray]
"""Observations (num_worlds, obs_size) to actions (num_worlds, num_actions) in [-1, 1]."""

BUILT_IN = ("random", "zero", "hold")


@dataclass(frozen=True)
class Policy:
    """What acts.

    Attributes:
        name: How the user called it.
        act: Function of the observations; None for the built-in policies.
        checkpoint: What was trained; None for all others.
        excitations: Excitations over time; None for all others.
    """

    name: str
    act: Act | None = None
    checkpoint: Checkpoint | None = None
    excitations: Storage | None = None


@dataclass
class Recording:
    """What happened, step by step; T steps, N worlds.

    Attributes:
        arrays: Name to array of shape (T, N, ...).
    """

    arrays: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def add(self, **values: np.ndarray) -> None:
        """Append one step."""
        for name, value in values.items():
            self.arrays.setdefault(name, []).append(value)


@dataclass(frozen=True)
class Summary:
    """Figures of a rollout; the rates cover the steps alone, without start-up and pictures."""

    task: str
    policy: str
    device: str
    num_worlds: int
    steps: int
    env_steps_per_s: float
    physics_steps_per_s: float
    episodes: int
    return_mean: float | None
    return_std: float | None
    success_percent: float | None
    faults: int


class PolicyError(Exception):
    """A user's policy raised; the cause says where."""


def find_policy(name: str, spec: TaskSpec) -> Policy:
    """Return a policy by name; code of the user that defines it is run once.

    Args:
        name: "random", "zero", "hold", "baseline", "baselines/<task>", the folder of a trained policy, a file
            of excitations (each a file in `myowarp.apps.policies`), "package.module:function" or
            "file.py:function".
        spec: The task in which it is to act.

    Raises:
        ValueError: No such policy, or it cannot act in this task.
        OSError: Its file cannot be read.
    """
    if name == "hold":
        check_hold(spec)
    if name in BUILT_IN:
        return Policy(name)
    if (folder := policy_folder(name, spec.key)) is not None:
        return Policy(name, checkpoint=read_policy(name, folder, spec))
    if is_replay(name):
        return Policy(name, excitations=read_storage(Path(name)))
    source, colon, attribute = name.rpartition(":")
    if not colon:
        raise ValueError(
            f"policy {name!r} unknown; available: {', '.join(BUILT_IN)}, baseline, "
            "baselines/<task>, the folder of a trained policy, excitations (.sto, .mot, .csv), "
            "package.module:function, file.py:function"
        )
    try:
        act = getattr(load(source), attribute, None)
    except ValueError as error:
        raise ValueError(f"policy {name!r} not found: {error}") from error
    if act is None:
        raise ValueError(f"policy {name!r} not found: {source} has no {attribute!r}")
    if not callable(act):
        raise ValueError(f"policy {name!r} must be a function of the observations, got {type(act).__name__}")
    return Policy(name, act)


def acting(policy: Policy, sim: Simulation, seed: int) -> Act:
    """Return the function that acts: the user's, with its errors marked as such, or a built-in one."""
    act, scene = policy.act, sim.scene
    if policy.checkpoint is not None:
        return bind(policy.checkpoint, sim)
    if policy.excitations is not None:
        return Replay(policy.name, policy.excitations, sim)
    if act is not None:

        def guarded(obs: np.ndarray) -> np.ndarray:
            try:
                return act(obs)
            except (ValueError, OSError, RuntimeError, ImportError) as error:
                raise PolicyError(f"policy {policy.name!r} failed") from error

        return guarded
    if policy.name == "hold":
        return Hold(scene)
    shape = (scene.num_worlds, scene.num_actions)
    if policy.name == "zero":
        return lambda obs: np.zeros(shape, dtype=np.float32)
    rng = np.random.default_rng(seed)
    return lambda obs: rng.uniform(-1.0, 1.0, shape).astype(np.float32)


def run(
    env: MyoWarpVectorEnv,
    policy: Policy,
    steps: int,
    seed: int,
    *,
    record: bool = False,
    film: Film | None = None,
    recorder: SignalRecorder | None = None,
    console: Console | None = None,
) -> tuple[Summary, Recording]:
    """Run a policy.

    Args:
        env: Environment with NumPy output, and autoreset in the same step or, to film the end of episodes,
            none: worlds that ended are then reset here, with the same numbers.
        policy: What acts, from `find_policy`.
        steps: Control steps.
        seed: Seed of the resets and of the random policy.
        record: Whether to keep observation, action, reward and endings of every step.
        film: Film that keeps what its worlds look like.
        recorder: Recorder of muscle signals.
        console: Where to draw the progress bar.

    Returns:
        Figures and recording.

    Raises:
        ValueError: The policy returned actions of a wrong shape or value.
    """
    act = acting(policy, env.sim, seed)
    recording, tally = Recording(), _Tally(env.num_envs)
    obs, _ = env.reset(seed=seed)
    seconds = 0.0
    with progress_bar("Simulating", "steps  {task.fields[rate]:>9,.0f} env steps/s", console) as bar:
        task = bar.add_task("", total=steps, rate=0.0)
        for step in range(1, steps + 1):
            actions = np.array(act(obs.copy() if record else obs))  # a policy may reuse its arrays
            begin = time.perf_counter()
            next_obs, reward, terminated, truncated, info = env.step(actions)
            seconds += time.perf_counter() - begin
            if record:
                recording.add(
                    obs=obs, action=actions, reward=reward, terminated=terminated, truncated=truncated
                )
            if recorder is not None:
                recorder.add()
            ended = terminated | truncated
            if film is not None:
                film.add(reward, _success(info, ended))
                film.begin(ended)
            tally.add(reward, ended, info)
            if ended.any() and "final_info" not in info:
                next_obs, _ = env.reset(options={"reset_mask": ended})
            obs = next_obs
            bar.update(task, advance=1, rate=env.num_envs * step / seconds)
    return _summary(env, policy, steps, seconds, tally), recording


def _success(info: dict[str, Any], ended: np.ndarray) -> np.ndarray:
    """Return whether the step that was made solved the task, shape (num_worlds,)."""
    if "final_info" not in info:
        return info["success"]
    return np.where(ended, info["final_info"]["success"], info["success"])


def _summary(env: MyoWarpVectorEnv, policy: Policy, steps: int, seconds: float, tally: "_Tally") -> Summary:
    """Return the figures of a rollout whose steps took `seconds`."""
    scene = env.sim.scene
    rate = env.num_envs * steps / seconds
    return Summary(
        task=scene.spec.env_id,
        policy=policy.name,
        device=str(scene.device),
        num_worlds=env.num_envs,
        steps=steps,
        env_steps_per_s=rate,
        physics_steps_per_s=rate * scene.num_substeps,
        **tally.figures(),
    )


class _Tally:
    """Returns and successes of finished episodes."""

    def __init__(self, num_worlds: int) -> None:
        self._running = np.zeros(num_worlds)
        self._returns: list[float] = []
        self._successes: list[bool] = []
        self._faults = 0

    def add(self, reward: np.ndarray, ended: np.ndarray, info: dict[str, Any]) -> None:
        """Count one step of all worlds."""
        self._running += reward
        self._faults += int(np.count_nonzero(info["fault"]))
        if ended.any():
            self._returns += self._running[ended].tolist()
            self._successes += info.get("final_info", info)["success"][ended].tolist()
            self._running[ended] = 0.0

    def figures(self) -> dict[str, Any]:
        """Return the figures of `Summary` that come from episodes."""
        finished = bool(self._returns)
        return {
            "episodes": len(self._returns),
            "return_mean": float(np.mean(self._returns)) if finished else None,
            "return_std": float(np.std(self._returns)) if finished else None,
            "success_percent": 100.0 * float(np.mean(self._successes)) if finished else None,
            "faults": self._faults,
        }


def save_recording(path: Path, env: MyoWarpVectorEnv, recording: Recording) -> None:
    """Write a recording as compressed npz, in place in one move.

    Raises:
        OSError: The file cannot be written.
    """
    columns = [f"{c.name}[{i}]" for c in env.sim.columns for i in range(c.size)]
    arrays = {name: np.stack(steps) for name, steps in recording.arrays.items()}
    arrays |= {"columns": np.array(columns), "muscles": np.array(env.muscle_names)}
    arrays |= {"control_dt": np.array(env.sim.scene.control_dt)}
    with in_place(path) as scratch, scratch.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
