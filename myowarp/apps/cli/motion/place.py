"""The step `myowarp motion place`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.steps import check_results, needed, say_saved
from myowarp.apps.cli.options import optional

FILES = ("placed.osim",)


@dataclass
class Place:
    """Put inertial sensors on a model, by what they recorded while the person stood in its default pose.

    Example: myowarp motion place gait.osim --setup placer.xml
    """

    model: of.Model
    orientations: Annotated[Path | None, optional("FILE")] = None
    """Orientations of sensors, .sto of quaternions; by default those that the set-up file names. The sensor
    femur_r_imu is on the body femur_r."""
    setup: Annotated[Path | None, optional("FILE")] = None
    """Set-up file of OpenSim's IMUPlacer: axes of the sensors' world, base sensor and its heading."""
    output: of.Output = of.OUT
    overwrite: of.Overwrite = False

    def __call__(self) -> None:
        """Check, place, write."""
        import numpy as np

        from myowarp.motion.orientations import Placing, place, read_orientations
        from myowarp.osim.document.read.element import parse
        from myowarp.osim.document.read.model import Document

        placing = Placing() if self.setup is None else Placing.read(self.setup)
        placing = replace(placing, orientations=self.orientations or placing.orientations)
        recorded = read_orientations(needed(placing.orientations, "place", "orientations"))
        check = check_results(self.output, FILES, self.overwrite)
        placed = place(Document(self.model, parse(self.model)[0]), recorded, placing)
        check()
        placed.write(self.output)
        lines = [f"on no body, and left out: {', '.join(placed.left)}"] if placed.left else []
        if placing.base:
            lines.append(f"heading turned by {np.degrees(placed.heading):.1f} degrees about the vertical")
        lines.append(f"sensors on {', '.join(body for body, _ in placed.sensors.values())}")
        say_saved(lines, FILES, self.output)
