"""Inverse dynamics: which generalised forces does a motion take, given the loads from outside?

    joint_moment = M(q) q'' + c(q, q') - sum of J^T load - passive

by two recursions over the bodies: accelerations from ground outwards, forces back. Passive is what springs,
limits, bushings and ligaments of the model do (`model_forces`); its contact forces are loads. What the root
joint needs is no muscle's: it is the residual, what motion and loads disagree by.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from myowarp.kernels.batching import batched
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import zeros_of
from myowarp.laws.forces.bushing import bushing_wrench
from myowarp.osim.body.contacts import Contacts, contacts_along
from myowarp.osim.body.model_forces import (
    ModelForces,
    acting_in,
    along_moves,
    ligament_pulls,
    motion_of,
    push_coordinates,
)
from myowarp.osim.body.parts import in_parts, joined
from myowarp.osim.body.skeleton import HINGE, Bones, Placement, Skeleton, place, station
from myowarp.osim.document.model import GROUND

CHUNK = 4096
"""Frames that are on the device at once."""

wp.set_module_options({"enable_backward": False})


@dataclass(frozen=True, eq=False)
class Load:
    """A force and a torque on a body from outside.

    Attributes:
        body: Where it acts.
        force: [N], shape (frames, 3).
        point: Where the force acts [m], shape (frames, 3).
        torque: [N m], shape (frames, 3).
        force_frame: Body in whose axes force and torque are given.
        point_frame: Body in which the point is given.
        name: Of a recorded load; empty: it is the model's own.
    """

    body: str
    force: np.ndarray
    point: np.ndarray
    torque: np.ndarray
    force_frame: str = "ground"
    point_frame: str = "ground"
    name: str = ""


@dataclass(frozen=True, eq=False)
class Needed:
    """Generalised forces of a motion.

    Attributes:
        joint_moment: Along the independent coordinates [N m] or [N], shape (frames, coordinates).
        passive: What the model's own springs, limits, bushings and ligaments do of what it takes, likewise.
        contacts: What its contact forces do; None: it has none that act.
        tension: Of its ligaments and path springs [N], by name, each of shape (frames,).
        force: What a joint, and the muscles over it, pass to its body [N], in ground, shape (frames, bodies,
            3).
        torque: The same about ground's origin [N m].
        origin: Of bodies [m], in ground, shape (frames, bodies, 3).
        rotation: Of bodies, shape (frames, bodies, 3, 3).
    """

    joint_moment: np.ndarray
    passive: np.ndarray
    contacts: Contacts | None
    tension: Mapping[str, np.ndarray]
    force: np.ndarray
    torque: np.ndarray
    origin: np.ndarray
    rotation: np.ndarray


@wp.struct
class Flow:
    """Accelerations and forces of bodies of all worlds, each (num_worlds, num_bodies).

    Attributes:
        turn: Angular velocity [rad/s].
        spin: Angular acceleration [rad/s^2].
        acceleration: Of the origin [m/s^2].
        force: That its joint passes to it [N].
        torque: About ground's origin [N m].
    """

    turn: wp.array2d[wp.vec3d]
    spin: wp.array2d[wp.vec3d]
    acceleration: wp.array2d[wp.vec3d]
    force: wp.array2d[wp.vec3d]
    torque: wp.array2d[wp.vec3d]


@wp.func
def carried(acceleration: wp.vec3d, turn: wp.vec3d, spin: wp.vec3d, offset: wp.vec3d) -> wp.vec3d:
    """a + alpha x r + w x (w x r)."""
    return acceleration + wp.cross(spin, offset) + wp.cross(turn, wp.cross(turn, offset))


@wp.func
def accelerate(
    worldid: int,
    skeleton: Skeleton,
    speeds: wp.array2d[wp.float64],
    accelerations: wp.array2d[wp.float64],
    placement: Placement,
    flow: Flow,
):
    """Angular velocities and accelerations of all bodies, and accelerations of their origins."""
    for body in range(skeleton.parent.shape[0]):
        parent = skeleton.parent[body]
        turn = wp.vec3d()
        spin = wp.vec3d()
        acceleration = wp.vec3d()
        point = wp.vec3d()
        if parent >= 0:
            turn = flow.turn[worldid, parent]
            spin = flow.spin[worldid, parent]
            acceleration = flow.acceleration[worldid, parent]
            point = placement.origin[worldid, parent]
        for move in range(skeleton.first[body], skeleton.first[body + 1]):
            acceleration = carried(acceleration, turn, spin, placement.point[worldid, move] - point)
            point = placement.point[worldid, move]
            free = skeleton.free[move]
            if free >= 0:
                speed = speeds[worldid, free]
                slope = placement.slope[worldid, move]
                along = slope * speed * placement.direction[worldid, move]
                faster = placement.bend[worldid, move] * speed * speed + slope * accelerations[worldid, free]
                more = faster * placement.direction[worldid, move]
                if skeleton.kind[move] == HINGE:
                    spin += more + wp.cross(turn, along)
                    turn += along
                else:
                    acceleration += more + wp.float64(2.0) * wp.cross(turn, along)
        flow.turn[worldid, body] = turn
        flow.spin[worldid, body] = spin
        flow.acceleration[worldid, body] = carried(
            acceleration, turn, spin, placement.origin[worldid, body] - point
        )


@wp.func
def inertial(
    worldid: int, body: int, factor: wp.float64, skeleton: Skeleton, placement: Placement, flow: Flow
):
    """F = m (a - g), T = r x F + I alpha + w x I w, about ground's origin; m and I times a factor."""
    rotation = placement.rotation[worldid, body]
    offset = rotation * skeleton.center[body]
    turn = flow.turn[worldid, body]
    spin = flow.spin[worldid, body]
    acceleration = carried(flow.acceleration[worldid, body], turn, spin, offset)
    force = factor * skeleton.mass[body] * (acceleration - skeleton.gravity)
    inertia = factor * (rotation * skeleton.inertia[body] * wp.transpose(rotation))
    torque = inertia * spin + wp.cross(turn, inertia * turn)
    flow.force[worldid, body] = force
    flow.torque[worldid, body] = torque + wp.cross(placement.origin[worldid, body] + offset, force)


