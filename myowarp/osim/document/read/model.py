"""Read an .osim file, documents 10901 to 40600, without OpenSim.

What the file cannot say legally is an error that names file, line and element; what is legal but has no
counterpart here is skipped with a `Note`. Documents before 4.0 keep joints inside their child bodies
and know no offset frames; both forms end in the same `Model`.
"""

import copy
from collections.abc import Container, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from myowarp.osim.document.elements import Pose
from myowarp.osim.document.model import GROUND, Body, Constraint, Coordinate, Joint, Loss, Model, Note
from myowarp.osim.document.read.components import READERS, read_components
from myowarp.osim.document.read.element import Element, parse
from myowarp.osim.document.read.frames import Frames, socket
from myowarp.osim.document.read.joints import JOINTS, in_order, read_coordinate, read_joint
from myowarp.osim.document.read.muscle_defaults import DEFAULTS
from myowarp.osim.document.read.paths import FUNCTIONS as FUNCTION_PATH
from myowarp.osim.document.read.paths import Scope, read_wraps
from myowarp.osim.document.read.shapes import read_shapes

VERSIONS = (10901, 40699)
"""First and last version of a document that is read: the first that OpenSim 4.6 reads; later ones of 4.6 add
nothing."""

RENAMED = {
    "ActuatorSet": "ForceSet",
    "MusclePointSet": "PathPointSet",
    "MusclePoint": "PathPoint",
    "MuscleViaPoint": "ConditionalPathPoint",
    "MovingMusclePoint": "MovingPathPoint",
    "MuscleWrapSet": "PathWrapSet",
    "MuscleWrap": "PathWrap",
    "GeneralizedForce": "CoordinateActuator",
    "Force": "PointActuator",
    "Torque": "TorqueActuator",
    "Schutte1993Muscle": "Schutte1993Muscle_Deprecated",
    "Delp1990Muscle": "Delp1990Muscle_Deprecated",
}
"""Classes and sets of documents before 30000, and what OpenSim 4.6 reads them as."""

PROPERTIES = (
    (30000, "MovingPathPoint", {f"{axis.upper()}Attachment": f"{axis}_location" for axis in "xyz"}),
    (20002, "ConditionalPathPoint", {"coordinates": "coordinate"}),
    (10905, "TorqueActuator", {"body_A": "bodyB", "body_B": "bodyA", "direction_A": "axis"}),
    (10905, "PointActuator", {"body_B": "body", "point_B": "point", "direction_A": "direction"}),
)
"""First version without, class, and what OpenSim 4.6 reads its properties as."""

REVERSED = 10905
"""First version in which an actuator pushes along its direction, not against it."""

ONE_LIST = 20101
"""First version in which each mesh of a body is an element."""

STATED = 30513
"""First version in which a muscle's `min_control` of 0 counts; OpenSim 4.6 drops that of earlier ones."""

MAX_BODIES = 400  # published models have up to about 100; a chain of bodies is walked recursively

OWN_FRAMES = 40000
"""First version of a document whose markers are in frames."""

PULLING = {tag for tag, (field, _) in READERS.items() if field in ("muscles", "ligaments", "path_actuators")}
"""Classes with a path."""

PATH_PARTS = ("GeometryPath", FUNCTION_PATH, "PathPointSet", "PathWrapSet", "MusclePointSet", "MuscleWrapSet")
"""Parts of a path in documents of any version."""

SETS = (
    ("BodySet", "bodyset"),
    ("JointSet", "jointset"),
    ("ConstraintSet", "constraintset"),
    ("ForceSet", "forceset"),
    ("MarkerSet", "markerset"),
    ("ContactGeometrySet", "contactgeometryset"),
    ("ControllerSet", "controllerset"),
    ("ProbeSet", "probeset"),
    ("ComponentSet", "componentset"),
    ("components", "componentset"),
)
"""Lists of components in a `<Model>`, and the first part of their members' paths."""


def read_model(path: Path, markers: Path | None = None, function_paths: Path | None = None) -> Model:
    """Read an .osim file, with parts of other files in place of its own.

    Args:
        path: The file.
        markers: An OpenSim `MarkerSet`, in place of the model's markers of the same names.
        function_paths: A set of `FunctionBasedPath`, in place of the paths of the muscles that it names.

    Raises:
        ValueError: The file is no OpenSim model or says something impossible, with file and line; or another
            file is not what it should be, or names what the model does not have.
        NotImplementedError: It needs something that has no counterpart here, such as an unknown joint class.
        OSError: A file cannot be read.
    """
    root, latin = parse(path)
    if markers is None and function_paths is None:
        notes = [Note("/", "the file is not UTF-8 as it says; read as Latin-1")] if latin else []
        return model_of(path, checked(root), root, notes)
    document = Document(path, root)
    for file, put in ((markers, set_markers), (function_paths, set_function_paths)):
        if file is not None:
            document = put(document, parse(file)[0])
    return document.model


