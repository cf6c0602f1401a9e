"""Pairs of geoms that may touch, worlds in lanes, on the CPU device.

A pair is the same in every world. For every unit n the separation f(n) of two convex bodies (see
`separation`) is at most their distance: one n with f(n) beyond the cutoff proves them apart. Tried are the
best n of a physics step ago, which is enough for most, the line between the centers, the one between the
closest points of two segments, the normals of a box or a plane, and steps of Newton's method against an
ellipsoid. The pairs left over are few, and `contact_search_kernel` finds their contacts, so that those do not
depend on what is tried here.
"""

from pathlib import Path

import mujoco_warp as mjw
import warp as wp

from myowarp.engine.stages.arrays import filled
from myowarp.engine.stages.contact_search_kernel import NearPairs, Shapes
from myowarp.engine.stepped import Stepped
from myowarp.kernels.lanes import WIDEST, at_namespace_level, block_scratch, native_kernel
from myowarp.kernels.launch import launch

SOLID = 26
"""Numbers of a `Solid` of contact_filter.cpp."""


@native_kernel(
    at_namespace_level(Path(__file__).with_suffix(".cpp")),
    does="""
    lanes::for_blocks(near.num.shape[0], nullptr, scratch.data,
                      [&](auto& block) { lanes::filter_block(block, shapes, near); });
    """,
)
def filter_pairs(
    # Model:
    shapes: Shapes,
    # In:
    scratch: wp.array[float],
    # Out:
    near: NearPairs,
):
    """f(n) <= margin + gap for every n that is tried."""


class ContactFilter:
    """The pairs of geoms that may touch."""

    def __init__(self, stepped: Stepped) -> None:
        """Allocate the lists of all worlds, and the memory of a block."""
        shapes, data = filled(Shapes, stepped.model, stepped.data), stepped.data
        num_pairs, solids = len(shapes.nxn_geom_pair_filtered), SOLID * stepped.oracle.ngeom
        self.near = NearPairs()
        self.near.num = wp.zeros(data.nworld, dtype=int, device=stepped.device)
        self.near.pairs = wp.zeros((data.nworld, num_pairs), dtype=int, device=stepped.device)
        self.near.normals = wp.zeros((data.nworld, num_pairs), dtype=wp.vec3, device=stepped.device)
        blocks = -(-data.nworld // WIDEST)
        self.near.kept = block_scratch(stepped.device, 3 * num_pairs * blocks)
        self.near.kept.zero_()
        self._scratch = block_scratch(stepped.device, shapes, solids)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """List the pairs."""
        launch(filter_pairs, 1, shapes=filled(Shapes, model, data), scratch=self._scratch, near=self.near)
