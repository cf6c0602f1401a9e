"""The object of relocate: a box, or three solids of random kinds that overlap.

Source: MyoSuite 3.0.0, `myoChallengeRelocateP1-v0` and `P2-v0`. P2 draws kind, size, place, turn and friction
of each part and the mass of all; parts have one density. In MyoSuite the engine takes the larger friction of
object and hand or table, so that draws below theirs (1, 0.005, 0.0001) have no effect, and principal moments
of inertia are at least 1e-4 kg m^2.
"""

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.entries import XYZ
from myowarp.definitions.task import Draw
from myowarp.tasks.euler_angles import quat_of, turned
from myowarp.tasks.solids import (
    BATCHED_SHAPE,
    BATCHED_WEIGHT,
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    SPHERE,
    TINY,
    Shapes,
    Weights,
    gyration,
    hide,
    shifted_inertia,
    turned_inertia,
    volume,
    write_shape,
    write_weight,
)

OBJECT_POS = (0.0, -0.25, 0.95)  # m, of the object's frame, where none is drawn
OBJECT_START = (-0.2, 0.0, -0.02, 0.0, 0.0, 0.0)  # m, rad, of its joints
START = wp.constant(wp.vec3(*OBJECT_START[:3]))
KINDS = tuple(int(kind) for kind in (SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX))  # in this order
NUM_KINDS = wp.constant(len(KINDS))
PARTS = wp.constant(3)
BOXES = (0.0284, 0.00284, 0.00284)  # m, half sides of the parts where none is drawn; one holds the others
ASKEW = (0.001, 0.001, 0.001)  # rad, of these boxes and, in the model alone, of the bin
RGBA = (0.25, 0.45, 0.8, 1.0)

BATCHED = (*BATCHED_SHAPE, *BATCHED_WEIGHT, "geom_pos", "geom_quat", "geom_friction")
"""Names of the model's fields that `shape_parts` and `weigh_parts` write per world."""


@wp.struct
class Parts:
    """Drawn properties of the parts, arrays (num_worlds, n).

    Attributes:
        kind_0: Kind of the first part, a number of `mujoco.mjtGeom`.
        kind_1: That of the second.
        kind_2: That of the third.
        part_size: Sizes [m], n = 9.
        part_place: Centers in shares of these sizes, n = 9.
        part_turn: Angles about x, then about its own y and z [rad], n = 9.
        part_friction: Coefficients (slide, spin, roll), n = 9.
        object_mass: Mass of all [kg], n = 1.
    """

    kind_0: wp.array2d[float]
    kind_1: wp.array2d[float]
    kind_2: wp.array2d[float]
    part_size: wp.array2d[float]
    part_place: wp.array2d[float]
    part_turn: wp.array2d[float]
    part_friction: wp.array2d[float]
    object_mass: wp.array2d[float]


@wp.struct
class Places:
    """Places of geoms on their bodies, and friction; fields are the engine's."""

    geom_pos: wp.array2d[wp.vec3]
    geom_quat: wp.array2d[wp.quat]
    geom_friction: wp.array2d[wp.vec3]


def add_parts(body: mujoco.MjsBody, varied: bool, priority: int) -> None:
    """Add the geoms of the object: three boxes; where parts are drawn, a geom of every kind for each."""
    for i, half in enumerate(BOXES):
        for kind in KINDS if varied else KINDS[-1:]:
            there = kind == KINDS[-1]
            geom = body.add_geom(name=f"part_{i}_{kind}", type=mujoco.mjtGeom(kind), rgba=RGBA)
            geom.size = 3 * (half if there else TINY,)
            geom.contype, geom.conaffinity, geom.condim = 1, 1, 4
            geom.quat, geom.priority = quat_of(ASKEW), priority


def kind_draws() -> tuple[Draw, ...]:
    """Return how the kind of each part is drawn."""
    kinds = "kind of part {}: 2 sphere, 3 capsule, 4 ellipsoid, 5 cylinder, 6 box"
    return tuple(
        Draw(f"kind {i}", "1", (), (), kinds.format(i), (), "start", KINDS, f"kind_{i}") for i in range(PARTS)
    )


