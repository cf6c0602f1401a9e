"""Targets of a pose: weights of markers and coordinates in a set-up file of OpenSim."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from myowarp.osim.document.read.element import Element

WITH = ("InverseKinematicsTool", "MarkerPlacer")
"""Tools with a set of tasks, which may be empty."""


@dataclass(frozen=True)
class Tasks:
    """Weights, 0 for tasks that do not apply.

    Attributes:
        markers: By marker.
        coordinates: By coordinate.
        values: Wanted values that the file states itself, by coordinate [rad] or [m].
        recorded: Coordinates that have their wanted values in a file of joint angles.
    """

    markers: Mapping[str, float]
    coordinates: Mapping[str, float]
    values: Mapping[str, float]
    recorded: tuple[str, ...] = ()

    def among(self, names: Sequence[str]) -> dict[str, float] | None:
        """Return the weights of those of some markers that have one; None: the file leaves them out.

        All markers count the same then, as in OpenSim.
        """
        return {name: self.markers[name] for name in self.markers if name in names} if self.markers else None


def tasks_of(root: Element) -> Tasks:
    """Return the tasks in an element of a set-up file.

    Raises:
        ValueError: It has none of markers, and is no tool's without such tasks.
    """
    weights: dict[str, dict[str, float]] = {"IKMarkerTask": {}, "IKCoordinateTask": {}}
    wanted, recorded = {}, []
    for element in root.walk():
        if element.tag in weights:
            on = element.flag("apply", default=True)
            weights[element.tag][element.name] = element.number("weight", default=1.0) if on else 0.0
            kind = element.string("value_type", default="default_value")
            if on and kind == "from_file":
                recorded.append(element.name)
            if kind == "manual_value":
                wanted[element.name] = element.number("value", default=0.0)
    holders = [one for one in root.walk() if one.tag in WITH]
    others = [one for holder in holders for one in holder.objects("IKTaskSet") if one.tag not in weights]
    if not weights["IKMarkerTask"] and (others or not holders):
        raise root.error("has no <IKMarkerTask>; a set-up file of inverse kinematics or of scaling has")
    return Tasks(weights["IKMarkerTask"], weights["IKCoordinateTask"], wanted, tuple(recorded))
