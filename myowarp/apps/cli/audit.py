"""The command `myowarp audit`: whether tasks are sound."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console

from myowarp.apps.cli.options import Asked, Overwrite, TaskIds, environment, optional
from myowarp.definitions.registry import check_least


@dataclass
class Audit:
    """Check whether tasks are sound: run zero, random and extreme actions, and examine targets and objects.

    Says for each id how often episodes fail at once, which share of the targets can be met, which
    observations and reward terms are constant, whether early termination is rewarded, how full contacts were,
    and whether objects have the inertia and friction that they should. A corrected version stands beside the
    one with MyoSuite's semantics. An id takes from seconds (elbow) to minutes (hand that touches).

    Two versions of a task: myowarp audit myoHandReachFixed-v0 myoHandReachFixed-v1

    Every registered id: myowarp audit --output out/all

    The paper's grid, each id with its reset: myowarp audit --paper
    """

    asked: Annotated[Asked, environment(leave_out=("task", "shards"))]
    tasks: TaskIds = ()
    paper: bool = False
    """Audit the grid of the MyoSuite paper, each id with its reset."""
    num_worlds: int = 64
    """Worlds simulated together: episodes seen for each policy."""
    steps: Annotated[int | None, optional("INT")] = None
    """Control steps of each policy; by default, and at least, one horizon of the task (reset-free: two)."""
    output: Path = Path("out/audit")
    """Folder for audit.json, written after every id, and index.html with plots (needs matplotlib)."""
    overwrite: Overwrite = False
    json: bool = False
    """Print the JSON instead of a table."""

    def __call__(self) -> None:
        """Check everything, then audit and report."""
        from myowarp.apps.studies.audit import tasks as command
        from myowarp.disk import check_folder, check_overwrite, make_folder
        from myowarp.sim.build import resolve_device

        asked = self.asked.setup
        jobs = command.find_jobs(self.tasks, self.paper, asked)
        check_least(1, num_worlds=self.num_worlds, steps=1 if self.steps is None else self.steps)
        resolve_device(asked.device)
        check_folder(self.output)
        check_overwrite((self.output / name for name in command.FILES), self.overwrite)
        make_folder(self.output)
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        audits = command.audit_all(
            jobs,
            self.output,
            console,
            num_worlds=self.num_worlds,
            steps=self.steps,
        )
        if self.json:
            print(command.as_json(audits))
        else:
            command.print_table(audits, Console())
