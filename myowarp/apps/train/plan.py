"""The plan of a training, checked before anything is built or written."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from myowarp.apps.policies.baselines import policy_folder
from myowarp.apps.policies.checkpoint import (
    Checkpoint,
    CheckpointError,
    is_file,
    last_saved,
    resume_command,
    trained_setup,
)
from myowarp.apps.policies.find import find_policy
from myowarp.apps.policies.learned import read_policy
from myowarp.apps.policies.run_folder import load_resumable, occupied
from myowarp.apps.rollouts.ranks import ALONE, Ranks
from myowarp.apps.train import bonus, settings
from myowarp.apps.train.settings import ALGORITHMS, Settings, divided
from myowarp.definitions.option import flag, options_of, shown
from myowarp.definitions.registry import check_choice
from myowarp.definitions.setup import OPTIONS, Setup
from myowarp.definitions.task import TaskSpec
from myowarp.disk import check_folder, files_digest, plain
from myowarp.extras import to_install
from myowarp.sim.patient_table import population_of
from myowarp.sim.state import State
from myowarp.tasks.setups import complete

SAVE_SECONDS = 30.0  # from one checkpoint to the next
NEEDS = ("torch", "safetensors", "tensorboard")


@dataclass(frozen=True)
class Job:
    """A run that was checked and is ready to be built.

    Attributes:
        asked: What the user said of the environment, with the preset; its manifest says so.
        setup: What that stands for, with the patients' conditions.
        settings: Settings of its algorithm.
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
    **given: Any,
) -> Job:
    """Return the run that is asked for, checked; nothing is built or written.

    Args:
        what: The environment, or a task alone; what it leaves open is the preset's, at last `TRAINING`.
        algorithm: Key in `ALGORITHMS`; None: that of the task's preset.
        output: New folder of the run; None: runs/<task>_<algorithm>_<seed>.
        resume: Folder of a run that is to go on.
        save_seconds: Seconds from one checkpoint to the next; 0: after every iteration.
        wandb: Whether to send the figures to Weights & Biases too.
        **given: Fields of the algorithm's settings, those that are not given are the preset's; and fields
            of `Setup`, in place of those of `what`.

    Raises:
        ValueError: An argument is wrong.
        ImportError: A package is not installed.
    """
    check_packages()
    if wandb and importlib.util.find_spec("wandb") is None:
        raise ImportError("--wandb needs wandb, which is not installed; run `pip install wandb`")
    if not 0.0 <= save_seconds < float("inf"):
        raise ValueError(f"--save-seconds must be at least 0, got {save_seconds}")
    said = Setup.of(what, **{name: given.pop(name) for name in given.keys() & OPTIONS.keys()})
    ranks, same = Ranks.started(), {"algorithm": algorithm, "output": output}
    how: dict[str, Any] = {"ranks": ranks, "save_seconds": save_seconds, "wandb": wandb}
    if resume is not None:
        return _resumed(resume, said, same, given, how)
    spec = complete(Setup(task=said.task)).spec
    algorithm = algorithm or settings.preset_algorithm(spec.name)
    chosen = settings.choose(spec.name, algorithm, given)
    asked = said.over(divided(settings.preset(spec.name, algorithm))[0]).over(settings.TRAINING)
    folder = output or Path("runs") / f"{spec.key}_{algorithm}_{asked.seed}"
    check_folder(folder)
    if ranks.restarts and last_saved(folder):
        return _resumed(folder, said, same, given, how)
    if ranks.leads and not ranks.restarts and occupied(folder):
        raise ValueError(
            f"output {str(folder)!r} is not empty; choose a new folder, or go on with "
            f"{resume_command(asked, folder, ranks.size)}"
        )
    for name in bonus.weights(chosen.bonus):
        check_choice("term of --bonus", name, bonus.names(spec))
    parent = None
    if chosen.parent:
        chosen, parent = _with_parent(chosen, asked, spec, given)
    if expert := getattr(chosen, "expert", ""):
        find_policy(expert, spec)
    return _with_files(Job(asked, complete(asked), chosen, folder, parent=parent, **how))


def _with_files(job: Job) -> Job:
    """Return a run with what its patient table and its file of states hold, both checked, and the ranks."""
    chosen, setup, spec = job.settings, job.setup, job.setup.spec
    start: State | None = None
    _check_ranks(job)
    if chosen.cohort:
        population = population_of(chosen.cohort, spec)
        each = population.each(chosen.num_worlds, "--num-worlds")
        if each % (copies := getattr(chosen, "copies", 1)):
            raise ValueError(
                f"--num-worlds must give each of the {len(population.patients)} patients of --cohort a "
                f"multiple of the {copies} --copies, which are one patient, got {chosen.num_worlds}"
            )
        setup = population.joined(setup, each)
    if chosen.start:
        if not Path(chosen.start).is_file():
            raise ValueError(f"--start {chosen.start!r} does not exist")
        start = State.load(chosen.start)
        if start.task != spec.key:
            raise ValueError(f"--start {chosen.start!r} holds states of {start.task!r}, not of {spec.key!r}")
        if start.arrays.get("episode.ended", np.zeros(1)).any():
            raise ValueError(f"--start {chosen.start!r} holds episodes that have ended; save others")
    paths = {"cohort": chosen.cohort, "start": chosen.start}
    paths["muscle_parameters"] = str(job.asked.muscle_parameters or "")
    sums = {name: files_digest([Path(path)]) for name, path in paths.items() if path}
    return replace(job, setup=setup, start=start, files_read=sums)