def frames_of(model: Element) -> Frames:
    """Return all frames of a `<Model>`."""
    return Frames.of(model, [element for _, element in _components(model) if element.tag == "Body"])


def model_of(path: Path, version: int, root: Element, notes: list[Note]) -> Model:
    """Return what a document says whose tags are those of today, by `checked`.

    Raises:
        ValueError: It says something impossible, with file and line.
        NotImplementedError: It needs something that has no counterpart here, such as an unknown joint class.
    """
    model = root.need("Model")
    components = _components(model)
    frames = frames_of(model)
    _refuse_duplicates(components)
    joints, coordinates, copies = _joints(components, frames, notes)
    bodies = {element.name: _body(element) for _, element in components if _is_body(element)}
    bodies.update(_shared(bodies, copies))
    wraps, more = read_wraps(model, frames)
    notes += more
    found = read_components(components, Scope(frames, coordinates, wraps, notes))
    notes += _inside(model, components)
    here = Pose(np.zeros(3), np.eye(3))
    closed = [Constraint(copy, "weld", (body, copy), (here, here)) for copy, body in copies.items()]
    found["constraints"] = (*found["constraints"], *closed)
    shapes = read_shapes(model, frames, notes)
    length_units, force_units = (
        model.string("length_units", default="meters"),
        model.string("force_units", default="N"),
    )
    if length_units.lower() not in ("m", "meter", "meters") or force_units.lower() not in (
        "n",
        "newton",
        "newtons",
    ):
        notes.append(
            Note("/", f"units {length_units!r} and {force_units!r} are taken as m and N, as OpenSim does")
        )
    return Model(
        name=model.name or path.stem,
        source=path,
        version=version,
        credits=model.string("credits"),
        publications=model.string("publications"),
        length_units=length_units,
        force_units=force_units,
        gravity=model.numbers("gravity", default=(0.0, -9.80665, 0.0), count=3),
        bodies=MappingProxyType(bodies),
        joints=MappingProxyType(joints),
        coordinates=MappingProxyType(coordinates),
        wraps=MappingProxyType(wraps),
        shapes=shapes,
        **found,
        notes=tuple(notes),
        frames=MappingProxyType(frames.named()),
    )


def _shared(bodies: Mapping[str, Body], copies: Mapping[str, str]) -> dict[str, Body]:
    """Return bodies with copies, and these: each has the same share of the mass, as in OpenSim."""
    shared = {}
    for body in dict.fromkeys(copies.values()):
        names = [body, *(copy for copy, of in copies.items() if of == body)]
        whole, share = bodies[body], 1.0 / len(names)
        for name in names:
            shared[name] = replace(whole, name=name, mass=share * whole.mass, inertia=share * whole.inertia)
    return shared


def checked(root: Element) -> int:
    """Return the version of a document; tie every element to its class's defaults, and rename old classes.

    Raises:
        ValueError: It is no OpenSim document, or of a version that is not read.
    """
    if root.tag != "OpenSimDocument":
        raise root.error("is no OpenSim model; its root must be <OpenSimDocument>")
    version = root.attributes.get("Version", "")
    if not (version.isascii() and version.isdigit() and VERSIONS[0] <= int(version[:9]) <= VERSIONS[1]):
        raise root.error(
            f"has version {version[:60]!r}; documents {VERSIONS[0]} to {VERSIONS[1]} are read, "
            "older ones after saving them with OpenSim 3.3"
        )
    for element in list(root.walk()):
        if int(version) < 30000:
            element.tag = RENAMED.get(element.tag, element.tag)
            _renew(element, int(version))
        if int(version) < STATED and element.tag in DEFAULTS and (control := element.own("min_control")):
            if not control.parsed(finite=False).any():
                element.children.remove(control)
    classes: dict[str, Element] = {}
    for place in (root, root.own("Model")):
        block = None if place is None else place.own("defaults")
        if place is not None and block is not None:
            classes.update((entry.tag, entry) for entry in block.children)
            place.children.remove(block)
    for element in root.walk() if classes else ():
        element.fallback = classes.get(element.tag)
    return int(version)


