"""Paths of tendons: length, moment arms and velocity of every tendon, and what its actuators make of them.

A path is a chain of straight segments between sites, and of segments that bend round a sphere or a cylinder
where that is in the way (MuJoCo's documentation, *Computation, Tendon*). All is done in world axes, relative
to the centre of the geom. On the plane through both ends of a segment (on a cylinder: across its axis) the
path leaves the circle of radius r at the tangent points

    q = r / e^2 (r e + turn sqrt(e^2 - r^2) n x e),   e: an end, n: normal of the plane

A side site says on which side the path passes: MuJoCo 4 compares winding angles of the path over the side
site with those of the straight one. They differ exactly if the triangle of ends and side site holds the
centre, which is three signs of cross products, and then the path winds as the side site does. Only a path that
does bend costs an arc tangent. A side site inside the geom makes the path pass through it (`wrap_inside` of
mujoco-warp).

Moment arm of dof j: a tendon that pulls along u through the point x does -(c_rot . (x - com) x u + c_lin . u)
to the dof (c_rot, c_lin) = cdof_j, given at com, the centre of mass of its tree. Dofs that move both ends of
a segment cancel and are left out beforehand.
"""

import warp as wp
from mujoco_warp._src.util_misc import wrap_inside

STRAIGHT = wp.constant(0)
SPHERE = wp.constant(1)
CYLINDER = wp.constant(2)

TINY = wp.constant(1e-15)
"""mjMINVAL: MuJoCo takes shorter vectors as zero."""


@wp.struct
class Link:
    """Dofs that move one end of a segment against the other, as a span of `PathProgram.crossings`.

    Attributes:
        near_root: Root of the tree that the near end is in, whose centre of mass `cdof` refers to.
        far_root: The same for the far end.
        first: Where dofs that move only the near end begin.
        middle: Where they end, and those that move only the far end begin.
        last: Where these end.
    """

    near_root: int
    far_root: int
    first: int
    middle: int
    last: int


@wp.struct
class PathOp:
    """A segment between two sites that is straight or may bend round a geom.

    Attributes:
        kind: STRAIGHT, SPHERE or CYLINDER.
        near_site: Where it begins.
        near_body: Body of that site.
        far_site: Where it ends.
        far_body: Body of that site.
        geom: What it may bend round.
        side_site: Side site, -1: none.
        side_body: Body of the side site.
        scale: 1 / divisor of the pulley branch.
        direct: Dofs between the sites.
        onto: Dofs between the near site and the geom.
        off: Dofs between the geom and the far site.
    """

    kind: int
    near_site: int
    near_body: int
    far_site: int
    far_body: int
    geom: int
    side_site: int
    side_body: int
    scale: float
    direct: Link
    onto: Link
    off: Link


@wp.struct
class Path:
    """A tendon.

    Attributes:
        fixed_length: Length of all that never changes [m].
        first_op: Its first segment in `PathProgram.ops`.
        last_op: The one after its last.
        row: Its row's address in `ten_J`.
        num_dofs: Entries of that row.
        first_drive: Its first actuator in `PathProgram.drives`.
        last_drive: The one after its last.
    """

    fixed_length: float
    first_op: int
    last_op: int
    row: int
    num_dofs: int
    first_drive: int
    last_drive: int


@wp.struct
class Drive:
    """An actuator on a tendon, or on a hinge or a slide.

    Attributes:
        actuator: Its id.
        row: Its row's address in `actuator_moment`.
        qpos: Address of its joint in qpos; not used on a tendon.
        dof: Its joint's dof; not used on a tendon.
    """

    actuator: int
    row: int
    qpos: int
    dof: int


