"""The plan of a training, checked before anything is built or written."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.apps.policies.baselines import policy_folder
from myowarp.apps.policies.checkpoint import (
    FOLDER,
    LEARNER,
    STATE,
    Checkpoint,
    CheckpointError,
    find_folder,
    is_file,
    load_checkpoint,
    trained_setup,
)
from myowarp.apps.policies.find import find_policy
from myowarp.apps.policies.learned import read_policy
from myowarp.apps.rollouts.ranks import ALONE, Ranks
from myowarp.apps.train import bonus
from myowarp.apps.train.settings import (
    ALGORITHMS,
    TRAINING,
    Gaussian,
    ImproveSettings,
    PPOSettings,
    Settings,
    all_settings,
    choose,
    divided,
    preset,
    preset_algorithm,
    restore,
)
from myowarp.definitions.condition import resolve
from myowarp.definitions.option import flag
from myowarp.definitions.registry import check_choice
from myowarp.definitions.setup import OPTIONS, Setup
from myowarp.definitions.task import TaskSpec
from myowarp.disk import check_folder, locked, make_folder
from myowarp.extras import to_install
from myowarp.sim.patient_columns import conditions_of
from myowarp.sim.patient_table import population_of
from myowarp.sim.state import State
from myowarp.tasks.setups import complete

SAVE_SECONDS = 30.0  # from one checkpoint to the next
LOCK = ".lock"
NEEDS = ("torch", "safetensors", "tensorboard")


@dataclass(frozen=True)
class Job:
    """A run that was checked and is ready to be built.

    Attributes:
        asked: What the user said of the environment, with the preset; its manifest says so.
        setup: What that stands for, with the patients' conditions.
        algorithm: Key in `ALGORITHMS`.
        settings: Settings.
        folder: Folder of the run.
        ranks: This process among those of the run.
        checkpoint: What is resumed; None: nothing.
        parent: Whose policy a new run starts from; None: networks are drawn.
        start: States of `--start`.
        files_read: Checksums of the files that these came from, by option.
        save_seconds: Seconds from one checkpoint to the next; 0: after every iteration.
        wandb: Whether figures go to Weights & Biases too.
    """

    asked: Setup
    setup: Setup
    algorithm: str
    settings: Settings
    folder: Path
    ranks: Ranks = ALONE
    checkpoint: Checkpoint | None = None
    parent: Checkpoint | None = None
    start: State | None = None
    files_read: dict[str, str] = field(default_factory=dict)
    save_seconds: float = SAVE_SECONDS
    wandb: bool = False

    @property
    def resume_command(self) -> str:
        """The command that goes on with the run."""
        return resume_command(self.asked, self.folder, self.ranks.size)


def resume_command(asked: Setup, folder: Path, ranks: int) -> str:
    """Return what a shell is told to go on with a run, which its checkpoint says."""
    start = f"torchrun --nproc-per-node {ranks} -m myowarp" if ranks > 1 else "myowarp"
    flag = ["--model"] if isinstance(asked.task, Path) else []
    file = [*flag, str(asked.task)] if is_file(asked) else []
    return f"{start} {shlex.join(['train', *file, '--resume', str(folder)])}"


def task_name(setup: Setup) -> str:
    """Return the task of a setup as a manifest says it; what a specification changes is in the contract."""
    return setup.task.key if isinstance(setup.task, TaskSpec) else str(setup.task)


def policy_task(name: str) -> Path | str | None:
    """Return the task that a network was trained in; None where the name is of no network.

    Raises:
        ValueError: It is damaged.
    """
    folder = None if name == "baseline" else policy_folder(name, None)
    return folder and trained_setup(load_checkpoint(folder).manifest).task  # type: ignore[return-value]


def check_packages() -> None:
    """Raise ImportError if a package that training needs is not installed."""
    missing = [name for name in NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ImportError(f"training needs {', '.join(missing)}; run {to_install('train')}")


def plan(
    what: Setup | str = Setup(),
    *,
    algorithm: str | None = None,
    output: Path | None = None,
    resume: Path | None = None,
    save_seconds: float = SAVE_SECONDS,
    wandb: bool = False,
    **settings: Any,
) -> Job:
    """Return the run that is asked for, checked; nothing is built or written.

    Args:
        what: The environment, or a task alone; what it leaves open is the preset's, at last `TRAINING`.
        algorithm: Key in `ALGORITHMS`; None: that of the task's preset.
        output: New folder of the run; None: runs/<task>_<algorithm>_<seed>.
        resume: Folder of a run that is to go on.
        save_seconds: Seconds from one checkpoint to the next; 0: after every iteration.
        wandb: Whether to send the figures to Weights & Biases too.
        **settings: Fields of the algorithm's settings, those that are not given are the preset's; and fields
            of `Setup`, in place of those of `what`.

    Raises:
        ValueError: An argument is wrong.
        ImportError: A package is not installed.
    """
    check_packages()
    fields = {name: settings.pop(name) for name in settings.keys() & OPTIONS.keys()}
    ranks, said = Ranks.started(), Setup.of(what, **fields)
    if not 0.0 <= save_seconds < float("inf"):
        raise ValueError(f"--save-seconds must be at least 0, got {save_seconds}")
    if wandb:
        from myowarp.apps.train.progress import check_wandb

        check_wandb()
    how: dict[str, Any] = {"ranks": ranks, "save_seconds": save_seconds, "wandb": wandb}
    if resume is not None:
        return _plan_resume(resume, said, {"algorithm": algorithm, "output": output}, settings, how)
    spec = complete(Setup(task=said.task)).spec
    algorithm = algorithm or preset_algorithm(spec.name)
    chosen = choose(spec.name, algorithm, settings)
    asked = said.over(divided(preset(spec.name, algorithm))[0]).over(TRAINING)
    folder = output or Path("runs") / f"{spec.key}_{algorithm}_{asked.seed}"
    check_folder(folder)
    if ranks.restarts and last_saved(folder):
        return _plan_resume(folder, said, {"algorithm": algorithm, "output": output}, settings, how)
    if ranks.leads and not ranks.restarts and occupied(folder):
        raise ValueError(
            f"output {str(folder)!r} is not empty; choose a new folder, or go on with "
            f"{resume_command(asked, folder, ranks.size)}"
        )
    for name in bonus.weights(chosen.bonus):
        check_choice("term of --bonus", name, bonus.names(spec))
    parent = None
    if chosen.parent:
        chosen, parent = _with_parent(chosen, algorithm, spec, settings)
    if expert := getattr(chosen, "expert", ""):
        find_policy(expert, spec)
    return _with_files(Job(asked, complete(asked), algorithm, chosen, folder, parent=parent, **how))


def occupied(folder: Path) -> bool:
    """Whether the folder of a run, which may not exist yet, holds anything.

    Raises:
        ValueError: Another process trains in it.
    """
    if (folder / LOCK).exists():
        with locked(folder / LOCK, wait=False):
            pass
    return folder.is_dir() and any(file.name != LOCK for file in folder.iterdir())


@contextmanager
def held(job: Job) -> Iterator[None]:
    """Keep the folder of a run from all other processes during the block; of ranks the one that saves does.

    Raises:
        ValueError: Another process holds it, or has trained in it since the run was planned.
        OSError: It cannot be written.
    """
    if not job.ranks.leads:
        yield
        return
    make_folder(job.folder)
    with locked(job.folder / LOCK, wait=False):
        if last_saved(job.folder) != (job.checkpoint and job.checkpoint.folder):
            raise ValueError(
                f"folder {str(job.folder)!r} has a new checkpoint, which another process wrote just now; go "
                f"on with {job.resume_command}"
            )
        yield


def last_saved(folder: Path) -> Path | None:
    """Return the last checkpoint in the folder of a run; None if there is none."""
    try:
        return find_folder(folder, learning=True)
    except CheckpointError:
        return None


def _with_files(job: Job) -> Job:
    """Return a run with what its patient table and its file of states hold, both checked.

    Raises:
        ValueError: A file is wrong, or does not fit to the run.
        ImportError: A package is not installed.
    """
    settings, spec, setup = job.settings, job.setup.spec, job.setup
    _check_ranks(job)
    if settings.cohort:
        population = population_of(settings.cohort, spec)
        number = len(population.patients)
        if settings.num_worlds % number:
            raise ValueError(
                f"--num-worlds must be a multiple of the {number} patients of --cohort, got "
                f"{settings.num_worlds}"
            )
        each = settings.num_worlds // number
        if isinstance(settings, ImproveSettings) and each % settings.copies:
            raise ValueError(
                f"--num-worlds must give each of the {number} patients of --cohort a multiple of the "
                f"{settings.copies} --copies, which are one patient, got {settings.num_worlds}"
            )
        patients = conditions_of(population.entries, spec, each)
        setup = dataclasses.replace(setup, conditions=(*(setup.conditions or ()), *patients))
        resolve(setup.conditions or (), spec)
    if settings.start and not Path(settings.start).is_file():
        raise ValueError(f"--start {settings.start!r} does not exist")
    start = State.load(settings.start) if settings.start else None
    if start is not None and start.task != spec.key:
        raise ValueError(f"--start {settings.start!r} holds states of {start.task!r}, not of {spec.key!r}")
    if start is not None and start.arrays.get("episode.ended", np.zeros(1)).any():
        raise ValueError(f"--start {settings.start!r} holds episodes that have ended; save others")
    return dataclasses.replace(job, setup=setup, start=start, files_read=_digests(job))


def _check_ranks(job: Job) -> None:
    """Raise ValueError if a run cannot be divided among its ranks."""
    ranks, settings = job.ranks, job.settings
    if ranks.size == 1:
        return
    if not isinstance(settings, PPOSettings):
        # TRPO's step and SAC's replay are those of one process.
        raise ValueError(
            f"training over {ranks.size} ranks is for ppo; start {job.algorithm} without torchrun, or pass "
            "--algorithm ppo"
        )
    if settings.start_share:  # states that one rank has kept are not those of another
        raise ValueError(f"--start-share is for one process, got {ranks.size} ranks; leave one of both out")
    rows = ranks.share("--num-worlds", settings.num_worlds) * settings.rollout_steps
    if rows % settings.minibatches:
        raise ValueError(
            f"--minibatches must divide the samples of a rank and iteration, {settings.num_worlds} worlds / "
            f"{ranks.size} ranks x {settings.rollout_steps} steps = {rows}, got {settings.minibatches}"
        )
    ranks.device(job.setup.device)


def _digests(job: Job) -> dict[str, str]:
    """Return checksums of the files that a run reads."""
    paths = {"cohort": job.settings.cohort, "start": job.settings.start}
    paths["muscle_parameters"] = str(job.asked.muscle_parameters or "")
    return {k: hashlib.sha256(Path(path).read_bytes()).hexdigest() for k, path in paths.items() if path}


def _with_parent(
    settings: Settings, algorithm: str, spec: TaskSpec, given: Mapping[str, Any]
) -> tuple[Settings, Checkpoint]:
    """Return settings with the shape of a parent's policy, and the checkpoint that holds it.

    Args:
        settings: Those of the run.
        algorithm: Key in `ALGORITHMS`.
        spec: The task.
        given: Settings that were named; where they say another shape, they are refused.

    Raises:
        ValueError: There is no such policy, or it is not one that the run can train.
    """
    folder = policy_folder(settings.parent, spec.key)
    if folder is None:
        raise ValueError(f"--parent {settings.parent!r} must be a run's folder, baseline or baselines/<id>")
    parent = read_policy(settings.parent, folder, spec)
    gaussian, trains = "log_std" in parent.policy, issubclass(ALGORITHMS[algorithm], Gaussian)
    if gaussian != trains and algorithm != "improve":  # which takes the means of any policy
        raise CheckpointError(
            f"--parent {settings.parent!r} was trained by {parent.manifest['algorithm']}, whose policies "
            f"{algorithm} cannot train"
        )
    theirs = {name: parent.manifest["settings"][name] for name in ("hidden", "activation")}
    theirs["hidden"] = tuple(theirs["hidden"])
    if trains:
        theirs["mean_bound"] = parent.manifest["policy"].get("mean_bound", "clip") if gaussian else "tanh"
    for name, shape in theirs.items():
        if name in given and _listed(given[name]) != _listed(shape):
            raise CheckpointError(
                f"{flag(name)} must be that of --parent {settings.parent!r}, {shown(shape)}; got "
                f"{shown(given[name])}; leave it out"
            )
    return dataclasses.replace(settings, **theirs), parent


def _plan_resume(
    folder: Path, said: Setup, asked: dict[str, Any], given: dict[str, Any], how: dict[str, Any]
) -> Job:
    """Return the run that goes on; see `plan`.

    Args:
        folder: Its folder.
        said: What was said of the environment.
        asked: What was said of algorithm and output; None: nothing.
        given: Settings that were named.
        how: Fields of the job that belong to this process.
    """
    checkpoint, ranks = load_checkpoint(folder, learning=True), how["ranks"]
    manifest = checkpoint.manifest
    if STATE not in manifest["files"]:
        raise CheckpointError(f"checkpoint {str(folder)!r} holds a policy alone and cannot be resumed")
    if manifest.get("learner") != LEARNER:
        raise CheckpointError(
            f"run {str(folder)!r} is one of the trainer before this one, and cannot go on; its policy plays, "
            f"and a new run can start from it with --parent {folder}"
        )
    if checkpoint.folder == folder and folder.absolute().parent.name == FOLDER:
        raise CheckpointError(f"--resume {str(folder)!r} is a checkpoint in a run; name the run's folder")
    if (before := manifest.get("ranks", 1)) != ranks.size:
        raise ValueError(
            f"run {str(folder)!r} goes on with the number of ranks that it began with, {before}, got "
            f"{ranks.size}"
        )
    began, settings = trained_setup(manifest), divided(manifest["settings"])[1]
    if manifest["algorithm"] == "trpo":
        settings.pop("learning_rate", None)  # of runs of before, where it did nothing
    if is_file(began):
        if said.task is None:
            raise ValueError(
                f"run {str(folder)!r} is of a task from a file, which a checkpoint does not open by itself; "
                f"go on with {resume_command(began, folder, ranks.size)}"
            )
        # Its path may be another one; whether it is the same task, its contract tells.
        began = dataclasses.replace(began, task=said.task)
    wanted = asked | {"task": said.task and str(said.task).removeprefix("MyoWarp/")}
    same = {"algorithm": manifest["algorithm"], "output": folder}
    for name, value in wanted.items():
        there = same.get(name, str(began.task).removeprefix("MyoWarp/"))
        if value is not None and str(value) != str(there):
            raise ValueError(f"--resume goes on with {name} {str(there)!r}, got {str(value)!r}; leave it out")
    fields, recorded = all_settings(), settings | began.plain()
    own = {name: value for name, value in said.plain().items() if getattr(said, name) is not None}
    for name, value in (given | own).items():
        free = name in fields and fields[name].metadata["free"]
        if name not in recorded or (not free and _listed(value) != recorded[name]):
            raise ValueError(
                f"--resume goes on with the settings of its run, where {flag(name)} is "
                f"{recorded.get(name)!r}, got {value!r}; leave it out, or start a new run"
            )
    check_choice("algorithm", manifest["algorithm"], ALGORITHMS)
    chosen = restore(ALGORITHMS[manifest["algorithm"]], settings | given)
    setup = complete(began)
    job = _with_files(Job(began, setup, manifest["algorithm"], chosen, folder, checkpoint=checkpoint, **how))
    if (now := job.files_read) != (then := manifest.get("files_read", {})):
        changed = next(name for name in now if now[name] != then.get(name))
        file = getattr(chosen, changed, "") or str(began.muscle_parameters)
        raise ValueError(f"{flag(changed)} {file!r} has changed since the run began")
    return job


def _listed(value: Any) -> Any:
    """Return a value as JSON gives it back."""
    return list(value) if isinstance(value, tuple) else value


def shown(value: Any) -> str:
    """Return a setting's value for people."""
    return " ".join(map(str, value)) or "none" if isinstance(value, tuple | list) else str(value) or "empty"
