"""The policies that the experiments use: how they are trained, and where they are.

    myowarp/apps/studies/reproduce/policies/<name>/<seed>/   manifest.json, policy.safetensors

`myowarp reproduce NAME --retrain --device cpu` makes them anew, bit for bit, in the folder `policies` of its
output. A new one comes into the package by `checkpoint.save_policy`, without the state of its training.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from myowarp.apps.policies.baselines import PREFIX, baseline_folder
from myowarp.apps.policies.checkpoint import Checkpoint, CheckpointError, load_checkpoint
from myowarp.apps.policies.run_folder import occupied
from myowarp.definitions.condition import Condition
from myowarp.definitions.setup import Setup

FOLDER = Path(__file__).parent / "policies"
QUICK = 10  # times fewer samples in a training for a first look
NEVER = 2.0  # share of successful episodes at which a training stops early


@dataclass(frozen=True)
class Training:
    """Training of a policy.

    Attributes:
        name: Its name, that of its folder.
        task: Key of its task.
        conditions: Returns the conditions under which it is trained.
        samples: Control steps of all worlds together.
        settings: Settings of `myowarp train` besides its preset for the task.
        algorithm: Key in `ALGORITHMS`.
        parent: The training whose policy this one starts from, or a policy of the package, baselines/<task>;
            None: networks are drawn.
        task_fields: Fields of the task that are others in the training, such as a weight of its reward.
    """

    name: str
    task: str
    conditions: Callable[[], tuple[Condition, ...]] = tuple
    samples: int = 1_000_000
    settings: Mapping[str, Any] = field(default_factory=dict)
    algorithm: str = "ppo"
    parent: Training | str | None = None
    task_fields: Mapping[str, Any] = field(default_factory=dict)


def available(training: Training, seed: int = 0) -> bool:
    """Return whether a policy comes with the package."""
    return (FOLDER / training.name / str(seed)).is_dir()


def committed(training: Training, seed: int) -> Checkpoint:
    """Return a policy of the package.

    Raises:
        ValueError: There is none of this name and seed, or it is damaged.
    """
    folder = FOLDER / training.name / str(seed)
    if not available(training, seed):
        home = FOLDER / training.name
        seeds = sorted(int(path.name) for path in home.iterdir()) if home.is_dir() else []
        which = f"seeds {', '.join(map(str, seeds))}" if seeds else "no seed"
        raise ValueError(
            f"policy {training.name!r} of seed {seed} does not come with the package, which has {which}; "
            "train it with --retrain"
        )
    checkpoint = load_checkpoint(folder)
    if checkpoint.task != training.task:
        raise CheckpointError(
            f"policy {str(folder)!r} was trained in {checkpoint.task!r}, {training.task!r} is needed"
        )
    return checkpoint


def retrained(training: Training, setup: Setup, folder: Path, console: Console, *, quick: bool) -> Checkpoint:
    """Return a policy that is trained into a folder; a finished one is taken, one broken off goes on.

    Args:
        training: How.
        setup: With which seed, and what the environments of all experiments have in common.
        folder: Folder of the run.
        console: Where progress is shown.
        quick: Whether to train with a tenth of the samples.

    Raises:
        ValueError: The folder holds another run, or another process trains in it.
        ImportError: torch is not installed.
    """
    from myowarp.apps.train.plan import Job, check_packages
    from myowarp.apps.train.run import STOPPED, train
    from myowarp.apps.train.settings import TRAINING, choose, divided, preset
    from myowarp.definitions.task import TASKS, TaskSpec
    from myowarp.tasks.setups import complete

    check_packages()
    name = TASKS[training.task].name
    task: str | TaskSpec = training.task
    if training.task_fields:
        task = dataclasses.replace(TASKS[training.task], **training.task_fields)
    parent = None
    if isinstance(training.parent, str):
        parent = load_checkpoint(baseline_folder(training.parent.removeprefix(PREFIX)))
    elif training.parent is not None:
        home = folder.parents[1] / training.parent.name / str(setup.seed)
        parent = retrained(training.parent, setup, home, console, quick=quick)
    own, given = divided(training.settings)
    samples = training.samples // (QUICK if quick else 1)
    # All seeds of a protocol learn from as many samples: what it compares is not the best of each training.
    given = {"samples": samples, "stop_success": NEVER, "selections": 0} | given
    settings = choose(name, training.algorithm, given)
    asked = Setup(task=task, conditions=training.conditions()).over(own)
    asked = setup.over(asked).over(divided(preset(name, training.algorithm))[0]).over(TRAINING)
    checkpoint = load_checkpoint(folder, learning=True) if occupied(folder) else None
    if checkpoint is not None:
        _check_same(checkpoint, training, asked)
        if checkpoint.manifest["samples"] >= settings.samples or _ended(folder):
            return checkpoint
    job = Job(
        asked=asked,
        setup=complete(asked),
        settings=settings,
        folder=folder,
        checkpoint=checkpoint,
        parent=parent if checkpoint is None else None,
    )
    if (reason := train(job, console)["ended"]) == STOPPED:
        raise RuntimeError(f"training of policy {training.name!r} was {reason}; the same command goes on")
    return load_checkpoint(folder)


def _ended(folder: Path) -> bool:
    """Return whether the training in a folder came to its own end."""
    from myowarp.apps.train.run import REPORT, STOPPED

    path = folder / REPORT
    return path.is_file() and json.loads(path.read_text())["ended"] != STOPPED


def _check_same(checkpoint: Checkpoint, training: Training, asked: Setup) -> None:
    """Raise CheckpointError if a folder holds another training."""
    manifest = checkpoint.manifest
    found = manifest["task"], manifest["algorithm"], manifest["settings"]["seed"]
    if found != (training.task, training.algorithm, asked.seed):
        raise CheckpointError(
            f"checkpoint {str(checkpoint.folder)!r} is of {found[1]} in {found[0]!r} with seed {found[2]}, "
            f"{training.algorithm} in {training.task!r} with seed {asked.seed} is needed; choose "
            "another --output"
        )
