"""Joint reactions: what bones press on each other with, once muscles are accounted for.

    reaction_i = sum over the bodies j that joint i carries of (m a - loads - muscles)_j

A muscle, and likewise a ligament, pulls with its tension along the straight pieces of its path, at its points
and at those where it touches a wrap surface. Springs of coordinates, reserves and what nobody gives are
moments of joints, and so in the reaction.

Source: OpenSim's `JointReaction`; Steele et al. (2012), doi:10.1016/j.gaitpost.2011.11.023.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from myowarp.motion.inverse_dynamics import Needed
from myowarp.osim.body.muscle_paths import TOGETHER, PathsOfMuscles
from myowarp.osim.body.parts import in_parts, joined
from myowarp.osim.body.skeleton import Bones

FRAMES = 4096
"""Frames that are solved together."""


@dataclass(frozen=True, eq=False)
class JointReactions:
    """Forces and moments of joints on their children, in ground's axes.

    Attributes:
        joints: Names.
        children: Their bodies.
        force: [N], shape (frames, joints, 3).
        moment: About `point` [N m].
        point: Origin of the joint's frame in the child [m].
    """

    joints: tuple[str, ...]
    children: tuple[str, ...]
    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray


def joint_reactions(
    bones: Bones, values: np.ndarray, needed: Needed, tension: Mapping[str, np.ndarray]
) -> JointReactions:
    """Return the reactions in all joints.

    Args:
        bones: The model.
        values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
        needed: What the motion takes, from `inverse_dynamics`.
        tension: By muscle, or by what else pulls along a path [N], each of shape (frames,).
    """
    joints = list(bones.model.joints.values())
    force, torque = muscle_wrenches(bones, values, {**tension, **needed.tension})
    for number in range(len(joints) - 1, -1, -1):
        parent = bones.bodies[joints[number].parent]
        if parent >= 0:
            force[:, parent] += force[:, number]
            torque[:, parent] += torque[:, number]
    place = np.stack([joint.child_frame.position for joint in joints])
    point = needed.origin + np.einsum("nbij,bj->nbi", needed.rotation, place)
    force = needed.force - force[:, :-1]
    moment = needed.torque - torque[:, :-1] - np.cross(point, force)
    names, children = zip(*((joint.name, joint.child) for joint in joints), strict=True)
    return JointReactions(names, children, force, moment, point)


def muscle_wrenches(
    bones: Bones, values: np.ndarray, tension: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return force [N] and torque about ground's origin [N m] of paths on each body, ground the last one.

    Returns:
        Two arrays of shape (frames, bodies + 1, 3).
    """
    if not tension:
        return np.zeros((len(values), len(bones.bodies), 3)), np.zeros((len(values), len(bones.bodies), 3))
    names, pull = tuple(tension), np.stack(list(tension.values()), axis=1)

    def solve(part: slice) -> tuple[np.ndarray, np.ndarray]:
        own = PathsOfMuscles(bones, min(len(values[part]), TOGETHER), names)
        return own.wrenches(values[part], pull[part])

    force, torque = joined(in_parts(len(values), FRAMES, solve))
    return force, torque
