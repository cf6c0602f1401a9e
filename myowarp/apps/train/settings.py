"""Settings of a training run, the presets of tasks, and checks before anything is built.

A setting is an `option`: default, help, bounds. The command line, the presets (`presets/<task>.toml`), the
checks and the manifest of a checkpoint all follow from it. The defaults are settings B of a plain PPO on the
hand, with updates that the measurements of `presets/` made cheaper.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, ClassVar

from myowarp.apps.policies.form import ACTIVATIONS, MEAN_BOUNDS
from myowarp.apps.reports.evaluation import SUCCESSES
from myowarp.apps.train import bonus
from myowarp.definitions.option import checked, flag, option, options_of, other
from myowarp.definitions.registry import check_choice
from myowarp.definitions.setup import OPTIONS, Setup

MOST_UNROLLED = 8  # 0.2 s and more; all steps of a rollout take twice the time of a small run
PRECISIONS = ("auto", "bfloat16", "float32")
NOISES = ("white", "repeated")
TRAINING = Setup(physics="fast", muscle="mujoco", seed=0)  # unless the preset of a task says otherwise


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of every algorithm."""

    algorithm: ClassVar[str]

    samples: int = option(3_000_000, "Control steps to train for, all worlds together.", least=1, free=True)
    stop_success: float = option(
        0.995, "Share of success that ends the training; above 1: none.", least=0.0, free=True
    )
    stop_rule: str = option(
        "success",
        "What counts as success: success (over 5 solved steps, no failure), success_last or success_any"
        " (solved on the last step, on any).",
        choices=SUCCESSES,
    )
    selections: int = option(
        20,
        "How often in a run the average policy is evaluated, with mean actions under parity; the best one is"
        " kept. 0: never; the last policy is kept, and the stop rule counts the last 256 episodes.",
        least=0,
    )
    parity_after: int = option(0, "Samples after which physics becomes parity; 0: it never does.", least=0)
    num_worlds: int = option(256, "Worlds simulated together.", least=1)
    rollout_steps: int = option(24, "Control steps of every world in an iteration.", least=1)
    bonus: tuple[str, ...] = option(
        (),
        "Terms added to the reward in training alone: solved, success, precision (reach), one of the task.",
        "[NAME=WEIGHT ...]",
    )
    cohort: str = option("", "Patient table that divides the worlds; empty: one body for all.")
    start: str = option(
        "", "State file (`State.save`) from which episodes start, with its goals; empty: the task resets."
    )
    start_share: float = option(
        0.0, "Share of episodes that start within an earlier success.", least=0.0, most=1.0
    )
    parent: str = option("", "Policy to start from: a run's folder or baselines/<id>; empty: none.")
    parent_samples: int = option(
        0,
        "Samples that the parent's observation normaliser counts for; 0: all that it has seen in the same"
        " task, 32 steps of all worlds in another task.",
        least=0,
    )
    # On two idle cores, two threads take 3.5 us a sample and pass (two networks 2 x 128), one 5.9.
    # When another process wants a core they take 10 to 60 times as long: they wait at every barrier.
    threads: int = option(
        1, "Torch's threads on the CPU; several help on idle cores only.", least=1, most=1024
    )
    precision: str = option(
        "auto", "Numbers of matrix products; auto: bfloat16 where fast.", choices=PRECISIONS
    )
    discount: float = option(0.97, "Discount of rewards for each control step.", least=0.0, most=1.0)
    hidden: tuple[int, ...] = option((128, 128), "Widths of the hidden layers.", least=1, most=16384)
    activation: str = option("elu", "Function between the layers.", choices=ACTIVATIONS)
    last_rate: float = option(0.5, "Share of the first rates left at the end.", least=0.0, most=1.0)
    average: float = option(0.9, "Weight of the past in the average policy.", least=0.0, most=0.9999)


@dataclass(frozen=True, kw_only=True)
class Gaussian(Settings):
    """Settings of PPO, TRPO, DAgger and improve: one spread for all states."""

    initial_std: float = option(0.5, "Standard deviation of actions at the start.", least=1e-3)
    initial_mean: float = option(0.0, "Mean of actions at the start.", least=-0.99, most=0.99)
    mean_bound: str = option("tanh", "Bound of mean actions.", choices=MEAN_BOUNDS)


@dataclass(frozen=True, kw_only=True)
class OnPolicy(Gaussian):
    """Settings of PPO and TRPO."""

    num_worlds: int = other(Settings, "num_worlds", 512)
    trace_decay: float = option(0.95, "Lambda of generalised advantage estimation.", least=0.0, most=1.0)
    epochs: int = option(5, "Passes over the samples in an update.", least=1)
    minibatches: int = option(4, "Parts of a pass.", least=1)
    value_rate: float = option(1e-3, "Learning rate of the value function at the start.", least=0.0)
    value_first: int = option(0, "Iterations in which the value function first learns alone.", least=0)
    noise: str = option("white", "Noise of actions; repeated: for up to 16 steps.", choices=NOISES)
    gradient_norm: float = option(1.0, "Norm to which gradients are clipped; 0: not at all.", least=0.0)