@wp.struct
class PathProgram:
    """All tendons and their actuators, compiled by `myowarp.models.path_program`.

    Attributes:
        paths: Every tendon.
        ops: Segments of all tendons, one tendon after the other.
        crossings: Dof and address in `ten_J` of each moment arm of a segment.
        dofs: Dof of each entry of `ten_J`.
        drives: Actuators, those on tendons in the order of the tendons, then those on joints.
        first_joint_drive: First actuator on a joint.
        site_pos: Positions of sites in their bodies [m], shape (1 or num_worlds, nsite).
        geom_size: Sizes of geoms, radius first [m], shape (1 or num_worlds, ngeom).
        actuator_gear: Gears, shape (1 or num_worlds, nu).
    """

    paths: wp.array[Path]
    ops: wp.array[PathOp]
    crossings: wp.array[wp.vec2i]
    dofs: wp.array[int]
    drives: wp.array[Drive]
    first_joint_drive: int
    site_pos: wp.array2d[wp.vec3]
    geom_size: wp.array2d[wp.vec3]
    actuator_gear: wp.array2d[wp.spatial_vector]


@wp.struct
class Pose:
    """Where all bodies are and how they move; the arrays of `mujoco_warp.Data` with these names."""

    qpos: wp.array2d[float]
    qvel: wp.array2d[float]
    xpos: wp.array2d[wp.vec3]
    xmat: wp.array2d[wp.mat33]
    geom_xpos: wp.array2d[wp.vec3]
    geom_xmat: wp.array2d[wp.mat33]
    subtree_com: wp.array2d[wp.vec3]
    cdof: wp.array2d[wp.spatial_vector]


@wp.struct
class Transmission:
    """What paths and actuators make of a pose; the arrays of `mujoco_warp.Data` with these names."""

    ten_length: wp.array2d[float]
    ten_J: wp.array2d[float]  # noqa: N815  (the engine's name)
    actuator_length: wp.array2d[float]
    actuator_velocity: wp.array2d[float]
    moment_rownnz: wp.array2d[int]
    moment_rowadr: wp.array2d[int]
    moment_colind: wp.array2d[int]
    actuator_moment: wp.array2d[float]


@wp.struct
class Bend:
    """A segment that bends.

    Attributes:
        length: Its length [m], < 0 where it stays straight.
        onto: Direction in which it leaves the near site.
        off: Direction in which it reaches the far site.
    """

    length: float
    onto: wp.vec3
    off: wp.vec3


@wp.func
def unit(vector: wp.vec3, length: float) -> wp.vec3:
    """Return vector / length, (1, 0, 0) for a zero vector as MuJoCo does."""
    if length < TINY:
        return wp.vec3(1.0, 0.0, 0.0)
    return vector / length


@wp.func
def sphere_normal(near: wp.vec3, far: wp.vec3) -> wp.vec3:
    """Return the normal of the plane through two points and the centre; MuJoCo's choice if these are in line."""
    normal = wp.cross(near, far)
    length = wp.length(normal)
    if length < TINY:
        size = wp.abs(near)
        other = wp.vec3(0.0, 1.0, 1.0)
        if size[1] > size[0] and size[1] > size[2]:
            other = wp.vec3(1.0, 0.0, 1.0)
        if size[2] > size[0] and size[2] > size[1]:
            other = wp.vec3(1.0, 1.0, 0.0)
        normal = wp.cross(near, other)
        length = wp.length(normal)
    return unit(normal, length)


@wp.func
def bend_outside(
    near: wp.vec3, far: wp.vec3, normal: wp.vec3, side: wp.vec3, has_side: bool, radius: float
) -> Bend:
    """Bend round a circle: `length` is that of the whole segment in the plane, directions are not unit."""
    bend = Bend()
    bend.length = -1.0
    near2, far2, radius2 = wp.dot(near, near), wp.dot(far, far), radius * radius
    step = far - near
    step2 = wp.dot(step, step)
    if near2 < radius2 or far2 < radius2 or radius < TINY or step2 < TINY:
        return bend
    turn = wp.dot(normal, wp.cross(near, step))
    encloses = bool(False)
    if has_side:
        to_side = wp.dot(normal, wp.cross(near, side))
        from_side = wp.dot(normal, wp.cross(side, far))
        encloses = (to_side > 0.0 and from_side > 0.0 and turn <= 0.0) or (
            to_side < 0.0 and from_side < 0.0 and turn >= 0.0
        )
        if encloses:
            turn = to_side
    if not encloses:
        along = -wp.dot(step, near)
        if along <= 0.0 or along >= step2 or turn * turn > radius2 * step2:
            return bend
    sign = wp.where(turn < 0.0, -1.0, 1.0)
    near_tangent, far_tangent = wp.sqrt(near2 - radius2), wp.sqrt(far2 - radius2)
    touch = radius / near2 * (radius * near + sign * near_tangent * wp.cross(normal, near))
    leave = radius / far2 * (radius * far - sign * far_tangent * wp.cross(normal, far))
    arc = wp.atan2(sign * wp.dot(normal, wp.cross(touch, leave)), wp.dot(touch, leave))
    if arc < 0.0:
        if not encloses:
            return bend
        arc += 2.0 * wp.pi
    bend.length = near_tangent + radius * arc + far_tangent
    bend.onto = touch - near
    bend.off = far - leave
    return bend


