"""The vector environment for Stable-Baselines3, which knows no `gymnasium.vector`.

    env = gymnasium.make_vec("MyoWarp/myoElbowPose1D6MRandom-v0", 64, autoreset_mode="SameStep")
    PPO("MlpPolicy", VecNormalize(VecMonitor(Sb3VecEnv(env)))).learn(250_000)

When an episode ends, `infos` has its last observation as `terminal_observation`; `TimeLimit.truncated`, from
which Stable-Baselines3 bootstraps; and `is_success`, which its `EvalCallback` averages.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from myowarp.apps.adapters.same_step import check_same_step
from myowarp.bridge_gym import MyoWarpVectorEnv


class Sb3VecEnv(VecEnv):
    """All worlds of a task as one vector environment of Stable-Baselines3.

    Attributes:
        env: The Gymnasium vector environment.
    """

    def __init__(self, env: MyoWarpVectorEnv) -> None:
        """Wrap an environment whose output is NumPy arrays.

        Args:
            env: Made with `autoreset_mode="SameStep"`.

        Raises:
            ValueError: It resets in another step, or its output is another library's, or no copies.
        """
        check_same_step(env, "numpy")
        if not env.copy:
            raise ValueError(
                "the environment must be made without copy=False: Stable-Baselines3 keeps observations "
                "that the next step would overwrite"
            )
        self.env = env
        self._actions = env.action_space.sample()
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Start new episodes, with the seeds of `seed` and the options of `set_options`; (num_envs, n).

        Raises:
            ValueError: Options differ between worlds.
        """
        if any(options != self._options[0] for options in self._options):
            raise ValueError("reset options must be the same for all worlds; those of one world: reset_mask")
        seeds = None if None in self._seeds else self._seeds
        obs, _ = self.env.reset(seed=seeds, options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (num_envs, num_actions) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Advance every world by one control step."""
        obs, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(done):
            infos[world] = {
                "terminal_observation": info["final_obs"][world],
                "TimeLimit.truncated": bool(truncated[world] and not terminated[world]),
                "is_success": bool(info["final_info"]["success"][world]),
            }
        return obs, reward, done, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return a picture of every world."""
        return list(self.env.render() or ())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each world."""
        return [getattr(self.env, attr_name)] * len(self._worlds(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise: the worlds are no objects of their own.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError(f"worlds have no attribute {attr_name!r} of their own; set it on .env")

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Raise: the worlds are no objects of their own.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError(f"worlds have no method {method_name!r} of their own; call it on .env")

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return that no world is wrapped."""
        return [False] * len(self._worlds(indices))

    def _worlds(self, indices: VecEnvIndices) -> Sequence[int]:
        """Return the numbers of the worlds that are meant."""
        return list(self._get_indices(indices))
