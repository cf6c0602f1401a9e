"""The step `myowarp motion report`."""

from __future__ import annotations

from dataclasses import dataclass

from myowarp.apps.cli.motion.steps import OUT, Model, Output, Recorded, check_results, say_saved, write_page
from myowarp.apps.cli.options import Overwrite

FILES = ("report.html",)


@dataclass
class Report:
    """Write a page on what other steps wrote into the same folder, the worst first.

    Example: myowarp motion report gait.osim -o out/trial
    """

    model: Model
    motion: Recorded = None
    output: Output = OUT
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, draw, write."""
        check_results(self.output, FILES, self.overwrite, FILES)
        write_page(self.output, self.model, self.motion)
        say_saved([], FILES, self.output)
