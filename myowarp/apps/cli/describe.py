"""The command `myowarp describe`: what each number of a task is."""

import json
import sys
from dataclasses import dataclass

from rich.console import Console

from myowarp.apps.cli.options import Conditions, Model, OptionalTask, Reset
from myowarp.definitions.task import TASKS
from myowarp.tasks.from_file import task_or_model

WIDTH, WIDEST = 80, 100  # characters: in a file, in a terminal


@dataclass
class Describe:
    """Say what each number of a task's observation, action and reward is, and when it is solved.

    Example: myowarp describe myoHandReachRandom-v1
    """

    task: OptionalTask = None
    model: Model = None
    reset: Reset = None
    conditions: Conditions = ()
    json: bool = False
    """Print JSON instead of text."""

    def __call__(self) -> None:
        """Describe and print."""
        from myowarp.apps.reports.describe import describe
        from myowarp.apps.reports.describe_text import as_text

        variant = task_or_model(self.task, self.model)
        spec = TASKS[variant.task]
        env_id = spec.env_id if self.task is None else f"MyoWarp/{self.task.removeprefix('MyoWarp/')}"
        facts = describe(
            spec,
            env_id=env_id,
            reset=self.reset or variant.reset,
            conditions=(*variant.conditions, *self.conditions),
        )
        width = min(Console().width, WIDEST) if sys.stdout.isatty() else WIDTH
        print(json.dumps(facts, indent=1) if self.json else as_text(facts, width))