def _check_ranks(job: Job) -> None:
    """Raise ValueError if a run cannot be divided among its ranks."""
    ranks, chosen = job.ranks, job.settings
    if ranks.size == 1:
        return
    if not isinstance(chosen, settings.PPOSettings):  # the step of TRPO and a replay are those of one process
        raise ValueError(
            f"training over {ranks.size} ranks is for ppo; start {chosen.algorithm} without torchrun, or "
            "pass --algorithm ppo"
        )
    if chosen.start_share:  # states that one rank has kept are not those of another
        raise ValueError(f"--start-share is for one process, got {ranks.size} ranks; leave one of both out")
    worlds = ranks.share("--num-worlds", chosen.num_worlds)
    rows = worlds * chosen.rollout_steps // chosen.unrolled
    if rows % chosen.minibatches:
        steps = chosen.rollout_steps // chosen.unrolled
        raise ValueError(
            f"--minibatches must divide the samples of a rank and iteration, {chosen.num_worlds} worlds / "
            f"{ranks.size} ranks x {steps} steps = {rows}, got {chosen.minibatches}"
        )
    ranks.device(job.setup.device)


def _with_parent(
    chosen: Settings, asked: Setup, spec: TaskSpec, given: Mapping[str, Any]
) -> tuple[Settings, Checkpoint]:
    """Return settings with the shape of a parent's policy, and its checkpoint; no other may be given."""
    name = chosen.parent
    if (folder := policy_folder(name, spec.key)) is None:
        raise ValueError(f"--parent {name!r} must be a run's folder, baseline or baselines/<id>")
    parent = read_policy(name, folder, spec)
    manifest, trains = parent.manifest, isinstance(chosen, settings.Gaussian)
    gaussian = "log_std" in parent.policy
    if gaussian != trains and chosen.algorithm != "improve":  # which takes the means of any policy
        raise CheckpointError(
            f"--parent {name!r} was trained by {manifest['algorithm']}, whose policies {chosen.algorithm} "
            "cannot train"
        )
    senses = trained_setup(manifest).observe or ()
    if missing := [sense for sense in senses if sense not in (asked.observe or ())]:
        raise CheckpointError(f"--parent {name!r} observes {missing[0]}; add it to --observe")
    theirs = {key: manifest["settings"][key] for key in ("hidden", "activation")}
    if units := manifest["settings"].get("memory", 0):
        theirs["memory"] = units
        if not isinstance(chosen, settings.PPOSettings):
            raise CheckpointError(f"--parent {name!r} has a memory, which {chosen.algorithm} cannot train")
    if trains:
        theirs["mean_bound"] = manifest["policy"].get("mean_bound", "clip") if gaussian else "tanh"
    for key, shape in theirs.items():
        if plain(given.get(key, shape)) != shape:
            raise CheckpointError(
                f"{flag(key)} must be that of --parent {name!r}, {shown(shape)}; got {shown(given[key])}; "
                "leave it out"
            )
    return replace(chosen, **theirs | {"hidden": tuple(theirs["hidden"])}), parent


def _resumed(
    folder: Path, said: Setup, same: dict[str, Any], given: dict[str, Any], how: dict[str, Any]
) -> Job:
    """Return the run that goes on.

    Args:
        folder: Its folder.
        said: What was said of the environment.
        same: What was said of algorithm and output; None: nothing.
        given: Settings that were named.
        how: Fields of the job that belong to this process.
    """
    checkpoint = load_resumable(folder, ranks := how["ranks"].size)
    manifest = checkpoint.manifest
    began, recorded = trained_setup(manifest), divided(manifest["settings"])[1]
    if is_file(began):
        if said.task is None:
            raise ValueError(
                f"run {str(folder)!r} is of a task from a file, which a checkpoint does not open by itself; "
                f"go on with {resume_command(began, folder, ranks)}"
            )
        # Its path may be another one; whether it is the same task, its contract tells.
        began = replace(began, task=said.task)
    check_choice("algorithm", manifest["algorithm"], ALGORITHMS)
    kind = ALGORITHMS[manifest["algorithm"]]
    known: dict[str, Any] = {"algorithm": kind.algorithm, "output": folder, "task": began.task}
    known |= recorded | began.plain()
    asked = {name: value for name, value in said.plain().items() if getattr(said, name) is not None}
    free = [name for name, entry in options_of(kind).items() if entry.metadata["free"]]
    for name, value in (same | {"task": said.task} | given | asked).items():
        there, here = plain(known.get(name)), plain(value)
        if name in (*same, "task"):
            there, here = (str(each).removeprefix("MyoWarp/") for each in (there, here))
        if value is not None and name not in free and here != there:
            what = name if name == "task" else flag(name)
            raise ValueError(
                f"--resume goes on with the settings of its run, where {what} is {there!r}, got {value!r}; "
                "leave it out, or start a new run"
            )
    chosen = settings.restore(kind, recorded | given)
    job = _with_files(Job(began, complete(began), chosen, folder, checkpoint=checkpoint, **how))
    then = manifest.get("files_read", {})
    for name, digest in job.files_read.items():
        if digest != then.get(name):
            file = getattr(chosen, name, "") or str(began.muscle_parameters)
            raise ValueError(f"{flag(name)} {file!r} has changed since the run began")
    return job
