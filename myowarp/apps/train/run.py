"""A training from its first step to its report: `train(plan("myoElbowPose1D6MRandom-v0"))`."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import time
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from rich.console import Console

from myowarp.apps.policies import checkpoint
from myowarp.apps.policies.checkpoint import (
    BEST,
    LEARNER,
    POLICY,
    CheckpointError,
    eval_command,
    last_saved,
    setup_entries,
    versions,
)
from myowarp.apps.policies.run_folder import held
from myowarp.apps.reports.curve import draw_curve
from myowarp.apps.reports.evaluation import SUCCESSES
from myowarp.apps.reports.machine import Stopwatch, processor
from myowarp.apps.train.plan import Job
from myowarp.apps.train.selection import Selection
from myowarp.disk import existing, in_place, plain
from myowarp.process import stop_asked

if TYPE_CHECKING:
    from myowarp.apps.reports.progress import Progress
    from myowarp.apps.train.loop import Run
    from myowarp.bridge_gym import MyoWarpVectorEnv

REPORT = "report.json"
STOPPED = "stopped by a signal"
SAVE_COST = 50.0  # least time between two checkpoints over the time that the last one took


def train(job: Job, console: Console | None = None) -> dict[str, Any]:
    """Train, and write a folder with the last checkpoint, progress.csv, TensorBoard events, curve and report.

    Ctrl-C finishes the iteration and saves; `plan(resume=folder)` is then the run that goes on.

    Args:
        job: What `plan` has checked.
        console: Where progress is shown; None: the error stream.

    Returns:
        What report.json says: what ended the run, samples, times, and figures of the last episodes.

    Raises:
        DivergedError: A loss or a weight was not finite; the last good checkpoint is there.
        FaultyTaskError: No world of the task can be stepped.
        OSError: A checkpoint or figures could not be written; the last good checkpoint is there.
    """
    watch = Stopwatch()
    console = console or Console(stderr=True, highlight=False, soft_wrap=True)
    if not job.ranks.leads:
        console.quiet = True
    with held(job.folder, job.checkpoint, job.resume_command) if job.ranks.leads else nullcontext():
        with job.ranks.together(job.ranks.device(job.setup.device)):
            run, selection = start(job), Selection(job)
            report = _report(job, run, selection, _iterate(job, run, selection, console))
            run.env.close()
            selection.close()
        report |= {name: round(value, 2) for name, value in watch.read().items()}
        if job.ranks.leads:
            with _written(job, "report"):
                _publish(job, report, console)
    return report


def start(job: Job) -> Run:
    """Build the environment and the agent; put a resumed run's numbers back.

    Raises:
        CheckpointError: The checkpoint does not fit the task as it is now.
    """
    import torch

    from myowarp.apps.train.loop import Run
    from myowarp.apps.train.replay import check_room

    torch.set_num_threads(job.settings.threads)
    env = _environment(job, job.checkpoint.manifest["samples"] if job.checkpoint else 0)
    if job.parent is not None:
        checkpoint.check_contract(job.parent, env.sim)
    run = Run(env, job.settings, job.parent, job.start, job.ranks)
    if run.learner.replay is not None:
        check_room(run.learner.replay.size, "disk", shutil.disk_usage(existing(job.folder)).free)
    if job.checkpoint is not None:
        checkpoint.check_contract(job.checkpoint, env.sim, learning=True)
        try:
            run.restore(job.checkpoint)
        except (KeyError, RuntimeError, ValueError) as error:
            reason, folder = " ".join(str(error).split()), str(job.checkpoint.folder)
            raise CheckpointError(f"checkpoint {folder!r} cannot be resumed: {reason}") from error
    return run


def _environment(job: Job, samples: int) -> MyoWarpVectorEnv:
    """Return this rank's worlds, under the physics that the run has after a number of samples."""
    from myowarp.bridge_gym import MyoWarpVectorEnv

    ranks, physics = job.ranks, _physics(job, samples)
    device = ranks.device(job.setup.device)
    setup = dataclasses.replace(job.setup, physics=physics, device=device, rank=ranks.part)
    number = ranks.share("--num-worlds", job.settings.num_worlds)
    return MyoWarpVectorEnv(setup, number, autoreset_mode="disabled", output="torch", copy=False)


