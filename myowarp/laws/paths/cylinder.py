"""The path of a line over a wrapping cylinder about z, as OpenSim 4.6 computes it.

A quadrant or the smaller angle picks one of two tangent points of each end point, which follow from the
circle that the axis sees. How far they slide along the axis comes from the plane through both end points
and an apex of the cylinder, so the path is close to the geodesic but is not the geodesic. Only a muscle
with several wrap objects has its tangent points adjusted until the spiral leaves them straight on, to 0.1
degrees. Source of the rules: `WrapCylinder.cpp` of opensim-core.
"""

import warp as wp

from myowarp.laws.paths.wrap import (
    INSIDE,
    MANDATORY,
    NONE,
    WRAPPED,
    Wrap,
    flat_cosine,
    flat_dot,
    flat_length,
    on_side,
    real,
)

LINE_EPSILON = wp.constant(wp.float64(1e-5))  # m, below which a line is parallel to a plane
LEVEL = wp.constant(wp.float64(1e-15))  # m of height that OpenSim takes for zero
TANGENCY = wp.constant(wp.float64(0.0017453292519943296))  # rad between line and spiral that is accepted
SPIRAL_STEP = wp.constant(wp.float64(0.002))  # m between the points of the spiral
ADJUSTMENTS = wp.constant(100)


@wp.func
def tangent_point(point: wp.vec3d, radius: wp.float64, side: wp.float64) -> wp.vec3d:
    """Return where a line from a point touches the circle, at its height; side 1: left, -1: right."""
    distance = flat_length(point)
    x, y = point[0] / distance, point[1] / distance
    inner = radius * radius / distance
    aside = side * wp.sqrt(wp.max(radius * radius - inner * inner, real(0.0)))
    return wp.vec3d(inner * x - aside * y, inner * y + aside * x, point[2])


@wp.func
def slid(
    start: wp.vec3d,
    normal: wp.vec3d,
    point: wp.vec3d,
    own: wp.vec3d,
    other: wp.vec3d,
    level: bool,
    free: bool,
) -> wp.vec3d:
    """Return a tangent point moved along the axis into the plane through `start` with a normal."""
    if wp.abs(real(20.0) * normal[2]) < LINE_EPSILON:
        return point
    shift = wp.dot(normal, start - point) / normal[2]
    height = point[2] + shift
    closer = wp.abs(height - other[2]) < wp.abs(own[2] - other[2])
    if level:
        closer = free and own[2] != other[2]
    if closer and wp.abs(shift) <= real(10.0):
        return wp.vec3d(point[0], point[1], height)
    return point


@wp.func
def turned(point: wp.vec3d, angle: wp.float64, rise: wp.float64) -> wp.vec3d:
    """Return a point turned about z and raised along it."""
    c, s = wp.cos(angle), wp.sin(angle)
    return wp.vec3d(c * point[0] - s * point[1], s * point[0] + c * point[1], point[2] + rise)


@wp.func
def slope(step: wp.vec3d) -> wp.float64:
    """Return the angle between a step and the axis."""
    return wp.acos(wp.clamp(wp.normalize(step)[2], real(-1.0), real(1.0)))


@wp.func
def transition(point: wp.vec3d, tangent: wp.vec3d, spiral: wp.vec3d) -> wp.float64:
    """Return how far a tangent point moves along the axis towards a straight transition; 0: it stays."""
    if not (wp.abs(slope(tangent - point) - slope(spiral - tangent)) > TANGENCY):
        return real(0.0)
    along = spiral - point
    t = flat_dot(tangent - point, along) / wp.max(flat_dot(along, along), real(1e-300))
    return real(1.5) * (point[2] + t * along[2] - tangent[2])


