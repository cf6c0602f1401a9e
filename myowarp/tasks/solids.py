"""Objects of simple solids whose kind, size and place are drawn anew in every episode.

MuJoCo fixes the kind of a geom when a model is compiled. So an object has a geom of every kind in each
place, of which one is there in a world: the others are tiny and touch nothing. Quantities that MuJoCo
derives from geoms when it compiles them are computed here and written per world: bounds for the search of
contacts, mass, inertia, inverse weights.

Source: MuJoCo documentation, *XML reference, body/geom* and *compiler* (`inertiafromgeom`, `boundinertia`);
solids are homogeneous, a capsule is a cylinder with two half spheres.
"""

import mujoco
import warp as wp

SPHERE = wp.constant(int(mujoco.mjtGeom.mjGEOM_SPHERE))
CAPSULE = wp.constant(int(mujoco.mjtGeom.mjGEOM_CAPSULE))
ELLIPSOID = wp.constant(int(mujoco.mjtGeom.mjGEOM_ELLIPSOID))
CYLINDER = wp.constant(int(mujoco.mjtGeom.mjGEOM_CYLINDER))
BOX = wp.constant(int(mujoco.mjtGeom.mjGEOM_BOX))

TINY = 1e-4  # m, half size of a geom that is not there
HIDDEN_SIZE = wp.constant(wp.vec3(TINY, TINY, TINY))
UNREACHED = wp.constant(10.0)  # m: so much closer than touching two geoms would have to be

BATCHED_SHAPE = ("geom_size", "geom_rbound", "geom_aabb", "geom_margin")
"""Names of the model's fields that `write_shape` and `hide` write."""

BATCHED_WEIGHT = (
    *("body_mass", "body_subtreemass", "body_inertia", "body_ipos", "body_iquat"),
    *("body_invweight0", "dof_invweight0"),
)
"""Fields that `write_weight` writes."""


@wp.struct
class Shapes:
    """Geoms of all worlds; fields are the engine's."""

    geom_size: wp.array2d[wp.vec3]
    geom_rbound: wp.array2d[float]
    geom_aabb: wp.array3d[wp.vec3]
    geom_margin: wp.array2d[float]


@wp.struct
class Weights:
    """Bodies of all worlds; fields are the engine's."""

    body_mass: wp.array2d[float]
    body_subtreemass: wp.array2d[float]
    body_inertia: wp.array2d[wp.vec3]
    body_ipos: wp.array2d[wp.vec3]
    body_iquat: wp.array2d[wp.quat]
    body_invweight0: wp.array2d[wp.vec2]
    dof_invweight0: wp.array2d[float]


@wp.func
def volume(kind: int, size: wp.vec3) -> float:
    """Volume [m^3]; sizes are MuJoCo's: radius and half length, semi-axes, or half sides."""
    if kind == BOX:
        return 8.0 * size[0] * size[1] * size[2]
    if kind == ELLIPSOID:
        return 4.0 / 3.0 * wp.pi * size[0] * size[1] * size[2]
    ball = 4.0 / 3.0 * wp.pi * size[0] * size[0] * size[0]
    rod = 2.0 * wp.pi * size[0] * size[0] * size[1]
    if kind == SPHERE:
        return ball
    if kind == CYLINDER:
        return rod
    return ball + rod


@wp.func
def gyration(kind: int, size: wp.vec3) -> wp.vec3:
    """Principal moments of inertia over mass [m^2], about the solid's own axes."""
    a, b, c = size[0] * size[0], size[1] * size[1], size[2] * size[2]
    if kind == BOX:
        return wp.vec3(b + c, a + c, a + b) / 3.0
    if kind == ELLIPSOID:
        return wp.vec3(b + c, a + c, a + b) / 5.0
    if kind == SPHERE:
        return wp.vec3(a, a, a) * 0.4
    height = 2.0 * size[1]
    across, along = (3.0 * a + height * height) / 12.0, 0.5 * a
    if kind == CAPSULE:
        balls = 4.0 * size[0] / (4.0 * size[0] + 3.0 * height)
        shift = height * (3.0 * size[0] + 2.0 * height) / 8.0
        across = (1.0 - balls) * across + balls * (0.4 * a + shift)
        along = (1.0 - balls) * along + balls * 0.4 * a
    return wp.vec3(across, across, along)


@wp.func
def half_box(kind: int, size: wp.vec3) -> wp.vec3:
    """Half sides of the bounding box [m]."""
    if kind == SPHERE:
        return wp.vec3(size[0], size[0], size[0])
    if kind == CAPSULE:
        return wp.vec3(size[0], size[0], size[0] + size[1])
    if kind == CYLINDER:
        return wp.vec3(size[0], size[0], size[1])
    return size


