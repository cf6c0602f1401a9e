"""The command `myowarp train`."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from myowarp.apps.cli.options import Environment, Said, flag_of, optional
from myowarp.apps.cli.rollout import Rollout
from myowarp.apps.reports.evaluation import EVALUATION_SEED
from myowarp.apps.train.plan import SAVE_SECONDS, Job, plan
from myowarp.apps.train.run import train
from myowarp.apps.train.settings import ALGORITHMS, all_settings
from myowarp.definitions.option import options_of, shown
from myowarp.disk import check_output


@dataclass
class TrainCommand:
    """Train a policy: PPO, TRPO, SAC, DAgger or a search, with a preset for the task.

    Writes a folder with the last checkpoint, progress.csv, TensorBoard events, curve.png and report.json.
    Ctrl-C finishes the iteration and saves; a run that was stopped or killed goes on with --resume, bit for
    bit on the CPU.

    Example: myowarp train myoElbowPose1D6MRandom-v0 --output runs/elbow

    Then: myowarp eval runs/elbow

    Or: myowarp rollout myoElbowPose1D6MRandom-v0 --policy runs/elbow --video elbow.mp4
    """

    asked: Environment
    algorithm: Annotated[str | None, optional("{" + ",".join(ALGORITHMS) + "}")] = None
    """Algorithm; by default that of the task's preset, which is ppo for all but a few."""
    output: Annotated[Path | None, optional("FOLDER")] = None
    """New folder of the run; by default runs/<task>_<algorithm>_<seed>."""
    resume: Annotated[Path | None, optional("FOLDER")] = None
    """Folder of a run that is to go on; its settings hold, only --samples and --stop-success may change."""
    video: Annotated[Path | None, optional("FILE")] = None
    """Write a video of the trained policy to this .mp4: deterministic actions, parity physics."""
    save_seconds: float = SAVE_SECONDS
    """Seconds from one checkpoint to the next, more where saving takes long; 0: after every iteration."""
    wandb: bool = False
    """Send the figures to Weights & Biases too."""

    def __call__(self) -> None:
        """Check everything, train and report."""
        asked = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        video, setup = asked.pop("video"), asked.pop("asked").setup
        check_output(video, ".mp4")
        if video is not None and video.exists():
            raise ValueError(f"output {str(video)!r} exists; choose another name")
        job = plan(setup, **{name: value for name, value in asked.items() if value is not None})
        train(job)
        if video and job.ranks.leads:
            _film(job, video)


def _film(job: Job, video: Path) -> None:
    """Run the policy that was trained, print what it does, and write a video."""
    asked = dataclasses.replace(job.asked, physics=None, seed=EVALUATION_SEED)
    Rollout(Said(asked), policy=str(job.folder), video=video)()


def setting_fields(algorithms: Collection[str], leave_out: Iterable[str] = ()) -> list[tuple[str, Any, Any]]:
    """Return the settings of algorithms as fields of a command, each None where it is not given."""
    fields: list[tuple[str, Any, Any]] = []
    for name, entry in all_settings().items():
        owners = [algorithm for algorithm in algorithms if name in options_of(ALGORITHMS[algorithm])]
        if owners and name not in leave_out:
            own = ALGORITHMS[owners[0]]
            default = options_of(own)[name].default if len(algorithms) == 1 else entry.default
            hint = f"(preset, else {shown(default)})"
            only = "" if len(owners) == len(algorithms) else f" ({', '.join(owners)})"
            fields.append(flag_of(entry, typing.get_type_hints(own)[name], hint, only))
    return fields


Train = dataclasses.make_dataclass("Train", setting_fields(ALGORITHMS), bases=(TrainCommand,))
Train.__doc__ = TrainCommand.__doc__
