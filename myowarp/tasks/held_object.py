"""An ellipsoid in the hand whose size is drawn anew in every episode.

Source: MyoSuite 3.0.0, `myoHandObjHoldRandom-v0`. It recompiles what MuJoCo derives from the size; here the
same fields are written per world.
"""

import warp as wp

DENSITY = 1000.0  # kg/m^3

BATCHED_SIZE = ("geom_size", "geom_rbound", "geom_aabb")
"""Names of the model's fields that `resize_object` writes per world."""

BATCHED_MASS = ("body_mass", "body_subtreemass", "body_inertia", "body_invweight0")
"""Further fields that `weigh_object` writes."""


@wp.kernel(enable_backward=False)
def resize_object(
    # Params:
    object_geom: int,
    # In:
    object_size: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    geom_size: wp.array2d[wp.vec3],
    geom_rbound: wp.array2d[float],
    geom_aabb: wp.array3d[wp.vec3],
):
    """Semi-axes, bounding sphere max(a, b, c) and bounding box of the ellipsoid."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    size = wp.vec3(object_size[worldid, 0], object_size[worldid, 1], object_size[worldid, 2])
    geom_size[worldid, object_geom] = size
    geom_rbound[worldid, object_geom] = wp.max(size)
    geom_aabb[worldid, object_geom, 1] = size


@wp.kernel(enable_backward=False)
def weigh_object(
    # Params:
    object_body: int,
    density: float,
    # In:
    object_size: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    body_mass: wp.array2d[float],
    body_subtreemass: wp.array2d[float],
    body_inertia: wp.array2d[wp.vec3],
    body_invweight0: wp.array2d[wp.vec2],
):
    """m = 4/3 pi rho a b c, I_x = m (b^2 + c^2) / 5 in cyclic order; inverse weights 1/m, mean of 1/I."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    size = wp.vec3(object_size[worldid, 0], object_size[worldid, 1], object_size[worldid, 2])
    mass = 4.0 / 3.0 * wp.pi * density * size[0] * size[1] * size[2]
    square = wp.cw_mul(size, size)
    inertia = 0.2 * mass * wp.vec3(square[1] + square[2], square[0] + square[2], square[0] + square[1])
    compliance = (1.0 / inertia[0] + 1.0 / inertia[1] + 1.0 / inertia[2]) / 3.0
    body_mass[worldid, object_body] = mass
    body_subtreemass[worldid, object_body] = mass
    body_inertia[worldid, object_body] = inertia
    body_invweight0[worldid, object_body] = wp.vec2(1.0 / mass, compliance)
