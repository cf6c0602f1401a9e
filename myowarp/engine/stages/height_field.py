"""Contacts of spheres, capsules and ellipsoids with a height field, which may differ from world to world."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp import DisableBit
from mujoco_warp._src.collision_core import contact_margin_gap

from myowarp.engine.stages.arrays import ContactPool, filled
from myowarp.engine.stages.contact_search_kernel import (
    CAPSULE,
    ELLIPSOID,
    ContactMaterial,
    Pair,
    Shapes,
    long_axis,
    write_touch,
)
from myowarp.engine.stages.prism import Prism, Solid, extent, prism_touch
from myowarp.engine.stages.separation import ellipsoid_matrix
from myowarp.kernels.batching import batched, num_threads
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of


@wp.struct
class Field:
    """A height field.

    Attributes:
        pairs: Its geom and one that may touch it.
        pairids: What the engine calls these pairs.
        half: Half of its lengths in x and y [m].
        bottom: Height of its base in its frame [m].
        ceiling: Height in its frame that it does not exceed [m].
        heights: In its frame [m], rows along x, shape (1 or num_worlds, num_rows, num_columns).
    """

    pairs: wp.array[wp.vec2i]
    pairids: wp.array[wp.vec2i]
    half: wp.vec2
    bottom: float
    ceiling: float
    heights: wp.array3d[float]


@wp.func
def solid_of(kind: int, size: wp.vec3, rotation: wp.mat33) -> Solid:
    """Return a sphere, capsule or ellipsoid; the rotation is that in the field's frame."""
    solid = Solid()
    solid.axis = long_axis(rotation)
    if kind == ELLIPSOID:
        solid.e = ellipsoid_matrix(size, rotation)
    else:
        solid.radius = size[0]
        solid.half = wp.where(kind == CAPSULE, size[1], 0.0)
    return solid


@wp.func
def cell_range(low: float, high: float, half: float, number: int) -> wp.vec2i:
    """Return the first and last grid line around what lies between two places, as MuJoCo C does."""
    step = 2.0 * half / float(number - 1)
    first = wp.max(0, int(wp.floor((low + half) / step)))
    return wp.vec2i(first, wp.min(number - 1, int(wp.ceil((high + half) / step))))


@wp.func
def corner(half: wp.vec2, heights: wp.array2d[float], row: int, column: int, place: wp.vec3) -> wp.vec3:
    """Return a point of the grid, seen from a place [m]."""
    x = 2.0 * half[0] * (float(column) / float(heights.shape[1] - 1) - 0.5)
    y = 2.0 * half[1] * (float(row) / float(heights.shape[0] - 1) - 0.5)
    return wp.vec3(x, y, heights[row, column]) - place


@wp.func
def triangle(
    half: wp.vec2, heights: wp.array2d[float], row: int, column: int, second: int, place: wp.vec3
) -> wp.mat33:
    """Return one of the two triangles of a cell, seen from a place, counterclockwise from above.

    The first is where y is large in the cell, the second where x is.
    """
    start = corner(half, heights, row, column, place)
    end = corner(half, heights, row + 1, column + 1, place)
    if second == 0:
        return wp.matrix_from_rows(end, corner(half, heights, row + 1, column, place), start)
    return wp.matrix_from_rows(start, corner(half, heights, row, column + 1, place), end)


