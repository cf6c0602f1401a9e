"""Inverse kinematics: which coordinates put a model's markers where they were recorded?

    minimize  sum w_i |p_i(q) - m_i|^2 / sum w_i + sum w_k (q_k - r_k)^2    over    lower <= q <= upper

by damped Gauss-Newton steps in the independent coordinates (Levenberg 1944, Marquardt 1963), each kept within
the bounds. A world goes through consecutive frames, each from the solution of the one before; worlds begin at
the solutions of a first pass over every `STRIDE`-th frame, which one world makes from the first frame on. So
angles run on where a person turns around, and frames are solved together.

With the weights as masses the normal matrix of the markers is a mass matrix, which composite bodies give in
one sweep (see `skeleton`); its cost does not grow with the number of markers.

Ranges of coordinates that are not clamped do not bind, locked coordinates stay, and couplers hold exactly:
OpenSim weighs them. The normalisation of marker weights is OpenSim's (Simbody's `Assembler`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from myowarp.kernels.batching import batched
from myowarp.kernels.cholesky import eliminated, substitute
from myowarp.kernels.launch import launch
from myowarp.kernels.structs import struct_of, zeros_of
from myowarp.motion.markers import Markers
from myowarp.motion.storage import logger
from myowarp.osim.body.parts import in_parts
from myowarp.osim.body.skeleton import Bones, Placement, Skeleton, place, station
from myowarp.osim.document.read.frames import TURN

STRIDE = 16
"""Frames that follow each other in one world."""

STEPS = 100
"""Most steps of a frame."""

TOLERANCE = 1e-7
"""Step of a coordinate [rad, m] below which a frame is done."""

GROWTH = 10.0
"""By which the damping changes."""

FEWEST = 3
"""Markers that some frame must show."""

LARGE = 0.1
"""Root mean square error of the markers [m] above which units or axes are doubted."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class Targets:
    """Targets of all frames.

    Attributes:
        body: Of each marker.
        location: In the body [m].
        weight: Of each marker, (1 or frames, markers).
        marker: Where it was seen [m], NaN where it was not, (frames, markers).
        sensor_body: Of each sensor.
        sensor_axes: In the body.
        sensor_weight: Of each sensor.
        orientation: Recorded axes of it, NaN where there are none, (frames, sensors).
        value: Wanted value of each coordinate, (frames, coordinates); counts where its weight is above 0.
        value_weight: Of coordinates.
        lower: Least value of each coordinate.
        upper: Greatest value.
    """

    body: wp.array[int]
    location: wp.array[wp.vec3d]
    weight: wp.array2d[wp.float64]
    marker: wp.array2d[wp.vec3d]
    sensor_body: wp.array[int]
    sensor_axes: wp.array[wp.mat33d]
    sensor_weight: wp.array[wp.float64]
    orientation: wp.array2d[wp.mat33d]
    value: wp.array2d[wp.float64]
    value_weight: wp.array[wp.float64]
    lower: wp.array[wp.float64]
    upper: wp.array[wp.float64]


@wp.struct
class Normal:
    """Normal equations of a world.

    Attributes:
        weight: Sum of w of what a body carries, (num_worlds, num_bodies).
        first: Sum of w p.
        second: Sum of w (p . p - p p^T).
        force: Sum of w (p - m).
        torque: Sum of w p x (p - m).
        matrix: Normal matrix, (num_worlds, coordinates, coordinates).
        factor: Its Cholesky factor.
        slope: Gradient, (num_worlds, coordinates).
        step: Step of the coordinates.
        old: Coordinates before the step.
    """

    weight: wp.array2d[wp.float64]
    first: wp.array2d[wp.vec3d]
    second: wp.array2d[wp.mat33d]
    force: wp.array2d[wp.vec3d]
    torque: wp.array2d[wp.vec3d]
    matrix: wp.array3d[wp.float64]
    factor: wp.array3d[wp.float64]
    slope: wp.array2d[wp.float64]
    step: wp.array2d[wp.float64]
    old: wp.array2d[wp.float64]


