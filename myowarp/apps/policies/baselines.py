"""Baselines: trained policies that come with the package, how they were trained, and how good they are.

    myowarp/baselines/<task>/
        manifest.json, policy.safetensors   what acts: a checkpoint without the learner's state
        result.json                         {"runs": [{"training", "evaluation"}, ...]}, a run for each seed;
                                            the policy is that of the first
        curve.csv                           return and success over samples of that run
        parent/                             manifest and policy that this run started from, where they are no
                                            other task's baseline

Playing one needs no torch. `python -m benchmarks.baselines --add` makes these files from runs.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from myowarp.apps.policies.checkpoint import LEARNER, Checkpoint, CheckpointError, load_checkpoint
from myowarp.definitions.registry import did_you_mean
from myowarp.definitions.task import TASKS
from myowarp.kernels.episode import MYOSUITE
from myowarp.process import warn_once

FOLDER = Path(__file__).parents[2] / "baselines"
RESULT, CURVE, PARENT = "result.json", "curve.csv", "parent"
OWN, PREFIX = "baseline", "baselines/"
"""Names of policies: the baseline of the task that it is to act in, and that of a task that is named."""


@dataclass(frozen=True)
class Baseline:
    """A trained policy of the package.

    Attributes:
        task: Key of its task.
        checkpoint: What acts.
        runs: Report of the training and figures of the evaluation for each seed; the first is the policy's.
    """

    task: str
    checkpoint: Checkpoint
    runs: list[dict[str, Any]]

    @property
    def is_todays(self) -> bool:
        """Whether today's trainer made it, which can then make it again."""
        return bool(self.checkpoint.manifest.get("learner") == LEARNER)

    def settings(self, seed: int | None = None) -> dict[str, Any]:
        """Return the settings of a seed's run.

        They end where it ended: by itself, for rates depend on all samples that it had, or, of a run that was
        stopped, by as many samples.

        Args:
            seed: None: that of the policy, which they remake. A seed that had no run has all samples.
        """
        settings = self.checkpoint.manifest["settings"]
        seed = settings["seed"] if seed is None else seed
        trainings = {run["training"]["seed"]: run["training"] for run in self.runs}
        stopped = trainings.get(seed, {"ended": ""})["ended"].startswith("stopped")
        return settings | {"seed": seed} | ({"samples": trainings[seed]["samples"]} if stopped else {})

    def check_trainer(self) -> None:
        """Raise CheckpointError if the trainer before this one made it, whose settings were others."""
        if not self.is_todays:
            raise CheckpointError(
                f"baseline {self.task!r} is of the trainer before this one, whose settings were others; "
                f"train a policy with `myowarp train {self.task}`"
            )


def baseline_tasks() -> list[str]:
    """Return the tasks that have a baseline."""
    return sorted(folder.name for folder in FOLDER.iterdir() if folder.is_dir()) if FOLDER.is_dir() else []


def baseline_folder(task: str) -> Path:
    """Return the folder of a task's baseline, or of `<task>/parent`.

    Raises:
        ValueError: There is none.
    """
    if task.endswith(f"/{PARENT}") and (FOLDER / task).is_dir():
        return FOLDER / task
    if task not in (available := baseline_tasks()):
        near = "" if task in TASKS else did_you_mean(task, available)
        others = near or f"available: {', '.join(available)}"
        if other := _other_version(task):
            others = f"that of another version is {PREFIX}{other}"
        raise ValueError(f"task {task!r} has no baseline; {others}")
    return FOLDER / task


def _other_version(task: str) -> str | None:
    """Return another version of a task that has a baseline, None where there is none."""
    name = task.rpartition("-")[0]
    return next((other for other in baseline_tasks() if other.rpartition("-")[0] == name), None)


def load_baseline(task: str) -> Baseline:
    """Return a task's baseline.

    Raises:
        ValueError: There is none, or a file of it is missing or damaged.
    """
    folder = baseline_folder(task)
    checkpoint = load_checkpoint(folder)
    try:
        runs = json.loads((folder / RESULT).read_text())["runs"]
        for run in runs:
            run["evaluation"]["deterministic"]["intervals"], run["training"]["samples"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"baseline {task!r} has no readable {RESULT} ({error})") from error
    return Baseline(task, checkpoint, runs)


def policy_folder(name: str, task: str | None) -> Path | None:
    """Return the folder of a trained policy; None where the name is that of no folder and no baseline.

    "baseline" is that of another version of the task, and says so, where the task has none of its own.

    Args:
        name: "baseline", "baselines/<task>" or a path.
        task: Key of the task in which it is to act; None if it is not known.

    Raises:
        ValueError: The task has no baseline.
    """
    if name == OWN:
        if task is None:
            raise ValueError(f"policy {OWN!r} needs a task; name it, or a policy {PREFIX}<task>")
        if task not in baseline_tasks() and (other := _other_version(task)):
            warn_once(f"task {task!r} has no baseline; that of another version acts, {PREFIX}{other}")
            task = other
        return baseline_folder(task)
    if name.startswith(PREFIX) and not Path(name).is_dir():
        return baseline_folder(name.removeprefix(PREFIX).removeprefix("MyoWarp/"))
    return Path(name) if Path(name).is_dir() else None


def shortfall(figures: dict[str, dict[str, Any]], table: dict[str, dict[str, Any]]) -> str:
    """Return in which modes success by the paper's rule is below the interval of a table; "" if in none.

    Args:
        figures: Mode to figures of an evaluation.
        table: The same, of the committed result.
    """
    found = []
    for mode, now in figures.items():
        least = table[mode]["intervals"][MYOSUITE][0]
        if now[MYOSUITE] < least:
            found.append(f"{100 * now[MYOSUITE]:.1f} % {mode}, at least {100 * least:.1f} % are needed")
    return "; ".join(found)
