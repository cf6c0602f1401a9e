"""What `myowarp train` does."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import tyro
from rich.console import Console

from myowarp.apps.cli.rollout import Rollout
from myowarp.apps.train.evaluation import EVALUATION_SEED
from myowarp.apps.train.machine import Stopwatch, processor
from myowarp.apps.train.plan import (
    SAVE_SECONDS,
    Job,
    TrainOptions,
    eval_command,
    held,
    last_saved,
    plan,
    shown,
)
from myowarp.apps.train.settings import ALGORITHMS, SUCCESSES, all_settings
from myowarp.disk import in_place, plain

if TYPE_CHECKING:
    from myowarp.apps.train.loop import Run
    from myowarp.apps.train.progress import Progress

REPORT = "report.json"
STOPPED = "stopped by a signal"


@dataclass
class TrainCommand(TrainOptions):
    """Train a policy: PPO, TRPO, SAC or FlashSAC, with a preset for the task.

    Writes a folder with the last checkpoint, progress.csv, TensorBoard events, curve.png and report.json.
    Ctrl-C finishes the iteration and saves; a run that was stopped or killed goes on with --resume, bit for
    bit on the CPU.

    Example: myowarp train myoElbowPose1D6MRandom-v0 --output runs/elbow

    Then: myowarp eval runs/elbow

    Or: myowarp rollout myoElbowPose1D6MRandom-v0 --policy runs/elbow --video elbow.mp4
    """

    def __call__(self) -> None:
        """Check everything, train and report."""
        watch, console = Stopwatch(), Console(stderr=True, highlight=False, soft_wrap=True)
        job = plan(self)
        console.quiet = not job.ranks.leads
        with held(job):
            with job.ranks.together(job.ranks.device(job.settings.device)):
                run = start(job)
                reason = train(job, run, console, self.save_seconds, self.wandb)
                run.env.close()
            if job.ranks.leads:
                with _written(job, "report"):
                    _report(job, run, reason, watch, console)
        if self.video and job.ranks.leads:
            _film(job, self.video)


def start(job: Job) -> Run:
    """Build the environment and the agent; put a resumed run's numbers back.

    Raises:
        CheckpointError: The checkpoint does not fit the task as it is now.
    """
    import torch

    from myowarp.apps.policies.checkpoint import CheckpointError, check_contract
    from myowarp.apps.train.loop import Run
    from myowarp.bridge_gym import MyoWarpVectorEnv

    settings, variant, ranks = job.settings, job.variant, job.ranks
    torch.set_num_threads(settings.threads)
    env = MyoWarpVectorEnv(
        variant.task,
        ranks.share("--num-worlds", settings.num_worlds),
        device=ranks.device(settings.device) or None,
        physics=settings.physics,
        muscle=settings.muscle,
        reset=settings.reset or variant.reset,
        conditions=(*variant.conditions, *settings.conditions, *job.conditions, *job.patients),
        autoreset_mode="disabled",
        output="torch",
        copy=False,
        rank=ranks.part,
    )
    if job.parent is not None:
        check_contract(job.parent, env.sim)
    run = Run(env, settings, job.parent, job.start, ranks)
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


def train(
    job: Job, run: Run, console: Console, save_seconds: float = SAVE_SECONDS, wandb: bool = False
) -> str:
    """Iterate until something ends the run; returns what.

    Raises:
        DivergedError: A loss or a weight was not finite; the last good checkpoint is there.
        FaultyTaskError: No world of the task can be stepped.
        OSError: A checkpoint or figures could not be written; the last good checkpoint is there.
    """
    from myowarp.apps.train.loop import DivergedError

    settings, ranks = job.settings, job.ranks
    _note_versions(job, console)
    if job.checkpoint is None:
        _save(job, run)  # whatever happens from here on, the run can go on
    over = f" over {ranks.size} ranks" if ranks.size > 1 else ""
    console.print(
        f"{job.task}: {job.algorithm}, {settings.num_worlds} worlds{over} under {settings.physics} physics"
        f"{f', from {settings.parent}' if settings.parent else ''}, into {job.folder}"
    )
    saved = time.monotonic()
    with (
        _stop_asked() as asked,
        _written(job, "figures"),
        _progress(job, run, console, wandb) as progress,
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", ".* was reset after a fault")  # the environment's; see below
        while True:
            due = time.monotonic() - saved >= save_seconds
            # Signals and clocks differ from rank to rank; what to do may not.
            stop, save = map(any, zip(*ranks.everyones((asked(), due)), strict=True))
            if stop:
                reason = STOPPED
            elif run.tally.reached(settings.stop_success, settings.stop_rule):
                reason = f"{100 * settings.stop_success:.1f} % {SUCCESSES[settings.stop_rule]}"
            elif run.samples >= settings.samples:
                reason = "all samples"
            else:
                reason = ""
            if reason or save:
                if progress:
                    progress.flush()
                _save(job, run)
                saved = time.monotonic()
            if reason:
                return reason
            said = len(run.faults)
            try:
                run.iterate()
            except DivergedError as error:
                advice = "mend the task" if run.faults else "try a lower --learning-rate"
                raise DivergedError(
                    f"{error}; the last good checkpoint is in {job.folder}, {advice}"
                ) from error
            for kind in run.faults[said:]:
                console.print(f"worlds of {job.task} ended by a fault, with reward 0: {kind}", style="yellow")
            if progress:
                progress.add(run.row())


@contextmanager
def _progress(job: Job, run: Run, console: Console, wandb: bool) -> Iterator[Progress | None]:
    """Open the files and the live line of a run, on the rank that logs."""
    from myowarp.apps.train.progress import Progress

    if not job.ranks.leads:
        yield None
        return
    with Progress(job.folder, job.settings.samples, console, after=run.samples) as progress:
        if wandb:
            progress.start_wandb(job.folder.name, dataclasses.asdict(job.settings))
        yield progress


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
    from myowarp.apps.policies.checkpoint import versions

    if job.checkpoint is None:
        return
    before, now = job.checkpoint.manifest["versions"], versions()
    for name in before.keys() & now.keys():
        if before[name] != now[name]:
            console.print(
                f"{name} was {before[name]}, is {now[name]}: the run goes on, not bit for bit", style="yellow"
            )


def _save(job: Job, run: Run) -> None:
    """Write a checkpoint, with the worlds of all ranks.

    Raises:
        OSError: It cannot be written; the one before is still there.
    """
    from myowarp.apps.policies import checkpoint

    manifest = {
        "task": job.task,
        "model": job.model,
        "reset": job.variant.reset,
        "conditions": [*job.variant.conditions, *(condition.name for condition in job.conditions)],
        "algorithm": job.algorithm,
        "contract": checkpoint.task_contract(run.env.sim),
        "settings": dataclasses.asdict(job.settings),
        "versions": checkpoint.versions(),
        "parent": _origin(job),
        "files_read": job.files_read,
        **run.manifest(),
    }
    arrays = run.arrays()
    if not job.ranks.leads:
        return
    with _written(job, f"checkpoint after {run.samples} samples"):
        checkpoint.save_checkpoint(job.folder, run.samples, plain(manifest), *arrays)


@contextmanager
def _written(job: Job, what: str) -> Iterator[None]:
    """Let what cannot be written end the run with a sentence.

    Raises:
        OSError: Something could not be written; the last good checkpoint is there.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None:  # it is a sentence already
            raise
        further = f"the last checkpoint is in {job.folder}, go on with {job.resume_command}"
        raise OSError(
            f"{what} could not be written ({error.strerror}); "
            f"{further if last_saved(job.folder) else f'choose another --output than {job.folder}'}"
        ) from error


