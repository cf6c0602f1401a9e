"""One training of `benchmarks.learning`: loop and learner of `myowarp train` on any of its contestants.

    python -m benchmarks.learner '{"kind": "myowarp", "task": "myoHandReachFixed-v0", "seconds": 60, ...}'

It prints a line of JSON after each iteration. Environments of rivals live in a process of their own
(`served_env.py`), which has their Python; what the pipe between them costs is measured, too.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import torch

from benchmarks.contestant import cpu_seconds
from myowarp.apps.train.loop import Run
from myowarp.apps.train.plan import plan
from myowarp.apps.train.run import start
from myowarp.apps.train.settings import choose
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TASKS
from myowarp.kernels.episode import SUCCESS_STEPS


class ServedEnv:
    """A rival's environment as `Run` takes one: resets by mask, tensors, no autoreset."""

    def __init__(self, python: str, num_envs: int, **options: Any) -> None:
        """Start its process."""
        script = Path(__file__).with_name("served_env.py")
        command = [python, str(script), json.dumps(options | {"num_envs": num_envs})]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin
        assert self._process.stdout
        self._to, self._of = self._process.stdin, self._process.stdout
        sizes = json.loads(self._of.readline())
        self.num_envs, self._obs_size = num_envs, sizes["obs_size"]
        box = gymnasium.spaces.Box
        self.single_observation_space = box(-np.inf, np.inf, (self._obs_size,), np.float32)
        self.single_action_space = box(-1.0, 1.0, (sizes["num_actions"],), np.float32)
        self.sim = SimpleNamespace(
            scene=SimpleNamespace(device="cpu"),
            setup=Setup(seed=0),
            transition=SimpleNamespace(obs=np.empty((num_envs, self._obs_size))),
            action=np.empty((num_envs, sizes["num_actions"])),
        )
        self._solved = np.zeros(num_envs, int)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        """Reset all worlds, or those of `reset_mask`."""
        if options:
            mask = options["reset_mask"]
            self._solved[mask] = 0
            self._send(b"m", mask.astype(np.uint8))
        else:
            self._solved[:] = 0
            self._send(b"r", np.int64(seed or 0))
        return self._floats(self._obs_size), {}

    def step(self, actions: torch.Tensor) -> tuple[Any, ...]:
        """Step all worlds; actions are clipped as ours are."""
        self._send(b"s", actions.clamp(-1.0, 1.0).float().numpy())
        obs, reward = self._floats(self._obs_size), self._floats(1)[:, 0]
        terminated, truncated, solved = (self._flags() for _ in range(3))
        self._solved += solved
        success = torch.from_numpy(self._solved > int(SUCCESS_STEPS))
        info = {"solved": torch.from_numpy(solved), "success": success}
        info["fault"] = torch.zeros(self.num_envs, dtype=torch.int32)  # a rival tells of none
        return obs, reward, torch.from_numpy(terminated), torch.from_numpy(truncated), info

    def close(self) -> None:
        """End the process."""
        self._to.close()
        self._process.wait(timeout=60)

    def _send(self, command: bytes, array: Any) -> None:
        """Send a command and its array."""
        self._to.write(command + array.tobytes())
        self._to.flush()

    def _floats(self, size: int) -> torch.Tensor:
        """Return what comes, shape (num_envs, size)."""
        content = bytearray(self._of.read(4 * self.num_envs * size))
        return torch.frombuffer(content, dtype=torch.float32).reshape(self.num_envs, size)

    def _flags(self) -> np.ndarray:
        """Return what comes, (num_envs,) bool."""
        return np.frombuffer(self._of.read(self.num_envs), np.uint8).astype(bool)


def make_run(kind: str, task: str, python: str, cores: int) -> Run:
    """Return a training with the task's preset.

    AsyncVectorEnv gets one environment a core, for each is a process, and as many more steps an iteration.
    """
    algorithm = "sac" if kind == "myowarp_sac" else "ppo"
    job = plan(task, algorithm=algorithm, device="cpu", output=Path("unwritten"))
    if kind.startswith("myowarp"):
        return start(job)
    settings = job.settings
    torch.set_num_threads(settings.threads)
    if kind == "myosuite_async":
        rows = settings.num_worlds * settings.rollout_steps // cores
        settings = choose(TASKS[task].name, "ppo", {"num_worlds": cores, "rollout_steps": rows})
    return Run(ServedEnv(python, settings.num_worlds, kind=kind, task=task, cores=cores), settings)  # type: ignore[arg-type]


def main() -> None:
    """Train until success or until the time is over."""
    options = json.loads(sys.argv[1])
    share, seconds, begin = options.pop("share"), options.pop("seconds"), options.pop("begin")
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    run, started = make_run(**options), time.time() - begin
    while True:
        run.iterate()
        figures, wall = run.worlds.tally.figures(), time.time() - begin
        row = {
            "seconds": wall,
            "start": started,
            "cpu": cpu_seconds(),
            "samples": run.samples,
            "success": figures["success"],
        }
        reached = run.worlds.tally.reached(share, "success")
        print(json.dumps(row | run.worlds.clock.shares() | {"reached": reached}), file=answers)
        if reached or wall > seconds:
            break
    run.env.close()


if __name__ == "__main__":
    main()
