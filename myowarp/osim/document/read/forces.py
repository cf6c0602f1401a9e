"""Actuators, springs, contact forces, constraints and shapes of an .osim file."""

import math
from typing import Any, Literal

import numpy as np

from myowarp.laws.expressions import Expression
from myowarp.osim.document.elements import (
    BodyActuator,
    Bushing,
    ContactForce,
    ContactParameters,
    CoordinateActuator,
    CoordinateFormula,
    CoordinateLimitForce,
    CoordinateSpring,
    Ligament,
    Path,
    PathActuator,
    PathPoint,
    PrescribedForce,
)
from myowarp.osim.document.functions import Constant, Function, Linear, Multiplier
from myowarp.osim.document.model import GROUND, Constraint, Coupler, Marker
from myowarp.osim.document.read.element import Element
from myowarp.osim.document.read.expressions import expression_in, expression_of
from myowarp.osim.document.read.frames import Frames, pose_of, socket
from myowarp.osim.document.read.functions import function_in, read_function
from myowarp.osim.document.read.muscles import control_range
from myowarp.osim.document.read.paths import Scope

ZERO = (0.0, 0.0, 0.0)
DEFLECTIONS = ("theta_x", "theta_y", "theta_z", "delta_x", "delta_y", "delta_z")
BUSHING_FORCES = ("Mx", "My", "Mz", "Fx", "Fy", "Fz")
TRANSITION = 0.01
"""m/s: transition velocity of a contact force where the file states none."""


def read_coordinate_actuator(element: Element, scope: Scope) -> CoordinateActuator:
    """Return an actuator on a coordinate."""
    coordinate = scope.coordinate(element, "coordinate")
    limits = control_range(element, -math.inf, math.inf)
    return CoordinateActuator(element.name, coordinate, element.number("optimal_force", default=1.0), limits)


def read_body_actuator(element: Element, scope: Scope) -> BodyActuator:
    """Return a `PointActuator` or a `TorqueActuator`.

    Raises:
        ValueError: It names no body, or its direction is zero.
    """
    torque = element.tag == "TorqueActuator"
    kind: Literal["point", "torque"] = "torque" if torque else "point"
    body, frame = scope.frames.attached(element, *(("bodyA",) if torque else ("body",)))
    reaction = GROUND
    if torque and (other := socket(element, "bodyB")):
        reaction, _ = scope.frames.resolve(other, element)
    axis = element.numbers("axis" if torque else "direction", default=(0.0, 0.0, 1.0), count=3)
    if np.linalg.norm(axis) < 1e-9:
        raise element.error("must have a direction other than 0 0 0")
    if element.flag("point_is_global", default=False):
        raise element.unsupported("acts at a point fixed in ground; only points of the body are supported")
    in_ground = element.flag("torque_is_global" if torque else "force_is_global", default=torque)
    return BodyActuator(
        element.name,
        kind,
        body,
        reaction,
        frame.point(element.numbers("point", default=ZERO, count=3)),
        axis / np.linalg.norm(axis) if in_ground else frame.rotation @ axis / np.linalg.norm(axis),
        in_ground,
        element.number("optimal_force", default=1.0),
        control_range(element, -math.inf, math.inf),
    )


def read_spatial_actuator(element: Element, scope: Scope) -> tuple[BodyActuator, ...]:
    """Return a `BodyActuator`: a motor for each of its six controls, three torques and three forces of 1.

    Their names are those of OpenSim's controls.

    Raises:
        NotImplementedError: It acts at a point of ground.
    """
    body, frame = scope.frames.attached(element, "body")
    if element.flag("point_is_global", default=False):
        raise element.unsupported("acts at a point fixed in ground; only points of the body are supported")
    in_ground = element.flag("spatial_force_is_global", default=True)
    point = frame.point(element.numbers("point", default=ZERO, count=3))
    axes = np.eye(3) if in_ground else frame.rotation.T
    kinds: tuple[Literal["torque", "point"], ...] = "torque", "point"
    limits = control_range(element, -math.inf, math.inf)
    return tuple(
        BodyActuator(f"{element.name}_{number}", kind, body, GROUND, point, axis, in_ground, 1.0, limits)
        for number, (kind, axis) in enumerate((kind, axis) for kind in kinds for axis in axes)
    )


