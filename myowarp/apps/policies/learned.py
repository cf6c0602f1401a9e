"""A trained policy from a checkpoint, in NumPy: playing one needs no torch.

    x = clip((obs - mean) / (sqrt(variance) + eps), -c, c)
    h = GRU(x, h), x = (x, h)                where a policy remembers its episode (`--memory`)
    x = f(W x + b)  for every hidden layer
    a = clip(W x + b, -1, 1), or its tanh    one standard deviation for all states (PPO, TRPO)
    a = tanh(first half of W x + b)          the second half is its logarithm (SAC)

The forward pass equals torch's to 1e-6 (tests/lab/test_train_policy.py).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from myowarp.apps.policies.checkpoint import (
    Checkpoint,
    CheckpointError,
    check_contract,
    check_task,
    load_checkpoint,
)
from myowarp.definitions.senses import PARAMETERS, SENSES, Told
from myowarp.definitions.setup import Setup
from myowarp.definitions.task import TaskSpec
from myowarp.sim.simulation import Simulation

ACTIVATIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}


Act = Callable[[np.ndarray], np.ndarray]
"""Observations (num_worlds, obs_size) to actions (num_worlds, num_actions) in [-1, 1]."""


MEMORY = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
"""Arrays of a gated recurrent unit behind `memory.`, as torch has them: rows of reset, update, new."""


def begins(sim: Simulation) -> np.ndarray:
    """Return which worlds stand where an episode begins, (num_worlds,) bool."""
    return np.equal(sim.episode.step_count.numpy(), 0)


class Parameters:
    """The parameters of the conditions of a simulation, whether its worlds observe them or not."""

    def __init__(self, sim: Simulation) -> None:
        """Arrange them."""
        self._shards = [Told(shard.scene, shard.clock) for shard in sim.shards]

    def __call__(self) -> np.ndarray:
        """Return what they are now, as `--observe parameters` has it, shape (num_worlds, num_parameters)."""
        return np.concatenate([shard.now() for shard in self._shards])


class LearnedPolicy:
    """Observations (rows, obs_size) to actions (rows, num_actions) in [-1, 1].

    Attributes:
        checkpoint: What it was read from.
        mean: Mean that observations are normalised with, shape (obs_size,).
        spread: Their standard deviation, shape (obs_size,).
        clip: Bound of normalised observations.
        layers: Weights (inputs, outputs) and biases (outputs,).
        activation: Function between the layers, key in `ACTIVATIONS`.
        squashed: Whether actions without noise are the hyperbolic tangent of the last layer, else its clip.
        num_actions: Entries of an action, the first ones of the last layer.
        memory: Arrays of `MEMORY`, weights as (inputs, outputs); empty: it remembers nothing.
        num_remembered: Numbers that are remembered of a row.
    """

    def __init__(self, checkpoint: Checkpoint, sampled: Setup | None = None) -> None:
        """Arrange the arrays.

        Args:
            checkpoint: What `load_checkpoint` returns.
            sampled: With whose seed actions are drawn, as in training; each of its ranks draws for the worlds
                of all, and takes its own. None: actions are the means.
        """
        self.checkpoint, arrays, form = checkpoint, checkpoint.policy, checkpoint.manifest["policy"]
        numbers = sorted({int(name.split(".")[1]) for name in arrays if name.startswith("net.")})
        self.layers = [(arrays[f"net.{i}.weight"].T.copy(), arrays[f"net.{i}.bias"]) for i in numbers]
        self.mean = arrays["observation_mean"].astype(np.float32)
        self.spread = np.sqrt(arrays["observation_variance"].astype(np.float32)) + np.float32(form["epsilon"])
        self.clip, self.activation = form["clip"], form["activation"]
        of_state = "log_std" not in arrays  # the spread, which then is the second half of the last layer
        self.squashed = of_state or form.get("mean_bound") == "tanh"
        self.num_actions = len(self.layers[-1][1]) // (2 if of_state else 1)
        self.memory = [arrays[f"memory.{name}"].T for name in MEMORY if f"memory.{name}" in arrays]
        self.num_remembered = len(self.memory[1]) if self.memory else 0
        self._remembered = np.zeros((0, self.num_remembered), dtype=np.float32)
        self._log_std, self._bounds = arrays.get("log_std"), form["log_std_bounds"]
        self._rank = (sampled.rank if sampled else None) or (0, 1)
        self._rng = np.random.default_rng(sampled.seed) if sampled else None

    @property
    def obs_size(self) -> int:
        """Entries of an observation."""
        return len(self.mean)

    def __call__(self, obs: np.ndarray, begins: np.ndarray | None = None) -> np.ndarray:
        """Return actions.

        Args:
            obs: What is observed.
            begins: Rows that forget, (rows,) bool; None: none. All begin where their number has changed.
        """
        x = np.clip((obs - self.mean) / self.spread, -self.clip, self.clip)
        if self.memory:
            if len(self._remembered) != len(x):
                self._remembered = np.zeros((len(x), self.num_remembered), dtype=np.float32)
            if begins is not None:
                self._remembered[begins] = 0.0
            self._remembered = self._after(x, self._remembered)
            x = np.concatenate((x, self._remembered), axis=1)
        function = ACTIVATIONS[self.activation]
        for weight, bias in self.layers[:-1]:
            x = function(x @ weight + bias)
        weight, bias = self.layers[-1]
        x = x @ weight + bias
        if self._log_std is not None:
            mean = np.tanh(x) if self.squashed else x
            return np.clip(self._drawn(mean, self._log_std), -1.0, 1.0).astype(np.float32)
        mean, log_std = np.split(x, 2, axis=1)
        return np.tanh(self._drawn(mean, log_std)).astype(np.float32)

    def copy(self, source: int, target: int) -> None:
        """Let a row remember what another one does."""
        if len(self._remembered):
            self._remembered[target] = self._remembered[source]

    def _after(self, x: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Return the memory after a step, as of `myowarp.apps.train.recurrent`."""
        of_x, of_memory, x_bias, memory_bias = self.memory
        reset, update, new = np.split(x @ of_x + x_bias, 3, axis=1)
        more_reset, more_update, more_new = np.split(memory @ of_memory + memory_bias, 3, axis=1)
        new = np.tanh(new + _sigmoid(reset + more_reset) * more_new)
        return (new + _sigmoid(update + more_update) * (memory - new)).astype(np.float32)

    def _drawn(self, mean: np.ndarray, log_std: np.ndarray) -> np.ndarray:
        """Return a draw, or the mean of a deterministic policy."""
        if self._rng is None:
            return mean
        std = np.exp(np.clip(log_std, *self._bounds))
        (rank, size), (rows, columns) = self._rank, mean.shape
        drawn = self._rng.standard_normal((size, rows, columns), dtype=np.float32)[rank]
        return mean + std * drawn