@wp.func
def marker_weight(frame: int, number: int, targets: Targets) -> wp.float64:
    """Return the weight of a marker in a frame, 0 where it was not seen."""
    seen = targets.marker[frame, number]
    weight = targets.weight[batched(frame, targets.weight.shape[0]), number]
    return wp.where(wp.isfinite(seen[0]), weight, wp.float64(0.0))


@wp.func
def total_weight(frame: int, targets: Targets) -> wp.float64:
    """Return the weight of all markers of a frame, 1 where none was seen."""
    total = wp.float64(0.0)
    for number in range(targets.body.shape[0]):
        total += marker_weight(frame, number, targets)
    return wp.where(total > wp.float64(0.0), total, wp.float64(1.0))


@wp.func
def sensor_weight(frame: int, number: int, targets: Targets) -> wp.float64:
    """Return the weight of a sensor in a frame, 0 where nothing was recorded."""
    seen = targets.orientation[frame, number]
    return wp.where(wp.isfinite(seen[0, 0]), targets.sensor_weight[number], wp.float64(0.0))


@wp.func
def total_sensor_weight(frame: int, targets: Targets) -> wp.float64:
    """Return the weight of all sensors of a frame, 1 where nothing was recorded."""
    total = wp.float64(0.0)
    for number in range(targets.sensor_body.shape[0]):
        total += sensor_weight(frame, number, targets)
    return wp.where(total > wp.float64(0.0), total, wp.float64(1.0))


@wp.func
def turned_off(worldid: int, frame: int, number: int, targets: Targets, placement: Placement) -> wp.vec3d:
    """Return the rotation vector from the recorded axes of a sensor to those of the model [rad]."""
    axes = targets.sensor_axes[number]
    body = targets.sensor_body[number]
    if body >= 0:
        axes = placement.rotation[worldid, body] * axes
    q = wp.quat_from_matrix(axes * wp.transpose(targets.orientation[frame, number]))
    part = wp.vec3d(q[0], q[1], q[2])
    sine = wp.length(part)
    if sine == wp.float64(0.0):
        return wp.vec3d()
    cosine = wp.where(q[3] < wp.float64(0.0), -q[3], q[3])
    angle = wp.float64(2.0) * wp.atan2(sine, cosine)
    return wp.where(q[3] < wp.float64(0.0), -angle, angle) / sine * part


@wp.func
def objective(
    worldid: int, frame: int, targets: Targets, placement: Placement, values: wp.array2d[wp.float64]
) -> wp.float64:
    """sum w_i |p_i - m_i|^2 / sum w_i + sum w_i angle_i^2 / sum w_i + sum w_k (q_k - r_k)^2."""
    cost = wp.float64(0.0)
    for number in range(targets.body.shape[0]):
        weight = marker_weight(frame, number, targets)
        if weight > wp.float64(0.0):
            p = station(worldid, targets.body[number], targets.location[number], placement)
            cost += weight * wp.length_sq(p - targets.marker[frame, number])
    cost /= total_weight(frame, targets)
    turned = wp.float64(0.0)
    for number in range(targets.sensor_body.shape[0]):
        weight = sensor_weight(frame, number, targets)
        if weight > wp.float64(0.0):
            turned += weight * wp.length_sq(turned_off(worldid, frame, number, targets, placement))
    cost += turned / total_sensor_weight(frame, targets)
    for k in range(values.shape[1]):
        off = values[frame, k] - targets.value[frame, k]
        cost += targets.value_weight[k] * off * off
    return cost


