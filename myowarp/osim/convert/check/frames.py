"""Vlt1: frames of the converted model against the forward kinematics of the OpenSim model."""

from dataclasses import dataclass

import mujoco
import numpy as np

from myowarp.osim.convert.compose.convert import Converted
from myowarp.osim.document.kinematics import forward, random_poses, station
from myowarp.osim.document.model import GROUND

POSES = 200


@dataclass(frozen=True)
class KinematicsError:
    """Errors of frames over random poses; every free coordinate on its own over its range.

    Attributes:
        position: Greatest distance between body origins [m].
        rotation: Greatest angle between body orientations [rad].
        marker: Greatest distance between markers [m]; 0 without markers.
        poses: How many were compared.
        worst: Body with the greatest distance.
    """

    position: float
    rotation: float
    marker: float
    poses: int
    worst: str


def kinematics_error(converted: Converted, model: mujoco.MjModel, count: int = POSES) -> KinematicsError:
    """Compare body frames and markers in random poses, in OpenSim's ground frame."""
    source = converted.model
    values = random_poses(source, count, 0)
    frames = forward(source, values)
    data = mujoco.MjData(model)
    free = {name: values[name] for name in converted.coordinates.free()}
    position = {name: 0.0 for name in source.bodies}
    rotation = marker = 0.0
    for index, qpos in enumerate(np.resize(converted.coordinates.qpos(model, free), (count, model.nq))):
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        turn = data.body(converted.bodies[GROUND]).xmat.reshape(3, 3).T
        for name in source.bodies:
            body, (axes, origin) = data.body(converted.bodies[name]), frames[name]
            position[name] = max(position[name], float(np.linalg.norm(turn @ body.xpos - origin[index])))
            between = turn @ body.xmat.reshape(3, 3) @ axes[index].T
            # |R - 1| = 2 sqrt(2) sin(angle / 2)
            half = np.linalg.norm(between - np.eye(3)) / np.sqrt(8)
            rotation = max(rotation, float(2 * np.arcsin(min(half, 1.0))))
        for item in source.markers.values():
            place = station(frames, item.body, item.location)[index]
            marker = max(marker, float(np.linalg.norm(turn @ data.site(item.name).xpos - place)))
    worst = max(position, key=lambda name: position[name], default="")
    return KinematicsError(position.get(worst, 0.0), rotation, marker, count, worst)
