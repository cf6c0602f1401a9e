"""What `myowarp train` does."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Optional

import tyro
from rich.console import Console

from myowarp.apps.commands.rollout import Rollout
from myowarp.apps.machine import Stopwatch, processor
from myowarp.apps.options import Model, OptionalTask, optional
from myowarp.apps.train.eval_command import EVALUATION_SEED
from myowarp.apps.train.settings import ALGORITHMS, SUCCESSES, Settings, all_settings, choose, restore
from myowarp.disk import check_folder, check_output, in_place
from myowarp.spec.registry import check_choice
from myowarp.spec.task import TASKS
from myowarp.tasks.from_file import task_or_model
from myowarp.tasks.variants import Variant

if TYPE_CHECKING:
    from myowarp.apps.train.checkpoint import Checkpoint
    from myowarp.apps.train.loop import Run

REPORT = "report.json"
NEEDS = ("torch", "skrl", "safetensors", "tensorboard")


@dataclass
class TrainCommand:
    """Train a policy: PPO, TRPO or SAC, with a preset for the task.

    Writes a folder with the last checkpoint, progress.csv, TensorBoard events, curve.png and report.json.
    Ctrl-C finishes the iteration and saves; a run that was stopped or killed goes on with --resume, bit for
    bit on the CPU.

    Example: myowarp train myoElbowPose1D6MRandom-v0 --output runs/elbow

    Then: myowarp eval runs/elbow

    Or: myowarp rollout myoElbowPose1D6MRandom-v0 --policy runs/elbow --video elbow.mp4
    """

    task: OptionalTask = None
    model: Model = None
    algorithm: Annotated[Literal["ppo", "trpo", "sac"] | None, optional("{ppo,trpo,sac}")] = None
    """Algorithm; by default ppo."""
    output: Annotated[Path | None, optional("FOLDER")] = None
    """New folder of the run; by default runs/<task>_<algorithm>_<seed>."""
    resume: Annotated[Path | None, optional("FOLDER")] = None
    """Folder of a run that is to go on; its settings hold, only --samples and when to stop may change."""
    video: Annotated[Path | None, optional("FILE")] = None
    """Write a video of the trained policy to this .mp4: deterministic actions, parity physics."""
    save_seconds: float = 30.0
    """Seconds from one checkpoint to the next; 0: after every iteration."""
    wandb: bool = False
    """Send the figures to Weights & Biases too."""

    def __call__(self) -> None:
        """Check everything, train and report."""
        watch, console = Stopwatch(), Console(stderr=True, highlight=False, soft_wrap=True)
        job = _plan(self)
        run = _start(job)
        reason = _train(job, run, console, self.save_seconds, self.wandb)
        run.env.close()
        _report(job, run, reason, watch, console)
        if self.video:
            _film(job, self.video)


@dataclass(frozen=True)
class Job:
    """A run that was checked and is ready to be built.

    Attributes:
        task: What the user called the task: an id, or the path of a model's file.
        model: Whether it is the path of a model's file.
        variant: What its id stands for.
        algorithm: Key in `ALGORITHMS`.
        settings: Settings.
        folder: Folder of the run.
        checkpoint: What is resumed; None: nothing.
    """

    task: str
    model: bool
    variant: Variant
    algorithm: str
    settings: Settings
    folder: Path
    checkpoint: Checkpoint | None = None


def _plan(command: TrainCommand) -> Job:
    """Return the run that a command asks for.

    Raises:
        ValueError: An argument is wrong; nothing was built or written.
        ImportError: A package is not installed.
    """
    missing = [name for name in NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ImportError(f'training needs {", ".join(missing)}; run `pip install "myowarp[train]"`')
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise ValueError("training runs in one process; start it without torchrun (WORLD_SIZE is above 1)")
    if not 0.0 <= command.save_seconds < float("inf"):
        raise ValueError(f"--save-seconds must be at least 0, got {command.save_seconds}")
    check_output(command.video, ".mp4")
    if command.video is not None and command.video.exists():
        raise ValueError(f"output {str(command.video)!r} exists; choose another name")
    if command.wandb:
        from myowarp.apps.train.progress import check_wandb

        check_wandb()
    given = {name: getattr(command, name) for name in all_settings()}
    given = {name: value for name, value in given.items() if value is not None}
    if command.resume is not None:
        return _plan_resume(command, given)
    variant = task_or_model(command.task, command.model)
    algorithm = command.algorithm or "ppo"
    settings = choose(TASKS[variant.task].name, algorithm, given)
    task = command.task or str(command.model)
    name = f"{TASKS[variant.task].key}_{algorithm}_{settings.seed}"
    folder = command.output or Path("runs") / name
    check_folder(folder)
    if folder.exists() and any(folder.iterdir()):
        raise ValueError(
            f"output {str(folder)!r} is not empty; choose a new folder, or go on with --resume {folder}"
        )
    return Job(task, command.model is not None, variant, algorithm, settings, folder)


def _plan_resume(command: TrainCommand, given: dict[str, Any]) -> Job:
    """Return the run that goes on; see `_plan`."""
    from myowarp.apps.train.checkpoint import STATE, CheckpointError, load_checkpoint

    folder = Path(str(command.resume))
    checkpoint = load_checkpoint(folder)
    manifest = checkpoint.manifest
    if STATE not in manifest["files"]:
        raise CheckpointError(f"checkpoint {str(folder)!r} holds a policy alone and cannot be resumed")
    recorded = manifest["settings"]
    task = command.task and command.task.removeprefix("MyoWarp/")
    wanted = {"task": task, "model": command.model, "algorithm": command.algorithm, "output": command.output}
    name = manifest["task"].removeprefix("MyoWarp/")
    same = {"task": name, "model": name, "algorithm": manifest["algorithm"], "output": folder}
    for what, value in wanted.items():
        if value is not None and str(value) != str(same[what]):
            raise ValueError(
                f"--resume goes on with {what} {str(same[what])!r}, got {str(value)!r}; leave it out"
            )
    fields = all_settings()
    for name, value in given.items():
        if name not in recorded or (not fields[name].metadata["free"] and _listed(value) != recorded[name]):
            flag = "--" + name.replace("_", "-")
            raise ValueError(
                f"--resume goes on with the settings of its run, where {flag} is {recorded.get(name)!r}, "
                f"got {value!r}; leave it out, or start a new run"
            )
    check_choice("algorithm", manifest["algorithm"], ALGORITHMS)
    settings = restore(ALGORITHMS[manifest["algorithm"]], recorded | given)
    task, is_model, algorithm = manifest["task"], manifest["model"], manifest["algorithm"]
    if (is_model or ":" in task) and command.task is None and command.model is None:
        raise ValueError(
            f"the task of the run is in the file {task!r}, which --resume opens if you name it, too"
        )
    variant = task_or_model(None if is_model else task, Path(task) if is_model else None)
    return Job(task, is_model, variant, algorithm, settings, folder, checkpoint)


def _listed(value: Any) -> Any:
    """Return a value as JSON gives it back."""
    return list(value) if isinstance(value, tuple) else value


def _start(job: Job) -> Run:
    """Build the environment and the agent; put a resumed run's numbers back.

    Raises:
        CheckpointError: The checkpoint does not fit the task as it is now.
    """
    import torch

    from myowarp.apps.train.checkpoint import CheckpointError, check_contract
    from myowarp.apps.train.loop import Run
    from myowarp.bridge_gym import MyoWarpVectorEnv

    settings, variant = job.settings, job.variant
    torch.set_num_threads(settings.threads)
    env = MyoWarpVectorEnv(
        variant.task,
        settings.num_worlds,
        device=settings.device or None,
        physics=settings.physics,
        muscle=settings.muscle,
        reset=settings.reset or variant.reset,
        conditions=(*variant.conditions, *settings.conditions),
        autoreset_mode="disabled",
        output="torch",
        copy=False,
    )
    run = Run(env, settings)
    if job.checkpoint is not None:
        check_contract(job.checkpoint, env.sim, learning=True)
        try:
            run.restore(job.checkpoint)
        except (KeyError, RuntimeError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise CheckpointError(
                f"checkpoint {str(job.checkpoint.folder)!r} cannot be resumed: {reason}"
            ) from error
    return run


def _train(job: Job, run: Run, console: Console, save_seconds: float, wandb: bool) -> str:
    """Iterate until something ends the run; returns what.

    Raises:
        DivergedError: A loss or a weight was not finite; the last good checkpoint is there.
        OSError: A checkpoint or figures could not be written; the last good checkpoint is there.
    """
    from myowarp.apps.train.loop import DivergedError
    from myowarp.apps.train.progress import Progress

    settings = job.settings
    job.folder.mkdir(parents=True, exist_ok=True)
    _note_versions(job, console)
    if job.checkpoint is None:
        _save(job, run)  # whatever happens from here on, the run can go on
    console.print(
        f"{job.task}: {job.algorithm}, {settings.num_worlds} worlds under {settings.physics} physics, "
        f"into {job.folder}"
    )
    saved = time.monotonic()
    with (
        _stop_asked() as asked,
        Progress(job.folder, settings.samples, console, after=run.samples) as progress,
    ):
        if wandb:
            progress.start_wandb(job.folder.name, dataclasses.asdict(settings))
        while True:
            if asked():
                reason = "stopped by a signal"
            elif run.tally.reached(settings.stop_success, settings.stop_rule):
                reason = f"{100 * settings.stop_success:.1f} % {SUCCESSES[settings.stop_rule]}"
            elif run.samples >= settings.samples:
                reason = "all samples"
            else:
                reason = ""
            if reason or time.monotonic() - saved >= save_seconds:
                progress.flush()
                _save(job, run)
                saved = time.monotonic()
            if reason:
                return reason
            try:
                run.iterate()
            except DivergedError as error:
                raise DivergedError(
                    f"{error}; the last good checkpoint is in {job.folder}, try a lower --learning-rate"
                ) from error
            progress.add(run.row())


@contextmanager
def _stop_asked() -> Iterator[Any]:
    """Turn the first Ctrl-C or SIGTERM into a wish; a second one acts as ever.

    Yields:
        A function that returns whether one came.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def note(number: int, frame: object) -> None:
        came.append(number)
        for each, handler in before.items():
            signal.signal(each, handler)

    for number in before:
        signal.signal(number, note)
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _note_versions(job: Job, console: Console) -> None:
    """Say if packages are not those that wrote the checkpoint that is resumed."""
    from myowarp.apps.train.checkpoint import versions

    if job.checkpoint is None:
        return
    before, now = job.checkpoint.manifest["versions"], versions()
    for name in before.keys() & now.keys():
        if before[name] != now[name]:
            console.print(
                f"{name} was {before[name]}, is {now[name]}: the run goes on, not bit for bit", style="yellow"
            )