@wp.func
def collect(
    worldid: int, frame: int, skeleton: Skeleton, targets: Targets, placement: Placement, normal: Normal
):
    """Weights, moments and errors of the markers of each body and of all that it carries."""
    count = skeleton.parent.shape[0]
    one = wp.float64(1.0)
    for body in range(count):
        normal.weight[worldid, body] = wp.float64(0.0)
        normal.first[worldid, body] = wp.vec3d()
        normal.second[worldid, body] = wp.mat33d()
        normal.force[worldid, body] = wp.vec3d()
        normal.torque[worldid, body] = wp.vec3d()
    total = total_weight(frame, targets)
    for number in range(targets.body.shape[0]):
        weight = marker_weight(frame, number, targets) / total
        body = targets.body[number]
        if weight > wp.float64(0.0) and body >= 0:
            p = station(worldid, body, targets.location[number], placement)
            off = weight * (p - targets.marker[frame, number])
            normal.weight[worldid, body] += weight
            normal.first[worldid, body] += weight * p
            normal.second[worldid, body] += weight * (
                wp.dot(p, p) * wp.diag(wp.vec3d(one, one, one)) - wp.outer(p, p)
            )
            normal.force[worldid, body] += off
            normal.torque[worldid, body] += wp.cross(p, off)
    total = total_sensor_weight(frame, targets)
    for number in range(targets.sensor_body.shape[0]):
        weight = sensor_weight(frame, number, targets) / total
        body = targets.sensor_body[number]
        if weight > wp.float64(0.0) and body >= 0:
            normal.second[worldid, body] += weight * wp.diag(wp.vec3d(one, one, one))
            normal.torque[worldid, body] += weight * turned_off(worldid, frame, number, targets, placement)
    for back in range(count):
        body = count - 1 - back
        parent = skeleton.parent[body]
        if parent >= 0:
            normal.weight[worldid, parent] += normal.weight[worldid, body]
            normal.first[worldid, parent] += normal.first[worldid, body]
            normal.second[worldid, parent] += normal.second[worldid, body]
            normal.force[worldid, parent] += normal.force[worldid, body]
            normal.torque[worldid, parent] += normal.torque[worldid, body]


@wp.func
def normal_equations_of_markers(
    worldid: int, frame: int, skeleton: Skeleton, targets: Targets, placement: Placement, normal: Normal,
    values: wp.array2d[wp.float64],
):  # fmt: skip
    """H_jk = s_j . I s_k, g_k = s_k . (force, torque), and the wanted values of coordinates."""
    for j in range(values.shape[1]):
        for k in range(values.shape[1]):
            normal.matrix[worldid, j, k] = wp.float64(0.0)
        weight = targets.value_weight[j]
        normal.matrix[worldid, j, j] = weight
        normal.slope[worldid, j] = wp.float64(0.0)
        if weight > wp.float64(0.0):
            normal.slope[worldid, j] = weight * (values[frame, j] - targets.value[frame, j])
    for body in range(skeleton.parent.shape[0]):
        if normal.weight[worldid, body] + wp.trace(normal.second[worldid, body]) > wp.float64(0.0):
            for move in range(skeleton.first[body], skeleton.first[body + 1]):
                k = skeleton.free[move]
                if k >= 0:
                    turn = placement.turn[worldid, move]
                    shift = placement.shift[worldid, move]
                    first = normal.first[worldid, body]
                    pull = normal.weight[worldid, body] * shift + wp.cross(turn, first)
                    twist = normal.second[worldid, body] * turn + wp.cross(first, shift)
                    normal.slope[worldid, k] += wp.dot(turn, normal.torque[worldid, body])
                    normal.slope[worldid, k] += wp.dot(shift, normal.force[worldid, body])
                    carrier = int(body)
                    last = int(move + 1)
                    while carrier >= 0:
                        for other in range(skeleton.first[carrier], last):
                            j = skeleton.free[other]
                            if j >= 0:
                                product = wp.dot(placement.shift[worldid, other], pull)
                                product += wp.dot(placement.turn[worldid, other], twist)
                                normal.matrix[worldid, k, j] += product
                                if other != move:
                                    normal.matrix[worldid, j, k] += product
                        carrier = skeleton.parent[carrier]
                        if carrier >= 0:
                            last = skeleton.first[carrier + 1]