def part_draws(
    size: tuple[float, float],
    friction: tuple[tuple[float, ...], tuple[float, ...]],
    mass: tuple[float, float],
) -> tuple[Draw, ...]:
    """Return how size, place, turn and friction of the parts are drawn, and the mass of all.

    Args:
        size: Bounds of the sizes [m].
        friction: Bounds of the coefficients (slide, spin, roll).
        mass: Bounds of the mass [kg].
    """

    def draw(name: str, unit: str, low: float, high: float, meaning: str) -> Draw:
        axes = tuple(f"part {i} {axis}" for i in range(PARTS) for axis in XYZ)
        bounds = len(axes) * (low,), len(axes) * (high,)
        return Draw(name, unit, *bounds, meaning, axes, "start", array=name.replace(" ", "_"))

    rough = tuple(f"part {i} {kind}" for i in range(PARTS) for kind in ("slide", "spin", "roll"))
    least, most = (PARTS * bound for bound in friction)
    right = np.pi / 2
    sizes = "sizes of each part: half sides, semi-axes, or radius and half length"
    turns = "by what each part is turned about x, then about its own y and z"
    coefficients = "coefficients of each part"
    return (
        draw("part size", "m", *size, sizes),
        draw("part place", "1", -1.0, 1.0, "center of each part, in shares of its sizes"),
        draw("part turn", "rad", -right, right, turns),
        Draw("part friction", "1", least, most, coefficients, rough, "start", array="part_friction"),
        Draw("object mass", "kg", mass[:1], mass[1:], "mass of the object", (), "start", array="object_mass"),
    )


@wp.func
def three(values: wp.array2d[float], worldid: int, part: int) -> wp.vec3:
    """Drawn numbers of a part."""
    i = 3 * part
    return wp.vec3(values[worldid, i], values[worldid, i + 1], values[worldid, i + 2])


@wp.func
def kind_of(parts: Parts, worldid: int, part: int) -> int:
    """Kind of a part."""
    if part == 0:
        return int(parts.kind_0[worldid, 0])
    if part == 1:
        return int(parts.kind_1[worldid, 0])
    return int(parts.kind_2[worldid, 0])


@wp.kernel(enable_backward=False)
def shape_parts(
    # Params:
    object_geom: int,
    # In:
    parts: Parts,
    mask: wp.array[bool],
    # Out:
    shapes: Shapes,
    places: Places,
):
    """One geom of each part is there, of the kind, size, place, turn and friction that were drawn."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    for part in range(PARTS):
        kind, size = kind_of(parts, worldid, part), three(parts.part_size, worldid, part)
        turn = turned(three(parts.part_turn, worldid, part))
        for i in range(NUM_KINDS):
            geom = object_geom + NUM_KINDS * part + i
            if SPHERE + i == kind:
                write_shape(shapes, worldid, geom, kind, size)
            else:
                hide(shapes, worldid, geom)
            places.geom_pos[worldid, geom] = wp.cw_mul(size, three(parts.part_place, worldid, part))
            places.geom_quat[worldid, geom] = wp.quat(turn[3], turn[0], turn[1], turn[2])  # w, x, y, z
            places.geom_friction[worldid, geom] = three(parts.part_friction, worldid, part)


@wp.kernel(enable_backward=False)
def weigh_parts(
    # Params:
    object_body: int,
    object_dof: int,
    least_inertia: float,
    free: bool,
    # In:
    parts: Parts,
    mask: wp.array[bool],
    # Out:
    weights: Weights,
):
    """m_i = m V_i / V; c = sum m_i c_i / m; I = sum R_i I_i R_i^T + m_i (|d|^2 1 - d d^T), d = c_i - c."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    whole = float(0.0)
    center = wp.vec3(0.0, 0.0, 0.0)
    for part in range(PARTS):
        size = three(parts.part_size, worldid, part)
        share = volume(kind_of(parts, worldid, part), size)
        whole += share
        center += share * wp.cw_mul(size, three(parts.part_place, worldid, part))
    center /= whole
    inertia = wp.mat33(0.0)
    for part in range(PARTS):
        kind, size = kind_of(parts, worldid, part), three(parts.part_size, worldid, part)
        mass = parts.object_mass[worldid, 0] * volume(kind, size) / whole
        axes = wp.quat_to_matrix(turned(three(parts.part_turn, worldid, part)))
        shift = wp.cw_mul(size, three(parts.part_place, worldid, part)) - center
        inertia += turned_inertia(axes, mass * gyration(kind, size)) + shifted_inertia(mass, shift)
    write_weight(
        weights,
        worldid,
        object_body,
        object_dof,
        parts.object_mass[worldid, 0],
        center,
        inertia,
        least_inertia,
        free,
    )
