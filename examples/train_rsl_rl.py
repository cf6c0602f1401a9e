"""Train the elbow with rsl_rl's PPO: pip install rsl-rl-lib; half a minute on two cores."""

import sys

import gymnasium as gym
import torch
from rsl_rl.runners import OnPolicyRunner

from myowarp.apps.adapters.rsl_rl import RslRlVecEnv

ID = "MyoWarp/myoElbowPose1D6MRandom-v0"
UPDATES = int(sys.argv[1]) if len(sys.argv) > 1 else 100
network = {
    "class_name": "MLPModel",
    "hidden_dims": [128, 128],
    "activation": "elu",
    "obs_normalization": True,
}
gaussian = {"class_name": "GaussianDistribution", "init_std": 0.6, "std_type": "scalar"}
config = {
    "num_steps_per_env": 32,
    "save_interval": 1000,
    "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
    "actor": network | {"distribution_cfg": gaussian},
    "critic": network,
    "algorithm": {"class_name": "PPO", "gamma": 0.95, "lam": 0.9, "desired_kl": 0.02},
}
env = RslRlVecEnv(gym.make_vec(ID, 64, autoreset_mode="SameStep", output="torch"))
runner = OnPolicyRunner(env, config, device=str(env.device))
runner.learn(UPDATES)

policy, ended = runner.get_inference_policy(), torch.zeros(64, dtype=torch.bool)
env.env.reset(seed=1)
with torch.inference_mode():
    while not ended.all():
        *_, ended, extras = env.step(policy(env.get_observations()))
print(f"success {extras['log']['/episode/success']:.0%} after {UPDATES} updates")
