"""The path of a line over a wrapping cylinder, as OpenSim 4.6 computes it.

The cylinder's axis is z. Two candidates of a tangent point per end point follow from the circle that the
axis sees; a quadrant or the smaller angle picks one of each. How far they slide along the axis comes from
the plane through both end points and an apex of the cylinder, so the path is close to the geodesic but is
not the geodesic. Only a muscle with several wrap objects has its tangent points adjusted until the spiral
leaves them straight on, to 0.1 degrees. Source of the rules: `WrapCylinder.cpp` of opensim-core.
"""

from typing import NamedTuple

import numpy as np

INSIDE, NONE, WRAPPED, MANDATORY = -1, 0, 1, 2
"""What became of a line: an end point is inside, no wrap, a possible wrap, a wrap that intersects."""

LINE_EPSILON = 1e-5
"""[m] below which OpenSim calls a line parallel to a plane."""
LEVEL = 1e-15
"""[m] of height below which OpenSim takes a vector as zero."""
TANGENCY = np.deg2rad(0.1)
"""[rad] between line and spiral that OpenSim accepts."""
ADJUSTMENTS = 100
"""Times that OpenSim moves the tangent points of one line."""
SPIRAL_STEP = 0.002
"""[m] between the points of OpenSim's spiral."""


class Wrap(NamedTuple):
    """Lines over one wrap object, in its frame.

    Attributes:
        status: one of `INSIDE`, `NONE`, `WRAPPED`, `MANDATORY`, shape `(n,)`.
        first: point where the line arrives at the surface [m], shape `(n, 3)`.
        last: point where it leaves the surface [m], shape `(n, 3)`.
        length: of the path between them, over the surface [m], shape `(n,)`.
    """

    status: np.ndarray
    first: np.ndarray
    last: np.ndarray
    length: np.ndarray


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors of length one; a zero vector stays zero."""
    norms = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(norms > 0, norms, 1.0)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the scalar products of two arrays of vectors."""
    return np.einsum("...i,...i->...", a, b)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle between vectors [rad]."""
    norms = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.arccos(np.clip(dot(a, b) / np.where(norms > 0, norms, 1.0), -1.0, 1.0))


def on_side(values: np.ndarray, sign: int) -> np.ndarray:
    """Whether coordinates lie on the side of `sign`; zero counts as positive."""
    return (values >= 0) == (sign > 0)


def wrap_cylinder(
    start: np.ndarray, end: np.ndarray, radius: float, length: float, axis: int, sign: int, adjust: bool
) -> Wrap:
    """Wrap lines over a cylinder.

    Args:
        start: first end points in the cylinder's frame [m], shape `(n, 3)`.
        end: second end points [m], shape `(n, 3)`.
        radius: of the cylinder [m].
        length: of the cylinder along z [m].
        axis: coordinate that the quadrant looks at, 0 to 2.
        sign: side of it that the path must take, 0 without a quadrant.
        adjust: whether tangent points are adjusted (muscles with several wrap objects).

    Returns:
        The wraps; `first`, `last` and `length` mean something where `status` is positive.
    """
    inside = (np.hypot(start[:, 0], start[:, 1]) < radius) | (np.hypot(end[:, 0], end[:, 1]) < radius)
    near, crosses = _nearest_on_line(start, end, radius)
    status = np.where(crosses, MANDATORY, NONE if sign == 0 else WRAPPED)
    with np.errstate(invalid="ignore", divide="ignore"):
        candidates = [_tangent_points(points, radius) for points in (start, end)]
        if sign == 0:
            first, last = _smallest_angle(candidates)
            far = long = np.zeros(len(start), bool)
        else:
            on_first, on_second = on_side(start[:, axis], sign), on_side(end[:, axis], sign)
            free = (on_first | on_second) & ~crosses
            stays = (on_first == on_second) | on_side(near[:, axis], sign)
            status = np.where(free & stays, NONE, status)
            status = np.where(on_first | on_second, status, WRAPPED)
            first, last, far = _on_quadrant(candidates, axis, sign)
            reach = (first - start) + (last - end)
            outward = (first + last)[:, :2]
            long = dot(outward, reach[:, :2]) < 0
        first, last = _slide(start, end, first, last, radius, far)
    beyond = (np.abs(first[:, 2]) > length / 2) & (np.abs(last[:, 2]) > length / 2)
    status = np.where(beyond, NONE, status)
    status = np.where(inside, INSIDE, status)
    first, last, arc = _spiral(start, end, first, last, radius, long, adjust & (status > 0))
    return Wrap(status, first, last, arc)


def _nearest_on_line(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of the lines nearest to the z axis, and whether the segments cross the cylinder."""
    along = (end - start)[:, :2]
    squared = dot(along, along)
    span = np.linalg.norm(end - start, axis=1)
    parallel = squared <= 2e-12 * span**2
    t = -dot(start[:, :2], along) / np.where(parallel, 1.0, squared)
    near = start + t[:, None] * (end - start)
    crosses = ~parallel & (np.hypot(near[:, 0], near[:, 1]) < radius) & (t > 0) & (t < 1)
    return near, crosses