@dataclass(frozen=True, kw_only=True)
class PPOSettings(OnPolicy):
    """Proximal policy optimisation."""

    algorithm = "ppo"
    clip: float = option(0.2, "Clip of the ratio of probabilities.", least=0.0)
    kl: float = option(0.0, "KL divergence of each action that sets the rate; 0: none does.", least=0.0)
    least_rate: float = option(1e-5, "Smallest learning rate under --kl.", least=0.0)
    largest_rate: float = option(1e-2, "Largest learning rate under --kl.", least=0.0)
    memory: int = option(0, "Units of a GRU, the policy's memory; 0: none.", least=0, most=4096)
    spread_rate: float = option(1e-3, "Learning rate of the spread of actions at the start.", least=0.0)
    entropy: float = option(0.0, "Weight of the entropy.", least=0.0)
    learning_rate: float = option(1e-3, "Learning rate of Adam at the start.", least=0.0)
    last_rate: float = other(Settings, "last_rate", 0.1)

    @property
    def unrolled(self) -> int:
        """Control steps that gradients of a memory go through, a divisor of the rollout's; 1 without one."""
        most = min(MOST_UNROLLED, self.rollout_steps) if self.memory else 1
        return next(steps for steps in range(most, 0, -1) if self.rollout_steps % steps == 0)


@dataclass(frozen=True, kw_only=True)
class TRPOSettings(OnPolicy):
    """Trust region policy optimisation, a natural gradient with a line search."""

    algorithm = "trpo"
    max_kl: float = option(0.02, "Largest KL divergence of an update.", least=1e-9)
    damping: float = option(0.1, "Damping of the Fisher matrix.", least=0.0)
    conjugate_steps: int = option(10, "Steps of the conjugate gradient.", least=1)


@dataclass(frozen=True, kw_only=True)
class Replaying(Settings):
    """Settings of SAC, DAgger and improve: a memory of samples."""

    learning_rate: float = option(3e-4, "Learning rate of Adam at the start.", least=0.0)
    batch_size: int = option(512, "Samples of a gradient step.", least=1)
    gradient_steps: int = option(8, "Gradient steps after each control step of the worlds.", least=1)
    replay: int = option(1_048_576, "Samples in the replay memory; a checkpoint holds them.", least=1)


@dataclass(frozen=True, kw_only=True)
class SACSettings(Replaying):
    """Soft actor-critic with categorical critics and repeated noise."""

    algorithm = "sac"
    num_worlds: int = other(Settings, "num_worlds", 64)
    random_steps: int = option(160, "Control steps of every world with random actions.", least=0)
    target_rate: float = option(0.01, "Rate at which target networks follow.", least=0.0, most=1.0)
    temperature: float = option(0.01, "Weight of the entropy at the start; it is learned.", least=1e-9)
    target_entropy: float = option(-0.5, "Entropy of each action that the weight is learned for.")
    critic_width: int = option(128, "Width of the critics' residual blocks.", least=1)
    critic_blocks: int = option(2, "Residual blocks of a critic.", least=1)
    atoms: int = option(101, "Values whose probabilities a critic learns.", least=2)
    policy_every: int = option(2, "Gradient steps of the critics for one of the policy.", least=1)


@dataclass(frozen=True, kw_only=True)
class DAggerSettings(Gaussian, Replaying):
    """Imitation of an expert in the states that the policy itself leads to."""

    algorithm = "dagger"
    expert: str = option("muscle-control", "Policy that is imitated, by its name as in `rollout --policy`.")
    expert_steps: int = option(100, "Control steps of every world in which the expert acts first.", least=1)
    initial_std: float = other(
        Gaussian, "initial_std", 0.1, "Noise of actions; worlds in turn have none, half or all of it."
    )
    learning_rate: float = other(Replaying, "learning_rate", 5e-4)
    gradient_steps: int = other(Replaying, "gradient_steps", 16)
    replay: int = other(Replaying, "replay", 262_144)


@dataclass(frozen=True, kw_only=True)
class ImproveSettings(Gaussian, Replaying):
    """A search by particles around a policy, and imitation of what succeeded."""

    algorithm = "improve"
    expert: str = option("", "Policy around which is searched; empty: the parent, as it improves.")
    copies: int = option(32, "Worlds that begin in the same state.", least=2)
    keep: int = option(2, "Copies of a state that are copied over the others.", least=1)
    every: int = option(10, "Control steps from one copying to the next.", least=1)
    num_worlds: int = other(Settings, "num_worlds", 1024, "Worlds together, a multiple of --copies.")
    initial_std: float = other(
        Gaussian, "initial_std", 0.8, "Standard deviation of the noise, before the tanh."
    )
    learning_rate: float = other(Replaying, "learning_rate", 1e-4)
    gradient_steps: int = other(Replaying, "gradient_steps", 500, "Gradient steps after each search.")
    average: float = other(Settings, "average", 0.5)