def read_limit_force(element: Element, scope: Scope) -> CoordinateLimitForce:
    """Return the springs at a coordinate's limits; OpenSim writes those of angles in degrees."""
    name = scope.coordinate(element, "coordinate")
    unit = math.radians(1.0) if scope.coordinates[name].rotational else 1.0
    low, high = element.number("lower_limit", default=0.0), element.number("upper_limit", default=0.0)
    if low > high:
        raise element.error(f"must have lower_limit at most upper_limit, got {low:g} and {high:g}")
    stiff = element.number("lower_stiffness", default=1.0), element.number("upper_stiffness", default=1.0)
    return CoordinateLimitForce(
        element.name,
        name,
        (low * unit, high * unit),
        (stiff[0] / unit, stiff[1] / unit),
        element.number("damping", default=0.001) / unit,
        element.number("transition", default=0.1) * unit,
    )


def read_coordinate_spring(element: Element, scope: Scope) -> CoordinateSpring:
    """Return a `SpringGeneralizedForce`."""
    return CoordinateSpring(
        element.name,
        scope.coordinate(element, "coordinate"),
        element.number("stiffness", default=0.0),
        element.number("rest_length", default=0.0),
        element.number("viscosity", default=0.0),
    )


def _two_frames(element: Element, frames: Frames) -> tuple[tuple[str, str], tuple[Any, Any]]:
    """Return bodies and poses of `frame1` and `frame2`, before 4.0 `body_1` and `body_2`."""
    bodies, poses = [], []
    for side in ("1", "2"):
        body, base = frames.attached(element, f"frame{side}", f"body_{side}")
        offset = pose_of(element, (f"location_body_{side}",), (f"orientation_body_{side}",))
        bodies.append(body)
        poses.append(base @ offset)
    return (bodies[0], bodies[1]), (poses[0], poses[1])


def read_bushing(element: Element, scope: Scope) -> Bushing:
    """Return a bushing: `BushingForce`, or one of functions or formulas."""
    bodies, poses = _two_frames(element, scope.frames)
    properties = (
        "rotational_stiffness",
        "translational_stiffness",
        "rotational_damping",
        "translational_damping",
    )
    turn, shift, turn_damping, shift_damping = (
        element.numbers(name, default=ZERO, count=3) for name in properties
    )
    formulas: list[Expression] = []
    if element.tag == "ExpressionBasedBushingForce":
        formulas = [expression_in(element, f"{one}_expression", DEFLECTIONS) for one in BUSHING_FORCES]
    elif element.tag == "FunctionBasedBushingForce":
        for number, (one, deflection) in enumerate(zip(BUSHING_FORCES, DEFLECTIONS, strict=True)):
            tag = f"{one[0].lower()}_{one[1]}_{deflection}_function"
            formulas.append(_program(element, function_in(element, tag) or Constant(0.0), number))
    return Bushing(
        element.name, bodies, poses, turn, shift, turn_damping, shift_damping, element.tag, tuple(formulas)
    )


def _program(element: Element, function: Function, variable: int = 0) -> Expression:
    """Return a function of one variable as a program."""
    try:
        return expression_of(function, variable)
    except NotImplementedError as error:
        raise element.unsupported(str(error)) from None


def read_coordinate_formula(element: Element, scope: Scope) -> CoordinateFormula:
    """Return an `ExpressionBasedCoordinateForce`."""
    coordinate = scope.coordinate(element, "coordinate")
    return CoordinateFormula(element.name, coordinate, expression_in(element, "expression", ("q", "qdot")))


def read_between_points(element: Element, scope: Scope) -> Ligament | PathActuator:
    """Return a force along the line between two points: a spring, a formula, or an actuator.

    Raises:
        NotImplementedError: Its points are fixed in ground.
    """
    letters = "AB" if element.tag == "PointToPointActuator" else "12"
    if element.flag("points_are_global", default=False):
        raise element.unsupported("acts between points of ground; only points of bodies are supported")
    points = []
    for letter in letters:
        body, frame = scope.frames.attached(element, f"body{letter}")
        location = frame.point(element.numbers(f"point{letter}", default=ZERO, count=3))
        points.append(PathPoint(f"{element.name}-{letter}", body, location))
    path = Path(tuple(points), ())
    if element.tag == "PointToPointActuator":
        force = -element.number("optimal_force", default=1.0)
        return PathActuator(element.name, path, force, control_range(element, -math.inf, math.inf))
    if element.tag == "PointToPointSpring":
        stiffness, rest = element.number("stiffness", default=1.0), element.number("rest_length", default=0.0)
        formula = expression_of(Linear(stiffness, -stiffness * rest))
    else:
        formula = expression_in(element, "expression", ("d", "ddot"))
    return Ligament(element.name, element.tag, path, 1.0, Constant(0.0), 0.0, 0.0, formula)


