"""Equations of motion of a `Model` in float64, in its independent coordinates: M(u) u'' + c(u, u') = forces.

The reference where OpenSim is not installed. With partial velocities v_j = dv/du'_j and w_j = dw/du'_j of
every body, its mass m and its inertia I about the mass centre (Kane, Levinson, *Dynamics*, 1985, chapter 6):

    M_jk = sum m v_j . v_k + w_j . I w_k
    c_j  = sum m v_j . (a - g) + w_j . (I alpha + w x I w)

a and alpha are accelerations for u'' = 0. Couplers hold exactly, constraints that close loops are off, a
locked coordinate stays at its default, and a body without mass has no inertia, as in OpenSim. Forces are
along the derivatives of coordinates, also of ball and free joints, where OpenSim's are about fixed axes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from myowarp.osim.document.kinematics import about, complete
from myowarp.osim.document.model import GROUND, Joint, Model, Move

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates of n states: values, and derivatives in lanes: by time, then by each independent one.

    Attributes:
        value: By name [rad] or [m], shape (n,).
        rate: By name, shape (1 + independent, n).
        second: By name, second derivative by time for u'' = 0, shape (n,).
    """

    value: Mapping[str, Array]
    rate: Mapping[str, Array]
    second: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Moving:
    """A frame in ground.

    Attributes:
        rotation: Shape (n, 3, 3).
        origin: [m], shape (n, 3).
        turn: Angular velocities in lanes, as `Coordinates.rate`, shape (lanes, n, 3).
        velocity: Of the origin in lanes, shape (lanes, n, 3).
        spin: Angular acceleration for u'' = 0 [rad/s^2], shape (n, 3).
        acceleration: Of the origin for u'' = 0 [m/s^2], shape (n, 3).
    """

    rotation: Array
    origin: Array
    turn: Array
    velocity: Array
    spin: Array
    acceleration: Array

    def at(self, offset: Array) -> "Moving":
        """Return the frame moved with it to `offset` in ground's axes [m], shape (n, 3)."""
        whirl = np.cross(self.turn[0], np.cross(self.turn[0], offset))
        return replace(
            self,
            origin=self.origin + offset,
            velocity=self.velocity + np.cross(self.turn, offset),
            acceleration=self.acceleration + np.cross(self.spin, offset) + whirl,
        )

    def moved(self, move: Move, coordinates: Coordinates) -> "Moving":
        """Return the frame behind a slide or hinge."""
        axis = self.rotation @ move.axis
        if move.coordinate is None:
            value, slope, bend = move.function.derivatives(np.zeros(len(axis)))
            rate, second = np.zeros((len(self.turn), len(axis))), np.zeros(len(axis))
        else:
            value, slope, bend = move.function.derivatives(coordinates.value[move.coordinate])
            inner = coordinates.rate[move.coordinate]
            rate = slope * inner
            second = bend * inner[0] ** 2 + slope * coordinates.second[move.coordinate]
        along, faster = rate[..., None] * axis, second[:, None] * axis
        gyration = np.cross(self.turn[0], along[0])
        if move.kind == "slide":
            there = self.at(value[:, None] * axis)
            return replace(
                there,
                velocity=there.velocity + along,
                acceleration=there.acceleration + faster + 2 * gyration,
            )
        return replace(
            self,
            rotation=self.rotation @ about(move.axis, value),
            turn=self.turn + along,
            spin=self.spin + faster + gyration,
        )


def equations(model: Model, values: Mapping[str, Array], speeds: Array) -> tuple[Array, Array]:
    """Return the mass matrix and the forces that hold a velocity against gravity.

    Args:
        model: The model.
        values: Of independent coordinates [rad] or [m], each of shape (n,).
        speeds: Of the independent coordinates in their order [1/s of these], shape (n, independent).

    Returns:
        M, shape (n, independent, independent), and c, shape (n, independent).
    """
    frames, free = moving_frames(model, rates(model, values, speeds)), speeds.shape[1]
    M, c = np.zeros((len(speeds), free, free)), np.zeros(speeds.shape)
    for name, body in model.bodies.items():
        frame = frames[name]
        if body.mass == 0:
            continue
        xx, yy, zz, xy, xz, yz = body.inertia
        about_centre = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = frame.rotation @ about_centre @ frame.rotation.transpose(0, 2, 1)
        centre = frame.at(frame.rotation @ body.mass_center)
        v, w = centre.velocity[1:], centre.turn[1:]
        turned = np.einsum("nab,jnb->jna", inertia, w)
        M += body.mass * np.einsum("jna,kna->njk", v, v) + np.einsum("jna,kna->njk", w, turned)
        force = body.mass * (centre.acceleration - model.gravity)
        spinning = np.einsum("nab,nb->na", inertia, centre.turn[0])
        torque = np.einsum("nab,nb->na", inertia, centre.spin) + np.cross(centre.turn[0], spinning)
        c += np.einsum("jna,na->nj", v, force) + np.einsum("jna,na->nj", w, torque)
    return M, c


def moving_frames(model: Model, coordinates: Coordinates) -> dict[str, Moving]:
    """Return the frames of all bodies and of ground."""
    lanes, count = next(iter(coordinates.rate.values())).shape
    lane, here = np.zeros((lanes, count, 3)), np.zeros((count, 3))
    frames = {GROUND: Moving(np.broadcast_to(np.eye(3), (count, 3, 3)), here, lane, lane, here, here)}
    for joint in model.joints.values():
        frames[joint.child] = _behind(joint, frames[joint.parent], coordinates)
    return frames


def _behind(joint: Joint, parent: Moving, coordinates: Coordinates) -> Moving:
    """Return the frame of the child of a joint."""
    frame = parent.at(parent.rotation @ joint.parent_frame.position)
    frame = replace(frame, rotation=frame.rotation @ joint.parent_frame.rotation)
    for move in joint.moves:
        frame = frame.moved(move, coordinates)
    back = joint.child_frame.inverse()
    frame = frame.at(frame.rotation @ back.position)
    return replace(frame, rotation=frame.rotation @ back.rotation)


def rates(model: Model, values: Mapping[str, Array], speeds: Array) -> Coordinates:
    """Return all coordinates; couplers move with those that they follow. Arguments as in `equations`."""
    count, free = len(speeds), model.independent
    value = complete(model, values, count)
    rate = {name: np.zeros((len(free) + 1, count)) for name in value}
    second = {name: np.zeros(count) for name in value}
    for number, name in enumerate(free):
        rate[name][0], rate[name][1 + number] = speeds[:, number], 1.0

    def follow(name: str) -> None:
        coupler = model.couplers[name]
        if coupler.independent in model.couplers:
            follow(coupler.independent)
        inner = rate[coupler.independent]
        _, slope, bend = coupler.function.derivatives(value[coupler.independent])
        rate[name] = slope * inner
        second[name] = bend * inner[0] ** 2 + slope * second[coupler.independent]

    for name in model.couplers:
        follow(name)
    return Coordinates(value, rate, second)
