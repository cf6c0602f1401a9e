"""Contact forces of an .osim file; their geometry is among its shapes."""

from myowarp.osim.document.elements import ContactForce, ContactParameters
from myowarp.osim.document.read.element import Element
from myowarp.osim.document.read.frames import socket
from myowarp.osim.document.read.paths import Scope

TRANSITION = 0.01
"""m/s: transition velocity where the file states none."""


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