@wp.kernel(enable_backward=False)
def find_field_contacts(
    # Model:
    shapes: Shapes,
    material: ContactMaterial,
    # Params:
    field: Field,
    # Data in:
    naconmax_in: int,
    # In:
    threads: int,
    # Data out:
    contact_out: ContactPool,
):
    """dist(prism, geom) < margin + gap, for all prisms below the geom."""
    worldid, thread = wp.tid()
    heights = field.heights[batched(worldid, field.heights.shape[0])]
    sizes = shapes.geom_size[batched(worldid, shapes.geom_size.shape[0])]
    pair, prism = Pair(), Prism()
    pair.worldid = worldid
    for i in range(thread, field.pairs.shape[0], threads):
        pair.geoms = field.pairs[i]
        pair.pairid = field.pairids[i]
        ground, geom = pair.geoms[0], pair.geoms[1]
        margin, gap = contact_margin_gap(
            shapes.geom_margin,
            shapes.geom_gap,
            shapes.pair_margin,
            shapes.pair_gap,
            pair.geoms,
            pair.pairid[0],
            worldid,
        )
        pair.margin = margin
        pair.gap = gap
        cutoff = margin + gap
        frame = shapes.geom_xmat[worldid, ground]
        center = shapes.geom_xpos[worldid, geom]
        place = wp.transpose(frame) @ (center - shapes.geom_xpos[worldid, ground])
        rotation = wp.transpose(frame) @ shapes.geom_xmat[worldid, geom]
        solid = solid_of(shapes.geom_type[geom], sizes[geom], rotation)
        reach = wp.vec3(
            extent(solid, wp.vec3(1.0, 0.0, 0.0)),
            extent(solid, wp.vec3(0.0, 1.0, 0.0)),
            extent(solid, wp.vec3(0.0, 0.0, 1.0)),
        )
        reach += wp.vec3(cutoff, cutoff, cutoff)
        if place[2] - reach[2] > field.ceiling:
            continue
        prism.bottom = field.bottom - place[2]
        columns = cell_range(place[0] - reach[0], place[0] + reach[0], field.half[0], heights.shape[1])
        rows = cell_range(place[1] - reach[1], place[1] + reach[1], field.half[1], heights.shape[0])
        for row in range(rows[0], rows[1]):
            for column in range(columns[0], columns[1]):
                for second in range(2):
                    prism.top = triangle(field.half, heights, row, column, second, place)
                    highest = wp.max(prism.top[0, 2], wp.max(prism.top[1, 2], prism.top[2, 2]))
                    if highest < -reach[2]:
                        continue
                    touch = prism_touch(solid, prism, cutoff)
                    if touch.dist < cutoff:
                        touch.pos = center + frame @ touch.pos
                        touch.normal = frame @ touch.normal
                        write_touch(touch, pair, material, 0, naconmax_in, contact_out)


class HeightField:
    """A height field, see `definitions.ground.Ground`; its heights are the model's until others come."""

    def __init__(self, host: mujoco.MjModel, pairs: np.ndarray, pairids: np.ndarray) -> None:
        """Copy a field to Warp's device.

        Args:
            host: The model.
            pairs: The field's geom and one that may touch it, shape (num_pairs, 2).
            pairids: What the engine calls these pairs, shape (num_pairs, 2).
        """
        self.hfield = number = int(host.geom_dataid[pairs[0, 0]])
        x, y, z, base = host.hfield_size[number].tolist()
        shape = int(host.hfield_nrow[number]), int(host.hfield_ncol[number])
        first = host.hfield_adr[number]
        values = host.hfield_data[first : first + shape[0] * shape[1]].reshape(1, *shape)
        self.pairs = frozenset((min(pair), max(pair)) for pair in pairs.tolist())
        self.heights = wp.array(z * values, dtype=float)
        half = wp.vec2(x, y)
        self._field = struct_of(Field, pairs=pairs, pairids=pairids, half=half, bottom=-base, ceiling=z)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Append contacts with the field to those that were found."""
        if model.opt.disableflags & (DisableBit.CONSTRAINT | DisableBit.CONTACT):
            return
        self._field.heights = self.heights
        threads = num_threads(data.nacon.device, self._field.pairs.shape[0])
        launch(
            find_field_contacts,
            (data.nworld, threads),
            data,
            threads=threads,
            field=self._field,
            shapes=filled(Shapes, model, data),
            material=filled(ContactMaterial, model),
            contact=filled(ContactPool, data.contact, data),
        )
