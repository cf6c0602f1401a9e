"""Forward kinematics of a `Model` in float64: coordinates -> frames of all bodies, over many poses.

The reference where OpenSim is not installed. The pose of a child in its parent is
X_PF * X_1(q) * ... * X_n(q) * inverse(X_BM): the frame of the joint in the parent, its moves in order,
and the inverse of its frame in the child (Seth et al. 2010, doi:10.1016/j.piutam.2011.04.021). Couplers
are evaluated, not assembled; constraints that close loops are not enforced.
"""

from collections.abc import Mapping

import numpy as np

from myowarp.osim.document.model import GROUND, Joint, Model, Move

Array = np.ndarray

Frames = dict[str, tuple[Array, Array]]
"""Of each body and of ground: rotations, shape `(n, 3, 3)`, and origins [m], shape `(n, 3)`, in ground."""

FLOATING = 3
"""Coordinates of a joint with ground from which it carries the model through space."""


def floating(model: Model) -> list[str]:
    """Return the coordinates of joints that carry the model through space."""
    found = []
    for joint in model.joints.values():
        own = [name for name in model.independent if model.coordinates[name].joint == joint.name]
        if joint.parent == GROUND and len(own) >= FLOATING:
            found += own
    return found


def random_poses(model: Model, count: int, seed: int) -> dict[str, Array]:
    """Return random poses: every free coordinate on its own over its range, the others following.

    Returns:
        Values of all coordinates [rad] or [m], each of shape (count,).
    """
    random = np.random.default_rng(seed)
    chosen = {
        name: random.uniform(*model.coordinates[name].sampling_range, count) for name in model.independent
    }
    return complete(model, chosen, count)


def complete(model: Model, coordinates: Mapping[str, Array], count: int) -> dict[str, Array]:
    """Return the values of all coordinates: those given, locked and missing ones at default, coupled ones.

    Args:
        model: To which they belong.
        coordinates: Values [rad] or [m], scalars or of shape (count,); those of coupled ones are ignored.
        count: Number of poses.

    Raises:
        ValueError: A coordinate is unknown.
    """
    if unknown := set(coordinates) - set(model.coordinates):
        raise ValueError(
            f"coordinate {sorted(unknown)[0]!r} unknown; available: {', '.join(model.coordinates)}"
        )
    values = {
        name: np.broadcast_to(np.asarray(coordinates.get(name, coordinate.default), float), (count,))
        for name, coordinate in model.coordinates.items()
    }
    done = {name for name in values if name not in model.couplers}
    waiting = dict(model.couplers)
    while waiting:
        for name in [name for name, coupler in waiting.items() if coupler.independent in done]:
            coupler = waiting.pop(name)
            values[name] = coupler.function.value(values[coupler.independent])
            done.add(name)
    return values


def forward(
    model: Model, coordinates: Mapping[str, Array], known: tuple[Mapping[str, Array], Frames] | None = None
) -> Frames:
    """Return the frames of all bodies.

    Args:
        model: The model.
        coordinates: Values of all coordinates [rad] or [m], each of shape (n,), from `complete`.
        known: Coordinates and frames of n poses; bodies that differ in no coordinate are taken from them.
    """
    count = len(next(iter(coordinates.values()))) if coordinates else 1
    frames: Frames = {GROUND: (np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3)))}
    before, there = known or ({}, {})
    same = {name for name, value in before.items() if np.array_equal(value, coordinates[name])}
    kept = {GROUND} if known else set()
    for joint in model.joints.values():
        if joint.parent in kept and {move.coordinate for move in joint.moves} <= same | {None}:
            frames[joint.child] = there[joint.child]
            kept.add(joint.child)
            continue
        rotation, origin = frames[joint.parent]
        inner, offset = joint_pose(joint, coordinates, count)
        frames[joint.child] = rotation @ inner, origin + np.einsum("nij,nj->ni", rotation, offset)
    return frames


def joint_pose(joint: Joint, coordinates: Mapping[str, Array], count: int) -> tuple[Array, Array]:
    """Return the pose of the child in the parent: rotations (count, 3, 3) and origins [m] (count, 3)."""
    rotation = np.broadcast_to(joint.parent_frame.rotation, (count, 3, 3))
    origin = np.broadcast_to(joint.parent_frame.position, (count, 3))
    for move in joint.moves:
        value = move_value(move, coordinates, count)
        if move.kind == "slide":
            origin = origin + value[:, None] * (rotation @ move.axis)
        else:
            rotation = rotation @ about(move.axis, value)
    back = joint.child_frame.inverse()
    return rotation @ back.rotation, origin + rotation @ back.position


def move_value(move: Move, coordinates: Mapping[str, Array], count: int) -> Array:
    """Return the distance [m] or angle [rad] of a move, shape (count,)."""
    argument = np.zeros(count) if move.coordinate is None else coordinates[move.coordinate]
    return move.function.value(argument)


def about(axis: Array, angle: Array) -> Array:
    """Return rotations about a unit axis (3,) by angles (n,) [rad], shape (n, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, versine = np.sin(angle)[:, None, None], 2 * np.sin(angle / 2)[:, None, None] ** 2
    return np.eye(3) + sine * cross + versine * (cross @ cross)


def station(frames: Frames, body: str, location: Array) -> Array:
    """Return a point of a body in ground [m], shape (n, 3)."""
    rotation, origin = frames[body]
    return origin + rotation @ location