def _save(job: Job, run: Run) -> None:
    """Write a checkpoint.

    Raises:
        OSError: It cannot be written; the one before is still there.
    """
    from myowarp.apps.train import checkpoint

    manifest = {
        "task": job.task,
        "model": job.model,
        "reset": job.variant.reset,
        "conditions": list(job.variant.conditions),
        "algorithm": job.algorithm,
        "contract": checkpoint.task_contract(run.env.sim),
        "settings": dataclasses.asdict(job.settings),
        "versions": checkpoint.versions(),
        **run.manifest(),
    }
    try:
        checkpoint.save_checkpoint(job.folder, run.samples, checkpoint.plain(manifest), *run.arrays())
    except OSError as error:
        raise OSError(
            f"checkpoint after {run.samples} samples could not be written ({error.strerror or error}); the "
            f"one before is in {job.folder}, go on with --resume {job.folder}"
        ) from error


def _report(job: Job, run: Run, reason: str, watch: Stopwatch, console: Console) -> None:
    """Draw the curve, write and print what came out."""
    from myowarp.apps.train.checkpoint import plain
    from myowarp.apps.train.progress import draw_curve

    settings, spent = job.settings, watch.read()
    figures: dict[str, Any] = {
        "task": job.task,
        "algorithm": job.algorithm,
        "seed": settings.seed,
        "physics": settings.physics,
        "ended": reason,
        "samples": run.samples,
        "updates": run.updates,
        "resumed_after": job.checkpoint.manifest["samples"] if job.checkpoint else 0,
        **{name: round(value, 2) for name, value in spent.items()},
        "processor": processor(),
        "cores": os.cpu_count(),
        "training_seconds": round(run.clock.total, 1),
        "training_cpu_seconds": round(run.clock.cpu, 1),
        **{name: value for name, value in run.tally.figures().items()},
        **{f"share_{name}": round(share, 3) for name, share in run.clock.shares().items()},
    }
    with in_place(job.folder / REPORT) as scratch:
        scratch.write_text(json.dumps(plain(figures), indent=1) + "\n")
    curve = draw_curve(job.folder, f"{job.task}, {job.algorithm}, seed {settings.seed}")
    share = f"{100 * figures['success']:.1f} %" if figures["episodes"] else "none"
    console.print(
        f"Ended after {run.samples:,} samples in {spent['seconds']:.1f} s: {reason}; of the last episodes "
        f"{share} succeeded, sampled actions under {settings.physics} physics"
    )
    console.print(f"Saved {job.folder}" + (f" and {curve}" if curve else ""))
    console.print(f"Evaluate: myowarp eval {job.folder}")


