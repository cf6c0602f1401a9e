"""The step `myowarp motion kinematics`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from myowarp.apps.cli.motion import options as of
from myowarp.apps.cli.motion.said import of_markers, of_sensors
from myowarp.apps.cli.motion.steps import check_results, checked, needed, say_saved, setup_of
from myowarp.apps.cli.options import optional

FILES = "ik.mot", "marker_errors.sto", "gaps.csv"
SENSOR_FILES = "ik.mot", "orientation_errors.sto"


@dataclass
class Kinematics:
    """Find joint angles from markers or inertial sensors, with the weights of an OpenSim set-up file.

    Example: myowarp motion kinematics gait.osim --markers walk.trc --setup ik.xml
    """

    model: of.Model
    markers: Annotated[Path | None, optional("FILE")] = None
    """Markers over time, .trc; by default those that the set-up file names."""
    orientations: Annotated[Path | None, optional("FILE")] = None
    """Orientations of sensors over time in place of markers, .sto of quaternions; the model has their frames
    from myowarp motion place."""
    setup: Annotated[Path | None, optional("FILE")] = None
    """Set-up file of OpenSim's InverseKinematicsTool or IMUInverseKinematicsTool: weights of markers, sensors
    and coordinates, by default the same for all markers; file and times are taken from it unless they are
    given here."""
    marker_set: Annotated[Path | None, optional("FILE")] = None
    """An OpenSim MarkerSet, in place of the model's markers of the same names."""
    fill: Annotated[float | None, optional("SECONDS")] = None
    """Gaps of markers up to so long are bridged by a spline; gaps.csv lists all."""
    span: of.Span = None
    output: of.Output = of.OUT
    overwrite: of.Overwrite = False

    def __call__(self) -> None:
        """Check, solve, write."""
        from myowarp.motion.results import written
        from myowarp.motion.steps import kinematics_in_parts
        from myowarp.osim.body.skeleton import Bones

        setup = setup_of(self)
        sensors = setup.orientations is not None
        files: tuple[str, ...] = SENSOR_FILES if sensors else FILES
        if sensors:
            if setup.markers is not None:
                raise ValueError("motion kinematics takes --markers or --orientations, not both")
            for name in ("fill", "marker_set"):
                if getattr(self, name) is not None:
                    option = name.replace("_", "-")
                    raise ValueError(f"--{option} is of markers; leave it out where sensors are followed")
        else:
            needed(setup.markers, "kinematics", "markers")
        check = check_results(self.output, files, self.overwrite)
        bones = Bones.read(self.model, markers=self.marker_set)
        found = written(checked(kinematics_in_parts(bones, setup), check), self.output)
        say_saved(of_sensors(found) if sensors else of_markers(found), files, self.output)
