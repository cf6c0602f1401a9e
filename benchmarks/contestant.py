"""One contestant of `benchmarks.rivals`: a process that steps when told to, and idles otherwise.

    python benchmarks/contestant.py '{"kind": "envpool", "task": "myoHandPoseRandom-v0", "num_envs": 64, ...}'

It speaks JSON, a line each: `ready` once it has stepped, then for every line with a number of seconds on its
input what it did in that time. It runs in the environment of the rival that it measures, so it imports
nothing of ours but what it measures. Steps count where physics moved: the step in which a vector environment
only resets a world is left out, its time is not.
"""

import itertools
import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np

FULL_BODY = "full_body-v0"  # a model of ours on which nobody has a task: poses of all its joints
ACTIONS = 64  # random actions drawn ahead, so that drawing costs no contestant anything


class Contestant(Protocol):
    """Something that steps."""

    facts: dict[str, object]

    def advance(self) -> int:
        """Step once, with random actions, resets included; return the environment steps that were made."""

    def close(self) -> None:
        """End what it has started."""


def random_actions(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
    """Return endless uniform actions in [-1, 1]."""
    return itertools.cycle(np.random.default_rng(0).uniform(-1, 1, (ACTIONS, *shape)).astype(np.float32))


class SingleEnv:
    """MyoSuite, one environment, reset where an episode ends."""

    def __init__(self, task: str, cores: int, **_: Any) -> None:
        import gymnasium
        import myosuite  # noqa: F401 (it registers its ids)

        self.env = gymnasium.make(task)
        self.env.reset(seed=0)
        self.actions = random_actions(self.env.action_space.shape)
        self.facts = {"envs": 1, "processes": 1}

    def advance(self) -> int:
        """See `Contestant`."""
        _, _, terminated, truncated, _ = self.env.step(next(self.actions))
        if terminated or truncated:
            self.env.reset()
        return 1

    def close(self) -> None:
        """See `Contestant`."""
        self.env.close()


class VectorEnv:
    """Any vector environment that resets an ended world in the step after."""

    def __init__(self, env: Any, num_envs: int, **facts: object) -> None:
        self.env, self.num_envs = env, num_envs
        first, _ = env.reset()
        self.ended = np.zeros(num_envs, dtype=bool)
        self.actions = random_actions((num_envs, env.action_space.shape[-1]))
        self.facts = {"envs": num_envs, "starts_are_identical": bool((np.ptp(first, axis=0) == 0).all())}
        self.facts |= facts

    def advance(self) -> int:
        """See `Contestant`."""
        _, _, terminated, truncated, _ = self.env.step(next(self.actions))
        moved = self.num_envs - int(self.ended.sum())
        self.ended = terminated | truncated
        return moved

    def close(self) -> None:
        """See `Contestant`."""
        self.env.close()


def myosuite_async(task: str, cores: int, **_: Any) -> VectorEnv:
    """MyoSuite in Gymnasium's AsyncVectorEnv, one worker a core."""
    import gymnasium
    import myosuite  # noqa: F401

    env = gymnasium.vector.AsyncVectorEnv(cores * [lambda: gymnasium.make(task)])
    return VectorEnv(env, cores, processes=cores + 1)


def envpool(task: str, cores: int, num_envs: int, **_: Any) -> VectorEnv:
    """EnvPool, one thread a core."""
    import envpool

    env = envpool.make_gymnasium(f"MyoSuite/{task}", num_envs=num_envs, num_threads=cores)
    return VectorEnv(env, num_envs, threads=cores)


def task_spec(task: str) -> Any:
    """Return a task of MyoWarp, registered."""
    import myowarp

    return myowarp.from_mjcf("full_body") if task == FULL_BODY else myowarp.TASKS[task]


def myowarp(task: str, cores: int, num_envs: int, physics: str, **_: Any) -> VectorEnv:
    """MyoWarp as a user makes it; all cores are its default."""
    import gymnasium

    task_spec(task)
    env = gymnasium.make_vec(f"MyoWarp/{task}", num_envs=num_envs, physics=physics, device="cpu")
    return VectorEnv(env, num_envs, physics=physics)


class MujocoC:
    """Bare `mj_step` of the unslimmed model through MuJoCo's own thread pool; no environment around it.

    Whole episodes from the start configuration, policy-like controls held for one control step.
    """

    def __init__(self, task: str, threads: int, **_: Any) -> None:
        import mujoco
        from mujoco.rollout import Rollout

        from myowarp.sim.build import full_spec

        spec = task_spec(task)
        model = full_spec(spec).compile()
        data = mujoco.MjData(model)
        data.qpos[:] = spec.start(model)
        state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.rollout, self.model = Rollout(nthread=threads), model
        self.threads, self.horizon = threads, spec.horizon
        self.starts = np.tile(state, (threads, 1))
        self.data = [mujoco.MjData(model) for _ in range(threads)]
        actions = np.random.default_rng(0).uniform(-1, 1, (threads, spec.horizon, model.nu))
        controls = 1.0 / (1.0 + np.exp(-5.0 * (actions - 0.5)))
        self.controls = np.repeat(controls, spec.num_substeps, axis=1)
        self.facts = {"envs": threads, "threads": threads}

    def advance(self) -> int:
        """See `Contestant`; one episode in every thread."""
        self.rollout.rollout(self.model, self.data, self.starts, self.controls)
        return self.threads * self.horizon

    def close(self) -> None:
        """See `Contestant`."""
        self.rollout.close()


KINDS = {
    "myosuite": SingleEnv,
    "myosuite_async": myosuite_async,
    "envpool": envpool,
    "mujoco_c": MujocoC,
    "myowarp": myowarp,
}


def process_ids() -> list[int]:
    """Return this process and its descendants."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it ended meanwhile
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    found = [os.getpid()]
    for pid in found:
        found.extend(child for child, parent in parents.items() if parent == pid)
    return found


def peak_memory() -> float:
    """Return the peak resident memory of this process and its workers [MB]; shared pages count in each."""
    peak = 0
    for pid in process_ids():
        with suppress(OSError):
            lines = Path(f"/proc/{pid}/status").read_text().splitlines()
            peak += sum(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    return peak / 1024


def cpu_seconds() -> float:
    """Return the processor time that this process and its workers have used [s]."""
    ticks = 0
    for pid in process_ids():
        with suppress(OSError):
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def measure(contestant: Contestant, seconds: float) -> dict[str, float]:
    """Step for about `seconds`, after one untimed step that warms the caches up again."""
    contestant.advance()
    steps, cpu, begin = 0, cpu_seconds(), time.perf_counter()
    while True:
        steps += contestant.advance()
        wall = time.perf_counter() - begin
        if wall >= seconds:
            return {"rate": steps / wall, "wall": wall, "cpu": cpu_seconds() - cpu, "memory": peak_memory()}


def main() -> None:
    """Serve requests until the input ends; what a contestant prints goes to the error stream."""
    options = json.loads(sys.argv[1])
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    contestant: Contestant = KINDS[options.pop("kind")](**options)
    contestant.advance()
    print(json.dumps({"facts": contestant.facts}), file=answers)
    for line in sys.stdin:
        print(json.dumps(measure(contestant, float(line))), file=answers)
    contestant.close()


if __name__ == "__main__":
    main()