def _film(job: Job, video: Path) -> None:
    """Run the policy that was trained, print what it does, and write a video."""
    settings = job.settings
    Rollout(
        task=None if job.model else job.task,
        model=Path(job.task) if job.model else None,
        policy=str(job.folder),
        seed=EVALUATION_SEED,
        device=settings.device or None,
        muscle=settings.muscle,
        reset=settings.reset or None,
        conditions=settings.conditions,
        video=video,
    )()


def _overrides() -> list[tuple[str, Any, Any]]:
    """Return the settings as fields of the command, each None where it is not given."""
    fields: list[tuple[str, Any, Any]] = []
    for name, entry in all_settings().items():
        kind: Any = type(entry.default)
        metavar = "{" + ",".join(filter(None, entry.metadata["choices"])) + "}"
        if kind is tuple:
            kind, metavar = (
                (tuple[int, ...], "[INT ...]") if name == "hidden" else (tuple[str, ...], "[NAME ...]")
            )
        elif not entry.metadata["choices"]:
            metavar = {int: "INT", float: "FLOAT"}.get(kind, "NAME")
        owners = [a for a, k in ALGORITHMS.items() if name in {f.name for f in dataclasses.fields(k)}]
        only = "" if len(owners) == len(ALGORITHMS) else f" ({', '.join(owners)})"
        hint = f"(preset, else {_shown(entry.default)})"
        text = entry.metadata["text"] + only
        fields.append(
            (
                name,
                Annotated[Optional[kind], tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint=hint)],  # noqa: UP045
                dataclasses.field(default=None),
            )
        )
    return fields


def _shown(value: Any) -> str:
    """Return a default for the help."""
    return " ".join(map(str, value)) or "none" if isinstance(value, tuple) else str(value) or "empty"


Train = dataclasses.make_dataclass("Train", _overrides(), bases=(TrainCommand,))
Train.__doc__ = TrainCommand.__doc__
