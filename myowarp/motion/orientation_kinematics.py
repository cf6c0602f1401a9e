"""Inverse kinematics of orientations: which coordinates turn a model's sensors as they were recorded?

    minimize  sum w_i angle(R_i(q), S_i)^2 / sum w_i    over    lower <= q <= upper

by the solver of markers (`inverse_kinematics`): an orientation adds w 1 to the tensor of its body and w times
the rotation vector from S_i to R_i to its torque, which is the gradient. Coordinates that are lengths stay at
their defaults, as orientations say nothing of places.

Source: Simbody's `OrientationSensors` (angles), OpenSim's `IMUInverseKinematicsTool` (lengths stay).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import warp as wp

from myowarp.motion.inverse_kinematics import Fitted, fitted_values, targets_of
from myowarp.motion.orientations import Orientations
from myowarp.osim.body.skeleton import Bones


def orientation_kinematics(
    bones: Bones, recorded: Orientations, weights: Mapping[str, float] | None = None
) -> Fitted:
    """Return the coordinates of each frame that turn the model's sensors as they were recorded.

    Args:
        bones: The model, with a frame of the name of each sensor, or a body.
        recorded: In OpenSim's axes.
        weights: By sensor; by default 1.

    Raises:
        ValueError: The model has no frame of a sensor, a weight is negative or of an unknown sensor, or no
            frame has an orientation.
    """
    model, given = bones.model, weights or {}
    if unknown := [name for name in given if name not in recorded.names]:
        raise ValueError(
            f"the recording has no sensor {unknown[0]!r}; available: {', '.join(recorded.names)}"
        )
    for name, weight in given.items():
        if not 0.0 <= weight < np.inf:
            raise ValueError(f"the weight of sensor {name!r} must be at least 0 and finite, got {weight}")
    used = [name for name in recorded.names if name in model.frames and given.get(name, 1.0) > 0.0]
    if not used:
        raise ValueError(
            f"the model has no frame of a sensor; the recording has {', '.join(recorded.names)}; place the "
            "sensors with myowarp motion place"
        )
    seen = recorded.rotations[:, [recorded.names.index(name) for name in used]]
    if not np.isfinite(seen).all(axis=(2, 3)).any():
        raise ValueError(f"no frame has an orientation of {', '.join(used)}")
    still = [name for name in bones.coordinates if not model.coordinates[name].rotational]
    with wp.ScopedDevice(bones.device):
        targets, bounds = targets_of(bones, len(seen), still=still)
        places = [model.frames[name] for name in used]
        targets.sensor_body = wp.array([bones.number(body) for body, _ in places], dtype=int)
        targets.sensor_axes = wp.array([pose.rotation for _, pose in places], dtype=wp.mat33d)
        targets.sensor_weight = wp.array([given.get(name, 1.0) for name in used], dtype=wp.float64)
        targets.orientation = wp.array(seen, dtype=wp.mat33d)
        out = fitted_values(bones, targets, bounds, len(seen))
        error = np.where(np.isfinite(seen).all(axis=(2, 3)), out["angles"].numpy(), np.nan)
    return Fitted(bones.coordinates, recorded.time, out["values"].numpy(), tuple(used), error)
