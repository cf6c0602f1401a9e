"""Springs and dampers that a model brings along: OpenSim's limits, ligaments, bushings, formulas.

What a model's text says (`osim.bundle.forces`) acts as passive forces, along joints, along the moment arms of
tendons and on bodies. The damping of limits and of formulas is written into the model in each step, so that
integrators take it in implicitly. Springs and dampers that stand for these forces in plain MuJoCo are off.
"""

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_array, struct_of
from myowarp.laws.expressions import Programs, Variables, added, programs, run
from myowarp.laws.forces.bushing import BodyMotion, Bushing, Wrench, bushing_wrench
from myowarp.laws.forces.coordinate_limit import CoordinateLimit, limit_damping, limit_spring
from myowarp.laws.forces.ligament import Ligament, ligament_tension
from myowarp.laws.pieces import PieceTables, evaluated, piece_tables
from myowarp.osim.bundle.forces import PassiveForces, bushing_table, ligament_table


@wp.struct
class Tree:
    """Bodies of the engine's model.

    Attributes:
        parent: Of each body.
        root: Whose centre of mass its `cdof` refer to.
        first_dof: Of each body, -1 for none.
        dofs: Number of these.
    """

    parent: wp.array[int]
    root: wp.array[int]
    first_dof: wp.array[int]
    dofs: wp.array[int]


SPEED = wp.constant(wp.float64(1e-4))
"""Share of a speed, and of 1 rad/s or m/s, over which the damping of a formula is found."""


@wp.struct
class Push:
    """A coordinate that a formula of its value and speed pushes.

    Attributes:
        address: Of its joint in qpos.
        dof: Of its joint.
        scale: What the joint has for each unit of the coordinate.
    """

    address: int
    dof: int
    scale: wp.float64


@wp.struct
class PushedBody:
    """A body on which force and torque are functions of time.

    Attributes:
        body: Its id.
        ground: Of the body whose axes are ground's.
        rotation: Of the frame that is meant, in the body.
        origin: Of that frame [m].
        force_in_ground: Whether force and torque are along ground's axes, 0 or 1.
        point_in_ground: The same of the point.
        program: First of nine formulas: force, point, torque.
    """

    body: int
    ground: int
    rotation: wp.mat33d
    origin: wp.vec3d
    force_in_ground: int
    point_in_ground: int
    program: int


@wp.func
def pushed(push: Push, formulas: Programs, program: int, qpos: float, qvel: float) -> wp.vec2d:
    """Return a push's force along its joint without damping, and its damping there, at least 0."""
    at = Variables()
    at[0] = wp.float64(qpos) / push.scale
    speed = wp.float64(qvel) / push.scale
    at[1] = speed
    force = run(formulas, program, at)
    step = SPEED * (wp.float64(1.0) + wp.abs(speed))
    at[1] = speed + step
    above = run(formulas, program, at)
    at[1] = speed - step
    damping = wp.max((run(formulas, program, at) - above) / (wp.float64(2.0) * step), wp.float64(0.0))
    return wp.vec2d((force + damping * speed) / push.scale, damping / (push.scale * push.scale))


@wp.func
def motion_of(
    worldid: int,
    body: int,
    tree: Tree,
    xpos: wp.array2d[wp.vec3],
    xmat: wp.array2d[wp.mat33],
    subtree_com: wp.array2d[wp.vec3],
    cdof: wp.array2d[wp.spatial_vector],
    qvel: wp.array2d[float],
) -> BodyMotion:
    """Return where a body is and how it moves."""
    found = BodyMotion()
    found.origin = wp.vec3d(xpos[worldid, body])
    found.rotation = wp.mat33d(xmat[worldid, body])
    com = wp.vec3d(subtree_com[worldid, tree.root[body]])
    carried = int(body)
    while carried > 0:
        for dof in range(tree.first_dof[carried], tree.first_dof[carried] + tree.dofs[carried]):
            speed = wp.float64(qvel[worldid, dof])
            found.turn += speed * wp.vec3d(wp.spatial_top(cdof[worldid, dof]))
            found.shift += speed * wp.vec3d(wp.spatial_bottom(cdof[worldid, dof]))
        carried = tree.parent[carried]
    found.shift -= wp.cross(found.turn, com)
    return found


