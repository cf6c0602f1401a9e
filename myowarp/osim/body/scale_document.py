"""A scaled model, as a document: every length of an .osim file times the factors of the body that it is in.

What each element does with the factors s of its body is OpenSim's: a point, a frame and a mass centre are
multiplied axis by axis; so is a sphere's radius with the mean of s, and the size of another surface by how
much its own axes grow. A translation of a `CustomJoint` grows by |axis| . s of the body that carries the
joint, unless it is the coordinate itself; then the coupler that leads it grows so. Muscles keep the shares of
fiber and tendon: both grow as the path does in the default pose. A body keeps its mass, or takes s_x s_y s_z
of it; its inertia is that of a body scaled alike, or of a cylinder if s is not the same in all axes. At last
masses are multiplied so that they add up to the subject's.

Source: OpenSim's classes, `extendScale` and `extendPostScale` of each, and `Body::scaleInertialProperties`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from myowarp.osim.body.moment_arm import own_reference, poses_of
from myowarp.osim.document.kinematics import complete
from myowarp.osim.document.model import GROUND, Model
from myowarp.osim.document.read.components import READERS
from myowarp.osim.document.read.element import Element
from myowarp.osim.document.read.frames import FRAMES, Frames, euler_xyz
from myowarp.osim.document.read.functions import READERS as FUNCTIONS
from myowarp.osim.document.read.joints import JOINTS, TRANSLATIONS
from myowarp.osim.document.read.model import Document, inertia_of

ONE = (1.0, 1.0, 1.0)
SAME = 1e-12
"""Factors that differ by less are the same."""


@dataclass(frozen=True)
class Scaling:
    """Scale factors of the bodies of a model."""

    model: Model
    frames: Frames
    factors: Mapping[str, np.ndarray]
    keep_masses: bool

    def of(self, body: str) -> np.ndarray:
        """Return the factors of a body, shape (3,)."""
        return self.factors.get(body, np.ones(3))

    def at(self, element: Element, *sockets: str) -> np.ndarray:
        """Return the factors of the body that a socket leads to."""
        return self.of(self.frames.attached(element, *sockets)[0])


Rule = Callable[[Element, Element, Scaling], None]
"""Changes an element (first), by what it says (second)."""


def _multiply(
    own: Element, element: Element, tag: str, factor: np.ndarray | float, default: tuple[float, ...] | None
) -> None:
    """Multiply the numbers of a property."""
    values = element.numbers(tag, default=default)
    if (values * factor != values).any():
        own.put_numbers(tag, values * factor)


def _point(own: Element, element: Element, scaling: Scaling) -> None:
    _multiply(own, element, "location", scaling.at(element, "parent_frame", "body"), (0.0, 0.0, 0.0))


def _moving_point(own: Element, element: Element, scaling: Scaling) -> None:
    for axis, factor in zip("xyz", scaling.at(element, "parent_frame", "body"), strict=True):
        _multiply_function(own, f"{axis}_location", float(factor))
        _multiply_function(own, f"{axis.upper()}Attachment", float(factor))  # the same, before 30000


def _multiply_function(own: Element, tag: str, factor: float) -> None:
    """Put a function that a property holds into a `MultiplierFunction`."""
    for place in own.children:
        held = place.children[0] if place.tag == tag and place.children else place
        if not (held.tag in FUNCTIONS and (held is not place or held.name == tag)):
            continue
        if held.tag == "MultiplierFunction":
            held.put_numbers("scale", np.array(held.number("scale", default=1.0) * factor))
            return
        inner = Element(held.source, held.tag, {}, held.line, held.text, held.children)
        held.tag, held.text, held.children = "MultiplierFunction", "", []
        held.put("function", "").children.append(inner)
        held.put_numbers("scale", np.array(factor))
        return


def _frame(own: Element, element: Element, scaling: Scaling) -> None:
    _multiply(own, element, "translation", scaling.at(element, "parent"), (0.0, 0.0, 0.0))


def _joint(own: Element, element: Element, scaling: Scaling) -> None:
    base = scaling.at(element, "parent_frame", "parent_body")
    holder = element.parent
    if holder is not None and holder.tag == "Joint" and holder.parent is not None:  # before 4.0
        child = scaling.of(holder.parent.name)
    else:
        child = scaling.at(element, "child_frame", "child_body")
    for tag, factors in (("location_in_parent", base), ("location", child), ("location_in_child", child)):
        _multiply(own, element, tag, factors, (0.0, 0.0, 0.0))
    if element.tag == "ScapulothoracicJoint":
        _multiply(own, element, "thoracic_ellipsoid_radii_x_y_z", base, ONE)
        _multiply(own, element, "scapula_winging_axis_origin", child[:2], (0.0, 0.0))
    transform, same = own.own("SpatialTransform"), element.own("SpatialTransform")
    if transform is None or same is None:
        return
    for axis, read in zip(transform.children, same.children, strict=True):
        if read.name in TRANSLATIONS and not _is_coordinate(read):
            factor = np.abs(read.numbers("axis", default=(1.0, 0.0, 0.0), count=3)) @ base
            _multiply_function(axis, "function", float(factor))


def _is_coordinate(axis: Element) -> bool:
    """Whether a `TransformAxis` is the line with slope 1 and offset 0."""
    for place in axis.children:
        held = place.children[0] if place.tag == "function" and place.children else place
        if held.tag == "LinearFunction":
            return bool((held.numbers("coefficients", default=(1.0, 0.0)) == (1.0, 0.0)).all())
    return False


def _coupler(own: Element, element: Element, scaling: Scaling) -> None:
    name = element.string("dependent_coordinate_name")
    coordinate = scaling.model.coordinates[name]
    if coordinate.rotational:
        return
    joint = scaling.model.joints[coordinate.joint]
    base = scaling.of(joint.parent)
    axes = [move.axis for move in joint.moves if move.kind == "slide" and move.coordinate == name]
    factor = np.abs(axes[0]) @ base if joint.type == "CustomJoint" and axes else base[0]
    _multiply(own, element, "scale_factor", float(factor), (1.0,))


def _wrap(own: Element, element: Element, scaling: Scaling) -> None:
    factors = scaling.of(scaling.frames.of_owner(element)[0])
    _multiply(own, element, "translation", factors, (0.0, 0.0, 0.0))
    turn = euler_xyz(element.numbers("xyz_body_rotation", default=(0.0, 0.0, 0.0), count=3))
    growth = np.linalg.norm(turn * factors[:, None], axis=0)
    across = growth[:2].mean()
    for tag, factor in {
        "WrapSphere": (("radius", factors.mean()),),
        "WrapCylinder": (("radius", across), ("length", growth[2])),
        "WrapEllipsoid": (("dimensions", growth),),
        "WrapTorus": (("inner_radius", across), ("outer_radius", across)),
    }[element.tag]:
        _multiply(own, element, tag, factor, None)


def _body(own: Element, element: Element, scaling: Scaling) -> None:
    if element.name == GROUND:
        return
    factors = scaling.of(element.name)
    _multiply(own, element, "mass_center", factors, (0.0, 0.0, 0.0))
    mass, tensor = element.number("mass"), inertia_of(element)
    now = mass if scaling.keep_masses else mass * abs(float(np.prod(factors)))
    own.put_numbers("mass", np.array(now))
    put_inertia(own, scaled_inertia(tensor, mass, now, factors))


def put_inertia(own: Element, tensor: np.ndarray) -> None:
    """Set the inertia of a body, as its document has it."""
    if own.own("inertia") is not None:
        own.put_numbers("inertia", tensor)
        return
    for ij, value in zip(("xx", "yy", "zz", "xy", "xz", "yz"), tensor, strict=True):
        own.put_numbers(f"inertia_{ij}", np.array(value))


def scaled_inertia(tensor: np.ndarray, mass: float, now: float, factors: np.ndarray) -> np.ndarray:
    """Return the inertia of a scaled body [kg m^2], shape (6,).

    Where the factors differ, the least moment m r^2 / 2 is that about the axis of a cylinder, and another,
    m (l^2 / 12 + r^2 / 4), gives its length l; both grow.

    Args:
        tensor: xx yy zz xy xz yz before [kg m^2], shape (6,).
        mass: Before [kg].
        now: Mass of the scaled body [kg].
        factors: Shape (3,).
    """
    if now <= np.finfo(float).eps:
        return np.zeros(6)
    size = np.abs(factors)
    if np.ptp(size) < SAME:
        return tensor * (now / mass) * size[0] ** 2
    axis = int(np.argmin(tensor[:3]))
    others = [k for k in range(3) if k != axis]
    radius = 2.0 * tensor[axis] / mass
    length = max(12.0 * (tensor[others[0]] / mass - radius / 4.0), 0.0) * factors[axis] ** 2
    radius *= factors[others[0]] * factors[others[1]]
    moments = np.full(3, now * (length / 12.0 + radius / 4.0))
    moments[axis] = now * radius / 2.0
    x, y, z = factors
    return np.concatenate([moments, tensor[3:] * (now / mass) * [x * y, x * z, y * z]])


def _shape(own: Element, element: Element, scaling: Scaling) -> None:
    above, places = element.parent, list[str]()
    while above is not None and above.tag in ("attached_geometry", "objects", "GeometrySet", "VisibleObject"):
        places, above = [*places, above.tag], above.parent
    if places and above is not None and above.tag in FRAMES:
        _multiply(own, element, "scale_factors", scaling.of(scaling.frames.of_owner(element)[0]), ONE)


RULES: dict[str, Rule] = {
    "Body": _body,
    "PhysicalOffsetFrame": _frame,
    **dict.fromkeys(JOINTS, _joint),
    **dict.fromkeys(("PathPoint", "ConditionalPathPoint", "Marker", "Station"), _point),
    "MovingPathPoint": _moving_point,
    "CoordinateCouplerConstraint": _coupler,
    **dict.fromkeys(("WrapSphere", "WrapCylinder", "WrapEllipsoid", "WrapTorus"), _wrap),
    **dict.fromkeys(
        ("Mesh", "Brick", "Sphere", "Ellipsoid", "Cylinder", "Cone", "Torus", "DisplayGeometry"), _shape
    ),
}
"""By OpenSim's class."""

