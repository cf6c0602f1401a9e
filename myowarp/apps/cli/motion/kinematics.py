"""The step `myowarp motion kinematics`."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from myowarp.apps.cli.motion.steps import (
    OUT,
    SHOWN,
    Model,
    Output,
    Span,
    check_results,
    needed,
    say_saved,
    setup_of,
)
from myowarp.apps.cli.options import Overwrite, optional
from myowarp.disk import make_folder

FILES = "ik.mot", "marker_errors.sto", "gaps.csv"
SENSOR_FILES = "ik.mot", "orientation_errors.sto"


@dataclass
class Kinematics:
    """Find joint angles from markers or inertial sensors, with the weights of an OpenSim set-up file.

    Example: myowarp motion kinematics gait.osim --markers walk.trc --setup ik.xml
    """

    model: Model
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
    span: Span = None
    output: Output = OUT
    overwrite: Overwrite = False

    def __call__(self) -> None:
        """Check, solve, write."""
        import numpy as np

        from myowarp.motion import trial
        from myowarp.motion.inverse_kinematics import MarkerErrors
        from myowarp.osim.body.skeleton import Bones

        setup = setup_of(
            self.setup,
            markers=self.markers,
            orientations=self.orientations,
            span=self.span,
            fill=self.fill,
        )
        if setup.orientations is not None:
            if setup.markers is not None:
                raise ValueError("motion kinematics takes --markers or --orientations, not both")
            check_results(self.output, SENSOR_FILES, self.overwrite)
            bones = Bones.read(self.model)
            make_folder(self.output)
            turned = trial.kinematics_of_sensors(bones, self.output, setup)
            lines = [f"{name}: {np.degrees(rms):.1f} degrees rms, {np.degrees(most):.1f} degrees at most"
                     for name, rms, most in turned.worst()[:SHOWN]]  # fmt: skip
            say_saved(lines, SENSOR_FILES, self.output)
            return
        needed(setup.markers, "kinematics", "markers")
        check_results(self.output, FILES, self.overwrite)
        bones, fitted = Bones.read(self.model, markers=self.marker_set), MarkerErrors()
        make_folder(self.output)
        for part in trial.kinematics_in_parts(bones, self.output, setup):
            fitted.add(part)
        lines = gaps_in(self.output / "gaps.csv")
        lines += [f"{marker}: {1e3 * rms:.1f} mm rms, {1e3 * most:.1f} mm at most"
                  for marker, rms, most in fitted.worst()[:SHOWN]]  # fmt: skip
        lines += [doubt] if (doubt := fitted.doubt()) else []
        say_saved(lines, FILES, self.output)


def gaps_in(path: Path) -> list[str]:
    """Return the longest gaps of markers that were not filled, one line each."""
    rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))[1:]
    left = [row for row in rows if row[3] == "no"]
    lines = [f"{name} was not seen from {first} to {last} s" for name, first, last, _ in left[:SHOWN]]
    if filled := len(rows) - len(left):
        lines.append(f"{filled} gaps were filled; gaps.csv lists all {len(rows)}")
    elif len(left) > SHOWN:
        lines.append(f"gaps.csv lists all {len(rows)}")
    return lines