@wp.func
def turned(worldid: int, body: int, vector: wp.vec3d, placement: Placement) -> wp.vec3d:
    """Return a vector of a body's axes in ground's; body -1 is ground."""
    if body < 0:
        return vector
    return placement.rotation[worldid, body] * vector


@wp.kernel(enable_backward=False)
def invert_dynamics(
    # Model:
    skeleton: Skeleton,
    load_body: wp.array2d[int],
    mass_factor: wp.array2d[wp.float64],
    acting: ModelForces,
    # In:
    values: wp.array2d[wp.float64],
    speeds: wp.array2d[wp.float64],
    accelerations: wp.array2d[wp.float64],
    load: wp.array3d[wp.vec3d],
    # Out:
    placement: Placement,
    flow: Flow,
    passive: wp.array2d[wp.float64],
    joint_moment: wp.array2d[wp.float64],
):
    """tau_k = sum of s_k . (force, torque) of what a coordinate moves.

    `load_body` is (body, axes of force and torque, frame of the point), `load` (force, point, torque).
    `passive` has no columns where nothing acts.
    """
    worldid = wp.tid()
    place(worldid, skeleton, values, worldid, placement)
    accelerate(worldid, skeleton, speeds, accelerations, placement, flow)
    count = skeleton.parent.shape[0]
    for body in range(count):
        factor = mass_factor[batched(worldid, mass_factor.shape[0]), body]
        inertial(worldid, body, factor, skeleton, placement, flow)
    for number in range(load_body.shape[0]):
        body = load_body[number, 0]
        if body >= 0:
            force = turned(worldid, load_body[number, 1], load[worldid, number, 0], placement)
            torque = turned(worldid, load_body[number, 1], load[worldid, number, 2], placement)
            point = station(worldid, load_body[number, 2], load[worldid, number, 1], placement)
            flow.force[worldid, body] -= force
            flow.torque[worldid, body] -= torque + wp.cross(point, force)
    for k in range(joint_moment.shape[1]):
        joint_moment[worldid, k] = wp.float64(0.0)
    if passive.shape[1] > 0:
        push_coordinates(worldid, acting, values, speeds, passive)
        for k in range(joint_moment.shape[1]):
            joint_moment[worldid, k] -= passive[worldid, k]
        for number in range(acting.bushings.shape[0]):
            bushing = acting.bushings[number]
            first = motion_of(worldid, bushing.first, skeleton, speeds, placement)
            second = motion_of(worldid, bushing.second, skeleton, speeds, placement)
            wrench = bushing_wrench(bushing, acting.formulas, first, second)
            for end in range(2):
                body = wp.where(end == 0, bushing.first, bushing.second)
                sign = wp.where(end == 0, wp.float64(-1.0), wp.float64(1.0))
                if body >= 0:
                    flow.force[worldid, body] -= sign * wrench.force
                    flow.torque[worldid, body] -= sign * wrench.torque
                along_moves(worldid, body, sign, wrench, skeleton, placement, passive)
    for back in range(count):
        body = count - 1 - back
        force = flow.force[worldid, body]
        torque = flow.torque[worldid, body]
        for move in range(skeleton.first[body], skeleton.first[body + 1]):
            free = skeleton.free[move]
            if free >= 0:
                joint_moment[worldid, free] += wp.dot(placement.turn[worldid, move], torque)
                joint_moment[worldid, free] += wp.dot(placement.shift[worldid, move], force)
        parent = skeleton.parent[body]
        if parent >= 0:
            flow.force[worldid, parent] += force
            flow.torque[worldid, parent] += torque


