"""The command `myowarp improve`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from myowarp.apps.cli.options import Asked, environment, optional
from myowarp.apps.cli.train import setting_fields
from myowarp.apps.policies.baselines import OWN, policy_folder
from myowarp.apps.policies.checkpoint import load_checkpoint, trained_setup
from myowarp.apps.train.plan import SAVE_SECONDS, plan
from myowarp.apps.train.run import train


@dataclass
class ImproveCommand:
    """Improve a policy: search by copies of states around it, and imitate the episodes that succeeded.

    Copies of a start act as the policy does, with noise; every few steps the best ones are copied over
    the others. It helps where a policy nearly succeeds, such as a key turn that lacks one grip. Writes a
    run's folder, as `myowarp train` does; `myowarp train --resume` goes on with it.

    Example: myowarp improve baselines/myoHandKeyTurnRandom-v0 --output runs/key
    """

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Folder of a run, baselines/ID, or with --task any policy of `rollout --policy`: muscle-control."""
    asked: Annotated[Asked, environment(flag=True)]
    output: Annotated[Path | None, optional("FOLDER")] = None
    """New folder of the run; by default runs/<task>_improve_<seed>."""
    save_seconds: float = SAVE_SECONDS
    """Seconds from one checkpoint to the next; 0: after every iteration."""

    def __call__(self) -> None:
        """Check everything, search, imitate and report."""
        given = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        policy, setup = given.pop("policy"), given.pop("asked").setup
        folder = None if policy == OWN else policy_folder(policy, None)
        if folder is None and policy != OWN and setup.task is None:
            raise ValueError(
                f"policy {policy!r} is no folder of a run; name one, or a policy of the package (`myowarp "
                "baselines list`), or give --task ID beside another, such as muscle-control"
            )
        given["expert" if folder is None else "parent"] = policy
        if folder is not None and setup.task is None:
            setup = dataclasses.replace(setup, task=trained_setup(load_checkpoint(folder).manifest).task)
        train(plan(setup, algorithm="improve", **{k: v for k, v in given.items() if v is not None}))


Improve = dataclasses.make_dataclass(
    "Improve", setting_fields(["improve"], leave_out=("parent", "expert")), bases=(ImproveCommand,)
)
Improve.__doc__ = ImproveCommand.__doc__
