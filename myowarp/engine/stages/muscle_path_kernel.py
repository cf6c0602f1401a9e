"""Paths of tendons: length, moment arms and velocity of every tendon, and what its actuators make of them.

    length = sum_segments scale |segment|,    ten_J = d length / d q

A path is a chain of segments between sites, straight or bent round a geom (`muscle_path.cpp`; MuJoCo's
documentation, *Wrapping geometry*). A segment whose far end moves with dof j, (c_rot, c_lin) = cdof_j given
at the centre of mass com of j's tree, adds

    c_rot . ((x - com) x u) + c_lin . u

to ten_J_j, with its direction u and any point x on its line; it subtracts that if its near end moves with j.
Dofs that move both ends cancel, and the program leaves them out. Actuators then have the length, moment and
velocity gear length, gear ten_J and gear ten_J . qvel. Source: MuJoCo's documentation, *Computation,
Actuation model*; layout of the arrays: mujoco-warp 4.0.0, `tendon` and `transmission`.
"""

from pathlib import Path as File

import warp as wp

from myowarp.kernels.lanes import at_namespace_level

STRAIGHT, SPHERE, CYLINDER = range(3)


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
        num_moments: Entries of `actuator_moment`.
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
    num_moments: int
    site_pos: wp.array2d[wp.vec3]
    geom_size: wp.array2d[wp.vec3]
    actuator_gear: wp.array2d[wp.spatial_vector]


@wp.struct
class Pose:
    """Places and velocities of all bodies; the arrays of `mujoco_warp.Data` with these names."""

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
    """Lengths and moments of paths and actuators; the arrays of `mujoco_warp.Data` with these names."""

    ten_length: wp.array2d[float]
    ten_J: wp.array2d[float]  # noqa: N815  (the engine's name)
    actuator_length: wp.array2d[float]
    actuator_velocity: wp.array2d[float]
    actuator_moment: wp.array2d[float]


FILE = File(__file__).with_name("muscle_path.cpp")


@wp.func_native(at_namespace_level(FILE))
def declare_follow_block(thread: int):
    """Declare the templates of `muscle_path.cpp`."""
    ...


@wp.func_native("""
#ifdef __CUDACC__  // a thread for a world and some paths
    lanes::Block<float> block{world, 1, nullptr};
    lanes::follow_block(block, thread, threads, program, pose.qpos, pose.qvel, pose, pose, transmission);
#else
    lanes::for_blocks(pose.qpos.shape[0], nullptr, scratch.data, [&](auto& block) {
        lanes::follow_block(block, 0, 1, program, pose.qpos, pose.qvel, pose, pose, transmission);
    });
#endif
""")
def follow(
    world: int,
    thread: int,
    threads: int,
    scratch: wp.array[float],
    program: PathProgram,
    pose: Pose,
    transmission: Transmission,
):
    """Follow paths: a share of a world's in a thread of CUDA, all of all worlds in the CPU's only one."""
    ...


@wp.kernel(enable_backward=False)
def muscle_path(
    # Params:
    program: PathProgram,
    threads: int,
    # In:
    scratch: wp.array[float],
    pose: Pose,
    # Out:
    transmission: Transmission,
):
    """Length = sum of segments, ten_J = its gradient; an actuator's length, moment, velocity = gear (...)."""
    worldid, thread = wp.tid()
    declare_follow_block(thread)
    follow(worldid, thread, threads, scratch, program, pose, transmission)