def _renew(element: Element, version: int) -> None:
    """Give an element of a document before 30000 the properties of today."""
    for before, tag, names in PROPERTIES:
        if version < before and element.tag == tag:
            for child in element.children:
                child.tag = names.get(child.tag, child.tag)
    if version < REVERSED and element.tag in ("TorqueActuator", "PointActuator"):
        axis = "axis" if element.tag == "TorqueActuator" else "direction"
        element.put_numbers(axis, -element.numbers(axis, default=(0.0, 0.0, 1.0), count=3))
        element.put("force_is_global", "true")
    owner = element.parent
    files = element.own("geometry_files") if element.tag == "VisibleObject" else None
    if version < ONE_LIST and files is not None and owner is not None and owner.tag == "Body":
        for file in files.text.split():
            mesh = Element(element.source, "DisplayGeometry", {}, files.line, parent=element)
            mesh.put("geometry_file", file)
            element.children.append(mesh)


def _rename_coordinates(joint: Element, before: Container[str]) -> None:
    """Call coordinates of a joint that have names of other joints' joint_coordinate."""
    names = {}
    for item in joint.objects("coordinates", "CoordinateSet"):
        if item.name in before:
            names[item.name] = item.attributes["name"] = f"{joint.name}_{item.name}"
    for axis in joint.walk() if names else ():
        for child in axis.children if axis.tag == "TransformAxis" else ():
            if child.tag == "coordinates":
                child.text = " ".join(names.get(word, word) for word in child.text.split())


def _components(model: Element) -> list[tuple[str, Element]]:
    """Return all components with their paths, those inside joints and frames left out."""
    listed = []
    for tag, name in SETS:
        whole = model.find(tag)
        if whole is not None and "file" in whole.attributes:
            listed.append((name, whole))
        for element in model.objects(tag):
            listed.append((name, element))
            if tag == "BodySet" and (inside := element.own("Joint")) is not None:
                listed += [("jointset", joint) for joint in inside.children]
    # As OpenSim does: the class's name where there is none, and a number from the second one of a name on.
    taken: set[tuple[str, str]] = set()
    for place, element in listed:
        if element.tag in (*JOINTS, *READERS) and element.tag != "Marker":
            base, number = element.name or element.tag.lower(), -1
            while (place, name := f"{base}_{number}" if number >= 0 else base) in taken:
                number += 1
            if name != element.name:
                element.attributes["name"] = name
            taken.add((place, name))
    return [(f"/{name}/{element.name}", element) for name, element in listed]


def _inside(model: Element, components: list[tuple[str, Element]]) -> list[Note]:
    """Return what is lost because it is listed inside of another component."""
    listed = {id(element) for _, element in components}
    rule = "is listed inside of another component; left out"
    return [
        Loss(f"/{element.name}", f"{element.tag} {rule}", code=element.tag, names=element.words())
        for element in model.walk()
        if element.tag in READERS and element.tag != "Marker" and id(element) not in listed
    ]


def _is_body(element: Element) -> bool:
    return element.tag == "Body" and element.name != GROUND


def _refuse_duplicates(components: list[tuple[str, Element]]) -> None:
    """Raise if two bodies have one name, or one has none."""
    seen: dict[str, Element] = {}
    for path, element in components:
        if element.tag != "Body":
            continue
        if not element.name:
            raise element.error("has no name")
        if path in seen:
            raise element.error(f"has the name of another body, in line {seen[path].line}")
        seen[path] = element


def _body(element: Element) -> Body:
    """Return a body."""
    mass = element.number("mass")
    if mass < 0:
        raise element.error(f"must have a mass of at least 0, got {mass:g}")
    centre = element.numbers("mass_center", default=(0.0, 0.0, 0.0), count=3)
    return Body(element.name, mass, centre, inertia_of(element))


def inertia_of(element: Element) -> np.ndarray:
    """Return xx yy zz xy xz yz of a body [kg m^2], shape (6,)."""
    if element.find("inertia") is not None:
        return element.numbers("inertia", count=6)
    return np.array(
        [element.number(f"inertia_{ij}", default=0.0) for ij in ("xx", "yy", "zz", "xy", "xz", "yz")]
    )