def read_prescribed_force(element: Element, scope: Scope) -> PrescribedForce:
    """Return a `PrescribedForce`.

    Raises:
        ValueError: A set of functions has not three.
    """
    body, frame = scope.frames.attached(element, "frame", "body")
    formulas: list[Expression] = []
    for tag in ("forceFunctions", "pointFunctions", "torqueFunctions"):
        found = [read_function(one) for place in element.children if tag in (place.tag, place.name)
                 for one in (place.own("objects") or place).children if one.tag != "groups"]  # fmt: skip
        if found and len(found) != 3:
            raise element.error(f"must have 3 functions or none as {tag}, got {len(found)}")
        formulas += [_program(element, function) for function in found or [Constant(0.0)] * 3]
    return PrescribedForce(
        element.name,
        body,
        tuple(formulas),
        frame,
        element.flag("forceIsGlobal", default=True),
        element.flag("pointIsGlobal", default=False),
    )


def read_smooth_contact(element: Element, scope: Scope) -> ContactForce:
    """Return a `SmoothSphereHalfSpaceForce`."""
    names = tuple(_last(socket(element, name)) for name in ("half_space", "sphere"))
    smoothing = (
        element.number("constant_contact_force", default=1e-5, least=0.0),
        element.number("hertz_smoothing", default=300.0, least=0.0),
        element.number("hunt_crossley_smoothing", default=50.0, least=0.0),
    )
    parts = (_parameters(element, names, 1.0),)
    return ContactForce(element.name, element.tag, parts, _transition(element), smoothing)


def read_hunt_crossley(element: Element, scope: Scope) -> ContactForce:
    """Return a `HuntCrossleyForce`."""
    sets = f"{element.tag}::ContactParametersSet", "contact_parameters"
    parts = tuple(
        _parameters(part, tuple(_last(word) for word in part.string("geometry").split()), 0.0)
        for part in element.objects(*sets)
    )
    return ContactForce(element.name, element.tag, parts, _transition(element))


def _parameters(element: Element, geometries: tuple[str, ...], stiffness: float) -> ContactParameters:
    """Return the material of some geometries; of the stiffness where the file states none [N/m^2]."""
    numbers = ("dissipation", "static_friction", "dynamic_friction", "viscous_friction")
    stiff = element.number("stiffness", default=stiffness, least=0.0)
    return ContactParameters(
        geometries, stiff, *(element.number(name, default=0.0, least=0.0) for name in numbers)
    )


def _transition(element: Element) -> float:
    """Return the transition velocity [m/s]."""
    found = element.number("transition_velocity", default=TRANSITION)
    if found <= 0:
        raise element.error(f"must have a transition_velocity above 0, got {found:g}")
    return found


def _last(path: str) -> str:
    """Return the last part of a path."""
    return path.rstrip("/").rpartition("/")[2]


def read_constraint(element: Element, scope: Scope) -> Constraint:
    """Return a `WeldConstraint` or a `PointConstraint`."""
    kind: Literal["weld", "point"] = "weld" if element.tag == "WeldConstraint" else "point"
    return Constraint(element.name, kind, *_two_frames(element, scope.frames))


def read_coupler(element: Element, scope: Scope) -> Coupler:
    """Return a `CoordinateCouplerConstraint`.

    Raises:
        NotImplementedError: It has several independent coordinates.
        ValueError: It has none, or names one that the model does not have.
    """
    function = function_in(element, "coupled_coordinates_function")
    if function is None:
        raise element.error("has no <coupled_coordinates_function>")
    independent = element.string("independent_coordinate_names").strip("()").split()
    dependent = element.string("dependent_coordinate_name")
    if len(independent) > 1:
        raise element.unsupported(f"depends on {len(independent)} coordinates; one is supported")
    for name in (*independent, dependent):
        if name not in scope.coordinates:
            raise element.error(f"refers to coordinate {name!r}, which the model does not have")
    if not independent or independent[0] == dependent:
        raise element.error("must have an independent coordinate other than the dependent one")
    scale = element.number("scale_factor", default=1.0)
    return Coupler(
        element.name, dependent, independent[0], function if scale == 1 else Multiplier(function, scale)
    )


def read_marker(element: Element, scope: Scope) -> Marker:
    """Return a marker."""
    body, frame = scope.frames.attached(element, "parent_frame", "body")
    return Marker(element.name, body, frame.point(element.numbers("location", default=ZERO, count=3)))