@wp.func
def along_dofs(
    worldid: int,
    body: int,
    sign: wp.float64,
    wrench: Wrench,
    tree: Tree,
    subtree_com: wp.array2d[wp.vec3],
    cdof: wp.array2d[wp.spatial_vector],
    qfrc: wp.array2d[float],
):
    """Add what a wrench times a sign on a body does along dofs."""
    com = wp.vec3d(subtree_com[worldid, tree.root[body]])
    about = wrench.torque - wp.cross(com, wrench.force)
    carried = int(body)
    while carried > 0:
        for dof in range(tree.first_dof[carried], tree.first_dof[carried] + tree.dofs[carried]):
            moment = wp.dot(wp.vec3d(wp.spatial_top(cdof[worldid, dof])), about)
            moment += wp.dot(wp.vec3d(wp.spatial_bottom(cdof[worldid, dof])), wrench.force)
            qfrc[worldid, dof] = qfrc[worldid, dof] + float(sign * moment)
        carried = tree.parent[carried]


@wp.func
def three(formulas: Programs, program: int, at: Variables) -> wp.vec3d:
    """Return the values of three formulas in turn."""
    x, y = run(formulas, program, at), run(formulas, program + 1, at)
    return wp.vec3d(x, y, run(formulas, program + 2, at))


@wp.func
def pushed_body(
    push: PushedBody, formulas: Programs, time: float, motion: BodyMotion, origin: wp.vec3d, axes: wp.mat33d
) -> Wrench:
    """Return what acts on a body at a time; of where it is, and of ground's origin and axes."""
    at = Variables()
    at[0] = wp.float64(time)
    force = three(formulas, push.program, at)
    point = three(formulas, push.program + 3, at)
    torque = three(formulas, push.program + 6, at)
    own = motion.rotation * push.rotation
    along = wp.where(push.force_in_ground == 0, own, axes)
    force = along * force
    torque = along * torque
    if push.point_in_ground == 0:
        point = motion.origin + motion.rotation * push.origin + own * point
    else:
        point = origin + axes * point
    found = Wrench()
    found.force = force
    found.torque = torque + wp.cross(point, force)
    return found


@wp.kernel(enable_backward=False)
def damp_limits(
    # Params:
    limits: wp.array[CoordinateLimit],
    pushes: wp.array[Push],
    formulas: Programs,
    steady: wp.array[float],
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # Out:
    dof_damping: wp.array2d[float],
):
    """dof_damping = that of the joint, c (S_low + S_high) of each of its limits, and -df/dv of formulas."""
    worldid = wp.tid()
    for i in range(limits.shape[0]):
        dof_damping[worldid, limits[i].dof] = steady[limits[i].dof]
    for i in range(pushes.shape[0]):
        dof_damping[worldid, pushes[i].dof] = steady[pushes[i].dof]
    for i in range(pushes.shape[0]):
        dof = pushes[i].dof
        found = pushed(pushes[i], formulas, i, qpos_in[worldid, pushes[i].address], qvel_in[worldid, dof])
        dof_damping[worldid, dof] = dof_damping[worldid, dof] + float(found[1])
    for i in range(limits.shape[0]):
        limit = limits[i]
        more = float(limit_damping(limit, wp.float64(qpos_in[worldid, limit.address])))
        dof_damping[worldid, limit.dof] = dof_damping[worldid, limit.dof] + more


