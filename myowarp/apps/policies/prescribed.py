"""Controls over time that the controllers of an OpenSim model prescribe, as excitations.

    myowarp rollout --model arm.osim --policy arm.osim

Functions belong to actuators by their places, as in OpenSim. Controls of several controllers add up, but
those of an `ActuatorInputController` take the place of what came before; an actuator that none drives gets
0. Inputs of an `InputController` are columns of a `TableSource`; without inputs it does nothing, as in
OpenSim. A file of controls is a table over time, or a set of `ControlLinear`. Between two rows a control
changes linearly. Controllers of other classes are named in a line; a reflex is a condition, which that line
gives.

Source: OpenSim 4.6, the classes of `CONTROLLERS`.
"""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from myowarp.definitions.task import TaskSpec
from myowarp.laws.expressions import values_of
from myowarp.motion.setup_words import file_of
from myowarp.motion.storage import SUFFIXES, Storage, read_storage
from myowarp.osim.document.model import Loss
from myowarp.osim.document.read.element import Element, parse
from myowarp.osim.document.read.expressions import expression_of
from myowarp.osim.document.read.functions import read_function
from myowarp.osim.document.read.model import checked, read_model
from myowarp.osim.document.read.muscles import is_on
from myowarp.process import start_warp

logger = logging.getLogger("myowarp")

REFLEX = "ToyReflexController"
DRIVEN = ("Muscle", "Muscle_Deprecated", "Actuator", "ClutchedPathSpring", "ControllableSpring")
"""Ends of the names of OpenSim's classes of actuators."""
OVERWRITES = "ActuatorInputController"

Controls = dict[str, np.ndarray]
"""Of each actuator, at all times."""


def prescribed(path: Path, spec: TaskSpec) -> Storage:
    """Return the controls that a model prescribes, at the ends of the control steps of an episode.

    Args:
        path: The model.
        spec: The task in which they act.

    Raises:
        ValueError: It has no such controller, or one that says something impossible.
        NotImplementedError: A controller has a function of a class that is not supported.
        OSError: A file cannot be read.
    """
    root, _ = parse(path)
    checked(root)
    found = [element for element in root.walk() if element.tag in CONTROLLERS and is_on(element)]
    model = read_model(path)
    lost = [note for note in model.notes if isinstance(note, Loss) and note.effect == "control"]
    others = [f"{note.code} {note.path}" for note in lost if note.code not in CONTROLLERS]
    if not found:
        raise ValueError(
            f"policy {str(path)!r} needs a {' or '.join(CONTROLLERS)} that is on; the model has "
            f"{', '.join(others) or 'none'}{_reflexes(root)}"
        )
    if others:
        logger.warning("controls of %s are without %s%s", path.name, ", ".join(others), _reflexes(root))
    step = spec.physics_dt * spec.num_substeps
    time = step * np.arange(spec.horizon + 2)
    controls = {name: np.zeros(len(time)) for name in model.muscles}
    for element in found:
        for name, values in CONTROLLERS[element.tag](element, time).items():
            before = 0.0 if element.tag == OVERWRITES else controls.get(name, 0.0)
            controls[name] = before + values
    return Storage(tuple(controls), time, np.stack(list(controls.values()), axis=1))


def _reflexes(root: Element) -> str:
    """Return which condition the reflexes of a model are; "" where it has none."""
    gains = {
        name: element.number("gain", default=1.0)
        for element in root.walk()
        if element.tag == REFLEX and is_on(element)
        for name in _actuators(element)
    }
    return f"; a reflex is the condition 'stretch_reflex(gain={gains!r})'" if gains else ""


def _actuators(element: Element) -> list[str]:
    """Return the names of the actuators that a controller drives.

    Raises:
        ValueError: The model has not one of them.
    """
    paths = element.string("socket_actuators", "actuator_list").split()
    known = [one.name for one in _root(element).walk() if one.tag.endswith(DRIVEN)]
    names = known if paths == ["ALL"] else [path.rpartition("/")[2] for path in paths]
    if unknown := [name for name in names if name not in known]:
        raise element.error(f"drives the actuator {unknown[0]!r}, which the model does not have")
    return names


def _root(element: Element) -> Element:
    """Return the root of its document."""
    return element if element.parent is None else _root(element.parent)


