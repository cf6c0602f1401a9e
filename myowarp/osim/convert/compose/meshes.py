"""Meshes of bones that the user has: .vtp, .stl, .obj -> geoms and files beside the model.

A .vtp file is XML; its ASCII form, which OpenSim's bones have, is rewritten as .obj, without VTK. Meshes
are for looking at: they have no mass and collide with nothing, contact meshes excepted.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from myowarp.osim.convert.compose.geometry import Build, quaternion
from myowarp.osim.document.elements import Shape
from myowarp.osim.document.kinematics import about
from myowarp.osim.document.read.element import Element, parse
from myowarp.osim.document.read.shapes import FOLDERS, located

MESH_GROUP, CONTACT_GROUP = 1, 0

TURN_Y_TO_Z = about(np.array([1.0, 0.0, 0.0]), np.array([-np.pi / 2]))[0]
"""OpenSim's cylinders stand along y, MuJoCo's along z."""

PLANE = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""OpenSim's half space fills x > 0; MuJoCo's plane looks along z."""


def add_shapes(build: Build, folders: Sequence[Path]) -> dict[str, bytes]:
    """Add geoms for all shapes.

    Args:
        build: What is being built.
        folders: Where to look for meshes, before the folders of the model.

    Returns:
        Mesh files by name, to be written into the folder `meshes` beside the model.
    """
    places = [*folders, *(build.model.source.parent / folder for folder in FOLDERS)]
    files: dict[str, bytes] = {}
    meshes: dict[tuple[str, tuple[float, ...]], str | None] = {}
    missing: list[str] = []
    for shape in build.model.shapes:
        if shape.kind == "mesh":
            key = shape.file or "", tuple(shape.size)
            if key not in meshes:
                meshes[key] = _add_mesh(build, shape, places, files, missing)
            if meshes[key] is not None:
                _add_geom(build, shape, meshes[key])
        elif shape.kind == "plane" and _moves(build.bodies[shape.body]):
            rule = "a half space on a body that moves, which MuJoCo's contact has not; left out there"
            build.note(f"/contactgeometryset/{shape.name}", rule)
        else:
            _add_geom(build, shape, None)
    if missing:
        named = ", ".join(dict.fromkeys(missing))
        rule = f"{len(missing)} mesh files are not found; --meshes names their folder: {named}"
        build.note("/meshes", rule, "0: for looking at only")
    return files


def _moves(body: mujoco.MjsBody | None) -> bool:
    """Whether a body, or one that carries it, has joints."""
    while body is not None:
        if body.joints:
            return True
        body = body.parent
    return False


def _add_geom(build: Build, shape: Shape, mesh: str | None) -> None:
    """Add the geom of a shape."""
    kinds = {
        "mesh": mujoco.mjtGeom.mjGEOM_MESH,
        "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
        "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        "box": mujoco.mjtGeom.mjGEOM_BOX,
        "plane": mujoco.mjtGeom.mjGEOM_PLANE,
    }
    rotation = shape.frame.rotation @ {"cylinder": TURN_Y_TO_Z, "plane": PLANE}.get(shape.kind, np.eye(3))
    geom = build.bodies[shape.body].add_geom(
        name=build.free_name("geom", shape.name or f"{shape.body}_{shape.kind}"),
        type=kinds[shape.kind],
        pos=shape.frame.position,
        quat=quaternion(rotation),
        mass=0.0,
        contype=int(shape.contact),
        conaffinity=int(shape.contact),
        rgba=shape.rgba,
        group=CONTACT_GROUP if shape.contact else MESH_GROUP,
    )
    if mesh is not None:
        geom.meshname = mesh
    elif shape.kind == "plane":
        geom.size = (0.0, 0.0, 1.0)
    else:
        geom.size[: len(shape.size)] = shape.size


def _add_mesh(
    build: Build, shape: Shape, places: Sequence[Path], files: dict[str, bytes], missing: list[str]
) -> str | None:
    """Add a mesh asset and return its name; None, with a note or in `missing`, if there is no usable file."""
    file, found = located(shape.file or "", places)
    if found is None:
        missing.append(file.name)
        return None
    where = f"{shape.body}/{file}"
    try:
        name, content = _content(found)
        _check(name, content, shape.size)
    except ValueError as error:
        build.note(where, f"the mesh cannot be used; left out: {str(error).splitlines()[0]}")
        return None
    files[name] = content
    build.spec.assets[name] = content
    asset = build.free_name("mesh", found.stem)
    mesh = build.spec.add_mesh(name=asset, file=name, scale=shape.size)
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return asset


def _content(path: Path) -> tuple[str, bytes]:
    """Return the name and content of the file that MuJoCo is to read.

    Raises:
        ValueError: The format is not supported.
    """
    suffix = path.suffix.lower()
    if suffix in (".stl", ".obj"):
        return path.stem + suffix, path.read_bytes()
    if suffix == ".vtp":
        return path.stem + ".obj", obj_of_vtp(path).encode()
    raise ValueError(f"{path.name} is none of .vtp, .stl, .obj")


def _check(name: str, content: bytes, scale: np.ndarray) -> None:
    """Raise if MuJoCo cannot compile a mesh."""
    spec = mujoco.MjSpec()
    spec.assets[name] = content
    mesh = spec.add_mesh(name="mesh", file=name, scale=scale)
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    spec.compile()


def obj_of_vtp(path: Path) -> str:
    """Return a VTK PolyData file in ASCII as Wavefront OBJ.

    Raises:
        ValueError: It is no such file, with file and line.
    """
    root, _ = parse(path)
    lines, base = [], 0
    for piece in (element for element in root.walk() if element.tag == "Piece"):
        points = _array(piece, "Points", "").reshape(-1, 3)
        connectivity = _array(piece, "Polys", "connectivity").astype(int)
        offsets = _array(piece, "Polys", "offsets").astype(int)
        if len(connectivity) and not 0 <= connectivity.min() <= connectivity.max() < len(points):
            raise piece.error("has polygons with points that it does not have")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
        start = 0
        for end in offsets:
            corners = connectivity[start:end] + 1 + base
            lines += [f"f {corners[0]} {b} {c}" for b, c in pairwise(corners[1:])]
            start = end
        base += len(points)
    return "\n".join(lines) + "\n"


def _array(piece: Element, group: str, name: str) -> np.ndarray:
    """Return the numbers of a data array."""
    for array in piece.need(group).children:
        if array.tag == "DataArray" and name in ("", array.attributes.get("Name", "")):
            if array.attributes.get("format", "ascii") != "ascii":
                raise array.error("must be in ASCII; save the mesh as ASCII .vtp, .stl or .obj")
            return array.parsed(finite=True)
    raise piece.error(f"has no {name or 'coordinates'} in <{group}>")
