"""Muscles, ligaments and path springs of an .osim file."""

import math

from myowarp.osim.document.elements import Ligament, PathActuator
from myowarp.osim.document.functions import Constant, Function, Linear, Multiplier, ToeThenLine
from myowarp.osim.document.model import Muscle
from myowarp.osim.document.read.element import Element, number_of
from myowarp.osim.document.read.expressions import expression_in
from myowarp.osim.document.read.functions import READERS, function_in, read_function
from myowarp.osim.document.read.muscle_defaults import DEFAULTS, FORCE_LENGTH
from myowarp.osim.document.read.paths import Scope, read_path

COMMON = {
    "max_isometric_force": 1000.0,
    "optimal_fiber_length": 0.1,
    "tendon_slack_length": 0.2,
    "pennation_angle_at_optimal": 0.0,
    "max_contraction_velocity": 10.0,
    "ignore_tendon_compliance": 0.0,
    "ignore_activation_dynamics": 0.0,
    "min_control": 0.0,
    "max_control": 1.0,
}
"""Parameters of every muscle, with OpenSim's defaults."""

NEEDED = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length")
"""Parameters that may not be empty."""

RENAMED = {"pennation_angle": "pennation_angle_at_optimal"}
"""Names before 3.0."""

ABOVE = {
    **dict.fromkeys(("FmaxTendonStrain", "FmaxMuscleStrain", "KshapeActive", "KshapePassive", "Af"), 0.0),
    "Flen": 1.0,
    **dict.fromkeys(("activation_time_constant", "deactivation_time_constant", "time_scale"), 0.0),
    **dict.fromkeys(("active_force_width_scale", "passive_fiber_strain_at_one_norm_force"), 0.0),
    "tendon_strain_at_one_norm_force": 0.0,
}
"""Lower bounds of further parameters, in the classes that have them."""

STEEPEST = 50.0
"""KshapePassive, of which exponentials are taken, at most."""

OTHERS = {name for defaults in DEFAULTS.values() for name in defaults}
"""Parameters that some class has always; optional ones of a class are not among them."""

STRUCTURE = (
    "PathPointSet",
    "PathWrapSet",
    "GeometryPath",
    "path",
    "components",
    "appliesForce",
    "isDisabled",
    "connectors",
)


def is_on(element: Element) -> bool:
    """Return whether a force, constraint or controller is switched on; before 4.0: not `isDisabled`."""
    on = element.flag("appliesForce", "isEnforced", "enabled", default=True)
    return on and not element.flag("isDisabled", default=False)


def control_range(element: Element, low: float, high: float) -> tuple[float, float]:
    """Return the least and greatest control."""
    least = element.number("min_control", default=low, finite=False)
    most = element.number("max_control", default=high, finite=False)
    if least > most:
        raise element.error(f"must have min_control at most max_control, got {least:g} and {most:g}")
    return least, most


def _leaves(element: Element) -> tuple[dict[str, float], dict[str, Function]]:
    """Return the numbers that an element states, and its functions, by property."""
    numbers: dict[str, float] = {}
    curves: dict[str, Function] = {}
    for child in reversed(element.children):  # of two of a name the first one counts, as in OpenSim
        if child.tag in STRUCTURE:
            continue
        if child.tag in READERS or child.name.endswith("_curve"):
            curves[child.name] = read_function(child)
        elif child.children and (child.children[0].tag in READERS or child.tag.endswith("_curve")):
            curves[child.tag] = read_function(child.children[0])
        elif child.children:
            inner, _ = _leaves(child)
            numbers.update({f"{child.tag}.{name}": value for name, value in inner.items()})
        elif (word := child.text.strip().lower()) in ("true", "false"):
            numbers[RENAMED.get(child.tag, child.tag)] = float(word == "true")
        elif _is_number(word):
            value = element.number(child.tag, finite=child.tag not in ("min_control", "max_control"))
            numbers[RENAMED.get(child.tag, child.tag)] = value
    return numbers, curves


def _leaf(element: Element, name: str) -> Element | None:
    """Return the element of a parameter, under its name or the one before 3.0, here or in a curve."""
    *outer, last = name.split(".")
    inner: Element | None = element
    for tag in outer:
        inner = None if inner is None else inner.find(tag)
    before = [old for old, new in RENAMED.items() if new == last]
    return None if inner is None else inner.find(last, *before)


def _is_number(word: str) -> bool:
    """Return whether a text is one number; NaN is one, and refused later."""
    try:
        number_of(word)
    except ValueError:
        return False
    return True