LENGTHS = {"muscles": ("optimal_fiber_length", "tendon_slack_length"), "ligaments": ("resting_length",)}
"""Properties that grow as a path does."""


def scale_document(
    document: Document, factors: Mapping[str, np.ndarray], mass: float | None, keep_masses: bool
) -> Document:
    """Scale a model in place, and return what it is now.

    Args:
        document: The model.
        factors: By body, shape (3,); others stay.
        mass: Of the whole model [kg]; None: what comes out.
        keep_masses: Whether bodies keep their shares of the mass; else they take those of their volumes.

    Raises:
        ValueError: The model says something impossible, or has no mass.
    """
    if named := [name for name, path in document.model.pulling.items() if path.function is not None]:
        raise ValueError(
            f"{document.model.source}: {len(named)} paths, such as that of {named[0]!r}, are functions of "
            "coordinates, which no factor scales; scale the model with its points, then fit functions again"
        )
    before = path_lengths(document.model)
    scaling = Scaling(document.model, document.frames, factors, keep_masses)
    for own, element in document.pairs:
        if element.tag in RULES:
            RULES[element.tag](own, element, scaling)
    scaled = Document(document.model.source, document.root)
    growth = {name: length / before[name] for name, length in path_lengths(scaled.model).items()}
    total = scaled.model.mass
    if mass is not None and total <= 0.0:
        raise ValueError(f"model {scaled.model.name!r} has no mass that could become {mass:g} kg")
    for own, element in scaled.pairs:
        field = READERS[element.tag][0] if element.tag in READERS else ""
        for tag in LENGTHS.get(field, ()):
            if element.name in growth and element.find(tag) is not None:
                own.put_numbers(tag, element.number(tag) * growth[element.name])
        if element.tag == "Body" and element.name != GROUND and mass is not None:
            own.put_numbers("mass", np.array(element.number("mass") * mass / total))
            put_inertia(own, inertia_of(element) * mass / total)
    return Document(document.model.source, document.root)


def path_lengths(model: Model) -> dict[str, np.ndarray]:
    """Return the lengths of muscles and ligaments in the default pose [m], each of shape (1,)."""
    if not model.coordinates:
        return {}
    poses = poses_of(model, complete(model, {}, 1), [])
    paths = {name: one.path for group in (model.muscles, model.ligaments) for name, one in group.items()}
    return {name: own_reference(model, path, poses, []).length for name, path in paths.items()}
