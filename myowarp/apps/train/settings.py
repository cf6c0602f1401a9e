"""What a training run can be told, the presets of tasks, and what is refused before anything is built.

A setting is one line: type, default, help, bounds. The command line, the presets (`presets/<task>.toml`), the
checks and the manifest of a checkpoint all follow from these lines. The defaults are settings B of a plain
PPO on the hand, with updates that the measurements of `presets/` made cheaper.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, TypeVar

from myowarp.apps.policies.form import ACTIVATIONS, MEAN_BOUNDS
from myowarp.apps.train import bonus
from myowarp.definitions.registry import check_choice
from myowarp.definitions.setup import OPTIONS, Setup

SUCCESSES = {
    "success": "more than 5 solved steps, no failure",
    "success_last": "solved on the last step",
    "success_any": "solved at any step",
}
PRECISIONS = ("auto", "bfloat16", "float32")
NOISES = ("white", "repeated")
TRAINING = Setup(physics="fast", muscle="mujoco", seed=0)  # unless the preset of a task says otherwise


def success_text(figures: Mapping[str, Any], rule: str) -> str:
    """Return a success of an evaluation in percent, with its interval unless all episodes are one."""
    if rule not in figures:  # of an evaluation of before
        return "-"
    if figures["one_episode"]:
        return f"{100 * figures[rule]:.0f} % (one episode)"
    low, high = figures["intervals"][rule]
    return f"{100 * figures[rule]:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def setting(
    default: Any,
    text: str,
    *,
    least: float | None = None,
    most: float | None = None,
    choices: Iterable[str] = (),
    items: type = int,
    free: bool = False,
) -> Any:
    """Return the field of a setting.

    Args:
        default: Its value without preset.
        text: Help, one line.
        least: Smallest value that is allowed.
        most: Largest value that is allowed.
        choices: Names that are allowed.
        items: Type of the entries of a tuple.
        free: Whether a run may be resumed with another value, because no number of the run depends on it.
    """
    bounds = {"least": least, "most": most, "choices": tuple(choices), "items": items}
    return field(default=default, metadata={"text": text, "free": free, **bounds})


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of every algorithm."""

    samples: int = setting(3_000_000, "Control steps of all worlds together.", least=1, free=True)
    stop_success: float = setting(
        0.995,
        "Stop when this share of the episodes of a selection succeeded; above 1: never.",
        least=0.0,
        free=True,
    )
    stop_rule: str = setting(
        "success",
        "What counts there: success (over 5 solved steps, no failure), success_last or success_any (solved).",
        choices=SUCCESSES,
    )
    selections: int = setting(
        20,
        "Evaluations of the average policy over the run, its means under parity, of which the best is kept;"
        " 0: none, the last policy is kept and the stop rule counts the last 256 episodes of the training.",
        least=0,
    )
    parity_after: int = setting(
        0, "Samples after which the run goes on under parity physics; 0: it stays with its own.", least=0
    )
    num_worlds: int = setting(256, "Worlds simulated together.", least=1)
    rollout_steps: int = setting(24, "Control steps of every world in an iteration.", least=1)
    bonus: tuple[str, ...] = setting(
        (),
        "Added to the training's reward alone, NAME=WEIGHT: solved, success, precision (of reach) or a term.",
        items=str,
    )
    cohort: str = setting("", "Patient table; every patient has as many worlds; empty: one body for all.")
    start: str = setting(
        "", "State file (`State.save`): episodes start in its worlds, with their goals; empty: resets."
    )
    start_share: float = setting(
        0.0,
        "Share of the episodes that start on the way of an earlier success, in its states, with its goal.",
        least=0.0,
        most=1.0,
    )
    parent: str = setting(
        "", "Policy that the training starts from: a run's folder or baselines/<id>; empty: none."
    )
    parent_samples: int = setting(
        0,
        "Weight of the parent's observation normaliser, in samples; 0: all that it has seen in the same"
        " task, 32 steps of all worlds in another one.",
        least=0,
    )
    # On two idle cores, two threads take 3.5 us a sample and pass (two networks 2 x 128), one 5.9.
    # When another process wants a core they take 10 to 60 times as long: they wait at every barrier.
    threads: int = setting(
        1, "Threads of torch on the CPU; more pay on idle cores alone.", least=1, most=1024
    )
    precision: str = setting(
        "auto",
        "Of products of matrices; auto: bfloat16 where the processor multiplies it, else float32.",
        choices=PRECISIONS,
    )
    discount: float = setting(
        0.97, "Discount of rewards from one control step to the next.", least=0.0, most=1.0
    )
    hidden: tuple[int, ...] = setting(
        (128, 128), "Widths of the hidden layers of policy and value function.", least=1, most=16384
    )
    activation: str = setting("elu", "Function between the layers.", choices=ACTIVATIONS)
    learning_rate: float = setting(3e-4, "Learning rate of Adam at the start.", least=0.0)
    last_rate: float = setting(
        0.5, "Share of all learning rates at the end; they fall along half a cosine.", least=0.0, most=1.0
    )
    average: float = setting(
        0.9, "Weight of what was before in the average of the policy, an iteration.", least=0.0, most=0.9999
    )