def _of_functions(element: Element, time: np.ndarray) -> Controls:
    """Return the controls of a `PrescribedController`."""
    names, found = _actuators(element), {}
    functions = [one for place in element.children if "ControlFunctions" in (place.tag, place.name)
                 for one in (place.own("objects") or place).children if one.tag != "groups"]  # fmt: skip
    if functions and len(functions) != len(names):
        raise element.error(f"needs a function for each of its {len(names)} actuators, got {len(functions)}")
    start_warp()
    for name, function in zip(names, functions, strict=False):
        if (called := function.name.rpartition("/")[2]) in names and called != name:
            raise function.error(
                f"has the place of {name!r}; put functions in the order of the actuators, as OpenSim does"
            )
        read = read_function(function)
        try:
            program = expression_of(read)
        except NotImplementedError as error:
            raise function.error(str(error)) from None
        found[name] = values_of([program], time[:, None])[:, 0]
    if (method := element.string("interpolation_method", default="1")) not in ("", "1"):
        if element.string("controls_file"):
            raise element.error(f"interpolates its file by method {method}; only 1, linear, is supported")
    table = _table(element, "controls_file", time)
    return found | {name: values for name, values in table.items() if name in names or not names}


def _of_file(element: Element, time: np.ndarray) -> Controls:
    """Return the controls of a `ControlSetController`."""
    file = file_of(element, "controls_file")
    if file is None:
        raise element.error("names no <controls_file>")
    if file.suffix.lower() in SUFFIXES:
        return _table(element, "controls_file", time)
    sets = [one for one in parse(file)[0].walk() if one.tag in ("ControlLinear", "ControlConstant")]
    return {
        one.name.removesuffix(".excitation"): _over_nodes(one, time) for one in sets if one.name != "default"
    }


def _over_nodes(control: Element, time: np.ndarray) -> np.ndarray:
    """Return a `ControlLinear` or a `ControlConstant` over time.

    With `use_steps` a node's value holds from the node before it up to its own time.
    """
    if control.tag == "ControlConstant":
        return np.full(len(time), control.number("value", default=0.0))
    nodes = sorted((one.number("t"), one.number("value")) for one in control.objects("x_nodes"))
    if not nodes:
        raise control.error("has no <x_nodes>; a control needs one or more")
    at, values = np.array(nodes).T
    if control.flag("use_steps", default=False):
        return values[np.minimum(np.searchsorted(at, time), len(at) - 1)]
    found = np.interp(time, at, values)
    if control.flag("extrapolate", default=True) and len(at) > 1:
        for outside, (one, other) in ((time < at[0], (0, 1)), (time > at[-1], (-1, -2))):
            slope = (values[other] - values[one]) / (at[other] - at[one])
            found[outside] = values[one] + slope * (time[outside] - at[one])
    return found


def _of_synergies(element: Element, time: np.ndarray) -> Controls:
    """Return the controls of a `SynergyController`: weights times inputs, summed over synergies."""
    names, inputs = _actuators(element), _inputs(element, time)
    weights = [one.numbers("synergy_weights", count=len(names)) for one in element.objects("synergy_vectors")]
    if inputs and len(inputs) != len(weights):
        raise element.error(f"needs an input for each of its {len(weights)} synergies, got {len(inputs)}")
    total = np.zeros((len(names), len(time)))
    for weight, (_, values) in zip(weights, inputs, strict=False):
        total += weight[:, None] * values
    return dict(zip(names, total, strict=True)) if inputs else {}


def _of_inputs(element: Element, time: np.ndarray) -> Controls:
    """Return the controls of an `ActuatorInputController`; the alias of an input names its actuator."""
    names, found = _actuators(element), {}
    for alias, values in _inputs(element, time):
        name = alias.rpartition("/")[2]
        if name not in names:
            raise element.error(f"has an input called {alias!r}, which is none of its actuators")
        found[name] = values
    return found


def _inputs(element: Element, time: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return alias and values of each input of a controller.

    Raises:
        ValueError: An input is no column of a `TableSource`.
    """
    sources = {one.name: one for one in _root(element).walk() if one.tag.startswith("TableSource")}
    found = []
    for path in element.string("input_controls").split():
        place, _, alias = path.removesuffix(")").partition("(")
        component, _, output = place.partition("|")
        kind, _, label = output.partition(":")
        source = sources.get(component.rpartition("/")[2])
        if source is None or kind != "column":
            raise element.error(f"has the input {path!r}; only columns of a TableSource are supported")
        table = _table(source, "filename", time, named=False)
        if label not in table:
            raise source.error(f"has no column {label!r}; its file has {', '.join(table)}")
        found.append((alias or label, table[label]))
    return found


def _table(element: Element, tag: str, time: np.ndarray, named: bool = True) -> Controls:
    """Return the columns of a file that a property names, over time; labels become actuators' names."""
    file = file_of(element, tag)
    if file is None:
        return {}
    table = read_storage(file)
    names = [one.removesuffix(".excitation").rpartition("/")[2] if named else one for one in table.labels]
    return {
        name: np.interp(time, table.time, column) for name, column in zip(names, table.values.T, strict=True)
    }


CONTROLLERS: Mapping[str, Callable[[Element, np.ndarray], Controls]] = {
    "PrescribedController": _of_functions,
    "ControlSetController": _of_file,
    "SynergyController": _of_synergies,
    OVERWRITES: _of_inputs,
}
"""OpenSim's classes of controllers that act here, and who reads each."""