@wp.func
def bound_step(
    worldid: int,
    frame: int,
    damping: wp.float64,
    targets: Targets,
    normal: Normal,
    values: wp.array2d[wp.float64],
) -> bool:
    """(H + damping (diag H + mean)) step = -g of the coordinates that no bound holds; the others stay."""
    count = values.shape[1]
    trace = wp.float64(0.0)
    for k in range(count):
        trace += normal.matrix[worldid, k, k]
    mean = wp.max(trace / wp.float64(count), wp.float64(1.0e-30))
    for k in range(count):
        value = values[frame, k]
        held = (value <= targets.lower[k] and normal.slope[worldid, k] > wp.float64(0.0)) or (
            value >= targets.upper[k] and normal.slope[worldid, k] < wp.float64(0.0)
        )
        for j in range(k + 1):
            normal.factor[worldid, k, j] = wp.where(held, wp.float64(0.0), normal.matrix[worldid, k, j])
        normal.step[worldid, k] = wp.where(held, wp.float64(0.0), -normal.slope[worldid, k])
        more = damping * (normal.matrix[worldid, k, k] + mean)
        normal.factor[worldid, k, k] = wp.where(held, mean, normal.matrix[worldid, k, k] + more)
        if held:
            normal.old[worldid, k] = wp.float64(1.0)
        else:
            normal.old[worldid, k] = wp.float64(0.0)
    for i in range(count):
        for j in range(i + 1):
            entry = normal.factor[worldid, i, j]
            if normal.old[worldid, j] > wp.float64(0.0) and i != j:
                entry = wp.float64(0.0)
            total = eliminated(worldid, i, j, entry, normal.factor)
            if i > j:
                normal.factor[worldid, i, j] = total / normal.factor[worldid, j, j]
            elif total > wp.float64(0.0):
                normal.factor[worldid, i, i] = wp.sqrt(total)
            else:
                return False
    substitute(worldid, count, normal.factor, normal.step)
    return True


@wp.func
def solve_frame(
    worldid: int, frame: int, skeleton: Skeleton, targets: Targets, placement: Placement, normal: Normal,
    values: wp.array2d[wp.float64],
) -> wp.float64:  # fmt: skip
    """Return the objective of a frame, solved from the coordinates that are there."""
    damping = wp.float64(1.0e-6)
    place(worldid, skeleton, values, frame, placement)
    cost = objective(worldid, frame, targets, placement, values)
    fresh = bool(True)
    done = bool(False)
    for _ in range(STEPS):
        if not done:
            if fresh:
                collect(worldid, frame, skeleton, targets, placement, normal)
                normal_equations_of_markers(worldid, frame, skeleton, targets, placement, normal, values)
            good = bound_step(worldid, frame, damping, targets, normal, values)
            largest = wp.float64(0.0)
            for k in range(values.shape[1]):
                normal.old[worldid, k] = values[frame, k]
                if good:
                    value = values[frame, k] + normal.step[worldid, k]
                    value = wp.clamp(value, targets.lower[k], targets.upper[k])
                    largest = wp.max(largest, wp.abs(value - values[frame, k]))
                    values[frame, k] = value
            place(worldid, skeleton, values, frame, placement)
            now = objective(worldid, frame, targets, placement, values)
            fresh = good and now <= cost
            if fresh:
                damping = wp.max(damping / wp.float64(GROWTH), wp.float64(1.0e-12))
                cost = now
                done = largest < wp.float64(TOLERANCE)
            else:
                damping *= wp.float64(GROWTH)
                done = damping > wp.float64(1.0e6) or (good and largest < wp.float64(TOLERANCE))
                for k in range(values.shape[1]):
                    values[frame, k] = normal.old[worldid, k]
    return cost


