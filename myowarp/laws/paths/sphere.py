"""The path of a line over a wrapping sphere, as OpenSim 4.6 computes it.

Source of the rules: `WrapSphere.cpp` of opensim-core.
"""

import warp as wp

from myowarp.laws.paths.wrap import INSIDE, MANDATORY, NONE, WRAPPED, Wrap, line_of_sight, on_side, real


@wp.func
def touch(point: wp.vec3d, normal: wp.vec3d, radius: wp.float64, side: wp.float64) -> wp.vec3d:
    """Return where a line from a point touches the sphere in the plane of a normal, on a side (-1 or 1)."""
    distance = wp.length(point)
    inward = -point / distance
    sine = wp.min(radius / distance, real(1.0))
    cosine = wp.sqrt(real(1.0) - sine * sine)
    reach = distance * cosine
    return point + reach * (cosine * inward + side * sine * wp.cross(normal, inward))


@wp.func
def free_status(start: wp.vec3d, end: wp.vec3d, on1: bool, on2: bool, axis: int, sign: int) -> int:
    """Return the status of a line with an end on the quadrant's side; OpenSim takes metres for a share."""
    along = wp.normalize(end - start)
    distance = -wp.dot(start, along)
    if distance > real(0.0) and distance < real(1.0):
        return MANDATORY
    near = start + distance * along
    if on1 != on2 and not on_side(near[axis], sign):
        return WRAPPED
    return NONE


@wp.func
def wrap_sphere(start: wp.vec3d, end: wp.vec3d, radius: wp.float64, axis: int, sign: int) -> Wrap:
    """Touching points in the plane of ends and centre; arc = r angle; only lines that intersect wrap."""
    wrap = Wrap()
    wrap.status = NONE
    line = start - end
    a, b = wp.length_sq(line), real(2.0) * wp.dot(end, line)
    c = wp.length_sq(end) - radius * radius
    if wp.length_sq(start) < radius * radius or c < real(0.0):
        wrap.status = INSIDE
        return wrap
    discriminant = b * b - real(4.0) * a * c
    if not (discriminant >= real(0.0)):
        return wrap
    root = wp.sqrt(discriminant)
    enter, leave = (-b + root) / (real(2.0) * a), (-b - root) / (real(2.0) * a)
    if not (enter > real(0.0) and enter < real(1.0) and leave > real(0.0) and leave < real(1.0)):
        return wrap
    normal = wp.normalize(wp.cross(wp.normalize(line), wp.normalize(end)))
    a1, b1 = touch(start, normal, radius, real(-1.0)), touch(start, normal, radius, real(1.0))
    a2, b2 = touch(end, normal, radius, real(-1.0)), touch(end, normal, radius, real(1.0))
    wrap.status = WRAPPED
    on1, on2 = on_side(start[axis], sign), on_side(end[axis], sign)
    if sign != 0 and (on1 or on2):
        wrap.status = free_status(start, end, on1, on2, axis, sign)
    first, last, far = a1, a2, bool(False)
    if sign != 0 and not (on1 and on2):
        middle = wp.normalize(-start - end)
        left1, left2 = b1, b2
        if not (line_of_sight(a1, middle) > line_of_sight(b1, middle)):
            first, left1 = b1, a1
        if not (line_of_sight(a2, middle) > line_of_sight(b2, middle)):
            last, left2 = b2, a2
        reach = first - start + last - end
        if reach[axis] * real(sign) < real(0.0):
            first, last = left1, left2
        far = wp.dot(first + last, first - start + last - end) < real(0.0)
    else:
        best = line_of_sight(a1, a2)
        cosine = line_of_sight(a1, b2)
        if cosine > best:
            best = cosine
            last = b2
        cosine = line_of_sight(b1, a2)
        if cosine > best:
            best = cosine
            first = b1
            last = a2
        if line_of_sight(b1, b2) > best:
            first = b1
            last = b2
    angle = wp.acos(wp.clamp(line_of_sight(first, last), real(-1.0), real(1.0)))
    if far:
        angle -= real(2.0) * real(wp.pi)
    wrap.first = first
    wrap.last = last
    wrap.length = radius * angle
    return wrap
