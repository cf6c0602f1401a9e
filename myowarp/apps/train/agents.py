"""skrl's agents from settings, and all their numbers as named arrays, and back.

skrl's own checkpoints unpickle code, forget SAC's entropy weight and restart the clock; here everything that
the next update depends on is listed once, as arrays and plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import torch
from skrl import config
from skrl.agents.torch import Agent
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.agents.torch.sac import SAC, SAC_CFG
from skrl.agents.torch.trpo import TRPO, TRPO_CFG
from skrl.memories.torch import RandomMemory
from skrl.models.torch import Model
from skrl.resources.schedulers.torch import KLAdaptiveLR
from torch import distributed

from myowarp.apps.train.dagger import DAGGER_CFG, DAgger
from myowarp.apps.train.flash_sac import CategoricalCritic, FlashSAC
from myowarp.apps.train.networks import GAUSSIAN_LOG_STD, LOG_STD, GaussianPolicy, SquashedPolicy, Value
from myowarp.apps.train.settings import (
    DAggerSettings,
    FlashSACSettings,
    Gaussian,
    OffPolicy,
    OnPolicy,
    PPOSettings,
    Replaying,
    SACSettings,
    Settings,
    TRPOSettings,
)
from myowarp.apps.train.skrl_names import MergedScaler, set_temperature

Arrays = dict[str, np.ndarray]
TRACKED = {
    "Loss / Policy loss": "policy_loss",
    "Loss / Value loss": "value_loss",
    "Loss / Critic loss": "critic_loss",
    "Policy / Standard deviation": "action_std",
    "Learning / Learning rate": "learning_rate",
    "Coefficient / Entropy coefficient": "entropy_weight",
}
"""What of skrl's figures is kept, and its name in `progress.csv`."""
REPLAYING = (SAC, DAgger)
"""Agents whose memory is part of a checkpoint."""
CRITICS = ("critic_1", "critic_2", "target_critic_1", "target_critic_2")
SCALER_CLIP, SCALER_EPSILON = 5.0, 1e-8  # of normalised observations; of their standard deviation
SCALER = {"clip_threshold": SCALER_CLIP, "epsilon": SCALER_EPSILON}
QUIET = {"write_interval": 0, "checkpoint_interval": 0}  # skrl writes no files: we do


class TrackedSAC(SAC):
    """SAC that keeps its losses; skrl's does so only where it also writes them."""

    def update(self, *, timestep: int, timesteps: int) -> None:
        """Do the gradient steps of one control step."""
        self.write_interval = 1
        try:
            super().update(timestep=timestep, timesteps=timesteps)
        finally:
            self.write_interval = 0


def make_agent(settings: Settings, observation: Any, action: Any, device: str) -> Agent:
    """Return an agent that is ready to train; torch's generator draws its first weights."""
    spaces = {"observation_space": observation, "action_space": action}
    shape = spaces, device, settings.hidden, settings.activation
    models: dict[str, Any]
    if isinstance(settings, Gaussian):
        drawn = settings.initial_std, settings.initial_mean, settings.mean_bound
        models = {"policy": GaussianPolicy(*shape, *drawn)}
    else:
        models = {"policy": SquashedPolicy(*shape)}
    if isinstance(settings, OnPolicy):
        models["value"] = Value(*shape)
    if isinstance(settings, OffPolicy):
        models |= {name: _critic(settings, spaces, device) for name in CRITICS}
    rows, replays = settings.rollout_steps, isinstance(settings, Replaying)
    if isinstance(settings, Replaying):
        rows = settings.replay // settings.num_worlds
    memory = RandomMemory(memory_size=rows, num_envs=settings.num_worlds, device=device, replacement=replays)
    kind, cfg = _configuration(settings, observation, action, device)
    if config.torch.is_distributed:
        average_together(**models)
    agent = kind(models=models, memory=memory, cfg=cfg, device=device, **spaces)
    agent.init()
    agent.enable_training_mode(True)
    return agent


def replay_bytes(settings: Settings, num_obs: int, num_actions: int) -> int:
    """Return what the replay of a run takes, in memory and in a checkpoint [B]; 0 without one."""
    if not isinstance(settings, Replaying):
        return 0
    once = num_obs + num_actions
    return 4 * settings.replay * (once if isinstance(settings, DAggerSettings) else once + num_obs + 2)


def average_together(policy: Model, value: Model) -> None:
    """Let ranks average the gradients of both networks in one message; skrl sends one for each."""
    parameters = [*policy.parameters(), *value.parameters()]

    def average() -> None:
        gradients = torch.cat([p.grad.view(-1) for p in parameters])
        distributed.all_reduce(gradients)
        gradients /= distributed.get_world_size()
        for parameter, mean in zip(parameters, gradients.split([p.numel() for p in parameters]), strict=True):
            parameter.grad.copy_(mean.view_as(parameter))

    policy.reduce_parameters, value.reduce_parameters = average, lambda: None


