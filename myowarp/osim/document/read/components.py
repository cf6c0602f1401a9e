"""Everything of an .osim file that stands on bodies and coordinates: forces, constraints, markers."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Literal

from myowarp.osim.document.model import Coupler, Loss, Note
from myowarp.osim.document.read import forces as read_forces
from myowarp.osim.document.read import muscles as read_muscles
from myowarp.osim.document.read.element import Element
from myowarp.osim.document.read.frames import FRAMES
from myowarp.osim.document.read.joints import JOINTS
from myowarp.osim.document.read.muscle_defaults import DEFAULTS
from myowarp.osim.document.read.paths import Scope
from myowarp.osim.document.read.shapes import SHAPES

READERS: dict[str, tuple[str, Callable[[Element, Scope], Any]]] = {
    **{tag: ("muscles", read_muscles.read_muscle) for tag in DEFAULTS},
    "Ligament": ("ligaments", read_muscles.read_ligament),
    "Blankevoort1991Ligament": ("ligaments", read_muscles.read_ligament),
    "PathSpring": ("ligaments", read_muscles.read_ligament),
    "ExpressionBasedPathForce": ("ligaments", read_muscles.read_ligament),
    "PathActuator": ("path_actuators", read_muscles.read_path_actuator),
    "CoordinateActuator": ("coordinate_actuators", read_forces.read_coordinate_actuator),
    "ActivationCoordinateActuator": ("coordinate_actuators", read_forces.read_coordinate_actuator),
    "TorqueActuator": ("body_actuators", read_forces.read_body_actuator),
    "PointActuator": ("body_actuators", read_forces.read_body_actuator),
    "BodyActuator": ("body_actuators", read_forces.read_spatial_actuator),
    "CoordinateLimitForce": ("limit_forces", read_forces.read_limit_force),
    "ExpressionBasedCoordinateForce": ("coordinate_formulas", read_forces.read_coordinate_formula),
    "PrescribedForce": ("prescribed_forces", read_forces.read_prescribed_force),
    "SpringGeneralizedForce": ("coordinate_springs", read_forces.read_coordinate_spring),
    "BushingForce": ("bushings", read_forces.read_bushing),
    "FunctionBasedBushingForce": ("bushings", read_forces.read_bushing),
    "ExpressionBasedBushingForce": ("bushings", read_forces.read_bushing),
    "PointToPointSpring": ("ligaments", read_forces.read_between_points),
    "ExpressionBasedPointToPointForce": ("ligaments", read_forces.read_between_points),
    "PointToPointActuator": ("path_actuators", read_forces.read_between_points),
    "SmoothSphereHalfSpaceForce": ("contact_forces", read_forces.read_smooth_contact),
    "HuntCrossleyForce": ("contact_forces", read_forces.read_hunt_crossley),
    "CoordinateCouplerConstraint": ("couplers", read_forces.read_coupler),
    "WeldConstraint": ("constraints", read_forces.read_constraint),
    "PointConstraint": ("constraints", read_forces.read_constraint),
    "Marker": ("markers", read_forces.read_marker),
}
"""OpenSim's class: field of `Model`, and who reads one or several. Bodies and joints are read before."""

MAX_CHAIN = 30  # couplers in series; composed functions are evaluated recursively

FIELDS = tuple(dict.fromkeys(field for field, _ in READERS.values()))
MAPPINGS = ("couplers", "muscles", "ligaments", "markers")
"""Fields that are looked up by name; the others are tuples."""

INERT = (*FRAMES, "Station", "IMU", "FrameGeometry", "ModelVisualPreferences", "TableSource__double_")
"""Components that others refer to, or that only record or show."""


CONTACT = ("ElasticFoundationForce", "MeyerFregly2016Force")
"""Forces between contact geometries that nobody reads."""


def unread(path: str, element: Element) -> Note:
    """Return what is said of a component that nobody reads."""
    why = "is in another file, which is not read" if "file" in element.attributes else "has no counterpart"
    rule = f"{element.tag} {why}; left out"
    where = path.split("/")[1]
    if where in ("markerset", "probeset"):
        return Note(path, rule, "0: records, and does not act")
    if where == "controllerset" or element.tag.endswith("Controller"):
        return Loss(path, rule, code=element.tag, effect="control")
    if element.tag in CONTACT:
        return Loss(path, rule, code=element.tag, effect="contact", names=element.words())
    constraint = where == "constraintset" or element.tag.endswith("Constraint")
    effect: Literal["motion", "force"] = "motion" if constraint else "force"
    return Loss(path, rule, code=element.tag, effect=effect, names=element.words())


def read_components(components: list[tuple[str, Element]], scope: Scope) -> dict[str, Any]:
    """Return the fields of `Model` that `READERS` fills; what nobody reads gets a note."""
    found: dict[str, dict[str, Any]] = {field: {} for field in FIELDS}
    for path, element in components:
        if element.tag in (*INERT, *JOINTS, *SHAPES):
            continue
        if element.tag not in DEFAULTS and not read_muscles.is_on(element):
            scope.notes.append(Note(path, "switched off in the file; left out", "0"))
            continue
        if element.tag not in READERS:
            scope.notes.append(unread(path, element))
            continue
        field, read = READERS[element.tag]
        items = read(element, scope)
        for item in items if isinstance(items, tuple) else (items,):
            key = item.dependent if isinstance(item, Coupler) else item.name
            if key not in found[field]:
                found[field][key] = item
                continue
            # Names of markers need not differ, and two couplers may want one coordinate.
            if field == "couplers":
                raise element.error(f"drives coordinate {key!r}, as {found[field][key].name!r} does")
            again = f"a second {element.tag} of that name; left out"
            scope.notes.append(
                Note(path, again)
                if field == "markers"
                else Loss(path, again, code=element.tag, names=element.words())
            )
        if element.tag == "ActivationCoordinateActuator":
            rule = "its activation dynamics are left out; it acts at once"
            scope.notes.append(Loss(path, rule, code=element.tag, effect="control"))
    _refuse_cycles(found["couplers"], components)
    return {
        field: MappingProxyType(items) if field in MAPPINGS else tuple(items.values())
        for field, items in found.items()
    }


def _refuse_cycles(couplers: Mapping[str, Coupler], components: list[tuple[str, Element]]) -> None:
    """Raise if a coordinate depends on itself."""
    for coupler in couplers.values():
        seen, name = {coupler.dependent}, coupler.independent
        while name in couplers and name not in seen:
            seen.add(name)
            name = couplers[name].independent
        if name in seen or len(seen) > MAX_CHAIN:
            element = next(element for _, element in components if element.name == coupler.name)
            reason = (
                "depend on itself" if name in seen else f"depend on another through over {MAX_CHAIN} couplers"
            )
            raise element.error(f"makes coordinate {name!r} {reason}")