@dataclass(frozen=True, kw_only=True)
class Gaussian(Settings):
    """What PPO, TRPO and DAgger share: one spread for all states."""

    initial_std: float = setting(
        0.5, "Standard deviation of actions at the start, with a parent, too.", least=1e-3
    )
    initial_mean: float = setting(
        0.0, "Mean of actions at the start, without a parent; below 0: quiet.", least=-0.99, most=0.99
    )
    mean_bound: str = setting(
        "tanh",
        "What keeps the mean of actions from -1 to 1: tanh, or clip, behind which noise and gradient vanish.",
        choices=MEAN_BOUNDS,
    )


@dataclass(frozen=True, kw_only=True)
class OnPolicy(Gaussian):
    """What PPO and TRPO share."""

    num_worlds: int = setting(512, "Worlds simulated together.", least=1)
    trace_decay: float = setting(0.95, "Lambda of generalised advantage estimation.", least=0.0, most=1.0)
    epochs: int = setting(5, "Passes over the samples in an update.", least=1)
    minibatches: int = setting(4, "Parts of a pass.", least=1)
    value_rate: float = setting(1e-3, "Learning rate of the value function at the start.", least=0.0)
    value_first: int = setting(
        0, "Iterations at the start in which the value function alone learns, with a parent.", least=0
    )
    gradient_norm: float = setting(1.0, "Norm to which gradients are clipped; 0: not at all.", least=0.0)


@dataclass(frozen=True, kw_only=True)
class PPOSettings(OnPolicy):
    """Proximal policy optimisation."""

    clip: float = setting(0.2, "Clip of the ratio of probabilities.", least=0.0)
    kl: float = setting(
        0.0,
        "KL divergence an entry of the action that the policy's learning rate aims at, 3e-4 say; 0: no aim.",
        least=0.0,
    )
    least_rate: float = setting(1e-5, "Smallest learning rate with an aim.", least=0.0)
    largest_rate: float = setting(1e-2, "Largest learning rate with an aim.", least=0.0)
    spread_rate: float = setting(1e-3, "Learning rate of the spread of actions at the start.", least=0.0)
    noise: str = setting(
        "white", "Noise of actions: white, or repeated for up to 16 control steps.", choices=NOISES
    )
    entropy: float = setting(0.0, "Weight of the entropy.", least=0.0)
    learning_rate: float = setting(1e-3, "Learning rate of Adam at the start.", least=0.0)
    last_rate: float = setting(
        0.1, "Share of all learning rates at the end; they fall along half a cosine.", least=0.0, most=1.0
    )


@dataclass(frozen=True, kw_only=True)
class TRPOSettings(OnPolicy):
    """Trust region policy optimisation, a natural gradient with a line search."""

    max_kl: float = setting(0.02, "Largest KL divergence of an update.", least=1e-9)
    damping: float = setting(0.1, "Damping of the Fisher matrix.", least=0.0)
    conjugate_steps: int = setting(10, "Steps of the conjugate gradient.", least=1)


@dataclass(frozen=True, kw_only=True)
class Replaying(Settings):
    """What SAC and DAgger share: a memory of samples."""

    batch_size: int = setting(512, "Samples of a gradient step.", least=1)
    gradient_steps: int = setting(8, "Gradient steps after each control step of the worlds.", least=1)
    replay: int = setting(1_048_576, "Samples in the replay memory; a checkpoint holds them.", least=1)


