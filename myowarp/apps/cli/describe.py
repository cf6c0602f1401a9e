"""The command `myowarp describe`: what each number of a task is."""

import json
import sys
from dataclasses import dataclass
from typing import Annotated

from rich.console import Console

from myowarp.apps.cli.options import Asked, environment
from myowarp.tasks.setups import complete

WIDTH, WIDEST = 80, 100  # characters: in a file, in a terminal


@dataclass
class Describe:
    """Say what each number of a task's observation, action and reward is, and when it is solved.

    Example: myowarp describe myoHandReachRandom-v1
    """

    asked: Annotated[Asked, environment(leave_out=("device", "shards", "seed"))]
    json: bool = False
    """Print JSON instead of text."""

    def __call__(self) -> None:
        """Describe and print."""
        from myowarp.apps.reports.describe import describe
        from myowarp.apps.reports.describe_text import as_text

        asked = self.asked.setup
        setup = complete(asked)
        name, is_text = str(asked.task).removeprefix("MyoWarp/"), isinstance(asked.task, str)
        if not is_text or ":" in name or name.endswith(".py"):  # others are ids, which say their conditions
            name = setup.spec.key
        facts = describe(setup, f"MyoWarp/{name}")
        width = min(Console().width, WIDEST) if sys.stdout.isatty() else WIDTH
        print(json.dumps(facts, indent=1) if self.json else as_text(facts, width))