@wp.func
def bound(kind: int, size: wp.vec3) -> float:
    """Radius of the bounding sphere [m]."""
    if kind == BOX:
        return wp.length(size)
    if kind == CYLINDER:
        return wp.length(wp.vec2(size[0], size[1]))
    return wp.max(half_box(kind, size))


@wp.func
def write_shape(shapes: Shapes, worldid: int, geom: int, kind: int, size: wp.vec3):
    """Give a geom a size, in one world, and what follows from it for the search of contacts."""
    shapes.geom_size[worldid, geom] = size
    shapes.geom_rbound[worldid, geom] = bound(kind, size)
    shapes.geom_aabb[worldid, geom, 1] = half_box(kind, size)
    shapes.geom_margin[worldid, geom] = 0.0


@wp.func
def hide(shapes: Shapes, worldid: int, geom: int):
    """Take a geom out of one world.

    The search compares centers with the sum of radii and margins, squared, so that the radius makes up for
    the margin.
    """
    shapes.geom_size[worldid, geom] = HIDDEN_SIZE
    shapes.geom_rbound[worldid, geom] = UNREACHED
    shapes.geom_aabb[worldid, geom, 1] = HIDDEN_SIZE
    shapes.geom_margin[worldid, geom] = -UNREACHED


@wp.func
def turned_inertia(axes: wp.mat33, moments: wp.vec3) -> wp.mat33:
    """R diag(I) R^T."""
    return axes @ wp.diag(moments) @ wp.transpose(axes)


@wp.func
def shifted_inertia(mass: float, shift: wp.vec3) -> wp.mat33:
    """m (|d|^2 1 - d d^T): what a distance d from the center adds."""
    return mass * (wp.dot(shift, shift) * wp.identity(n=3, dtype=float) - wp.outer(shift, shift))


@wp.func
def principal_axes(inertia: wp.mat33) -> wp.mat33:
    """Principal axes, right-handed, in columns.

    Warp's `eig3` leaves up to 3e-3 of the largest moment beside the diagonal (of 20,000 random inertias), and
    axes that are 3e-6 off a right angle; a second pass and right angles leave 2e-6.
    """
    rough, _ = wp.eig3(inertia)
    fine, _ = wp.eig3(wp.transpose(rough) @ inertia @ rough)
    columns = wp.transpose(rough @ fine)
    x = wp.normalize(columns[0])
    y = wp.normalize(columns[1] - x * wp.dot(x, columns[1]))
    return wp.matrix_from_cols(x, y, wp.cross(x, y))


@wp.func
def write_weight(
    weights: Weights,
    worldid: int,
    body: int,
    dof: int,
    mass: float,
    center: wp.vec3,
    inertia: wp.mat33,
    least_inertia: float,
    free: bool,
):
    """Give a body of three slides and three hinges, or a free one, mass, center and inertia, in one world.

    Principal moments are raised to `least_inertia`, as the compiler's `boundinertia` does. Inverse weights:
    of the body 1/m and the mean of 1/I; of slides 1/m + (c x e)^T I^-1 (c x e), of hinges e^T I^-1 e; of a
    free joint the means of these three.
    """
    axes = principal_axes(inertia)
    moments = wp.get_diag(wp.transpose(axes) @ inertia @ axes)
    bounded = wp.vec3(
        wp.max(moments[0], least_inertia),
        wp.max(moments[1], least_inertia),
        wp.max(moments[2], least_inertia),
    )
    inverse = wp.vec3(1.0 / bounded[0], 1.0 / bounded[1], 1.0 / bounded[2])
    turn = wp.quat_from_matrix(axes)
    weights.body_mass[worldid, body] = mass
    weights.body_subtreemass[worldid, body] = mass
    weights.body_inertia[worldid, body] = bounded
    weights.body_ipos[worldid, body] = center
    weights.body_iquat[worldid, body] = wp.quat(turn[3], turn[0], turn[1], turn[2])  # w, x, y, z
    weights.body_invweight0[worldid, body] = wp.vec2(1.0 / mass, (inverse[0] + inverse[1] + inverse[2]) / 3.0)
    compliance = turned_inertia(axes, inverse)
    slide, hinge = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    for i in range(3):
        axis = wp.vec3(0.0, 0.0, 0.0)
        axis[i] = 1.0
        lever = wp.cross(center, axis)
        slide[i] = 1.0 / mass + wp.dot(lever, compliance @ lever)
        hinge[i] = compliance[i, i]
    if free:
        slide = wp.vec3(1.0, 1.0, 1.0) * (slide[0] + slide[1] + slide[2]) / 3.0
        hinge = wp.vec3(1.0, 1.0, 1.0) * (hinge[0] + hinge[1] + hinge[2]) / 3.0
    for i in range(3):
        weights.dof_invweight0[worldid, dof + i] = slide[i]
        weights.dof_invweight0[worldid, dof + 3 + i] = hinge[i]
