"""Set-up files of OpenSim's tools: which files a step reads, and how.

`InverseKinematicsTool`, `IMUInverseKinematicsTool`, `InverseDynamicsTool`, `AnalyzeTool` (with
`StaticOptimization`) and `CMCTool`. Files are beside the set-up file. What belongs to OpenSim's own solvers
(accuracies, integrators, optimisers) has no meaning here.
"""

from __future__ import annotations

import math
from pathlib import Path

from myowarp.motion.orientations import angles_in
from myowarp.motion.setup import MOTIONS, POSES, TrialSetup
from myowarp.motion.setup_words import Span, file_of, files_of, in_order, span_of
from myowarp.motion.tasks import tasks_of
from myowarp.osim.document.read.element import Element, parse

ALL = (-math.inf, math.inf)
TOOLS = {
    "InverseKinematicsTool": ALL,
    "IMUInverseKinematicsTool": ALL,
    "InverseDynamicsTool": ALL,
    "AnalyzeTool": (0.0, 1.0),
    "CMCTool": (0.0, 1.0),
}
"""Times of each where its set-up file states none [s]; that OpenSim 4.6 ends kinematics at 2 s is a slip."""
ANGLES = ("coordinates_file", "desired_kinematics_file", "states_file")
CUTOFFS = ("lowpass_cutoff_frequency_for_coordinates", "lowpass_cutoff_frequency")


def read_tool_setup(path: Path) -> TrialSetup:
    """Read a set-up file; a set of tasks alone says nothing else.

    Raises:
        ValueError: It is none.
        OSError: It, or a file of actuators, tasks or constraints, cannot be read.
    """
    root, _ = parse(path)
    tool = next((element for element in root.walk() if element.tag in TOOLS), None)
    other = next((element.tag for element in root.walk() if element.tag.endswith("Tool")), "")
    if tool is None and other:
        raise root.error(
            f"is a set-up file of OpenSim's {other}; kinematics takes those of {', '.join(POSES)}, steps "
            f"along a motion those of {', '.join(MOTIONS)}"
        )
    if tool is None and any(element.tag == "IKTaskSet" for element in root.walk()):
        return TrialSetup(path, "IKTaskSet", tasks=tasks_of(root), sources=(path,))
    if tool is None:
        raise root.error(f"holds none of {', '.join(f'<{name}>' for name in TOOLS)}")
    cutoff = max(tool.number(tag, default=-1.0) for tag in CUTOFFS)
    optimiser = next((element for element in tool.walk() if element.tag == "StaticOptimization"), None)
    force_sets = files_of(tool, "force_set_files")
    tasks, constraints = file_of(tool, "task_set_file"), file_of(tool, "constraints_file")
    reserves, unread = {}, []
    for file in force_sets:
        for actuator in _actuators(file):
            if actuator.tag == "CoordinateActuator":
                reserves[actuator.string("coordinate")] = actuator.number("optimal_force", default=1.0)
            else:
                unread.append(f"{actuator.tag} {actuator.name}")
    return TrialSetup(
        file=path,
        tool=tool.tag,
        markers=file_of(tool, "marker_file"),
        motion=file_of(tool, *ANGLES),
        loads=file_of(tool, "external_loads_file"),
        orientations=file_of(tool, "orientations_file"),
        sensor_angles=angles_in(tool),
        sensor_weights={
            one.name: one.number("weight", default=1.0)
            for one in tool.walk()
            if one.tag == "OrientationWeight" and one.name
        },
        coordinates=file_of(tool, "coordinate_file"),
        cutoff=cutoff if cutoff > 0.0 else None,
        span=_span(tool),
        tasks=tasks_of(root) if tool.tag == "InverseKinematicsTool" else None,
        exponent=None if optimiser is None else optimiser.number("activation_exponent", default=2.0),
        reserves=reserves,
        unread=tuple(unread),
        gains=_gains(tasks),
        controls=_controls(constraints),
        excluded=(
            tuple(tool.string("forces_to_exclude").split()) if tool.tag == "InverseDynamicsTool" else None
        ),
        sources=(path, *force_sets, *filter(None, (tasks, constraints))),
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
    """Return the range of time [s], None for all."""
    begin, end = TOOLS[tool.tag]
    if math.isinf(end):
        begin, end = span_of(tool, ALL)
    else:
        times = zip(("initial_time", "final_time"), (begin, end), strict=True)
        begin, end = in_order(tool, *(tool.number(tag, default=x, finite=False) for tag, x in times))
    return None if (begin, end) == ALL else (begin, end)
