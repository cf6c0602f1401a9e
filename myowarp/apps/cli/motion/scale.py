"""The step `myowarp motion scale`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.said import of_scaling
from myowarp.apps.cli.motion.steps import check_results, needed, say_saved
from myowarp.apps.cli.options import optional

FILES = "scaled.osim", "scale_factors.xml", "static.mot"


@dataclass
class Scale:
    """Scale a generic model to a person, by markers of one who stands still and an OpenSim set-up file.

    Example: myowarp motion scale generic.osim --setup scale.xml --markers static.trc
    """

    model: of.Model
    setup: Annotated[Path | None, optional("FILE")] = None
    """Set-up file of OpenSim's ScaleTool."""
    markers: Annotated[Path | None, optional("FILE")] = None
    """Markers over time, .trc; by default those that the set-up file names."""
    output: of.Output = of.OUT
    overwrite: of.Overwrite = False

    def __call__(self) -> None:
        """Check, scale, write."""
        from myowarp.motion.scaling import read_setup, scale

        setup = read_setup(needed(self.setup, "scale", "setup"))
        if self.markers is not None and "measurements" not in setup.order and setup.tasks is None:
            raise ValueError(
                f"--markers measure or pose a person; {str(self.setup)!r} has neither, so leave them out"
            )
        check = check_results(self.output, FILES, self.overwrite)
        scaled = scale(self.model, setup, self.markers)
        check()
        scaled.write(self.output)
        say_saved(of_scaling(scaled), FILES, self.output)
