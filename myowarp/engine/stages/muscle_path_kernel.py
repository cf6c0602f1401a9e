"""Paths of tendons: length, moment arms and velocity of every tendon, and what its actuators make of them.

    length = sum_segments scale |segment|,    ten_J = d length / d q

A path is a chain of segments between sites, straight or bent round a geom (`stages.wrap`). A segment whose
far end moves with dof j, (c_rot, c_lin) = cdof_j given at the centre of mass com of j's tree, adds

    c_rot . ((x - com) x u) + c_lin . u

to ten_J_j, with its direction u and any point x on its line; it subtracts that if its near end moves with j.
Dofs that move both ends cancel, and the program leaves them out. Actuators then have the length, moment and
velocity gear length, gear ten_J and gear ten_J . qvel. Source: MuJoCo's documentation, *Computation,
Actuation model*; layout of the arrays: mujoco-warp 4.0.0, `tendon` and `transmission`.
"""

import warp as wp

from myowarp.engine.stages.wrap import STRAIGHT, Bend, bend_round, unit
from myowarp.kernels.batching import batched


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
    """All tendons and their actuators, compiled by `myowarp.engine.stages.path_program`.

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
    sites = program.site_pos[batched(worldid, program.site_pos.shape[0])]
    sizes = program.geom_size[batched(worldid, program.geom_size.shape[0])]
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
            radius = sizes[op.geom][0]
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
    gears = program.actuator_gear[batched(worldid, program.actuator_gear.shape[0])]
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
