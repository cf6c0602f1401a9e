"""Set-up files of OpenSim's tools: which files a step reads, and how.

`InverseKinematicsTool`, `InverseDynamicsTool`, `AnalyzeTool` (with `StaticOptimization`) and `CMCTool`. Files
are beside the set-up file. What belongs to OpenSim's own solvers (accuracies, integrators, optimisers) has no
meaning here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from myowarp.motion.setup_words import Span, file_of, files_of, in_order, span_of
from myowarp.opensim.read.document import Element, parse

ALL = (-math.inf, math.inf)
TOOLS = {
    "InverseKinematicsTool": ALL,
    "InverseDynamicsTool": ALL,
    "AnalyzeTool": (0.0, 1.0),
    "CMCTool": (0.0, 1.0),
}
"""Times of each where its set-up file states none [s]; that OpenSim 4.6 ends kinematics at 2 s is a slip."""
MOTIONS = ("coordinates_file", "desired_kinematics_file", "states_file")
CUTOFFS = ("lowpass_cutoff_frequency_for_coordinates", "lowpass_cutoff_frequency")


@dataclass(frozen=True)
class ToolSetup:
    """What a set-up file says.

    Attributes:
        markers: Recorded markers, .trc.
        motion: Joint angles.
        loads: External loads.
        coordinates: Joint angles that kinematics should have.
        cutoff: Of the filter [Hz]; None: none.
        span: First and last time [s], of which one may be infinite; None: all.
        exponent: Of activations in the cost; None: it says none.
        reserves: Optimal force of its `CoordinateActuator`s, by coordinate [N m] or [N].
        unread: Actuators of other classes, which are left out.
        gains: Of CMC's tasks, by coordinate [1/s^2].
        controls: Least and greatest excitation of CMC's constraints, by muscle [1].
    """

    markers: Path | None = None
    motion: Path | None = None
    loads: Path | None = None
    coordinates: Path | None = None
    cutoff: float | None = None
    span: tuple[float, float] | None = None
    exponent: float | None = None
    reserves: Mapping[str, float] = field(default_factory=dict)
    unread: tuple[str, ...] = ()
    gains: Mapping[str, float] = field(default_factory=dict)
    controls: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def read_tool_setup(path: Path) -> ToolSetup:
    """Read a set-up file; a set of tasks alone says nothing else.

    Raises:
        ValueError: It is none.
        OSError: It, or a file of actuators, tasks or constraints, cannot be read.
    """
    root, _ = parse(path)
    tool = next((element for element in root.walk() if element.tag in TOOLS), None)
    if tool is None and any(element.tag == "IKTaskSet" for element in root.walk()):
        return ToolSetup()
    if tool is None:
        raise root.error(f"holds none of {', '.join(f'<{name}>' for name in TOOLS)}")
    cutoff = max(tool.number(tag, default=-1.0) for tag in CUTOFFS)
    optimiser = next((element for element in tool.walk() if element.tag == "StaticOptimization"), None)
    reserves, unread = {}, []
    for file in files_of(tool, "force_set_files"):
        for actuator in _actuators(file):
            if actuator.tag == "CoordinateActuator":
                reserves[actuator.string("coordinate")] = actuator.number("optimal_force", default=1.0)
            else:
                unread.append(f"{actuator.tag} {actuator.name}")
    return ToolSetup(
        file_of(tool, "marker_file"),
        file_of(tool, *MOTIONS),
        file_of(tool, "external_loads_file"),
        file_of(tool, "coordinate_file"),
        cutoff if cutoff > 0.0 else None,
        _span(tool),
        None if optimiser is None else optimiser.number("activation_exponent", default=2.0),
        reserves,
        tuple(unread),
        _gains(file_of(tool, "task_set_file")),
        _controls(file_of(tool, "constraints_file")),
    )


def _actuators(path: Path) -> list[Element]:
    """Return the actuators of a file."""
    return [element for element in parse(path)[0].walk() if element.tag.endswith("Actuator")]


def _gains(path: Path | None) -> dict[str, float]:
    """Return the gains of the tasks of a file, by coordinate [1/s^2]."""
    tasks = [] if path is None else [one for one in parse(path)[0].walk() if one.tag == "CMC_Joint"]
    return {
        one.string("coordinate", default=one.name): float(one.numbers("kp")[0])
        for one in tasks
        if one.flag("on", default=True) and one.name != "default"
    }


def _controls(path: Path | None) -> dict[str, tuple[float, float]]:
    """Return least and greatest excitations of the constraints of a file, by muscle."""
    found = [] if path is None else [one for one in parse(path)[0].walk() if one.tag == "ControlLinear"]
    return {
        one.name.removesuffix(".excitation"): (
            one.number("default_min", default=0.0),
            one.number("default_max", default=1.0),
        )
        for one in found
        if one.name != "default"
    }


def _span(tool: Element) -> Span | None:
    """Return the range of time [s], None for all.

    Raises:
        ValueError: It is none.
    """
    begin, end = TOOLS[tool.tag]
    if math.isinf(end):
        begin, end = span_of(tool, ALL)
    else:
        times = zip(("initial_time", "final_time"), (begin, end), strict=True)
        begin, end = in_order(tool, *(tool.number(tag, default=x, finite=False) for tag, x in times))
    return None if (begin, end) == ALL else (begin, end)