@wp.kernel(enable_backward=False)
def push_and_pull(
    # Model:
    ten_J_rownnz: wp.array[int],
    ten_J_rowadr: wp.array[int],
    ten_J_colind: wp.array[int],
    # Params:
    limits: wp.array[CoordinateLimit],
    ligaments: wp.array[Ligament],
    curves: PieceTables,
    formulas: Programs,
    # Data in:
    qpos_in: wp.array2d[float],
    ten_length_in: wp.array2d[float],
    ten_velocity_in: wp.array2d[float],
    ten_J_in: wp.array2d[float],
    # Data out:
    qfrc_passive_out: wp.array2d[float],
):
    """qfrc_passive += springs of limits - J' T of ligaments."""
    worldid = wp.tid()
    for i in range(limits.shape[0]):
        limit = limits[i]
        push = float(limit_spring(limit, wp.float64(qpos_in[worldid, limit.address])))
        qfrc_passive_out[worldid, limit.dof] = qfrc_passive_out[worldid, limit.dof] + push
    for i in range(ligaments.shape[0]):
        ligament = ligaments[i]
        tendon = ligament.tendon
        length = wp.float64(ten_length_in[worldid, tendon])
        spring = evaluated(curves, i, length / ligament.resting_length)[0]
        velocity = wp.float64(ten_velocity_in[worldid, tendon])
        tension = float(ligament_tension(ligament, formulas, spring, length, velocity))
        first = ten_J_rowadr[tendon]
        for k in range(first, first + ten_J_rownnz[tendon]):
            dof = ten_J_colind[k]
            qfrc_passive_out[worldid, dof] = qfrc_passive_out[worldid, dof] - tension * ten_J_in[worldid, k]


@wp.kernel(enable_backward=False)
def push_joints(
    # Params:
    pushes: wp.array[Push],
    formulas: Programs,
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # Data out:
    qfrc_passive_out: wp.array2d[float],
):
    """qfrc_passive += formulas of coordinates, without their damping."""
    worldid = wp.tid()
    for i in range(pushes.shape[0]):
        dof = pushes[i].dof
        found = pushed(pushes[i], formulas, i, qpos_in[worldid, pushes[i].address], qvel_in[worldid, dof])
        qfrc_passive_out[worldid, dof] = qfrc_passive_out[worldid, dof] + float(found[0])


@wp.kernel(enable_backward=False)
def push_bodies(
    # Params:
    tree: Tree,
    bushings: wp.array[Bushing],
    pushed_bodies: wp.array[PushedBody],
    formulas: Programs,
    # Data in:
    time_in: wp.array[float],
    qvel_in: wp.array2d[float],
    xpos_in: wp.array2d[wp.vec3],
    xmat_in: wp.array2d[wp.mat33],
    subtree_com_in: wp.array2d[wp.vec3],
    cdof_in: wp.array2d[wp.spatial_vector],
    # Data out:
    qfrc_passive_out: wp.array2d[float],
):
    """qfrc_passive += J' w of bushings and of pushed bodies."""
    worldid = wp.tid()
    one = wp.float64(1.0)
    for i in range(bushings.shape[0]):
        bushing = bushings[i]
        begin = motion_of(worldid, bushing.first, tree, xpos_in, xmat_in, subtree_com_in, cdof_in, qvel_in)
        end = motion_of(worldid, bushing.second, tree, xpos_in, xmat_in, subtree_com_in, cdof_in, qvel_in)
        wrench = bushing_wrench(bushing, formulas, begin, end)
        along_dofs(worldid, bushing.first, -one, wrench, tree, subtree_com_in, cdof_in, qfrc_passive_out)
        along_dofs(worldid, bushing.second, one, wrench, tree, subtree_com_in, cdof_in, qfrc_passive_out)
    for i in range(pushed_bodies.shape[0]):
        body = pushed_bodies[i].body
        motion = motion_of(worldid, body, tree, xpos_in, xmat_in, subtree_com_in, cdof_in, qvel_in)
        ground = pushed_bodies[i].ground
        origin, axes = wp.vec3d(xpos_in[worldid, ground]), wp.mat33d(xmat_in[worldid, ground])
        wrench = pushed_body(pushed_bodies[i], formulas, time_in[worldid], motion, origin, axes)
        along_dofs(worldid, body, one, wrench, tree, subtree_com_in, cdof_in, qfrc_passive_out)


