"""Set-up of a trial: files, filter, times, weights and reserves, for steps and studies.

What a user states comes before what a set-up file of one of OpenSim's tools says (`tool_setup`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from myowarp.osim.body.model_forces import without
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.contacts import TYPES
from myowarp.osim.document.kinematics import floating

if TYPE_CHECKING:
    from myowarp.motion.muscle_forces import Mode
    from myowarp.motion.tasks import Tasks

EXPONENT = 2.0
"""Of activations in the cost, by default."""
POSES = "InverseKinematicsTool", "IMUInverseKinematicsTool", "IKTaskSet"
"""Tools, and sets of tasks, whose set-up files kinematics takes."""
MOTIONS = "InverseDynamicsTool", "AnalyzeTool", "CMCTool"
"""Tools whose set-up files every step along a motion takes."""


@dataclass(frozen=True)
class TrialSetup:
    """Set-up of a trial; None and nothing mean the default of a step.

    Attributes:
        file: The set-up file.
        tool: Element that it holds: the name of OpenSim's tool, or of its set of tasks; empty: no file.
        markers: Recorded markers, .trc.
        motion: Joint angles.
        loads: External loads.
        orientations: Recorded orientations of sensors.
        sensor_angles: From the sensors' world into OpenSim's, about its x, then y, then z [rad].
        sensor_weights: By sensor; others have 1.
        coordinates: Joint angles that kinematics should have.
        cutoff: Of the filter [Hz].
        span: First and last time [s], of which one may be infinite.
        fill: Longest gap of a marker that a spline bridges [s].
        tasks: Weights of markers and coordinates.
        mode: What muscles can give, see `muscle_forces`.
        exponent: Of activations in the cost; None: as `EXPONENT`.
        reserve: Force of a reserve at cost 1 on every coordinate [N m] or [N], in place of `reserves`.
        residual: The same on the coordinates that carry the model through space.
        reserves: The same of the actuators of a set-up file, by coordinate.
        unread: Actuators of other classes, which are left out.
        gains: Ways back to a motion that is tracked, by coordinate [1/s^2].
        controls: Least and greatest excitation of a motion that is tracked, by muscle [1].
        strength: Factors on maximum isometric forces in a motion that is tracked, by muscle.
        contact: "opensim": contact forces of the model act beside the loads; None: they rest.
        excluded: Forces that inverse dynamics leaves out; None: the tool is another one.
        sources: Files that were read for this: the set-up file, and those that it is spread over.
    """

    file: Path | None = None
    tool: str = ""
    markers: Path | None = None
    motion: Path | None = None
    loads: Path | None = None
    orientations: Path | None = None
    sensor_angles: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_weights: Mapping[str, float] = field(default_factory=dict)
    coordinates: Path | None = None
    cutoff: float | None = None
    span: tuple[float, float] | None = None
    fill: float | None = None
    tasks: Tasks | None = None
    mode: Mode = "equilibrium"
    exponent: float | None = None
    reserve: float | None = None
    residual: float | None = None
    reserves: Mapping[str, float] = field(default_factory=dict)
    unread: tuple[str, ...] = ()
    gains: Mapping[str, float] = field(default_factory=dict)
    controls: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    strength: Mapping[str, float] = field(default_factory=dict)
    contact: str | None = None
    excluded: tuple[str, ...] | None = None
    sources: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        """Check what is stated.

        Raises:
            ValueError: A number is out of bounds.
        """
        for name, least in (("reserve", 0.0), ("residual", 0.0), ("exponent", 1.0)):
            value = getattr(self, name)
            if value is not None and not least <= value < float("inf"):
                raise ValueError(f"--{name} must be at least {least:g} and finite, got {value:g}")

    def check_tool(self, tools: Sequence[str]) -> None:
        """Check that a set-up file is one that a step takes.

        Raises:
            ValueError: It is another tool's, whose times, filter and weights are not meant for the step.
        """
        if self.tool and self.tool not in tools:
            raise ValueError(
                f"{str(self.file)!r} is a set-up file of OpenSim's {self.tool}; this step takes those of "
                f"{', '.join(tools)}; give one of these, or options in place of --setup"
            )

    @property
    def recording(self) -> Path:
        """The file of recorded markers.

        Raises:
            ValueError: There is none.
        """
        if self.markers is None:
            raise ValueError("joint angles need recorded markers; give a .trc file with --markers FILE")
        return self.markers

    @property
    def angles(self) -> Path:
        """The file of joint angles.

        Raises:
            ValueError: There is none, or the set-up file is not of a tool that has a motion.
        """
        self.check_tool(MOTIONS)
        if self.motion is None:
            raise ValueError("this step needs joint angles; give a .mot or .sto file with --motion FILE")
        return self.motion

    @property
    def whole(self) -> Self:
        """The same set-up, of all of a motion."""
        return replace(self, span=None)

    def within(self, time: np.ndarray) -> tuple[float, float]:
        """Return the first and the last time, where the set-up has none those of a motion [s]."""
        begin, end = self.span or (-np.inf, np.inf)
        return float(time[0] if np.isinf(begin) else begin), float(time[-1] if np.isinf(end) else end)

    def stating(self, **stated: Any) -> Self:
        """Return this with what a user states in place of what it has; None: nothing is stated."""
        return replace(self, **{name: value for name, value in stated.items() if value is not None})

    def reserves_of(self, bones: Bones) -> dict[str, float]:
        """Return the force of the reserve of each coordinate that has one [N m] or [N].

        Raises:
            ValueError: A residual is stated, and nothing carries the model through space.
        """
        root = floating(bones.model)
        if self.residual is not None and not root:
            raise ValueError(
                f"--residual is of coordinates that carry a model through space; {bones.model.name!r} has "
                "none, so leave it out"
            )
        if self.reserve is None:
            found = {name: force for name, force in self.reserves.items() if name in bones.coordinates}
        else:
            found = dict.fromkeys(bones.coordinates, self.reserve)
        if self.residual is not None:
            found |= dict.fromkeys(root, self.residual)
        return {name: force for name, force in found.items() if force}

    def model_of(self, bones: Bones) -> tuple[Bones, list[str]]:
        """Return the model without the forces that are excluded, and what is to be said of them.

        Raises:
            ValueError: Contact forces are to act, and the model has none.
        """
        lines = [f"left out of {self.file}: {', '.join(self.unread)}"] if self.unread else []
        touching = len(bones.model.contact_forces)
        if self.contact is not None and not touching:
            raise ValueError(
                f"--contact opensim needs a {' or '.join(TYPES)} in the model; "
                f"{bones.model.source.name} has none"
            )
        if touching and self.loads is not None:
            lines.append(
                f"{touching} contact forces of the model act beside the external loads of "
                f"{self.loads.name}: the ground may push twice"
            )
        if self.excluded is None:
            return bones, lines
        model, unknown = without(bones.model, self.excluded)
        lines += [f"forces_to_exclude names {name!r}, which the model has not" for name in unknown]
        if not {"ALL", "ACTUATORS", "MUSCLES"} & {name.upper() for name in self.excluded}:
            lines.append(
                "forces_to_exclude has no Muscles: OpenSim's moments are then what muscles at their default "
                "activations leave over; these are what muscles have to give"
            )
        return Bones(model, bones.device), lines