def read_muscle(element: Element, scope: Scope) -> Muscle:
    """Return a muscle of any class that has the properties of OpenSim's Muscle.

    Raises:
        ValueError: A parameter is missing, not finite, or out of its range.
        NotImplementedError: Its path is of a kind that is not supported.
    """
    given, curves = ({}, {}) if element.fallback is None else _leaves(element.fallback)
    own_numbers, own_curves = _leaves(element)
    given, curves = {**given, **own_numbers}, {**curves, **own_curves}
    own = {**COMMON, **DEFAULTS[element.tag]}
    for name in own:
        found = _leaf(element, name)
        if found is not None and name not in given and (name in NEEDED or found.text.strip()):
            raise found.error(f"must be one number, got {found.text.strip()[:60]!r}")
    # OpenSim ignores parameters of other classes, such as a damping that a Thelen2003Muscle had before 3.0.
    values = {**own, **{name: given[name] for name in given if name in own or name not in OTHERS}}
    for name, low, high in (
        ("max_isometric_force", 0.0, math.inf),
        ("optimal_fiber_length", 1e-6, math.inf),
        ("tendon_slack_length", 0.0, math.inf),
        ("pennation_angle_at_optimal", -math.pi / 2, math.pi / 2),
        # Where a class has a time scale, that alone says how fast it is.
        ("max_contraction_velocity", 0.0 if "time_scale" in values else 1e-6, math.inf),
    ):
        if not low <= values[name] <= high:
            raise element.error(f"must have {name} from {low:g} to {high:g}, got {values[name]:g}")
    for name, low in ABOVE.items():
        if values.get(name, math.inf) <= low:
            raise element.error(f"must have {name} above {low:g}, got {values[name]:g}")
    if values.get("KshapePassive", 0.0) > STEEPEST:
        raise element.error(f"must have KshapePassive at most {STEEPEST:g}, got {values['KshapePassive']:g}")
    limits = control_range(element, values["min_control"], values["max_control"])
    return Muscle(
        name=element.name,
        type=element.tag,
        path=read_path(element, scope),
        max_isometric_force=values["max_isometric_force"],
        optimal_fiber_length=values["optimal_fiber_length"],
        tendon_slack_length=values["tendon_slack_length"],
        pennation_angle_at_optimal=values["pennation_angle_at_optimal"],
        max_contraction_velocity=values["max_contraction_velocity"],
        ignore_tendon_compliance=bool(values["ignore_tendon_compliance"]),
        ignore_activation_dynamics=bool(values["ignore_activation_dynamics"]),
        control_range=limits,
        applies_force=is_on(element),
        parameters={name: value for name, value in values.items() if name not in COMMON},
        curves=curves,
        given=frozenset(given),
    )


def read_path_actuator(element: Element, scope: Scope) -> PathActuator:
    """Return an actuator along a path."""
    force = element.number("optimal_force", default=1.0)
    limits = control_range(element, -math.inf, math.inf)
    return PathActuator(element.name, read_path(element, scope), force, limits)


def read_ligament(element: Element, scope: Scope) -> Ligament:
    """Return a ligament or a path spring.

    Raises:
        ValueError: Its resting length is not above 0, or its path is wrong.
    """
    length = element.number("resting_length", "slack_length", default=0.0)
    if element.tag == "ExpressionBasedPathForce":
        clamp = element.flag("clamp_stretch", default=True)
        formula = expression_in(element, "expression", ("s", "ldot"))
        stretch: tuple[tuple[str, float], ...] = (("variable", 0.0), ("number", length), ("sub", 0.0))
        stretch += (("number", 0.0), ("max", 0.0)) if clamp else ()
        formula = formula.of(0, stretch)
        return Ligament(
            element.name, element.tag, read_path(element, scope), 1.0, Constant(0.0), 0.0, 0.0, formula
        )
    if length <= 0:
        raise element.error(f"must have a resting length above 0, got {length:g}")
    force: Function
    dissipation = damping = 0.0
    if element.tag == "Ligament":
        curve = function_in(element, "force_length_curve") or FORCE_LENGTH
        force = Multiplier(curve, element.number("pcsa_force", default=0.0))
    elif element.tag == "Blankevoort1991Ligament":
        stiffness = element.number("linear_stiffness", default=1.0, least=0.0)
        force = ToeThenLine(stiffness, element.number("transition_strain", default=0.06, least=0.0))
        damping = element.number("damping_coefficient", default=0.003, least=0.0) / length
    else:
        stiffness = element.number("stiffness", least=0.0) * length
        force, dissipation = (
            Linear(stiffness, -stiffness),
            element.number("dissipation", default=0.0, least=0.0),
        )
    path = read_path(element, scope)
    return Ligament(element.name, element.tag, path, length, force, dissipation, damping)