class OwnForces:
    """The springs and dampers of a model, in all worlds."""

    def __init__(self, acting: PassiveForces, host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> None:
        """Write tables on the current Warp device, and switch off what stands for these forces in MuJoCo."""
        limits: list[tuple[Any, ...]] = []
        for limit in acting.limits:
            joint = host.joint(limit.joint)
            limits.append((joint.qposadr[0], joint.dofadr[0], *list(vars(limit).values())[1:]))
        self.limits = struct_array(CoordinateLimit, limits)
        formulas = [push.formula for push in acting.pushes]
        joints = [(host.joint(push.joint), push.scale) for push in acting.pushes]
        self.pushes = struct_array(Push, [(j.qposadr[0], j.dofadr[0], scale) for j, scale in joints])
        tendons = [host.tendon(one.tendon).id for one in acting.ligaments]
        self.ligaments = ligament_table(acting.ligaments, tendons, formulas)
        self.bushings = bushing_table(acting.bushings, lambda name: int(host.body(name).id), formulas)
        bodies = [
            (
                host.body(one.body).id,
                host.body(one.ground).id,
                one.rotation,
                one.origin,
                int(one.force_in_ground),
                int(one.point_in_ground),
                added(formulas, one.formulas),
            )
            for one in acting.body_pushes
        ]
        self.pushed_bodies = struct_array(PushedBody, bodies)
        self.formulas = programs(formulas)
        self.tree = struct_of(
            Tree,
            parent=host.body_parentid,
            root=host.body_rootid,
            first_dof=host.body_dofadr,
            dofs=host.body_dofnum,
        )
        self.curves = piece_tables(ligament.curves for ligament in acting.ligaments)
        springs = [host.tendon(name).id for name in acting.springs]
        for name in ("tendon_stiffness", "tendon_stiffnesspoly") if springs else ():
            values = getattr(model, name)
            numbers = values.numpy()
            numbers[:, springs] = 0.0
            values.assign(numbers)
        bare = {host.joint(name).id: numbers for name, numbers in acting.bare.items()}
        places = {host.joint(name).qposadr[0]: at for name, (_, at) in acting.bare.items()}
        for name, values in (
            ("jnt_stiffness", {joint: stiffness for joint, (stiffness, _) in bare.items()}),
            ("qpos_spring", places),
        ):
            array = getattr(model, name)
            numbers = array.numpy()
            for place, number in values.items():
                numbers[:, place] = number
            if values:
                array.assign(numbers)
        damping = model.dof_damping.numpy()
        for name, amount in acting.dampers.items():
            dof = host.joint(name).dofadr[0]
            damping[:, dof] -= amount
        self.steady = wp.array(damping[0], dtype=float)
        model.dof_damping = wp.array(np.tile(damping[0], (data.nworld, 1)), dtype=float)
        self.launch_damping(model, data)

    def launch_damping(self, model: mjw.Model, data: mjw.Data) -> None:
        """Write the damping of limits and formulas into `dof_damping`."""
        if self.limits.size or self.pushes.size:
            launch(damp_limits, data.nworld, self, data, dof_damping=model.dof_damping)

    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Add all other forces to `qfrc_passive`."""
        launch(push_and_pull, data.nworld, self, model, data)
        if self.pushes.size:
            launch(push_joints, data.nworld, self, model, data)
        if self.bushings.size or self.pushed_bodies.size:
            launch(push_bodies, data.nworld, self, model, data)

    def launch_implicit(self, model: mjw.Model, data: mjw.Data, directions: wp.array) -> None:
        """Add nothing: what damps is `dof_damping`."""


def forces_of(host: mujoco.MjModel, model: mjw.Model, data: mjw.Data) -> OwnForces | None:
    """Return the forces that a model brings along, on the current Warp device; None: it brings none."""
    acting = PassiveForces.of(host)
    return None if acting is None else OwnForces(acting, host, model, data)