@wp.func
def bend_inside(near: wp.vec3, far: wp.vec3, normal: wp.vec3, radius: float) -> Bend:
    """Bend over the nearest point of the inside of a circle; what is returned is as in `bend_outside`."""
    bend = Bend()
    bend.length = -1.0
    distance = wp.length(near)
    first = unit(near, distance)
    second = wp.cross(normal, first)
    ends = wp.vec4(distance, 0.0, wp.dot(far, first), wp.dot(far, second))
    arc, point, _ = wrap_inside(ends, radius)
    if arc < 0.0:
        return bend
    touch = point[0] * first + point[1] * second
    bend.onto = touch - near
    bend.off = far - touch
    bend.length = wp.length(bend.onto) + wp.length(bend.off)
    return bend


@wp.func
def bend_round(
    kind: int, near: wp.vec3, far: wp.vec3, axis: wp.vec3, side: wp.vec3, has_side: bool, radius: float
) -> Bend:
    """Bend round a geom; points relative to its centre, `axis` is the cylinder's."""
    flat_near, flat_far, rise = near, far, float(0.0)
    if kind == CYLINDER:
        low, high = wp.dot(near, axis), wp.dot(far, axis)
        flat_near, flat_far, rise = near - low * axis, far - high * axis, high - low
        normal = axis
    else:
        normal = sphere_normal(near, far)
    if has_side and wp.length_sq(side) < radius * radius:
        bend = bend_inside(flat_near, flat_far, normal, radius)
    else:
        bend = bend_outside(flat_near, flat_far, normal, side, has_side, radius)
    if bend.length < 0.0:
        return bend
    # A cylinder's path rises at one slope from end to end.
    slope = rise / bend.length
    bend.onto += slope * wp.length(bend.onto) * axis
    bend.off += slope * wp.length(bend.off) * axis
    bend.onto = unit(bend.onto, wp.length(bend.onto))
    bend.off = unit(bend.off, wp.length(bend.off))
    bend.length = wp.sqrt(bend.length * bend.length + rise * rise)
    return bend


@wp.func
def add_moments(
    crossings: wp.array[wp.vec2i],
    subtree_com: wp.array[wp.vec3],
    cdof: wp.array[wp.spatial_vector],
    link: Link,
    point: wp.vec3,
    force: wp.vec3,
    row: wp.array[float],
):
    """row[j] += cdof_j . ((point - com) x force, force), with the sign of the end that dof j moves."""
    if link.first < link.middle:
        wrench = wp.spatial_vector(wp.cross(point - subtree_com[link.near_root], force), force)
        for i in range(link.first, link.middle):
            crossing = crossings[i]
            row[crossing[1]] = row[crossing[1]] - wp.dot(cdof[crossing[0]], wrench)
    if link.middle < link.last:
        wrench = wp.spatial_vector(wp.cross(point - subtree_com[link.far_root], force), force)
        for i in range(link.middle, link.last):
            crossing = crossings[i]
            row[crossing[1]] = row[crossing[1]] + wp.dot(cdof[crossing[0]], wrench)