def inverse_dynamics(
    bones: Bones,
    values: np.ndarray,
    speeds: np.ndarray,
    accelerations: np.ndarray,
    loads: Sequence[Load] = (),
    masses: np.ndarray | float = 1.0,
    passive: bool = True,
) -> Needed:
    """Return the generalised forces of a motion.

    Args:
        bones: The model.
        values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
        speeds: Their derivatives by time.
        accelerations: Their second derivatives.
        loads: From outside.
        masses: Factors on masses and inertias, which broadcast to (frames, bodies).
        passive: Whether springs, limits, bushings, ligaments and contact forces of the model act.

    Raises:
        ValueError: Shapes do not fit, or a load acts on an unknown body.
    """
    values, speeds, accelerations = (np.asarray(x, float) for x in (values, speeds, accelerations))
    wanted = (len(values), len(bones.coordinates))
    for name, given in (("values", values), ("speeds", speeds), ("accelerations", accelerations)):
        if given.shape != wanted:
            raise ValueError(f"{name} must have the shape {wanted} (frames, coordinates), got {given.shape}")
    contacts = contacts_along(bones, values, speeds) if passive and bones.model.contact_forces else None
    if contacts is not None:
        loads = [*loads, *_pushing(contacts)]
    frames = [(bones.number(x.body), bones.number(x.force_frame), bones.number(x.point_frame)) for x in loads]
    loading = np.zeros((len(values), len(loads), 3, 3))
    for number, load in enumerate(loads):
        for part, given in enumerate((load.force, load.point, load.torque)):
            loading[:, number, part] = given
    acting = acting_in(bones)
    heavy = np.atleast_2d(np.asarray(masses, float))
    heavy = np.broadcast_to(heavy, (len(heavy), len(bones.bodies) - 1))

    loaded = np.array(frames, np.int32).reshape(-1, 3)
    pushing = passive and acting.any

    def solve(c: slice) -> tuple[np.ndarray, ...]:
        count = len(loading[c])
        with wp.ScopedDevice(bones.device):
            placement = bones.placement(count)
            flow = zeros_of(Flow, (count, len(bones.bodies) - 1))
            moment = wp.zeros((count, len(bones.coordinates)), dtype=wp.float64)
            pushed = wp.zeros((count, len(bones.coordinates) * pushing), dtype=wp.float64)
            launch(
                invert_dynamics,
                count,
                skeleton=bones.skeleton,
                load_body=wp.array(loaded, dtype=int),
                mass_factor=wp.array(heavy[c] if len(heavy) > 1 else heavy, dtype=wp.float64),
                acting=acting.tables,
                values=wp.array(values[c], dtype=wp.float64),
                speeds=wp.array(speeds[c], dtype=wp.float64),
                accelerations=wp.array(accelerations[c], dtype=wp.float64),
                load=wp.array(loading[c], dtype=wp.vec3d),
                placement=placement,
                flow=flow,
                passive=pushed,
                joint_moment=moment,
            )
        arrays = (moment, pushed, flow.force, flow.torque, placement.origin, placement.rotation)
        return tuple(array.numpy().copy() for array in arrays)

    moment, pushed, *rest = joined(in_parts(len(values), CHUNK, solve))
    pushed = pushed if pushed.shape[1] else np.broadcast_to(0.0, moment.shape)
    if not (passive and acting.ligaments):
        return Needed(moment, pushed, contacts, {}, *rest)
    tension, pulled = ligament_pulls(bones, values, speeds)
    pulls = dict(zip(acting.ligaments, tension.T, strict=True))
    return Needed(moment - pulled, pushed + pulled, contacts, pulls, *rest)


def _pushing(contacts: Contacts) -> Iterator[Load]:
    """Yield what contacts put on bodies."""
    for number, pair in enumerate(contacts.pairs):
        force, point = contacts.force[:, number], contacts.location[:, number]
        for surface, sign in ((pair.first, -1.0), (pair.second, 1.0)):
            if surface.body != GROUND:
                yield Load(surface.body, sign * force, point, np.zeros_like(force))
