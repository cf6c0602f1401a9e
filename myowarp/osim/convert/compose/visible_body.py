"""Bones where no mesh of a document is found: capsules from joint to joint, and a floor.

They are for looking at: without mass, touching nothing. A capsule is fixed in its body, so that a knee that
slides moves along it.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from myowarp.osim.convert.compose.geometry import Build
from myowarp.osim.convert.compose.meshes import MESH_GROUP
from myowarp.osim.document.model import Model

Array = np.ndarray

LEAST = 0.02
"""Length of a bone that is worth drawing, over that of the longest."""
THICKNESS, THICKEST = 0.07, 0.03
"""Radius of a bone over its own length, at most over that of the longest."""
BONE_COLOR = (0.89, 0.86, 0.78, 1.0)
FLOOR, TILES, TILES_A_SIDE = "floor", ((0.85, 0.87, 0.9), (0.78, 0.8, 0.84)), 20
REACH = 5.0
"""Half a side of the floor [m]."""


def bones(model: Model, names: Mapping[str, str], compiled: mujoco.MjModel) -> list[tuple[str, Array]]:
    """Return body and ends of every bone in the default pose, in MuJoCo's world [m], shape (2, 3) each.

    A bone goes from the origin of a body to that of each body on it; the last body of a chain reaches as far
    beyond its mass centre as this is away, or to its farthest site where that is the origin.

    Args:
        model: What was converted.
        names: Name in MuJoCo of every body.
        compiled: The converted model, compiled; it stands in the default pose.
    """
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    found = []
    for name, body in model.bodies.items():
        own = compiled.body(names[name]).id
        origin, turn = data.xpos[own], data.xmat[own].reshape(3, 3)
        children = [joint.child for joint in model.joints.values() if joint.parent == name]
        ends = [data.xpos[compiled.body(names[child]).id] for child in children]
        if not children:
            sites = compiled.site_pos[compiled.site_bodyid == own]
            points = [2 * body.mass_center] if body.mass_center.any() else [*sites]
            ends = [origin + turn @ max(points, key=np.linalg.norm, default=np.zeros(3))]
        found += [(name, np.array([origin, end])) for end in ends]
    lengths = [np.linalg.norm(end - start) for _, (start, end) in found]
    return [
        bone
        for bone, length in zip(found, lengths, strict=True)
        if length > max(LEAST * max(lengths), mujoco.mjMINVAL)
    ]


def add_visible_body(build: Build, compiled: mujoco.MjModel) -> None:
    """Add capsules to bodies that have nothing to draw, and a floor where the document has no plane."""
    names = {name: body.name for name, body in build.bodies.items()}
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    drawn = {shape.body for shape in build.model.shapes if shape.kind != "mesh" and not shape.contact}
    found = bones(build.model, names, compiled)
    longest = max((float(np.linalg.norm(end - start)) for _, (start, end) in found), default=0.0)
    for name, ends in found:
        if name in drawn:
            continue
        own = compiled.body(names[name]).id
        local = (ends - data.xpos[own]) @ data.xmat[own].reshape(3, 3)
        length = float(np.linalg.norm(local[1] - local[0]))
        turn = np.zeros(4)
        mujoco.mju_quatZ2Vec(turn, (local[1] - local[0]) / length)
        build.bodies[name].add_geom(
            name=build.free_name("geom", f"{name}_bone"),
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            pos=local.mean(axis=0),
            quat=turn,
            size=(min(THICKNESS * length, THICKEST * longest), length / 2, 0.0),
            mass=0.0,
            contype=0,
            conaffinity=0,
            group=MESH_GROUP,
            rgba=BONE_COLOR,
        )
    if found and all(shape.kind != "plane" for shape in build.model.shapes):
        _add_floor(build, min(0.0, *(float(ends[:, 2].min()) for _, ends in found)))


def _add_floor(build: Build, height: float) -> None:
    """Add a chequered floor at a height [m], and a light above it."""
    build.spec.worldbody.add_light(name="light", pos=(0.0, 0.0, height + REACH), dir=(0.0, 0.0, -1.0))
    build.spec.add_texture(
        name=FLOOR,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        width=256,
        height=256,
        rgb1=TILES[0],
        rgb2=TILES[1],
    )
    material = build.spec.add_material(name=FLOOR, texrepeat=(TILES_A_SIDE / 2,) * 2)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = FLOOR
    build.spec.worldbody.add_geom(
        name=build.free_name("geom", FLOOR),
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(0.0, 0.0, height),
        size=(REACH, REACH, 0.1),
        material=FLOOR,
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=MESH_GROUP,
    )
