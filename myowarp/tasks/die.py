"""A die whose size, mass and friction are drawn anew in every episode.

Source: MyoSuite 3.0.0, `myoChallengeDieReorientP2-v0`: twelve capsules are its edges, three boxes its faces.
It recompiles what MuJoCo derives from size and mass; here the same fields are written per world.

In MyoSuite the engine takes the larger friction of die and hand, so that draws below the hand's (1, 0.005,
0.0001) have no effect, and the die has an inertia of at least 1e-4 kg m^2.
"""

import mujoco
import warp as wp

HALF = 0.0235  # m, half length of an edge, and half the distance between parallel ones
EDGE_RADIUS = wp.constant(0.005)  # m
LONG, NARROW = 0.0284, 0.0236  # m, half sizes of a box: through two faces, and across
HALF_EDGE, HALF_LONG, HALF_NARROW = wp.constant(HALF), wp.constant(LONG), wp.constant(NARROW)
MASS = 0.108  # kg
GYRATION = wp.constant(6.0e-4)  # m^2, inertia over mass
EDGES = wp.constant(12)
PARTS = 15  # edges, then boxes
FRICTION = (1.0, 0.005, 0.0001)

LINES = (
    *((1, (1, 0, -1)), (1, (-1, 0, -1)), (0, (0, 1, -1)), (0, (0, -1, -1))),
    *((1, (1, 0, 1)), (1, (-1, 0, 1)), (0, (0, 1, 1)), (0, (0, -1, 1))),
    *((2, (1, -1, 0)), (2, (1, 1, 0)), (2, (-1, 1, 0)), (2, (-1, -1, 0))),
)
"""Direction and middle of each edge, in half lengths."""

BATCHED_SHAPE = ("geom_size", "geom_pos", "geom_rbound", "geom_aabb", "geom_friction")
"""Names of the model's fields that `shape_die` writes per world."""

BATCHED_MASS = ("body_mass", "body_subtreemass", "body_inertia", "body_invweight0", "dof_invweight0")
"""Fields that `weigh_die` writes."""


def add_die(body: mujoco.MjsBody, name: str, rgba: tuple[float, ...]) -> list[mujoco.MjsGeom]:
    """Add the geoms of a die to a body, edges first, and give it its mass; returns them."""
    body.mass, body.explicitinertial, body.ipos = MASS, True, (0.0, 0.0, 0.0)
    body.inertia = 3 * (MASS * float(GYRATION),)
    geoms = []
    for axis, middle in LINES:
        ends = ([HALF * (sign if i == axis else middle[i]) for i in range(3)] for sign in (-1, 1))
        line = [number for end in ends for number in end]
        edge = body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=line)
        edge.size = (float(EDGE_RADIUS), 0.0, 0.0)
        geoms.append(edge)
    for axis in range(3):
        size = [LONG if i == axis else NARROW for i in range(3)]
        geoms.append(body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size))
    for i, geom in enumerate(geoms):
        geom.name = f"{name}_{i}"
        geom.contype, geom.conaffinity, geom.condim, geom.rgba = 1, 1, 3, rgba
    return geoms


@wp.func
def stretched(at: float, length: float) -> float:
    """A coordinate of an edge's middle, as far out as the edge is half long; 0 stays 0."""
    return wp.where(wp.abs(at) < EDGE_RADIUS, 0.0, wp.sign(at) * length)


@wp.kernel(enable_backward=False)
def shape_die(
    # Params:
    die_geom: int,
    # In:
    die_growth: wp.array2d[float],
    die_friction: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    geom_size: wp.array2d[wp.vec3],
    geom_pos: wp.array2d[wp.vec3],
    geom_rbound: wp.array2d[float],
    geom_aabb: wp.array3d[wp.vec3],
    geom_friction: wp.array2d[wp.vec3],
):
    """Half sizes and distances grow by d, radii of edges stay; bounds of capsule and box; frictions."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    growth = die_growth[worldid, 0]
    length = HALF_EDGE + growth
    for part in range(die_friction.shape[1] // 3):
        geom = die_geom + part
        coefficient = 3 * part
        geom_friction[worldid, geom] = wp.vec3(
            die_friction[worldid, coefficient],
            die_friction[worldid, coefficient + 1],
            die_friction[worldid, coefficient + 2],
        )
        if part < EDGES:
            at = geom_pos[worldid, geom]
            geom_pos[worldid, geom] = wp.vec3(
                stretched(at[0], length), stretched(at[1], length), stretched(at[2], length)
            )
            geom_size[worldid, geom] = wp.vec3(EDGE_RADIUS, length, 0.0)
            geom_rbound[worldid, geom] = length + EDGE_RADIUS
            geom_aabb[worldid, geom, 1] = wp.vec3(EDGE_RADIUS, EDGE_RADIUS, length + EDGE_RADIUS)
        else:
            size = wp.vec3(HALF_NARROW + growth, HALF_NARROW + growth, HALF_NARROW + growth)
            size[part - EDGES] = HALF_LONG + growth
            geom_size[worldid, geom] = size
            geom_rbound[worldid, geom] = wp.length(size)
            geom_aabb[worldid, geom, 1] = size


@wp.kernel(enable_backward=False)
def weigh_die(
    # Params:
    object_body: int,
    die_dof: int,
    least_inertia: float,
    # In:
    die_mass: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    body_mass: wp.array2d[float],
    body_subtreemass: wp.array2d[float],
    body_inertia: wp.array2d[wp.vec3],
    body_invweight0: wp.array2d[wp.vec2],
    dof_invweight0: wp.array2d[float],
):
    """Mass m, inertia I = max(6e-4 m, least) about every axis; inverse weights 1/m and 1/I."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    mass = die_mass[worldid, 0]
    inertia = wp.max(GYRATION * mass, least_inertia)
    body_mass[worldid, object_body] = mass
    body_subtreemass[worldid, object_body] = mass
    body_inertia[worldid, object_body] = wp.vec3(inertia, inertia, inertia)
    body_invweight0[worldid, object_body] = wp.vec2(1.0 / mass, 1.0 / inertia)
    for i in range(3):
        dof_invweight0[worldid, die_dof + i] = 1.0 / mass
        dof_invweight0[worldid, die_dof + 3 + i] = 1.0 / inertia