def _joints(
    components: list[tuple[str, Element]], frames: Frames, notes: list[Note]
) -> tuple[dict[str, Joint], dict[str, Coordinate], dict[str, str]]:
    """Return joints, parents first, coordinates in the order of the file, and copies of bodies."""
    read: dict[str, tuple[Joint, Element]] = {}
    elements: dict[str, tuple[Element | None, str]] = {}
    bodies = [element.name for _, element in components if _is_body(element)]
    if len(bodies) > MAX_BODIES:
        raise ValueError(
            f"{components[0][1].source} has {len(bodies)} bodies; at most {MAX_BODIES} are supported"
        )
    for path, element in components:
        if not path.startswith("/jointset/") and element.tag not in JOINTS:
            continue
        inside = (
            element.parent is not None and element.parent.tag == "Joint" and element.parent.parent is not None
        )
        owner = element.parent.parent.name if inside and element.parent and element.parent.parent else None
        _rename_coordinates(element, elements)
        joint, listed, names = read_joint(element, frames, owner, notes)
        read[joint.name] = joint, element
        for index, name in enumerate(names):
            item = listed[index] if index < len(listed) else None
            if name in elements:
                raise (item or element).error(f"has the coordinate {name!r} twice; names must differ")
            elements[name] = item, joint.name
    ordered, copies, more = in_order(read, bodies)
    notes += more
    by_name = {joint.name: joint for joint in ordered}
    for joint in ordered:
        for move in joint.moves:
            if move.coordinate is not None:
                elements.setdefault(move.coordinate, (None, joint.name))
    coordinates: dict[str, Coordinate] = {}
    for name, (item, owner) in elements.items():
        coordinates[name], more = read_coordinate(item, name, by_name[owner])
        notes += more
    return by_name, coordinates, copies


class Document:
    """An .osim file, and what it says.

    Attributes:
        root: As in the file; what is changed is changed here.
        pairs: Each element, and the same with the tags of today and the defaults of its class.
        frames: Of the model.
        model: What is read from it.
        version: Of the document.
    """

    def __init__(self, source: Path, root: Element) -> None:
        """Read a document.

        Raises:
            ValueError: It is no model, or says something impossible.
            NotImplementedError: It needs something that is not supported.
        """
        self.root, today = root, copy.deepcopy(root)
        both = list(zip(root.walk(), today.walk(), strict=True))
        self.version = checked(today)
        kept = {id(element) for element in today.walk()}
        self.pairs = [(own, element) for own, element in both if id(element) in kept]
        self.frames: Frames = frames_of(today.need("Model"))
        self.model: Model = model_of(source, self.version, today, [])


def set_function_paths(document: Document, paths: Element) -> Document:
    """Put the lengths of a set of `FunctionBasedPath` in place of the paths of the forces that they name.

    The set is what Moco's `ModOpReplacePathsWithFunctionBasedPaths` reads; return what the model is now.

    Raises:
        ValueError: The set has none, or one names a force that the model does not have, or that has no path.
    """
    owners = {own.name: own for own, element in document.pairs if element.tag in PULLING}
    found = [element for element in paths.walk() if element.tag == FUNCTION_PATH]
    if not found:
        raise paths.error(f"has no <{FUNCTION_PATH}>; give a set of them, such as Moco's")
    for path in found:
        name = path.name.rpartition("/")[2]
        if name not in owners:
            raise path.error("names a force that the model does not have, or that has no path")
        owner, held = owners[name], owners[name].own("path")
        places = [owner] if held is None else [owner, held]
        for place in places:
            place.children = [child for child in place.children if child.tag not in PATH_PARTS]
        inner = Element(path.source, FUNCTION_PATH, {"name": "path"}, path.line, parent=places[-1])
        inner.children = path.children
        places[-1].children.insert(0, inner)
    return Document(document.model.source, document.root)


def set_markers(document: Document, markers: Element) -> Document:
    """Put the markers of a set into a model, in place of those of the same names; return what it is now.

    Raises:
        ValueError: A marker is on no body.
    """
    model = document.root.need("Model")
    own = model.own("MarkerSet")
    if own is None:
        own = Element(model.source, "MarkerSet", {}, model.line, parent=model)
        model.children.append(own)
    inner = own.own("objects") or own.put("objects", "")
    for marker in [element for element in markers.walk() if element.tag == "Marker"]:
        body = socket(marker, "parent_frame", "body").rsplit("/", 1)[-1]
        if body not in {*document.model.bodies, GROUND}:
            raise marker.error(f"is on the body {body!r}, which the model does not have")
        inner.children = [child for child in inner.children if child.name != marker.name]
        new = Element(marker.source, "Marker", {"name": marker.name}, marker.line, parent=inner)
        if document.version < OWN_FRAMES:
            new.put("body", body)
        else:
            new.put("socket_parent_frame", f"/{GROUND}" if body == GROUND else f"/bodyset/{body}")
        new.put_numbers("location", marker.numbers("location", count=3))
        new.put("fixed", "true" if marker.flag("fixed", default=False) else "false")
        inner.children.append(new)
    return Document(document.model.source, document.root)


def read_groups(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the members of each group of a model, such as the flexors of a hip, by its name.

    Raises:
        ValueError: The file is no document, with file and line.
        OSError: It cannot be read.
    """
    groups = (element for element in parse(path)[0].walk() if element.tag == "ObjectGroup")
    return {group.name: tuple(group.string("members").split()) for group in groups}
