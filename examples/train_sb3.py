"""Train the elbow with Stable-Baselines3's PPO: pip install stable-baselines3; 20 s on two idle cores."""

import sys

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from myowarp import Sb3VecEnv

ID = "MyoWarp/myoElbowPose1D6MRandom-v0"
SAMPLES = int(sys.argv[1]) if len(sys.argv) > 1 else 250_000


def success_rate(model: PPO, env: VecNormalize, num_steps: int = 100) -> float:
    """Return the share of episodes that succeed, all worlds from their reset on."""
    env.training, obs, found = False, env.reset(), []
    for _ in range(num_steps):
        obs, _, _, infos = env.step(model.predict(obs, deterministic=True)[0])
        found += [info["is_success"] for info in infos if "is_success" in info]
    return float(np.mean(found))


env = VecNormalize(VecMonitor(Sb3VecEnv(gym.make_vec(ID, 64, autoreset_mode="SameStep"))), gamma=0.95)
env.seed(0)
torch.set_num_threads(1)  # more of them wait for each other in networks as small as these
settings = {"n_steps": 32, "batch_size": 512, "n_epochs": 5, "gamma": 0.95, "gae_lambda": 0.9, "seed": 0}
model = PPO("MlpPolicy", env, policy_kwargs={"log_std_init": -0.5}, target_kl=0.02, verbose=1, **settings)
model.learn(SAMPLES, log_interval=10)
print(f"success {success_rate(model, env):.0%} after {model.num_timesteps:,} samples")