def _origin(job: Job) -> dict[str, Any] | None:
    """Return which policy a run started from: its task, samples and file."""
    if job.checkpoint is not None:
        return dict(job.checkpoint.manifest.get("parent") or {}) or None
    if job.parent is None:
        return None
    from myowarp.apps.policies.checkpoint import POLICY

    manifest = job.parent.manifest
    return {"task": job.parent.task, "samples": manifest["samples"], **manifest["files"][POLICY]}


def _report(job: Job, run: Run, reason: str, watch: Stopwatch, console: Console) -> None:
    """Draw the curve, write and print what came out."""
    from myowarp.apps.train.progress import draw_curve

    settings, spent = job.settings, watch.read()
    figures: dict[str, Any] = {
        "task": job.task,
        "algorithm": job.algorithm,
        "seed": settings.seed,
        "ranks": job.ranks.size,
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
    if reason == STOPPED:
        console.print(f"Go on: {job.resume_command}")
    console.print(f"Evaluate: {eval_command(job.task, job.model, job.folder)}")


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
        hint = f"(preset, else {shown(entry.default)})"
        text = entry.metadata["text"] + only
        fields.append(
            (
                name,
                Annotated[Optional[kind], tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint=hint)],  # noqa: UP045
                dataclasses.field(default=None),
            )
        )
    return fields


Train = dataclasses.make_dataclass("Train", _overrides(), bases=(TrainCommand,))
Train.__doc__ = TrainCommand.__doc__
