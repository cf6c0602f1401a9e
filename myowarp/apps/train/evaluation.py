"""Evaluations of trained policies: planned, and run in an environment of their own; torch is not needed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from myowarp.apps.train.plan import eval_command, is_file
from myowarp.apps.train.ranks import Ranks
from myowarp.apps.train.settings import MOST_SEED
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.registry import check_choice, check_least
from myowarp.definitions.task import PHYSICS, RESETS, TASKS
from myowarp.sim.build import MOST_WORLDS, check_device_name
from myowarp.tasks.from_file import task_or_model
from myowarp.tasks.variants import Variant

if TYPE_CHECKING:
    from myowarp.apps.policies.checkpoint import Checkpoint

EVALUATION_SEED = 1_000_000  # other worlds than those of training
MODES = ("deterministic", "sampled")


@dataclass(frozen=True)
class EvaluationJob:
    """An evaluation that was checked and can be run.

    Attributes:
        checkpoint: What is evaluated.
        variant: Its task, with reset and conditions of its id.
        episodes: Episodes of each mode, over all ranks.
        modes: Of `MODES`.
        seed: World i resets with seed + i.
        device: Warp device; empty: the GPU if there is one.
        options: Physics, muscle, reset and conditions of the environment.
        ranks: This process among those that share the episodes.
    """

    checkpoint: Checkpoint
    variant: Variant
    episodes: int
    modes: tuple[str, ...]
    seed: int
    device: str
    options: dict[str, Any]
    ranks: Ranks


def plan_evaluation(
    checkpoint: Path,
    *,
    task: str | None = None,
    model: Path | None = None,
    episodes: int = 256,
    mode: str = "both",
    seed: int = EVALUATION_SEED,
    physics: str = "parity",
    muscle: str | None = None,
    reset: str | None = None,
    conditions: Sequence[str] | None = None,
    device: str | None = None,
) -> EvaluationJob:
    """Return the evaluation that is asked for, checked; nothing is built.

    Args:
        checkpoint: Folder of a run or of a checkpoint, or a policy of the package, baselines/<task>.
        task: Another task with the same observation and actuators; None: that of the training.
        model: MJCF file of the training, for a policy that was trained with one.
        episodes: Episodes of each mode, and worlds simulated together.
        mode: One of `MODES`, or "both".
        seed: World i resets with seed + i.
        physics: Name in `PHYSICS`.
        muscle: Muscle model; None: that of the training.
        reset: What episodes start from; None: as in the training.
        conditions: Names of conditions; None: those of the training.
        device: Warp device; None: the GPU if there is one.

    Raises:
        ValueError: An argument is wrong.
    """
    from myowarp.apps.policies.baselines import policy_folder
    from myowarp.apps.policies.checkpoint import CheckpointError, load_checkpoint

    check_least(1, MOST_WORLDS, episodes=episodes)
    check_least(0, MOST_SEED, seed=seed)
    check_choice("physics", physics, PHYSICS)
    check_choice("mode", mode, ("both", *MODES))
    if muscle is not None:
        check_choice("muscle", muscle, MUSCLES)
    if reset is not None:
        check_choice("reset", reset, RESETS)
    check_device_name(device)
    own = task and task.removeprefix("MyoWarp/")
    loaded = load_checkpoint(policy_folder(str(checkpoint), own) or checkpoint)
    manifest = loaded.manifest
    trained = manifest["settings"]
    other = task is not None or model is not None
    if not other and is_file(manifest["task"], manifest["model"]):
        whole = eval_command(manifest["task"], manifest["model"], checkpoint)
        raise CheckpointError(
            f"checkpoint {str(checkpoint)!r} was trained in a task from a file, which a checkpoint does not "
            f"open by itself; try {whole}"
        )
    variant = task_or_model(task if other else manifest["task"], model)
    options = {
        "physics": physics,
        "muscle": muscle or trained["muscle"],
        "reset": reset or trained["reset"] or variant.reset,
        "conditions": (*variant.conditions, *(trained["conditions"] if conditions is None else conditions)),
    }
    modes = MODES if mode == "both" else (mode,)
    return EvaluationJob(loaded, variant, episodes, modes, seed, device or "", options, ranks=Ranks.started())


def evaluate_policy(job: EvaluationJob) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Run an evaluation, one episode in every world for each mode.

    Returns:
        Under what the policy was evaluated; and the figures of `Evaluation`, by mode.

    Raises:
        CheckpointError: The policy does not fit the task as it is now.
    """
    from myowarp.apps.policies.checkpoint import check_contract
    from myowarp.apps.policies.learned import LearnedPolicy
    from myowarp.apps.train.evaluate import evaluate
    from myowarp.bridge_gym import MyoWarpVectorEnv

    checkpoint, ranks, results = job.checkpoint, job.ranks, {}
    number, device = ranks.share("--episodes", job.episodes), ranks.device(job.device)
    console = Console(stderr=True, quiet=not ranks.leads)
    with ranks.together(device, learning=False):
        env = MyoWarpVectorEnv(
            job.variant.task,
            number,
            autoreset_mode="same_step",
            rank=ranks.part,
            device=device or None,
            **job.options,
        )
        check_contract(checkpoint, env.sim)
        for mode in job.modes:
            act = LearnedPolicy(checkpoint, sampled=mode == "sampled", seed=job.seed, rank=ranks.part)
            figures = evaluate(env, act, job.seed, title=mode, console=console, ranks=ranks)
            results[mode] = dataclasses.asdict(figures)
        env.close()
    head = {"task": TASKS[job.variant.task].env_id, "checkpoint": str(checkpoint.folder), "seed": job.seed}
    head |= {name: job.options[name] for name in ("physics", "muscle", "reset")}
    head |= {"conditions": list(job.options["conditions"]), "device": str(env.sim.scene.device)}
    trained = checkpoint.manifest
    head |= {"trained_under": trained["settings"]["physics"], "samples": trained["samples"]}
    return head, results
