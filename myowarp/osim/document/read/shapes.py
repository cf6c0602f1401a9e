"""Shapes of an .osim file, to look at and to collide with; files of meshes, found without parsing."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import unescape

import numpy as np

from myowarp.osim.document.elements import Pose, Shape
from myowarp.osim.document.model import Note
from myowarp.osim.document.read.element import Element, decoded
from myowarp.osim.document.read.frames import Frames, euler_xyz, pose_of

MAX_PATH = 200  # characters of a file's name

FOLDERS = ("", "Geometry", "../Geometry")
"""Beside the model, where its meshes usually are."""
NAMED = re.compile("<(?:mesh_file|geometry_file|filename)>([^<]+)<")
"""Elements that name a mesh in the text of a document."""

SHAPES: dict[str, Any] = {
    "Mesh": ("mesh", "scale_factors", 3),
    "DisplayGeometry": ("mesh", "scale_factors", 3),
    "Sphere": ("sphere", "radius", 1),
    "Cylinder": ("cylinder", "radius half_height", 2),
    "Ellipsoid": ("ellipsoid", "radii", 3),
    "Brick": ("box", "half_lengths", 3),
    "ContactSphere": ("sphere", "radius", 1),
    "ContactHalfSpace": ("plane", "", 0),
    "ContactMesh": ("mesh", "", 0),
    "ContactEllipsoid": ("ellipsoid", "radii", 3),
}
"""OpenSim's class: kind, the properties that are its size, and how many numbers these have."""


def located(name: str, places: Sequence[Path]) -> tuple[Path, Path | None]:
    """Return a mesh file as a document names it, and where it is; None: nowhere."""
    file = Path(name.replace("\\", "/")[-MAX_PATH:])
    files = (place / part for place in places for part in (file, file.name))
    return file, next((path for path in files if path.is_file()), None)


def mesh_files(model: Path) -> list[Path]:
    """Return the mesh files of a model that are there; its document is not parsed, so that this is quick."""
    text, _ = decoded(model.read_bytes())
    names = dict.fromkeys(unescape(name.strip()) for name in NAMED.findall(text))
    places = [model.parent / folder for folder in FOLDERS]
    return [file for name in names if (file := located(name, places)[1]) is not None]


def read_shapes(model: Element, frames: Frames, notes: list[Note]) -> tuple[Shape, ...]:
    """Return what there is to look at and to collide with."""
    shapes = []
    for element in model.walk():
        if element.tag not in SHAPES:
            continue
        shape = read_shape(element, frames)
        if shape.kind == "mesh" and not shape.file:
            notes.append(Note(f"/{element.tag}/{element.name}", "a mesh without a file; left out", "0"))
            continue
        shapes.append(shape)
        if shape.contact:
            notes.append(
                Note(
                    f"/contactgeometryset/{element.name}",
                    "a geom with MuJoCo's own contact model and parameters",
                )
            )
    return tuple(shapes)


def _scale_around(element: Element) -> np.ndarray:
    """Return the factors that a `VisibleObject`, before 4.0, has on all in it, shape (3,)."""
    around: Element | None = element
    while around is not None and around.tag not in ("VisibleObject", "Body", "Ground"):
        around = around.parent
    if around is None or around.tag != "VisibleObject":
        return np.ones(3)
    return around.numbers("scale_factors", default=(1.0,) * 3, count=3)


def read_shape(element: Element, frames: Frames) -> Shape:
    """Return something to look at or to collide with.

    Raises:
        ValueError: Its size is not above 0, or a mesh names no file.
    """
    kind, properties, count = SHAPES[element.tag]
    contact = element.tag.startswith("Contact")
    if contact:
        body, base = frames.attached(element, "frame", "body_name")
        frame = base @ pose_of(element, ("location",), ("orientation",))
    else:
        body, base = frames.of_owner(element)
        transform = element.numbers("transform", default=(0.0,) * 6, count=6)
        frame = base @ Pose(transform[3:], euler_xyz(transform[:3]))
    size = np.array(
        [value for name in properties.split() for value in element.numbers(name, default=(1.0,) * count)]
    )
    size = size[:count] if count else np.ones(3)
    scale = element.numbers("scale_factors", default=(1.0,) * 3, count=3)
    if kind == "mesh":
        size = size * _scale_around(element)
    if kind != "mesh" and count:
        size = size * (scale if count == 3 else scale[0])
    if len(size) < count or (kind != "mesh" and (size <= 0).any()):
        raise element.error(f"must have {properties} above 0")
    file = element.string("mesh_file", "geometry_file", "filename") if kind == "mesh" else None
    look = element.find("Appearance")
    color = (element if look is None else look).numbers("color", default=(1.0, 1.0, 1.0))
    opacity = (element if look is None else look).number("opacity", default=1.0)
    red, green, blue = np.clip(color[:3] if len(color) >= 3 else (1, 1, 1), 0, 1)
    rgba = (float(red), float(green), float(blue), min(max(opacity, 0.0), 1.0))
    return Shape(element.name, kind, body, frame, size, file, rgba, contact)