@wp.kernel(enable_backward=False)
def solve_inverse_kinematics(
    # Model:
    skeleton: Skeleton,
    # In:
    targets: Targets,
    first: wp.array[int],
    frames: int,
    stride: int,
    # Out:
    placement: Placement,
    normal: Normal,
    values: wp.array2d[wp.float64],
    cost: wp.array[wp.float64],
    places: wp.array2d[wp.vec3d],
    angles: wp.array2d[wp.float64],
):
    """Solve frames first, first + stride, ..., `frames` of them, each from the one before.

    The values of the first frame are where it starts. `places` is where the markers of the model are,
    `angles` by how much its sensors are off.
    """
    worldid = wp.tid()
    for step in range(frames):
        frame = first[worldid] + step * stride
        if frame < values.shape[0]:
            if step > 0:
                for k in range(values.shape[1]):
                    values[frame, k] = values[frame - stride, k]
            cost[frame] = solve_frame(worldid, frame, skeleton, targets, placement, normal, values)
            place(worldid, skeleton, values, frame, placement)
            for number in range(targets.body.shape[0]):
                places[frame, number] = station(
                    worldid, targets.body[number], targets.location[number], placement
                )
            for number in range(targets.sensor_body.shape[0]):
                off = turned_off(worldid, frame, number, targets, placement)
                angles[frame, number] = wp.length(off)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Coordinates that fit markers, or sensors.

    Attributes:
        coordinates: Names of the independent coordinates.
        time: [s], shape (frames,).
        values: [rad] or [m], shape (frames, coordinates).
        names: Those of markers or sensors that had a weight.
        error: Distance [m] or angle [rad] to where they were recorded, NaN where they were not seen, shape
            (frames, names).
    """

    coordinates: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    names: tuple[str, ...]
    error: np.ndarray

    def worst(self) -> list[tuple[str, float, float]]:
        """Return name, root mean square and largest error of each that was seen, the worst first."""
        return FitErrors().add(self).worst()

    def doubt(self) -> str | None:
        """Return what is likely wrong with the recording, None where markers fit."""
        return FitErrors().add(self).doubt()


class FitErrors:
    """Errors of markers or sensors, of all parts of a recording."""

    def __init__(self) -> None:
        """Begin with none."""
        self._names: tuple[str, ...] = ()
        self._squares, self._count, self._most = np.zeros((3, 0))

    def add(self, fitted: Fitted) -> FitErrors:
        """Count a part."""
        if not self._names:
            self._names = fitted.names
            self._squares, self._count, self._most = np.zeros((3, len(fitted.names)))
        seen = np.isfinite(fitted.error)
        error = np.where(seen, fitted.error, 0.0)
        self._squares = self._squares + (error**2).sum(axis=0)
        self._count = self._count + seen.sum(axis=0)
        self._most = np.maximum(self._most, error.max(axis=0, initial=0.0))
        return self

    def worst(self) -> list[tuple[str, float, float]]:
        """Return name, root mean square and largest error of each that was seen, the worst first."""
        rms = np.sqrt(self._squares / np.maximum(self._count, 1))
        rows = zip(self._names, rms.tolist(), self._most.tolist(), self._count, strict=True)
        return sorted(((name, mean, most) for name, mean, most, n in rows if n), key=lambda row: -row[1])

    @property
    def rms(self) -> float:
        """Root mean square over all markers and frames [m], or of sensors [rad], whatever their weights."""
        return float(np.sqrt(self._squares.sum() / max(self._count.sum(), 1)))

    def doubt(self) -> str | None:
        """Return what is likely wrong with the recording, None where markers fit."""
        if self.rms <= LARGE:
            return None
        return (
            f"markers are {self.rms:.3g} m off (root mean square); check the recording's unit, its vertical "
            f"axis, and that names are those of the model: worst is {self.worst()[0][0]!r}"
        )


def inverse_kinematics(
    bones: Bones,
    recorded: Markers,
    marker_weights: Mapping[str, float] | None = None,
    coordinate_weights: Mapping[str, float] | None = None,
    coordinate_values: Mapping[str, float | np.ndarray] | None = None,
    start: Mapping[str, float] | None = None,
    near: np.ndarray | None = None,
    weight_factors: np.ndarray | float = 1.0,
) -> Fitted:
    """Return the coordinates of each frame that put the model's markers where they were recorded.

    Args:
        bones: The model.
        recorded: Markers over time; NaN where one was not seen.
        marker_weights: By marker; by default 1 for all that the model and the recording share.
        coordinate_weights: By coordinate, how much it should have its value; by default 0.
        coordinate_values: That value [rad] or [m], one or one for each frame; by default the model's default.
        start: Coordinates from which the first frame is solved; by default the model's defaults.
        near: Where each frame begins [rad] or [m], shape (frames, coordinates); each is then solved by
            itself.
        weight_factors: On marker weights, which broadcast to (frames, markers with a weight).

    Raises:
        ValueError: A marker or coordinate is unknown, a weight is negative or none is positive, or a
            recording in
            which no frame shows three markers.
    """
    model, names = bones.model, bones.coordinates
    weights = _checked(bones, recorded, marker_weights)
    used = tuple(weights)
    seen = recorded.positions[:, [recorded.names.index(name) for name in used]]
    blind = np.isfinite(seen).all(axis=2).sum(axis=1) < FEWEST
    if blind.all():
        raise ValueError(
            f"no frame shows {FEWEST} markers with a weight; the recording has {', '.join(recorded.names)}"
        )
    if blind.any() and near is None:
        logger.warning(
            "%d of %d frames show fewer than %d markers with a weight, first at %.4g s, and have a pose of "
            "the frames beside; fill them with --fill, or leave them out with --span",
            *(blind.sum(), len(blind), FEWEST, recorded.time[blind.argmax()]),
        )
    with wp.ScopedDevice(bones.device):
        targets, bounds = targets_of(bones, len(seen), coordinate_weights or {}, coordinate_values or {})
        targets.marker = wp.array(seen, dtype=wp.vec3d)
        factors = np.atleast_2d(np.asarray(weight_factors, float))
        targets.body = wp.array([bones.number(model.markers[name].body) for name in used], dtype=int)
        targets.location = wp.array([model.markers[name].location for name in used], dtype=wp.vec3d)
        targets.weight = wp.array(factors * list(weights.values()), dtype=wp.float64)
        out = fitted_values(bones, targets, bounds, len(seen), start, near)
        error = np.linalg.norm(out["places"].numpy() - seen, axis=2)
        return Fitted(names, recorded.time, out["values"].numpy(), used, error)


def _checked(bones: Bones, recorded: Markers, marker_weights: Mapping[str, float] | None) -> dict[str, float]:
    """Return the weights that are above 0, by marker; by default 1 for all that model and recording share."""
    model = bones.model
    shared = [name for name in recorded.names if name in model.markers]
    weights = dict.fromkeys(shared, 1.0) if marker_weights is None else dict(marker_weights)
    for name, weight in weights.items():
        if name not in model.markers:
            raise ValueError(f"the model has no marker {name!r}; available: {', '.join(model.markers)}")
        if name not in recorded.names:
            raise ValueError(f"the recording has no marker {name!r}; available: {', '.join(recorded.names)}")
        if not 0.0 <= weight < np.inf:
            raise ValueError(f"the weight of marker {name!r} must be at least 0 and finite, got {weight}")
    used = {name: weight for name, weight in weights.items() if weight > 0.0}
    if not shared:
        raise ValueError(
            f"the model has none of the recorded markers {', '.join(recorded.names)}, but "
            f"{', '.join(model.markers) or 'none'}; rename markers, or take a MarkerSet with --marker-set"
        )
    if not used:
        raise ValueError("no marker has a weight above 0; give at least three markers one")
    return used


def fitted_values(
    bones: Bones,
    targets: Targets,
    bounds: tuple[np.ndarray, np.ndarray],
    count: int,
    start: Mapping[str, float] | None = None,
    near: np.ndarray | None = None,
) -> dict[str, wp.array]:
    """Return values, costs, places of markers and angles of sensors of so many frames.

    Args:
        bones: The model.
        targets: What is wanted.
        bounds: Least and greatest values of coordinates, each of shape (coordinates,).
        count: Of frames.
        start: As in `inverse_kinematics`.
        near: As in `inverse_kinematics`.
    """
    names, model = bones.coordinates, bones.model
    values = np.tile([(start or {}).get(name, model.coordinates[name].default) for name in names], (count, 1))
    out = {
        "values": wp.array(np.clip(values if near is None else near, *bounds), dtype=wp.float64),
        "cost": wp.zeros(count, dtype=wp.float64),
        "places": wp.zeros((count, targets.body.shape[0]), dtype=wp.vec3d),
        "angles": wp.zeros((count, targets.sensor_body.shape[0]), dtype=wp.float64),
    }
    if near is None:
        heads = np.arange(0, count, STRIDE)
        _run(bones, targets, np.zeros(1, int), len(heads), STRIDE, out)
        _run(bones, targets, heads, STRIDE, 1, out)
    else:
        _run(bones, targets, np.arange(count), 1, 1, out)
    return out


def targets_of(
    bones: Bones,
    count: int,
    weights: Mapping[str, float] | None = None,
    values: Mapping[str, float | np.ndarray] | None = None,
    still: Collection[str] = (),
) -> tuple[Targets, tuple[np.ndarray, np.ndarray]]:
    """Return what coordinates of so many frames should be, and their bounds; no markers, no sensors.

    Args:
        bones: The model.
        count: Of frames.
        weights: As `coordinate_weights` of `inverse_kinematics`.
        values: As `coordinate_values` of it.
        still: Coordinates that stay at their defaults.

    Raises:
        ValueError: A coordinate is unknown, or the one value of an angle is beyond a turn.
    """
    model, names, weights, values = bones.model, bones.coordinates, weights or {}, values or {}
    pull, wanted = np.zeros(len(names)), np.zeros((count, len(names)))
    for name, weight in weights.items():
        if name in names:
            pull[names.index(name)] = weight
        elif name not in model.coordinates:
            raise ValueError(f"coordinate {name!r} unknown; available: {', '.join(model.coordinates)}")
    for k, name in enumerate(names):
        wanted[:, k] = value = values.get(name, model.coordinates[name].default)
        one = float(value) if isinstance(value, (int, float)) else 0.0
        if pull[k] and model.coordinates[name].rotational and abs(one) > TURN:
            raise ValueError(
                f"coordinate {name!r} should have the value {one:g}, in radians {np.degrees(one):.4g} "
                "degrees; a value of an angle is in radians"
            )
    bounds = [
        model.coordinates[n].range if model.coordinates[n].clamped else (-np.inf, np.inf) for n in names
    ]
    for number, name in enumerate(names):
        if name in still:
            bounds[number] = (model.coordinates[name].default,) * 2
    lower, upper = np.array(bounds, float).reshape(-1, 2).T
    none = dict.fromkeys(("body", "sensor_body"), np.zeros(0, int))
    targets = struct_of(Targets, **none, value=wanted, value_weight=pull, lower=lower, upper=upper)
    return targets, (lower, upper)


def _run(
    bones: Bones, targets: Targets, first: np.ndarray, frames: int, stride: int, out: Mapping[str, Any]
) -> None:
    """Solve `frames` frames in each world from its first frame on."""
    bodies, free = len(bones.bodies) - 1, len(bones.coordinates)

    def solve(part: slice) -> None:
        heads, worlds = first[part], len(first[part])
        with wp.ScopedDevice(bones.device):
            normal = zeros_of(
                Normal,
                **dict.fromkeys(("weight", "first", "second", "force", "torque"), (worlds, bodies)),
                **dict.fromkeys(("matrix", "factor"), (worlds, free, free)),
                **dict.fromkeys(("slope", "step", "old"), (worlds, free)),
            )
            launch(
                solve_inverse_kinematics,
                worlds,
                skeleton=bones.skeleton,
                targets=targets,
                first=wp.array(heads, dtype=int),
                frames=frames,
                stride=stride,
                placement=bones.placement(worlds),
                normal=normal,
                **out,
            )

    in_parts(len(first), len(first), solve)