def _critic(settings: OffPolicy, spaces: dict[str, Any], device: str) -> Model:
    """Return a critic of actions."""
    if isinstance(settings, FlashSACSettings):
        sizes = settings.critic_width, settings.critic_blocks, settings.atoms
        return CategoricalCritic(spaces, device, *sizes)
    return Value(spaces, device, settings.hidden, settings.activation, of_actions=True)


def _configuration(
    settings: Settings, observation: Any, action: Any, device: str
) -> tuple[Callable[..., Agent], Any]:
    """Return skrl's class and configuration."""
    common: dict[str, Any] = {
        "discount_factor": settings.discount,
        "learning_rate": settings.learning_rate,
        "observation_preprocessor": MergedScaler,
        "observation_preprocessor_kwargs": {"size": observation, "device": device, **SCALER},
        "experiment": QUIET,
    }
    if isinstance(settings, OffPolicy):
        common |= dict(
            batch_size=settings.batch_size,
            gradient_steps=settings.gradient_steps,
            polyak=settings.target_rate,
            random_timesteps=settings.random_steps,
            learning_starts=max(settings.random_steps, math.ceil(settings.batch_size / settings.num_worlds)),
            initial_entropy_value=settings.temperature,
            target_entropy=settings.target_entropy * action.shape[0],
        )
        if isinstance(settings, FlashSACSettings):
            own = {name: getattr(settings, name) for name in ("num_worlds", "policy_every", "precision")}
            return partial(FlashSAC, **own), SAC_CFG(**common)
        assert isinstance(settings, SACSettings)
        scale = settings.reward_scale
        return TrackedSAC, SAC_CFG(**common, rewards_shaper=lambda rewards, *_: rewards * scale)
    if isinstance(settings, DAggerSettings):
        return partial(DAgger, settings=settings), DAGGER_CFG(**common)
    assert isinstance(settings, OnPolicy)
    common |= {
        "rollouts": settings.rollout_steps,
        "learning_epochs": settings.epochs,
        "mini_batches": settings.minibatches,
        "gae_lambda": settings.trace_decay,
        "grad_norm_clip": settings.gradient_norm,
        "value_preprocessor": MergedScaler,
        "value_preprocessor_kwargs": {"size": 1, "device": device},
        "time_limit_bootstrap": True,  # else advantages leak from one episode into the one before
    }
    if isinstance(settings, TRPOSettings):
        return TRPO, TRPO_CFG(
            **common,
            max_kl_divergence=settings.max_kl,
            damping=settings.damping,
            conjugate_gradient_steps=settings.conjugate_steps,
        )
    assert isinstance(settings, PPOSettings)
    adaptive = {"kl_threshold": settings.kl, "min_lr": settings.least_rate, "max_lr": settings.largest_rate}
    return PPO, PPO_CFG(
        **common,
        ratio_clip=settings.clip,
        value_clip=settings.value_clip,
        entropy_loss_scale=settings.entropy,
        value_loss_scale=settings.value_loss,
        learning_rate_scheduler=KLAdaptiveLR if settings.kl else None,
        learning_rate_scheduler_kwargs=adaptive if settings.kl else {},
    )


def policy_form(settings: Settings) -> dict[str, Any]:
    """Return what the arrays of a policy leave open, for `myowarp.apps.policies.learned`."""
    bounds, bound = LOG_STD, "tanh"
    if isinstance(settings, Gaussian):
        bounds, bound = GAUSSIAN_LOG_STD, settings.mean_bound
    return {
        "mean_bound": bound,
        "activation": settings.activation,
        "clip": SCALER_CLIP,
        "epsilon": SCALER_EPSILON,
        "log_std_bounds": list(bounds),
    }


def losses(agent: Agent) -> dict[str, float]:
    """Return what the last updates tracked under the names of `TRACKED`."""
    tracked = {
        TRACKED[tag]: float(np.mean(agent.tracking_data[tag]))
        for tag in TRACKED
        if tag in agent.tracking_data
    }
    agent.tracking_data.clear()
    return tracked


def is_finite(agent: Agent) -> bool:
    """Return whether every weight is finite."""
    total = sum(p.detach().sum() for model in agent.models.values() for p in model.parameters())
    return bool(torch.isfinite(torch.as_tensor(total)))


def policy_arrays(agent: Agent) -> Arrays:
    """Return what acts: the policy's weights and the normaliser of observations."""
    scaler = agent.checkpoint_modules["observation_preprocessor"]
    tensors = dict(agent.policy.state_dict())
    tensors |= {"observation_mean": scaler.running_mean, "observation_variance": scaler.running_variance}
    return {name: _array(tensor) for name, tensor in tensors.items()}


