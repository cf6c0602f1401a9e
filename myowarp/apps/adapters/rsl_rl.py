"""The vector environment for rsl_rl, all on the device of the simulation and without copies.

    env = gymnasium.make_vec("MyoWarp/myoElbowPose1D6MRandom-v0", 64, autoreset_mode="SameStep",
                             output="torch")
    OnPolicyRunner(RslRlVecEnv(env), config).learn(100)

The observation is the group `policy`. At a time limit rsl_rl bootstraps from the value of the state before
the last step, which is its own approximation; `extras["time_outs"]` tells it where.
"""

from typing import Any

import torch
import warp as wp
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from myowarp.apps.adapters.same_step import check_same_step
from myowarp.bridge_gym import MyoWarpVectorEnv


class RslRlVecEnv(VecEnv):
    """All worlds of a task as one vector environment of rsl_rl.

    Attributes:
        env: The Gymnasium vector environment.
        num_envs: Worlds stepped together.
        num_actions: Actions of a world.
        max_episode_length: Control steps of an episode.
        device: Where all tensors are.
        cfg: What rsl_rl logs: id, number of worlds and seed.
    """

    def __init__(self, env: MyoWarpVectorEnv, *, seed: int = 0) -> None:
        """Wrap an environment whose output is torch tensors, and start the first episodes.

        Args:
            env: Made with `autoreset_mode="SameStep", output="torch"`.
            seed: World i is seeded with `seed + i`.

        Raises:
            ValueError: It resets in another step, or its output is another library's.
        """
        check_same_step(env, "torch")
        sim = env.sim
        self.env, self.cfg = env, {"env_id": sim.scene.spec.env_id, "num_envs": env.num_envs, "seed": seed}
        self.num_envs, self.num_actions = env.num_envs, sim.action.shape[1]
        self.max_episode_length = sim.horizon
        self.device = wp.device_to_torch(sim.scene.device)
        self._step_count = wp.to_torch(sim.episode.step_count)
        self._obs, _ = env.reset(seed=seed)

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Control steps since every world's reset; what is written here ends episodes earlier or later."""
        return self._step_count

    @episode_length_buf.setter
    def episode_length_buf(self, steps: torch.Tensor) -> None:
        self._step_count.copy_(steps)

    def get_observations(self) -> TensorDict:
        """Return the observations (num_envs, n) as group `policy`."""
        return TensorDict({"policy": self._obs.clone()}, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance every world by one control step, and reset what has ended.

        Args:
            actions: Shape (num_envs, num_actions).

        Returns:
            Observations, rewards (num_envs,), endings (num_envs,), and extras: `time_outs`, and for the log
            the share of successes among the episodes that ended.
        """
        self._obs, reward, terminated, truncated, info = self.env.step(actions)
        done = terminated | truncated
        extras: dict[str, Any] = {"time_outs": truncated & ~terminated}
        if done.any():
            success = info["final_info"]["success"][done]
            extras["log"] = {"/episode/success": success.float().mean()}
        return self.get_observations(), reward.clone(), done.clone(), extras