@dataclass(frozen=True, kw_only=True)
class SACSettings(Replaying):
    """Soft actor-critic with categorical critics and repeated noise."""

    num_worlds: int = setting(64, "Worlds simulated together.", least=1)
    random_steps: int = setting(160, "Control steps of every world with random actions.", least=0)
    target_rate: float = setting(0.01, "Rate at which target networks follow.", least=0.0, most=1.0)
    temperature: float = setting(0.01, "Weight of the entropy at the start; it is learned.", least=1e-9)
    target_entropy: float = setting(-0.5, "Entropy that the weight aims at, for each action.")
    critic_width: int = setting(128, "Width of the critics' residual blocks.", least=1)
    critic_blocks: int = setting(2, "Residual blocks of a critic.", least=1)
    atoms: int = setting(101, "Values whose probabilities a critic learns.", least=2)
    policy_every: int = setting(2, "Gradient steps of the critics for one of the policy.", least=1)


@dataclass(frozen=True, kw_only=True)
class DAggerSettings(Gaussian, Replaying):
    """Imitation of an expert in the states that the policy itself leads to."""

    expert: str = setting("muscle-control", "Policy that is imitated, by its name as in `rollout --policy`.")
    expert_steps: int = setting(
        100, "Control steps of every world, at the start, in which the expert acts.", least=1
    )
    initial_std: float = setting(
        0.1,
        "Standard deviation of the noise; a third of the worlds has none, a third half of it.",
        least=1e-3,
    )
    learning_rate: float = setting(5e-4, "Learning rate of Adam at the start.", least=0.0)
    gradient_steps: int = setting(16, "Gradient steps after each control step of the worlds.", least=1)
    replay: int = setting(262_144, "Samples in the replay memory; a checkpoint holds them.", least=1)


@dataclass(frozen=True, kw_only=True)
class ImproveSettings(Gaussian, Replaying):
    """A search by particles around a policy, and imitation of what succeeded."""

    expert: str = setting("", "Policy that the search is around; empty: the parent, as it improves.")
    copies: int = setting(32, "Worlds that begin in the same state.", least=2)
    keep: int = setting(2, "Copies of a state that are copied over the others.", least=1)
    every: int = setting(10, "Control steps from one copying to the next.", least=1)
    num_worlds: int = setting(1024, "Worlds simulated together, a multiple of --copies.", least=1)
    initial_std: float = setting(
        0.8, "Standard deviation of the noise, which lasts and comes before the tanh.", least=1e-3
    )
    learning_rate: float = setting(1e-4, "Learning rate of Adam at the start.", least=0.0)
    gradient_steps: int = setting(500, "Gradient steps after each search.", least=1)
    average: float = setting(
        0.5, "Weight of what was before in the average of the policy, an iteration.", least=0.0, most=0.9999
    )


ALGORITHMS: dict[str, type[Settings]] = {
    "ppo": PPOSettings,
    "trpo": TRPOSettings,
    "sac": SACSettings,
    "dagger": DAggerSettings,
    "improve": ImproveSettings,
}
RENAMED = {"flashsac": "sac"}
RECORDED = TypeVar("RECORDED", bound=Settings)


def all_settings() -> dict[str, dataclasses.Field[Any]]:
    """Return the settings of all algorithms by name."""
    return {f.name: f for kind in ALGORITHMS.values() for f in dataclasses.fields(kind)}


def preset(name: str, algorithm: str) -> dict[str, Any]:
    """Return the settings that a task's preset changes; none for a task without preset.

    Args:
        name: Name of the task without version.
        algorithm: Key in `ALGORITHMS`; its table follows what the preset says for all.
    """
    table = _preset_table(name)
    own = table.get(algorithm, {})
    shared = {key: value for key, value in table.items() if not isinstance(value, dict)}
    shared.pop("algorithm", None)
    return shared | own


def divided(values: Mapping[str, Any]) -> tuple[Setup, dict[str, Any]]:
    """Return the setup and the settings of plain values, which presets and checkpoints have side by side."""
    settings = {name: value for name, value in values.items() if name not in OPTIONS}
    return Setup.from_plain(values), settings


def preset_algorithm(name: str) -> str:
    """Return the algorithm of a task's preset, ppo where it names none."""
    return str(_preset_table(name).get("algorithm", "ppo"))


def _preset_table(name: str) -> dict[str, Any]:
    """Return a task's preset as it stands in its file."""
    file = resources.files(__package__) / "presets" / f"{name}.toml"
    return tomllib.loads(file.read_text()) if file.is_file() else {}