def learner_arrays(agent: Agent) -> Arrays:
    """Return everything else that the next update depends on.

    The samples of PPO and TRPO are not among it: a checkpoint is written between two iterations, and the next
    one overwrites them all.
    """
    tensors: dict[str, torch.Tensor] = {"torch_generator": torch.get_rng_state()}
    if torch.device(agent.device).type == "cuda":
        tensors["cuda_generator"] = torch.cuda.get_rng_state(agent.device)
    for name, module in _modules(agent).items():
        tensors |= {f"{name}.{key}": value for key, value in module.state_dict().items()}
    for name, optimizer in _optimizers(agent).items():
        state = optimizer.state_dict()
        tensors[f"{name}.rate"] = torch.tensor([g["lr"] for g in state["param_groups"]], dtype=torch.float64)
        for index, entries in state["state"].items():
            tensors |= {f"{name}.{index}.{key}": value for key, value in entries.items()}
    if isinstance(agent, SAC):
        tensors["log_entropy_coefficient"] = agent.log_entropy_coefficient.detach()
    if isinstance(agent, REPLAYING):
        memory = agent.memory
        rows = memory.memory_size if memory.filled else memory.memory_index
        tensors["memory_index"] = torch.tensor([memory.memory_index, int(memory.filled)])
        tensors |= {f"memory.{name}": tensor[:rows] for name, tensor in memory.tensors.items()}
    return {name: _array(tensor) for name, tensor in tensors.items()}


def restore_agent(agent: Agent, policy: Mapping[str, np.ndarray], learner: Mapping[str, np.ndarray]) -> None:
    """Put an agent's numbers back; torch's generators too.

    Raises:
        KeyError: An array is missing.
        RuntimeError: An array has another shape.
    """
    agent.policy.load_state_dict({k: _tensor(policy[k]) for k in agent.policy.state_dict()})
    for name, module in _modules(agent).items():
        module.load_state_dict({k: _tensor(learner[f"{name}.{k}"]) for k in module.state_dict()})
    for name, optimizer in _optimizers(agent).items():
        _restore_optimizer(optimizer, f"{name}.", learner)
    if isinstance(agent, SAC):
        with torch.no_grad():
            agent.log_entropy_coefficient.copy_(_tensor(learner["log_entropy_coefficient"]))
        set_temperature(agent, torch.exp(agent.log_entropy_coefficient.detach()))
    if isinstance(agent, REPLAYING):
        memory = agent.memory
        memory.memory_index, memory.filled = (int(n) for n in learner["memory_index"])
        memory.filled = bool(memory.filled)
        for name, tensor in memory.tensors.items():
            rows = _tensor(learner[f"memory.{name}"])
            tensor[: len(rows)].copy_(rows)
    torch.set_rng_state(_tensor(learner["torch_generator"]))
    if "cuda_generator" in learner:
        torch.cuda.set_rng_state(_tensor(learner["cuda_generator"]), agent.device)


def inherit(agent: Agent, parent: Mapping[str, np.ndarray], samples: int, count: int) -> None:
    """Start from the policy of another run, with a spread and a value function of this one.

    Args:
        agent: Agent with networks of the same sizes.
        parent: Arrays of that policy.
        samples: Samples that its normaliser of observations has seen.
        count: Samples as which they count here, few enough for the new task's to outweigh them soon.
    """
    own = agent.policy.state_dict()
    agent.policy.load_state_dict({k: v if k == "log_std" else _tensor(parent[k]) for k, v in own.items()})
    mean, variance = parent["observation_mean"], parent["observation_variance"]
    # A column that never changed, such as a fixed goal, has weights that nothing trained, and no more
    # variance than skrl's normaliser starts with: that of one sample beside the mean 0.
    unseen = variance * samples < 1.01 * (1.0 + mean * mean)
    with torch.no_grad():
        agent.policy.net[0].weight[:, torch.from_numpy(unseen)] = 0.0
    scaler = agent.checkpoint_modules["observation_preprocessor"]
    scaler.running_mean.copy_(_tensor(mean))
    scaler.running_variance.copy_(_tensor(variance))
    scaler.current_count.fill_(count)


def _restore_optimizer(
    optimizer: torch.optim.Optimizer, prefix: str, learner: Mapping[str, np.ndarray]
) -> None:
    """Put an optimiser's moments, counts and rates back."""
    state = optimizer.state_dict()
    for group, rate in zip(state["param_groups"], learner[f"{prefix}rate"].tolist(), strict=True):
        group["lr"] = rate
    entries: dict[int, dict[str, torch.Tensor]] = {}
    for name, array in learner.items():
        index, _, key = name.removeprefix(prefix).partition(".")
        if name.startswith(prefix) and key:
            entries.setdefault(int(index), {})[key] = _tensor(array)
    optimizer.load_state_dict({"state": entries, "param_groups": state["param_groups"]})


def _modules(agent: Agent) -> dict[str, torch.nn.Module]:
    """Return networks and normalisers by name, without the policy."""
    modules = agent.checkpoint_modules.items()
    return {n: m for n, m in modules if isinstance(m, torch.nn.Module) and n != "policy"}


def _optimizers(agent: Agent) -> dict[str, torch.optim.Optimizer]:
    """Return optimisers by name."""
    return {n: m for n, m in agent.checkpoint_modules.items() if isinstance(m, torch.optim.Optimizer)}


def _array(tensor: torch.Tensor) -> np.ndarray:
    """Return a copy on the host."""
    return tensor.detach().cpu().numpy().copy()


def _tensor(array: np.ndarray) -> torch.Tensor:
    """Return a tensor that owns its memory."""
    return torch.from_numpy(np.array(array))