def _tangent_points(points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return both points where a line from each point touches the circle, at the height of the point."""
    distance = np.hypot(points[:, 0], points[:, 1])
    outward = points[:, :2] / distance[:, None]
    inner = radius * radius / distance
    aside = np.sqrt(np.maximum(radius**2 - inner**2, 0.0))
    across = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
    left, right = points.copy(), points.copy()
    left[:, :2] = inner[:, None] * outward + aside[:, None] * across
    right[:, :2] = inner[:, None] * outward - aside[:, None] * across
    return left, right


def _smallest_angle(candidates: list) -> tuple[np.ndarray, np.ndarray]:
    """Return the pair of tangent points with the smallest angle between them."""
    pairs = [(first, last) for first in candidates[0] for last in candidates[1]]
    cosines = np.stack([dot(unit(first[:, :2]), unit(last[:, :2])) for first, last in pairs])
    best = np.argmax(cosines, axis=0)
    index = np.arange(len(best))
    return np.stack([p[0] for p in pairs])[best, index], np.stack([p[1] for p in pairs])[best, index]


def _on_quadrant(candidates: list, axis: int, sign: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the tangent points on the quadrant's side of the path, and whether that is the far side."""
    (left_1, right_1), (left_2, right_2) = candidates
    wider = angle_between(left_1[:, :2], right_2[:, :2]) > angle_between(right_1[:, :2], left_2[:, :2])
    a1, b1 = on_side(left_1[:, axis], sign), on_side(right_1[:, axis], sign)
    a2, b2 = on_side(left_2[:, axis], sign), on_side(right_2[:, axis], sign)
    by_second = np.where(a2, False, np.where(b2, True, wider))
    take_left = np.where(a1 & b1, ~a2, np.where(a1, True, np.where(b1, False, by_second)))
    far = np.where(a1 | b1 | a2 | b2, take_left == wider, True)
    first = np.where(take_left[:, None], left_1, right_1)
    last = np.where(take_left[:, None], right_2, left_2)
    return first, last, far


def _slide(
    start: np.ndarray, end: np.ndarray, first: np.ndarray, last: np.ndarray, radius: float, far: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slide tangent points along the axis into the plane of the end points and the apex."""
    distance = [np.hypot(points[:, 0], points[:, 1]) for points in (start, end)]
    t = distance[0] / (distance[0] + distance[1])
    middle = start + t[:, None] * (end - start)
    centre = np.zeros_like(middle)
    centre[:, 2] = middle[:, 2]
    normal = unit(np.cross(unit(start - centre), unit(end - centre)))
    upright = unit(np.stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal))], axis=1))
    apexes = centre + radius * upright, centre - radius * upright
    gaps = [dot(middle - apex, middle - apex) for apex in apexes]
    apex = np.where(((gaps[0] < gaps[1]) != far)[:, None], *apexes)
    normal = unit(np.cross(unit(start - apex), unit(end - apex)))
    # OpenSim measures along the axis in the direction of the second end's height. Without a height there is
    # none: the first point then stays, and the last one slides however far.
    level = np.abs(end[:, 2]) < LEVEL
    moved = []
    for point, own, other, free in ((first, start, end, False), (last, end, start, True)):
        meets = np.abs(20.0 * normal[:, 2]) >= LINE_EPSILON
        shift = dot(normal, start - point) / np.where(meets, normal[:, 2], 1.0)
        height = point[:, 2] + shift
        closer = np.abs(height - other[:, 2]) < np.abs(own[:, 2] - other[:, 2])
        closer = np.where(level, free & (own[:, 2] != other[:, 2]), closer)
        point = point.copy()
        point[:, 2] = np.where(meets & (np.abs(shift) <= 10.0) & closer, height, point[:, 2])
        moved.append(point)
    return moved[0], moved[1]


def _spiral(
    start: np.ndarray,
    end: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    radius: float,
    long: np.ndarray,
    adjust: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return tangent points and length of the spiral between them, adjusted where asked."""
    first, last = first.copy(), last.copy()
    cross = first[:, 0] * last[:, 1] - first[:, 1] * last[:, 0]
    turn = np.arctan2(cross, dot(first[:, :2], last[:, :2]))
    # OpenSim subtracts the signed angle: a long way of negative sense is more than a whole turn.
    turn = np.where(long, turn - 2 * np.pi, turn)
    busy = np.flatnonzero(adjust)
    for _ in range(ADJUSTMENTS):
        rise = last[busy, 2] - first[busy, 2]
        steps = np.floor(np.hypot(radius * turn[busy], rise) / SPIRAL_STEP)
        busy, rise, steps = busy[steps >= 2], rise[steps >= 2], steps[steps >= 2]
        if not len(busy):
            break
        point = _rotated(first[busy], turn[busy] / steps, rise / steps)
        first[busy, 2], moved = _adjusted(start[busy], first[busy], point)
        # As in OpenSim this point starts from the first tangent point after it was moved.
        point = _rotated(first[busy], turn[busy] * (1 - 1 / steps), rise * (1 - 1 / steps))
        last[busy, 2], moved_last = _adjusted(end[busy], last[busy], point)
        busy = busy[moved | moved_last]
    return first, last, np.hypot(radius * turn, last[:, 2] - first[:, 2])


def _rotated(points: np.ndarray, angle: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """Return points turned about z and raised along it."""
    x, y = points[:, 0], points[:, 1]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, points[:, 2] + rise], axis=1)


def _adjusted(points: np.ndarray, tangent: np.ndarray, spiral: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return heights of tangent points moved towards a straight transition, and which moved."""
    slopes = [np.arccos(np.clip(unit(v)[:, 2], -1.0, 1.0)) for v in (tangent - points, spiral - tangent)]
    moves = np.abs(slopes[0] - slopes[1]) > TANGENCY
    along = spiral - points
    flat = along[:, :2]
    t = dot(tangent[:, :2] - points[:, :2], flat) / np.maximum(dot(flat, flat), 1e-300)
    straight = points[:, 2] + t * along[:, 2]
    return np.where(moves, tangent[:, 2] + 1.5 * (straight - tangent[:, 2]), tangent[:, 2]), moves