def choose(name: str, algorithm: str, given: Mapping[str, Any]) -> Settings:
    """Return settings: the defaults, a task's preset over them, and over both what is given.

    Raises:
        ValueError: A setting does not belong to the algorithm, is out of its range or does not fit to others.
    """
    if algorithm in RENAMED:
        raise ValueError(f"algorithm {algorithm!r} is called {RENAMED[algorithm]} now")
    check_choice("algorithm", algorithm, ALGORITHMS)
    kind = ALGORITHMS[algorithm]
    known = {f.name for f in dataclasses.fields(kind)}
    for key in given:
        if key not in known:
            owners = [a for a, k in ALGORITHMS.items() if key in {f.name for f in dataclasses.fields(k)}]
            where = (
                f"it belongs to {' and '.join(owners)}"
                if owners
                else f"available: {', '.join(sorted(known))}"
            )
            raise ValueError(f"{algorithm} has no setting {flag(key)}; {where}")
    return restore(kind, divided(preset(name, algorithm))[1] | dict(given))


def restore(kind: type[RECORDED], values: Mapping[str, Any]) -> RECORDED:
    """Return settings from plain values, checked.

    Raises:
        ValueError: A value has the wrong type, is out of its range or does not fit to others.
    """
    fields = {f.name: f for f in dataclasses.fields(kind)}
    checked = {}
    for key, value in values.items():
        if key not in fields:
            raise ValueError(f"setting {key!r} is unknown; available: {', '.join(fields)}")
        checked[key] = _checked(fields[key], value)
    settings = kind(**checked)
    _check_together(settings)
    return settings


def _checked(entry: dataclasses.Field[Any], value: Any) -> Any:
    """Return a setting's value in its type.

    Raises:
        ValueError: It has another type, or is out of its range.
    """
    name, bounds, kind = flag(entry.name), entry.metadata, type(entry.default)
    if kind is float and type(value) is int:
        value = float(value)
    if kind is tuple and isinstance(value, list | tuple):
        value = tuple(value)
    if type(value) is not kind:
        raise ValueError(f"{name} must be of type {kind.__name__}, got {value!r}")
    for item in value if isinstance(value, tuple) else (value,):
        if bounds["choices"]:
            check_choice(name, item, bounds["choices"])
        elif kind is tuple and type(item) is not bounds["items"]:
            wanted = "integers" if bounds["items"] is int else "texts"
            raise ValueError(f"{name} must be {wanted}, got {item!r}")
        elif isinstance(item, int | float):
            _check_bounds(name, item, bounds["least"], bounds["most"])
    return value


def _check_bounds(name: str, value: float, least: float | None, most: float | None) -> None:
    """Raise ValueError if a number is not within its bounds, or not a number."""
    low, high = float("-inf") if least is None else least, float("inf") if most is None else most
    if low <= value <= high and abs(value) != float("inf"):
        return
    wanted = f"at least {least}" if most is None else f"from {least} to {most}"
    raise ValueError(f"{name} must be {wanted if least is not None else 'finite'}, got {value}")


def _check_together(settings: Settings) -> None:
    """Raise ValueError if settings do not fit together."""
    bonus.weights(settings.bonus)
    iteration = settings.num_worlds * settings.rollout_steps
    if settings.samples < iteration:
        raise ValueError(
            f"--samples must be at least one iteration, {settings.num_worlds} worlds x "
            f"{settings.rollout_steps} steps = {iteration}, got {settings.samples}"
        )
    if isinstance(settings, OnPolicy) and iteration % settings.minibatches:
        raise ValueError(
            f"--minibatches must divide the samples of an iteration, {settings.num_worlds} worlds x "
            f"{settings.rollout_steps} steps = {iteration}, got {settings.minibatches}"
        )
    if isinstance(settings, PPOSettings) and settings.least_rate > settings.largest_rate:
        raise ValueError(
            f"--least-rate must be at most --largest-rate, {settings.largest_rate}, got {settings.least_rate}"
        )
    if isinstance(settings, ImproveSettings):
        if settings.num_worlds % settings.copies:
            raise ValueError(
                f"--num-worlds must be a multiple of the {settings.copies} --copies, got "
                f"{settings.num_worlds}"
            )
        if not settings.parent and not settings.expert:
            raise ValueError("improve needs a policy to search around; name it with --parent or --expert")
        if settings.keep > settings.copies:
            raise ValueError(f"--keep must be at most --copies, {settings.copies}, got {settings.keep}")
    elif isinstance(settings, Replaying):
        if settings.replay % settings.num_worlds:
            raise ValueError(
                f"--replay must be a multiple of the {settings.num_worlds} worlds, got {settings.replay}"
            )
        if settings.batch_size > settings.replay:
            raise ValueError(
                f"--batch-size must be at most --replay, {settings.replay} samples, got {settings.batch_size}"
            )


def flag(name: str) -> str:
    """Return a setting's name on the command line."""
    return "--" + name.replace("_", "-")
