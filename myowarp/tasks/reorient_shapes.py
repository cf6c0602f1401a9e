"""The object of reorient: a solid of a kind and size from a table; discs at the ends of its axis only weigh.

Source: MyoSuite 3.0.0, family Reorient; the tables are recorded from its wheel, Apache-2.0.
"""

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import warp as wp

from myowarp.tasks.solids import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    TINY,
    Shapes,
    Weights,
    gyration,
    hide,
    shifted_inertia,
    volume,
    write_shape,
    write_weight,
)

TABLES = Path(__file__).with_name("reorient_shapes.npz")
KINDS = tuple(int(kind) for kind in (CAPSULE, ELLIPSOID, CYLINDER, BOX))  # in this order
NUM_KINDS = wp.constant(len(KINDS))
MASS = wp.constant(1.2)  # kg
DENSITY, CAP_DENSITY = wp.constant(1500.0), wp.constant(1000.0)  # kg/m^3, before the mass is set
CAP = wp.constant(wp.vec3(0.013, 0.002, 0.0))  # m: two discs at the ends of the axis, which weigh only
CAPSULE_CAP = wp.constant(1.3)  # half lengths from a capsule's center to its discs
NO_LEAST = wp.constant(0.0)
NOMINAL = (0.015, 0.015, 0.045)  # m, semi-axes of the ellipsoid that is compiled in


@cache
def shapes(table: str) -> np.ndarray:
    """Return a table of shapes: kind, a number of `mujoco.mjtGeom`, and sizes [m], shape (n, 4)."""
    with np.load(TABLES) as tables:
        return tables[table]


def add_kinds(body: mujoco.MjsBody, name: str, condim: int, rgba: tuple[float, ...]) -> None:
    """Add a geom of every kind, of which the ellipsoid is there until a shape is drawn."""
    for kind in KINDS:
        geom = body.add_geom(name=f"{name}_{kind}", type=mujoco.mjtGeom(kind), rgba=rgba)
        geom.size = NOMINAL if kind == int(ELLIPSOID) else 3 * (TINY,)
        geom.contype, geom.conaffinity, geom.condim = 1, 1, condim
        geom.density = float(DENSITY)


@wp.func
def kind_in(table: wp.array2d[float], row: int) -> int:
    """Kind of a shape."""
    return int(table[row, 0])


@wp.func
def size_in(table: wp.array2d[float], row: int) -> wp.vec3:
    """Sizes of a shape [m]."""
    return wp.vec3(table[row, 1], table[row, 2], table[row, 3])


@wp.func
def drawn_row(table: wp.array2d[float], row: wp.array2d[float], worldid: int) -> int:
    """The drawn number, rounded down."""
    return wp.min(int(row[worldid, 0]), table.shape[0] - 1)


@wp.func
def cap_height(kind: int, size: wp.vec3) -> float:
    """From the center to the discs [m]."""
    if kind == CAPSULE:
        return CAPSULE_CAP * size[1]
    if kind == CYLINDER:
        return size[1]
    return size[2]


@wp.kernel(enable_backward=False)
def shape_drawn(
    # Params:
    object_geom: int,
    target_geom: int,
    table: wp.array2d[float],
    # In:
    row: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    shape_fields: Shapes,
):
    """Of object and target the geom of the drawn kind is there, in the drawn size."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    drawn = drawn_row(table, row, worldid)
    for i in range(NUM_KINDS):
        if CAPSULE + i == kind_in(table, drawn):
            write_shape(shape_fields, worldid, object_geom + i, CAPSULE + i, size_in(table, drawn))
            write_shape(shape_fields, worldid, target_geom + i, CAPSULE + i, size_in(table, drawn))
        else:
            hide(shape_fields, worldid, object_geom + i)
            hide(shape_fields, worldid, target_geom + i)


@wp.kernel(enable_backward=False)
def weigh_shape(
    # Params:
    object_body: int,
    object_dof: int,
    free: bool,
    table: wp.array2d[float],
    # In:
    row: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    weights: Weights,
):
    """m = 1.2 kg, of a solid of 1500 kg/m^3 and two discs of 1000 kg/m^3 in proportion."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    drawn = drawn_row(table, row, worldid)
    kind, size = kind_in(table, drawn), size_in(table, drawn)
    solid, cap = DENSITY * volume(kind, size), CAP_DENSITY * volume(CYLINDER, CAP)
    scale = MASS / (solid + 2.0 * cap)
    inertia = wp.diag(scale * (solid * gyration(kind, size) + 2.0 * cap * gyration(CYLINDER, CAP)))
    inertia += shifted_inertia(2.0 * scale * cap, wp.vec3(0.0, 0.0, cap_height(kind, size)))
    write_weight(
        weights,
        worldid,
        object_body,
        object_dof,
        MASS,
        wp.vec3(0.0, 0.0, 0.0),
        inertia,
        NO_LEAST,
        free,
    )