@wp.func
def wrap_cylinder(
    start: wp.vec3d,
    end: wp.vec3d,
    radius: wp.float64,
    length: wp.float64,
    axis: int,
    sign: int,
    adjust: bool,
) -> Wrap:
    """Tangent points slid into the plane of the ends and the apex; arc = sqrt((r turn)^2 + rise^2)."""
    wrap = Wrap()
    wrap.status = NONE
    r1, r2 = flat_length(start), flat_length(end)
    if r1 < radius or r2 < radius:
        wrap.status = INSIDE
        return wrap
    line = end - start
    squared = flat_dot(line, line)
    near, crosses = start, bool(False)
    if squared > real(2e-12) * wp.dot(line, line):
        t = -flat_dot(start, line) / squared
        near = start + t * line
        crosses = flat_length(near) < radius and t > real(0.0) and t < real(1.0)
    left1, right1 = tangent_point(start, radius, real(1.0)), tangent_point(start, radius, real(-1.0))
    left2, right2 = tangent_point(end, radius, real(1.0)), tangent_point(end, radius, real(-1.0))
    first, last = left1, left2
    far, long_way = bool(False), bool(False)
    if sign == 0:
        if not crosses:
            return wrap
        wrap.status = MANDATORY
        best = flat_cosine(left1, left2)
        cosine = flat_cosine(left1, right2)
        if cosine > best:
            best = cosine
            last = right2
        cosine = flat_cosine(right1, left2)
        if cosine > best:
            best = cosine
            first = right1
            last = left2
        if flat_cosine(right1, right2) > best:
            first = right1
            last = right2
    else:
        on1, on2 = on_side(start[axis], sign), on_side(end[axis], sign)
        wrap.status = wp.where(crosses and (on1 or on2), MANDATORY, WRAPPED)
        if (on1 or on2) and not crosses and (on1 == on2 or on_side(near[axis], sign)):
            wrap.status = NONE
            return wrap
        wider = flat_cosine(left1, right2) < flat_cosine(right1, left2)
        a1, b1 = on_side(left1[axis], sign), on_side(right1[axis], sign)
        a2, b2 = on_side(left2[axis], sign), on_side(right2[axis], sign)
        take_left = bool(wider)
        if a1 and b1:
            take_left = not a2
        elif a1:
            take_left = True
        elif b1 or a2:
            take_left = False
        elif b2:
            take_left = True
        far = take_left == wider or not (a1 or b1 or a2 or b2)
        first = wp.where(take_left, left1, right1)
        last = wp.where(take_left, right2, left2)
        long_way = flat_dot(first + last, (first - start) + (last - end)) < real(0.0)
    middle = start + (r1 / (r1 + r2)) * line
    centre = wp.vec3d(real(0.0), real(0.0), middle[2])
    across = wp.normalize(wp.cross(wp.normalize(start - centre), wp.normalize(end - centre)))
    upright = radius * wp.normalize(wp.vec3d(-across[1], across[0], real(0.0)))
    nearer = wp.length_sq(middle - centre - upright) < wp.length_sq(middle - centre + upright)
    apex = wp.where(nearer != far, centre + upright, centre - upright)
    normal = wp.normalize(wp.cross(wp.normalize(start - apex), wp.normalize(end - apex)))
    level = wp.abs(end[2]) < LEVEL
    first = slid(start, normal, first, start, end, level, False)
    last = slid(start, normal, last, end, start, level, True)
    if wp.abs(first[2]) > length / real(2.0) and wp.abs(last[2]) > length / real(2.0):
        wrap.status = NONE
        return wrap
    turn = wp.atan2(first[0] * last[1] - first[1] * last[0], flat_dot(first, last))
    if long_way:
        turn -= real(2.0) * real(wp.pi)
    if adjust:
        for _ in range(ADJUSTMENTS):
            rise = last[2] - first[2]
            steps = wp.floor(wp.sqrt((radius * turn) * (radius * turn) + rise * rise) / SPIRAL_STEP)
            if not (steps >= real(2.0)):
                break
            moved = transition(start, first, turned(first, turn / steps, rise / steps))
            first = wp.vec3d(first[0], first[1], first[2] + moved)
            share = real(1.0) - real(1.0) / steps
            moved_last = transition(end, last, turned(first, turn * share, rise * share))
            last = wp.vec3d(last[0], last[1], last[2] + moved_last)
            if moved == real(0.0) and moved_last == real(0.0):
                break
    rise = last[2] - first[2]
    wrap.first = first
    wrap.last = last
    wrap.length = wp.sqrt((radius * turn) * (radius * turn) + rise * rise)
    return wrap