def _physics(job: Job, samples: int) -> str | None:
    """Return the physics that a run has after a number of samples."""
    return "parity" if 0 < job.settings.parity_after <= samples else job.setup.physics


def _iterate(job: Job, run: Run, selection: Selection, console: Console) -> str:
    """Iterate until something ends the run; returns what."""
    from myowarp.apps.train.loop import DivergedError

    settings, ranks = job.settings, job.ranks
    now: dict[str, str] = versions()
    then: dict[str, str] = job.checkpoint.manifest["versions"] if job.checkpoint else now
    for name in (name for name in then.keys() & now.keys() if then[name] != now[name]):
        text = f"{name} was {then[name]}, is {now[name]}: the run goes on, not bit for bit"
        console.print(text, style="yellow")
    if job.checkpoint is None:
        _save(job, run, selection)  # whatever happens from here on, the run can go on
    over = f" over {ranks.size} ranks" if ranks.size > 1 else ""
    console.print(
        f"{job.asked.task}: {settings.algorithm}, {settings.num_worlds} worlds{over} under "
        f"{run.env.sim.setup.physics} physics"
        f"{f', from {settings.parent}' if settings.parent else ''}, into {job.folder}"
    )
    saved, taken = time.monotonic(), 0.0
    with (
        stop_asked() as asked,
        _written(job, "figures"),
        _progress(job, run, selection, console) as progress,
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", ".* was reset after a fault")  # the environment's; see below
        if settings.parent and settings.selections and not run.samples:
            _select(job, run, selection, console)  # no run plays worse than its parent
        while True:
            every = max(job.save_seconds, SAVE_COST * taken) if job.save_seconds else 0.0
            due = time.monotonic() - saved >= every
            # Signals and clocks differ from rank to rank; what to do may not.
            stop, save = map(any, zip(*ranks.everyones((asked(), due)), strict=True))
            reason = STOPPED if stop else _end(run, selection)
            if reason or save:
                if progress:
                    progress.flush()
                begin = time.monotonic()
                _save(job, run, selection)
                saved = time.monotonic()
                taken = saved - begin
            if reason:
                return reason
            said = len(run.faults)
            if (physics := _physics(job, run.samples)) != run.env.sim.setup.physics:
                run.move(_environment(job, run.samples))
                console.print(f"from {run.samples:,} samples on under {physics} physics")
            try:
                run.iterate()
            except DivergedError as error:
                advice = "mend the task" if run.faults else "try a lower --learning-rate"
                raise DivergedError(
                    f"{error}; the last good checkpoint is in {job.folder}, {advice}"
                ) from error
            for kind in run.faults[said:]:
                text = f"worlds of {job.asked.task} ended by a fault, with reward 0: {kind}"
                console.print(text, style="yellow")
            if selection.is_due(run.samples):
                _select(job, run, selection, console)
            if progress:
                progress.add(run.row() | selection.figures())


def _progress(
    job: Job, run: Run, selection: Selection, console: Console
) -> AbstractContextManager[Progress | None]:
    """Return the files and the live line of a run; only the rank that logs has them."""
    from myowarp.apps.reports.progress import Progress

    if not job.ranks.leads:
        return nullcontext()
    told = manifest_of(job, run, selection)["settings"] if job.wandb else None
    return Progress(job.folder, run.settings.samples, console, after=run.samples, wandb=told)


def _end(run: Run, selection: Selection) -> str:
    """Return what ends a run by itself, "" where nothing does: success of the last selection, or samples.

    Without selections the success is that of the training; a parent's ends nothing.
    """
    settings, last = run.settings, selection.last
    if settings.selections:
        reached = last is not None and last.samples > 0 and last.success >= settings.stop_success
    else:
        reached = run.worlds.tally.reached(settings.stop_success, settings.stop_rule)
    if reached:
        actions = "mean" if settings.selections else "drawn"
        share = f"{100 * settings.stop_success:.1f} %"
        rule = SUCCESSES[settings.stop_rule]
        return f"at least {share} of the episodes succeeded with {actions} actions ({rule})"
    return "all samples" if run.samples >= settings.samples else ""


@contextmanager
def _written(job: Job, what: str) -> Iterator[None]:
    """Let what cannot be written end the run with a sentence, an OSError."""
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


def _save(job: Job, run: Run, selection: Selection) -> None:
    """Write a checkpoint, with the worlds of all ranks; where it cannot be, the one before is still there."""
    manifest, policy, state = manifest_of(job, run, selection), run.learner.acting(), run.arrays()
    if job.ranks.leads:
        with _written(job, f"checkpoint after {run.samples} samples"):
            checkpoint.save_checkpoint(job.folder, run.samples, manifest, policy, state)


def _select(job: Job, run: Run, selection: Selection, console: Console) -> None:
    """Evaluate the average policy, and keep it if it is the best."""
    manifest, policy, before = manifest_of(job, run, selection), run.learner.acting(), selection.last
    if selection.evaluate(run.samples, manifest, policy) and job.ranks.leads:
        manifest |= {"selection": plain(selection.manifest())}
        with _written(job, f"the best policy, after {run.samples} samples"):
            checkpoint.save_checkpoint(job.folder, run.samples, manifest, policy, root=BEST)
    if sentence := selection.stall(before):
        console.print(sentence, style="yellow")


def manifest_of(job: Job, run: Run, selection: Selection) -> dict[str, Any]:
    """Return what a checkpoint is."""
    origin = job.checkpoint.manifest.get("parent") if job.checkpoint else None
    if job.parent is not None:
        theirs = job.parent.manifest
        origin = {"task": job.parent.task, "samples": theirs["samples"], **theirs["files"][POLICY]}
    manifest = {
        **setup_entries(job.asked, job.setup),
        "algorithm": job.settings.algorithm,
        "learner": LEARNER,
        "contract": checkpoint.task_contract(run.env.sim),
        # Side by side; the other way: `divided`.
        "settings": dataclasses.asdict(run.settings)
        | job.asked.plain()
        | {"muscle": job.setup.muscles.model},
        "versions": versions(),
        "parent": origin or None,
        "files_read": job.files_read,
        "selection": selection.manifest(),
        **run.manifest(),
    }
    return dict(plain(manifest))


def _report(job: Job, run: Run, selection: Selection, reason: str) -> dict[str, Any]:
    """Return what came out, but for the time that the process took."""
    clock, manifest = run.worlds.clock, manifest_of(job, run, selection)
    same = ("task", "algorithm", "ranks", "samples", "updates", "selection")
    return {
        **{name: manifest[name] for name in same},
        "seed": job.setup.seed,
        "physics": job.setup.physics,
        "parity_after": job.settings.parity_after,
        "ended": reason,
        "resumed_after": job.checkpoint.manifest["samples"] if job.checkpoint else 0,
        "processor": processor(),
        "cores": os.cpu_count(),
        "training_seconds": round(clock.total, 1),
        "training_cpu_seconds": round(clock.cpu, 1),
        **run.worlds.tally.figures(),
        **{f"share_{name}": round(share, 3) for name, share in clock.shares().items()},
    }


def _publish(job: Job, report: dict[str, Any], console: Console) -> None:
    """Write a report, draw the curve, and print what came out."""
    with in_place(job.folder / REPORT) as scratch:
        scratch.write_text(json.dumps(plain(report), indent=1) + "\n")
    curve = draw_curve(job.folder, f"{job.asked.task}, {job.settings.algorithm}, seed {job.setup.seed}")
    share = f"{100 * report['success']:.1f} %" if report["episodes"] else "none"
    acts = f"drawn actions, {_physics(job, report['samples'])} physics"
    console.print(
        f"Ended after {report['samples']:,} samples: {report['ended']}. {share} of the last episodes "
        f"succeeded ({acts}). {report['training_seconds']:.1f} s of training, "
        f"{report['seconds']:.1f} s in all"
    )
    console.print(f"Saved {job.folder}" + (f" and {curve}" if curve else ""))
    if report["ended"] == STOPPED:
        console.print(f"Go on: {job.resume_command}")
    console.print(f"Evaluate: {eval_command(job.asked, job.folder)}")
