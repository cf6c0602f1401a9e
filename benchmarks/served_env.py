"""A rival's vector environment for `benchmarks.learner`, in the Python that has the rival.

    python benchmarks/served_env.py '{"kind": "envpool", "task": "myoHandReachFixed-v0", "num_envs": 64, ...}'

It answers in bytes. First comes a line of JSON with the sizes. "r" and a seed (int64) reset all worlds,
"m" and a mask (num_envs uint8) those of the mask; the answer is all observations (float32). "s" and actions
(float32) step; the answer is observations, rewards (float32), and terminated, truncated, solved (uint8 each).
"""

import json
import os
import sys
from typing import Any

import numpy as np


class EnvPool:
    """EnvPool, one thread a core."""

    def __init__(self, task: str, num_envs: int, cores: int) -> None:
        import envpool

        self.env = envpool.make_gymnasium(f"MyoSuite/{task}", num_envs=num_envs, num_threads=cores, seed=0)
        self.size = self.env.action_space.shape[-1]

    def reset(self, seed: int) -> np.ndarray:
        """Reset all; the seed is that of `make`."""
        self.obs = np.asarray(self.env.reset()[0], np.float32)
        return self.obs

    def restart(self, mask: np.ndarray) -> np.ndarray:
        """Reset the worlds of a mask."""
        ids = np.flatnonzero(mask).astype(np.int32)
        self.obs = self.obs.copy()
        self.obs[ids] = self.env.reset(ids)[0]
        return self.obs

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Step all."""
        obs, reward, terminated, truncated, info = self.env.step(actions)
        self.obs = np.asarray(obs, np.float32)
        return self.obs, reward, terminated, truncated, info["solved"]


class MyoSuiteAsync:
    """MyoSuite in Gymnasium's AsyncVectorEnv, one worker an environment."""

    def __init__(self, task: str, num_envs: int, cores: int) -> None:
        import gymnasium
        import myosuite  # noqa: F401 (it registers its ids)
        from gymnasium.vector import AutoresetMode

        self.env = gymnasium.vector.AsyncVectorEnv(
            num_envs * [lambda: gymnasium.make(task)], autoreset_mode=AutoresetMode.DISABLED
        )
        self.size = self.env.single_action_space.shape[0]

    def reset(self, seed: int) -> np.ndarray:
        """Reset all."""
        return self.env.reset(seed=seed)[0]

    def restart(self, mask: np.ndarray) -> np.ndarray:
        """Reset the worlds of a mask."""
        return self.env.reset(options={"reset_mask": mask})[0]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Step all."""
        obs, reward, terminated, truncated, info = self.env.step(actions)
        return obs, reward, terminated, truncated, info["solved"]


KINDS: dict[str, Any] = {"envpool": EnvPool, "myosuite_async": MyoSuiteAsync}


def main() -> None:
    """Serve until the input ends; what the rival prints goes to the error stream."""
    options = json.loads(sys.argv[1])
    source, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    env = KINDS[options.pop("kind")](**options)
    n, obs = options["num_envs"], env.reset(0)
    sizes = {"obs_size": int(obs.shape[1]), "num_actions": int(env.size)}
    answers.write(json.dumps(sizes).encode() + b"\n")
    answers.flush()
    while command := source.read(1):
        if command == b"r":
            parts: tuple[np.ndarray, ...] = (env.reset(int(np.frombuffer(source.read(8), np.int64)[0])),)
        elif command == b"m":
            parts = (env.restart(np.frombuffer(source.read(n), np.uint8).astype(bool)),)
        else:
            parts = env.step(np.frombuffer(source.read(4 * n * env.size), np.float32).reshape(n, -1))
        for i, part in enumerate(parts):
            answers.write(np.ascontiguousarray(part, np.float32 if i < 2 else np.uint8).tobytes())
        answers.flush()


if __name__ == "__main__":
    main()
