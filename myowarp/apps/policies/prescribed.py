"""Controls that a model of OpenSim prescribes: its `PrescribedController`s, as excitations over time.

    myowarp rollout --model arm.osim --policy arm.osim

Several controllers of one actuator add up, as in OpenSim; an actuator that none of them drives gets 0. A file
of controls that a controller names is a table over time, between whose rows a control changes linearly.

Source: OpenSim 4.6, class PrescribedController.
"""

from pathlib import Path

import numpy as np

from myowarp.definitions.task import TaskSpec
from myowarp.laws.expressions import values_of
from myowarp.motion.storage import Storage, read_storage
from myowarp.osim.document.read.element import Element, parse
from myowarp.osim.document.read.expressions import expression_of
from myowarp.osim.document.read.functions import READERS, read_function
from myowarp.osim.document.read.model import checked, read_model
from myowarp.osim.document.read.muscles import is_on

CONTROLLER = "PrescribedController"


def prescribed(path: Path, spec: TaskSpec) -> Storage:
    """Return the controls that a model prescribes, at the ends of the control steps of an episode.

    Args:
        path: The model.
        spec: The task in which they act.

    Raises:
        ValueError: It has no such controller, or one that says something impossible.
        OSError: A file cannot be read.
    """
    root, _ = parse(path)
    checked(root)
    found = [element for element in root.walk() if element.tag == CONTROLLER and is_on(element)]
    if not found:
        raise ValueError(f"policy {str(path)!r} needs a {CONTROLLER} that is on; the model has none")
    step = spec.physics_dt * spec.num_substeps
    time = step * np.arange(spec.horizon + 2)
    controls = {name: np.zeros(len(time)) for name in read_model(path).muscles}
    for element in found:
        for name, values in _controls(element, path, time).items():
            controls[name] = controls.get(name, 0.0) + values
    return Storage(tuple(controls), time, np.stack(list(controls.values()), axis=1))


def _controls(element: Element, path: Path, time: np.ndarray) -> dict[str, np.ndarray]:
    """Return what one controller prescribes, by the name of the actuator."""
    actuators = element.string("socket_actuators", "actuator_list").split()
    names = [actuator.rpartition("/")[2] for actuator in actuators]
    functions = [one for place in element.children if "ControlFunctions" in (place.tag, place.name)
                 for one in (place.own("objects") or place).children if one.tag in READERS]  # fmt: skip
    found = {}
    for number, function in enumerate(functions):
        name = function.name.rpartition("/")[2]
        if name not in names:  # without a name its place counts
            if number >= len(names):
                raise function.error(f"is of the actuator {name!r}, which the controller does not drive")
            name = names[number]
        try:
            program = expression_of(read_function(function))
        except NotImplementedError as error:
            raise function.error(str(error)) from None
        found[name] = values_of([program], time[:, None])[:, 0]
    if file := element.string("controls_file"):
        if (method := element.string("interpolation_method", default="1")) not in ("", "1"):
            raise element.error(f"interpolates its file by method {method}; only 1, linear, is supported")
        table = read_storage(path.parent / file)
        for label, column in zip(table.labels, table.values.T, strict=True):
            name = label.removesuffix(".excitation").rpartition("/")[2]
            if name in names or not names:
                found[name] = np.interp(time, table.time, column)
    return found
