"""Evaluations of trained policies: planned, and run in an environment of their own; torch is not needed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from myowarp.apps.train.plan import eval_command, is_file, trained_setup
from myowarp.apps.train.ranks import Ranks
from myowarp.definitions.registry import check_choice, check_least
from myowarp.definitions.setup import Setup
from myowarp.sim.build import MOST_WORLDS
from myowarp.tasks.setups import complete

if TYPE_CHECKING:
    from myowarp.apps.policies.checkpoint import Checkpoint

EVALUATION_SEED = 1_000_000  # other worlds than those of training
MODES = ("deterministic", "sampled")


@dataclass(frozen=True)
class EvaluationJob:
    """An evaluation that was checked and can be run.

    Attributes:
        checkpoint: What is evaluated.
        setup: In what.
        episodes: Episodes of each mode, over all ranks.
        modes: Of `MODES`.
        ranks: This process among those that share the episodes.
    """

    checkpoint: Checkpoint
    setup: Setup
    episodes: int
    modes: tuple[str, ...]
    ranks: Ranks


def plan_evaluation(
    checkpoint: Path,
    what: Setup | str = Setup(),
    *,
    episodes: int = 256,
    mode: str = "both",
    **fields: Any,
) -> EvaluationJob:
    """Return the evaluation that is asked for, checked; nothing is built.

    Args:
        checkpoint: Folder of a run or of a checkpoint, or a policy of the package, baselines/<task>.
        what: Where it is evaluated: task (one with the same observation and actuators), muscle, reset and
            conditions are those of the training where it says nothing; physics is "parity" then.
        episodes: Episodes of each mode, and worlds simulated together.
        mode: One of `MODES`, or "both".
        **fields: Fields of `Setup`, in place of those of `what`.

    Raises:
        ValueError: An argument is wrong.
    """
    from myowarp.apps.policies.baselines import policy_folder
    from myowarp.apps.policies.checkpoint import CheckpointError, check_task, load_checkpoint

    asked = Setup.of(what, **fields)
    check_least(1, MOST_WORLDS, episodes=episodes)
    check_choice("mode", mode, ("both", *MODES))
    own = asked.task.removeprefix("MyoWarp/") if isinstance(asked.task, str) else None
    loaded = load_checkpoint(policy_folder(str(checkpoint), own) or checkpoint)
    trained = trained_setup(loaded.manifest)
    if asked.task is None and is_file(trained):
        raise CheckpointError(
            f"checkpoint {str(checkpoint)!r} was trained in a task from a file, which a checkpoint does not "
            f"open by itself; try {eval_command(trained, checkpoint)}"
        )
    inherited = dataclasses.replace(trained, physics=None, device=None, seed=EVALUATION_SEED)
    if asked.task is not None:
        inherited = dataclasses.replace(inherited, task=None)
    modes, setup = MODES if mode == "both" else (mode,), complete(asked.over(inherited))
    check_task(loaded, setup.spec)
    return EvaluationJob(loaded, setup, episodes, modes, Ranks.started())


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
    from myowarp.sim.signals import Signals
    from myowarp.sim.simulation import Simulation

    checkpoint, ranks, results = job.checkpoint, job.ranks, {}
    number, device = ranks.share("--episodes", job.episodes), ranks.device(job.setup.device)
    console = Console(stderr=True, quiet=not ranks.leads)
    setup = dataclasses.replace(job.setup, device=device, rank=ranks.part)
    with ranks.together(device):
        sim = Simulation(setup, number, autoreset="same_step")
        check_contract(checkpoint, sim)
        signals = Signals(sim) if sim.scene.muscles.names else None
        for mode in job.modes:
            act = LearnedPolicy(checkpoint, setup if mode == "sampled" else None)
            figures = evaluate(sim, act, signals=signals, title=mode, console=console, ranks=ranks)
            results[mode] = dataclasses.asdict(figures)
        sim.close()
    head: dict[str, Any] = {
        "task": setup.spec.env_id,
        "checkpoint": str(checkpoint.folder),
        "seed": setup.seed,
    }
    head |= {"physics": setup.physics, "muscle": setup.muscles.model, "reset": setup.reset}
    head |= {"conditions": list(map(str, setup.conditions or ())), "device": str(sim.scene.device)}
    trained = checkpoint.manifest
    head |= {"trained_under": trained["settings"]["physics"], "samples": trained["samples"]}
    return head, results
