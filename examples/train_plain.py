"""PPO on the elbow from top to bottom, in plain torch: pip install torch; 10 s on two cores.

Schulman et al. 2017, arXiv:1707.06347, with generalised advantages (Schulman et al. 2016, arXiv:1506.02438).
An episode that ends by its time limit is not over: its last observation stands for what would have followed.
"""

import sys

import torch
from torch import nn

import myowarp

SAMPLES = int(sys.argv[1]) if len(sys.argv) > 1 else 150_000
WORLDS, STEPS, EPOCHS, MINIBATCH = 64, 32, 5, 512
GAMMA, LAMBDA, CLIP, LEARNING_RATE = 0.95, 0.9, 0.2, 1e-3

torch.manual_seed(0)
torch.set_num_threads(1)  # networks this small gain nothing from more
env = myowarp.make_vec(
    "myoElbowPose1D6MRandom-v0", WORLDS, device="cpu", output="torch", autoreset_mode="SameStep"
)
num_obs, num_actions = env.single_observation_space.shape[0], env.single_action_space.shape[0]


def network(outputs: int) -> nn.Sequential:
    """Return a network of two hidden layers."""
    return nn.Sequential(
        nn.Linear(num_obs, 64), nn.ELU(), nn.Linear(64, 64), nn.ELU(), nn.Linear(64, outputs)
    )


policy, value = network(num_actions), network(1)
log_std = nn.Parameter(torch.full((num_actions,), -0.5))
parameters = [*policy.parameters(), *value.parameters(), log_std]
optimizer = torch.optim.Adam(parameters, LEARNING_RATE)


def distribution(obs: torch.Tensor) -> torch.distributions.Normal:
    """Return the actions' distribution; the environment cuts them to [-1, 1]."""
    return torch.distributions.Normal(policy(obs), log_std.exp())


def advantages(reward: torch.Tensor, ended: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Return generalised advantages (STEPS, WORLDS); `values` (STEPS + 1, WORLDS) goes one step further."""
    found, carried = torch.zeros_like(reward), torch.zeros_like(reward[0])
    for t in reversed(range(len(reward))):
        goes_on = 1.0 - ended[t]
        error = reward[t] + GAMMA * goes_on * values[t + 1] - values[t]
        carried = error + GAMMA * LAMBDA * goes_on * carried
        found[t] = carried
    return found


def collect(now: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Act for STEPS steps; return what is observed then, and the samples: see `update`."""
    obs, action = torch.zeros(STEPS, WORLDS, num_obs), torch.zeros(STEPS, WORLDS, num_actions)
    reward, ended = torch.zeros(2, STEPS, WORLDS)
    for t in range(STEPS):
        obs[t], action[t] = now, distribution(now).sample()
        now, reward[t], terminated, truncated, info = env.step(action[t].clamp(-1.0, 1.0))
        ended[t] = terminated | truncated
        if truncated.any():  # the time is over, not the task: what would have followed counts
            reward[t] += GAMMA * truncated * value(info["final_obs"]).squeeze(-1)
    values = value(torch.cat((obs, now[None]))).squeeze(-1)
    advantage = advantages(reward, ended, values)
    density = distribution(obs).log_prob(action).sum(-1)
    samples = obs, action, advantage, advantage + values[:-1], density
    return now, *(each.flatten(0, 1) for each in samples)


def update(
    obs: torch.Tensor,
    action: torch.Tensor,
    advantage: torch.Tensor,
    returns: torch.Tensor,
    density: torch.Tensor,
) -> None:
    """Pass over the samples EPOCHS times, in parts."""
    advantage = (advantage - advantage.mean()) / advantage.std()
    for rows in (rows for _ in range(EPOCHS) for rows in torch.randperm(len(obs)).split(MINIBATCH)):
        ratio = (distribution(obs[rows]).log_prob(action[rows]).sum(-1) - density[rows]).exp()
        gain = torch.min(ratio * advantage[rows], ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * advantage[rows])
        miss = (value(obs[rows]).squeeze(-1) - returns[rows]).square()
        optimizer.zero_grad()
        (0.5 * miss - gain).mean().backward()
        nn.utils.clip_grad_norm_(parameters, 1.0)
        optimizer.step()


def evaluate() -> str:
    """Return how one episode of all worlds ends, without drawing actions."""
    obs, _ = env.reset(seed=1)
    for _ in range(env.spec.max_episode_steps):
        obs, *_, info = env.step(policy(obs).clamp(-1.0, 1.0))
    success, error = info["final_info"]["success"], info["final_obs"][:, 2].abs().rad2deg()
    return f"success {torch.as_tensor(success).float().mean():.0%}, at the end {error.mean():.1f} deg off"


with torch.no_grad():
    print(f"untrained: {evaluate()}")
obs, _ = env.reset(seed=0)
for _ in range(0, SAMPLES, STEPS * WORLDS):
    with torch.no_grad():
        obs, *samples = collect(obs.clone())
    update(*samples)
with torch.no_grad():
    print(f"after {SAMPLES:,} samples: {evaluate()}")
