"""Train the elbow with skrl's own trainer and wrapper: pip install skrl torch; half a minute on two cores."""

import sys

import gymnasium as gym
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.trainers.torch import SequentialTrainer
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

import myowarp  # noqa: F401  (registers the ids)

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
env = wrap_env(gym.make_vec("MyoWarp/myoElbowPose1D6MRandom-v0", 64))
spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}
network = [{"name": "net", "input": "OBSERVATIONS", "layers": [128, 128], "activations": "elu"}]
policy = gaussian_model(**spaces, network=network, output="ACTIONS", initial_log_std=-0.5)
models = {"policy": policy, "value": deterministic_model(**spaces, network=network, output="ONE")}
scaled = {"size": env.observation_space, "device": env.device}
cfg = PPO_CFG(
    **{"rollouts": 32, "learning_epochs": 5, "mini_batches": 4, "discount_factor": 0.95, "gae_lambda": 0.9},
    **{"time_limit_bootstrap": True, "experiment": {"write_interval": 0, "checkpoint_interval": 0}},
    **{"observation_preprocessor": RunningStandardScaler, "observation_preprocessor_kwargs": scaled},
)
memory = RandomMemory(memory_size=32, num_envs=env.num_envs, device=env.device)
agent = PPO(models=models, memory=memory, cfg=cfg, **spaces)
SequentialTrainer(env=env, agents=agent, cfg={"timesteps": STEPS, "headless": True}).train()

obs, _ = env.reset()
agent.enable_training_mode(False)
with torch.no_grad():
    for _ in range(100):
        _, outputs = agent.act(obs, None, timestep=STEPS, timesteps=STEPS)
        obs, _, _, _, info = env.step(outputs["mean_actions"])
print(f"success {info['success'].mean():.0%} after {64 * STEPS:,} samples")