KINDS: tuple[type[Settings], ...]
KINDS = PPOSettings, TRPOSettings, SACSettings, DAggerSettings, ImproveSettings
ALGORITHMS = {kind.algorithm: kind for kind in KINDS}
RENAMED = {"flashsac": "sac"}


def all_settings() -> dict[str, dataclasses.Field[Any]]:
    """Return the settings of all algorithms by name, each as the first one that has it says it."""
    return {name: own for kind in reversed(ALGORITHMS.values()) for name, own in options_of(kind).items()}


def preset(name: str, algorithm: str) -> dict[str, Any]:
    """Return what the preset of a task, named without version, changes for an algorithm; maybe nothing."""
    table = _preset_table(name)
    said = (table | table.get(algorithm, {})).items()
    return {key: value for key, value in said if key != "algorithm" and not isinstance(value, dict)}


def divided(values: Mapping[str, Any]) -> tuple[Setup, dict[str, Any]]:
    """Return the setup and the settings of plain values, which presets and checkpoints have side by side."""
    return Setup.from_plain(values), {name: value for name, value in values.items() if name not in OPTIONS}


def preset_algorithm(name: str) -> str:
    """Return the algorithm of a task's preset, ppo where it names none."""
    return str(_preset_table(name).get("algorithm", "ppo"))


def _preset_table(name: str) -> dict[str, Any]:
    """Return a task's preset as it stands in its file."""
    file = resources.files(__package__) / "presets" / f"{name}.toml"
    return tomllib.loads(file.read_text()) if file.is_file() else {}


def choose(name: str, algorithm: str, given: Mapping[str, Any]) -> Settings:
    """Return settings: the defaults, a task's preset over them, and over both what is given, as `restore`."""
    if algorithm in RENAMED:
        raise ValueError(f"algorithm {algorithm!r} is called {RENAMED[algorithm]} now")
    check_choice("algorithm", algorithm, ALGORITHMS)
    return restore(ALGORITHMS[algorithm], divided(preset(name, algorithm))[1] | dict(given))


def restore(kind: type[Settings], values: Mapping[str, Any]) -> Settings:
    """Return settings from plain values, checked.

    Raises:
        ValueError: A setting does not belong to the algorithm, is out of its range or does not fit to others.
    """
    known = options_of(kind)
    for name in (name for name in values if name not in known):
        owners = " and ".join(owner for owner, own in ALGORITHMS.items() if name in options_of(own))
        there = f"it belongs to {owners}" if owners else f"available: {', '.join(sorted(known))}"
        raise ValueError(f"{kind.algorithm} has no setting {flag(name)}; {there}")
    settings = kind(**{name: checked(known[name], value, flag(name)) for name, value in values.items()})
    bonus.weights(settings.bonus)
    for right, name, wanted in _rules(settings):
        if not right:
            raise ValueError(f"{flag(name)} must {wanted}, got {getattr(settings, name)}")
    if isinstance(settings, ImproveSettings) and not settings.parent and not settings.expert:
        raise ValueError("improve needs a policy to search around; name it with --parent or --expert")
    return settings


def _rules(of: Settings) -> Iterator[tuple[bool, str, str]]:
    """Yield how settings have to fit together: whether they do, which one is wrong else, what it must."""
    iteration = of.num_worlds * of.rollout_steps
    product = f"{of.num_worlds} worlds x {of.rollout_steps} steps = {iteration}"
    yield of.samples >= iteration, "samples", f"be at least one iteration, {product}"
    if isinstance(of, OnPolicy):
        yield iteration % of.minibatches == 0, "minibatches", f"divide the samples of an iteration, {product}"
    if isinstance(of, PPOSettings):
        sequences = iteration // of.unrolled
        right = sequences % of.minibatches == 0
        yield right, "minibatches", f"divide the {sequences} sequences of {of.unrolled} steps of an iteration"
        right = of.least_rate <= of.largest_rate
        yield right, "least_rate", f"be at most --largest-rate, {of.largest_rate}"
    if isinstance(of, ImproveSettings):
        yield of.num_worlds % of.copies == 0, "num_worlds", f"be a multiple of the {of.copies} --copies"
        yield of.keep <= of.copies, "keep", f"be at most --copies, {of.copies}"
    elif isinstance(of, Replaying):
        yield of.replay % of.num_worlds == 0, "replay", f"be a multiple of the {of.num_worlds} worlds"
        yield of.batch_size <= of.replay, "batch_size", f"be at most --replay, {of.replay} samples"
