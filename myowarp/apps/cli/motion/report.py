"""The step `myowarp motion report`."""

from __future__ import annotations

from dataclasses import dataclass

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.steps import check_results, say_saved, write_page

FILES = ("report.html",)


@dataclass
class Report:
    """Write a page on what other steps wrote into the same folder, the worst first.

    Example: myowarp motion report gait.osim -o out/trial
    """

    model: of.Model
    motion: of.Motion = None
    output: of.Output = of.OUT
    overwrite: of.Overwrite = False

    def __call__(self) -> None:
        """Check, draw, write."""
        check_results(self.output, FILES, self.overwrite, FILES)
        write_page(self.output, self.model, self.motion)
        say_saved([], FILES, self.output)