@wp.func
def follow(program: PathProgram, pose: Pose, worldid: int, path: Path, moments: wp.array[float]) -> float:
    """Add the moment arms of a path to its row of `ten_J`, and return its length."""
    length = path.fixed_length
    sites = program.site_pos[worldid % program.site_pos.shape[0]]
    subtree_com, cdof = pose.subtree_com[worldid], pose.cdof[worldid]
    for i in range(path.first_op, path.last_op):
        op = program.ops[i]
        near = pose.xpos[worldid, op.near_body] + pose.xmat[worldid, op.near_body] * sites[op.near_site]
        far = pose.xpos[worldid, op.far_body] + pose.xmat[worldid, op.far_body] * sites[op.far_site]
        bend = Bend()
        bend.length = -1.0
        if op.kind != STRAIGHT:
            centre = pose.geom_xpos[worldid, op.geom]
            turned = pose.geom_xmat[worldid, op.geom]
            axis = wp.vec3(turned[0, 2], turned[1, 2], turned[2, 2])
            radius = program.geom_size[worldid % program.geom_size.shape[0], op.geom][0]
            side = wp.vec3()
            if op.side_site >= 0:
                side = pose.xmat[worldid, op.side_body] * sites[op.side_site]
                side += pose.xpos[worldid, op.side_body] - centre
            bend = bend_round(op.kind, near - centre, far - centre, axis, side, op.side_site >= 0, radius)
        if bend.length >= 0.0:
            length += op.scale * bend.length
            add_moments(program.crossings, subtree_com, cdof, op.onto, near, op.scale * bend.onto, moments)
            add_moments(program.crossings, subtree_com, cdof, op.off, far, op.scale * bend.off, moments)
        else:
            step = far - near
            distance = wp.length(step)
            length += op.scale * distance
            force = op.scale * unit(step, distance)
            add_moments(program.crossings, subtree_com, cdof, op.direct, near, force, moments)
    return length


@wp.kernel(enable_backward=False)
def muscle_path(
    # Params:
    program: PathProgram,
    threads: int,
    # In:
    pose: Pose,
    # Out:
    transmission: Transmission,
):
    """Length = sum of segments, ten_J = its gradient; an actuator's length, moment, velocity = gear (...)."""
    worldid, thread = wp.tid()
    moments, qvel = transmission.ten_J[worldid], pose.qvel[worldid]
    gears = program.actuator_gear[worldid % program.actuator_gear.shape[0]]
    for pathid in range(thread, program.paths.shape[0], threads):
        path = program.paths[pathid]
        for entry in range(path.row, path.row + path.num_dofs):
            moments[entry] = 0.0
        length = follow(program, pose, worldid, path, moments)
        transmission.ten_length[worldid, pathid] = length
        for i in range(path.first_drive, path.last_drive):
            drive = program.drives[i]
            gear = gears[drive.actuator][0]
            velocity = float(0.0)
            for k in range(path.num_dofs):
                dof, moment = program.dofs[path.row + k], gear * moments[path.row + k]
                transmission.moment_colind[worldid, drive.row + k] = dof
                transmission.actuator_moment[worldid, drive.row + k] = moment
                velocity += moment * qvel[dof]
            transmission.actuator_length[worldid, drive.actuator] = gear * length
            transmission.actuator_velocity[worldid, drive.actuator] = velocity
            transmission.moment_rownnz[worldid, drive.actuator] = path.num_dofs
            transmission.moment_rowadr[worldid, drive.actuator] = drive.row
    for i in range(program.first_joint_drive + thread, program.drives.shape[0], threads):
        drive = program.drives[i]
        gear = gears[drive.actuator][0]
        transmission.actuator_length[worldid, drive.actuator] = gear * pose.qpos[worldid, drive.qpos]
        transmission.actuator_velocity[worldid, drive.actuator] = gear * qvel[drive.dof]
        transmission.moment_rownnz[worldid, drive.actuator] = 1
        transmission.moment_rowadr[worldid, drive.actuator] = drive.row
        transmission.moment_colind[worldid, drive.row] = drive.dof
        transmission.actuator_moment[worldid, drive.row] = gear