def _sigmoid(x: np.ndarray) -> np.ndarray:
    """Return 1 / (1 + exp(-x)), which overflows nowhere."""
    return 0.5 * (1.0 + np.tanh(0.5 * x))


def read_policy(name: str, folder: Path, spec: TaskSpec) -> Checkpoint:
    """Return the checkpoint of a folder, checked as far as a task alone can tell.

    Args:
        name: How the user called it.
        folder: Where it is.
        spec: The task in which it is to act.

    Raises:
        CheckpointError: There is none, it is damaged, or it belongs to another family, body or observation.
    """
    checkpoint = load_checkpoint(folder)
    contract = checkpoint.manifest["contract"]
    there = f"{contract['task']!r} ({contract['family']} with {contract['body']})"
    if (contract["family"], contract["body"]) != (spec.family, spec.body):
        raise CheckpointError(
            f"policy {name!r} was trained in {there} and cannot act in {spec.key!r} "
            f"({spec.family} with {spec.body})"
        )
    check_task(checkpoint, spec)
    return checkpoint


class Bound:
    """A learned policy in a simulation: observations (num_worlds, obs_size) to actions.

    Of the senses it sees its own, whatever else the worlds observe; parameters it is told in any case.
    """

    def __init__(self, checkpoint: Checkpoint, sim: Simulation, sampled: Setup | None = None) -> None:
        """Arrange what it sees; `sampled` as in `LearnedPolicy`.

        Raises:
            CheckpointError: Observations or actuators are other ones.
        """
        check_contract(checkpoint, sim)
        self._learned, self._sim = LearnedPolicy(checkpoint, sampled), sim
        own = [name for name, *_ in checkpoint.manifest["contract"]["columns"] if name in SENSES]
        others = sum(column.size for column in sim.columns if column.name not in SENSES)
        same = own == [column.name for column in sim.columns if column.name in SENSES]
        self._blocks = [slice(None)] if same else [slice(others), *(sim.blocks.get(name) for name in own)]
        self._told = Parameters(sim) if PARAMETERS in own and PARAMETERS not in sim.blocks else None

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return actions, shape (num_worlds, num_actions)."""
        told = self._told() if self._told else obs[:, :0]
        seen = [told if block is None else obs[:, block] for block in self._blocks]
        obs = np.concatenate(seen, axis=1) if len(seen) > 1 else seen[0]
        return self._learned(obs, begins(self._sim) if self._learned.memory else None)

    def copy(self, source: int, target: int) -> None:
        """Let a world remember what another one does."""
        self._learned.copy(source, target)
