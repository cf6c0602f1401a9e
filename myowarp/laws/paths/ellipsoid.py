"""The path of a line over a wrapping ellipsoid, as OpenSim 4.6 computes it.

The path lies in the plane through both end points and one point of the surface, so it is no geodesic and
the lengths that OpenSim reports are not an exact integral of its moment arms. The point comes from the
middle of the line inside the ellipsoid (midpoint), from where the line meets a plane of symmetry (axial),
or from a blend of that and of the mean direction to the surface (hybrid). All is scaled so that the mean
half axis is 1. Source of the rules and of all constants: `WrapEllipsoid.cpp` of opensim-core; nearest
points after D. Eberly.
"""

import warp as wp

from myowarp.laws.paths.wrap import INSIDE, MANDATORY, NONE, Wrap, line_of_sight, on_side, real

HYBRID = wp.constant(0)
MIDPOINT = wp.constant(1)
AXIAL = wp.constant(2)
SAMPLED = wp.constant(3)  # as HYBRID, most rays of the fan between a ninth of them

FAN_BELOW = wp.constant(wp.float64(0.7073))  # cosine of line and main axis, only the fan below
AXIAL_ABOVE = wp.constant(wp.float64(0.9))  # the same, only the axial rule above
EDGE = wp.constant(wp.float64(0.3))  # share of the line inside over which the axial rule fades in
FAN = wp.constant(wp.float64(300.0))  # parts of the line inside
FAN_RAYS = wp.constant(298)  # from where they meet; OpenSim leaves the last one out
SPACING = wp.constant(9)  # between rays that are computed in any case
BLOCKS = wp.constant(11)  # of three spacings each
BENT = wp.constant(
    wp.float64(1e-5)
)  # squared third difference of a block beyond which all its rays are computed
NEWTON_STEPS = wp.constant(64)
NEWTON_ERROR = wp.constant(wp.float64(1e-9))
TANGENT_ERROR = wp.constant(wp.float64(1e-8))  # squared
TANGENT_STEPS = wp.constant(50)
SEARCH_STEPS = wp.constant(1000)
SURFACE = wp.constant(wp.float64(1e-4))  # value of the equation below which a point is on the surface
SEGMENT = wp.constant(wp.float64(0.001))  # m
ZERO = wp.constant(wp.float64(2e-12))  # below which OpenSim calls a coordinate zero


@wp.struct
class Plane:
    """Vectors that set the plane of a path.

    Attributes:
        point: Of the surface, in the plane.
        fan: Weight of the fan.
        begin1: Where the search for the first tangent point begins.
        begin2: The same for the second.
    """

    point: wp.vec3d
    fan: wp.float64
    begin1: wp.vec3d
    begin2: wp.vec3d


@wp.struct
class Arc:
    """A cut of the plane with the surface: its length, the neighbours of its ends, and its pieces."""

    length: wp.float64
    second: wp.vec3d
    next_to_last: wp.vec3d
    pieces: int


@wp.func
def surface_value(a: wp.vec3d, p: wp.vec3d) -> wp.float64:
    """Return |p / a|^2 - 1."""
    return wp.length_sq(wp.cw_div(p, a)) - real(1.0)


@wp.func
def eberly(a: wp.vec3d, p: wp.vec3d) -> wp.vec3d:
    """Return a^2 p / (t + a^2) with sum(a^2 p^2 / (t + a^2)^2) = 1, by Newton and OpenSim's stop."""
    squares = wp.cw_mul(a, a)
    weights = wp.cw_mul(squares, wp.cw_mul(p, p))
    t = real(0.0)
    if surface_value(a, p) >= real(0.0):
        t = wp.max(a[0], wp.max(a[1], a[2])) * wp.length(p)
    for _ in range(NEWTON_STEPS):
        shifted = squares + wp.vec3d(t, t, t)
        inverse = wp.cw_div(wp.vec3d(real(1.0), real(1.0), real(1.0)), shifted)
        ratio = wp.cw_mul(weights, wp.cw_mul(inverse, inverse))
        product = shifted[0] * shifted[1] * shifted[2]
        value = real(1.0) - ratio[0] - ratio[1] - ratio[2]
        if not (wp.abs(product * product * value) >= NEWTON_ERROR):
            break
        bend = wp.dot(ratio, inverse)
        t -= value / (real(2.0) * ((inverse[0] + inverse[1] + inverse[2]) * value + bend))
    return wp.cw_div(wp.cw_mul(squares, p), squares + wp.vec3d(t, t, t))


@wp.func
def eberly_flat(ai: wp.float64, aj: wp.float64, pi: wp.float64, pj: wp.float64) -> wp.vec2d:
    """Return the same on an ellipse."""
    si, sj = ai * ai, aj * aj
    t = real(0.0)
    if (pi / ai) * (pi / ai) + (pj / aj) * (pj / aj) >= real(1.0):
        t = wp.max(ai, aj) * wp.sqrt(pi * pi + pj * pj)
    for _ in range(NEWTON_STEPS):
        ii, jj = real(1.0) / (si + t), real(1.0) / (sj + t)
        ri, rj = si * pi * pi * ii * ii, sj * pj * pj * jj * jj
        product = (si + t) * (sj + t)
        value = real(1.0) - (ri + rj)
        if not (wp.abs(product * product * value) >= NEWTON_ERROR):
            break
        t -= value / (real(2.0) * ((ii + jj) * value + ri * ii + rj * jj))
    return wp.vec2d(si * pi / (si + t), sj * pj / (sj + t))


@wp.func
def on_short_axis(ai: wp.float64, aj: wp.float64, pi: wp.float64, pj: wp.float64) -> wp.vec2d:
    """Return the nearest point of an ellipse to a point on axis j, the coordinate along i being zero."""
    if ai >= aj or wp.abs(pj) >= aj - ai * ai / aj:
        return wp.vec2d(pi, wp.where(pj >= real(0.0), aj, -aj))
    beside = aj * aj * pj / (aj * aj - ai * ai)
    return wp.vec2d(ai * wp.sqrt(wp.abs(real(1.0) - (beside / aj) * (beside / aj))), beside)


@wp.func
def nearest_on_ellipse(ai: wp.float64, aj: wp.float64, pi: wp.float64, pj: wp.float64) -> wp.vec2d:
    """Return the point of an ellipse nearest to a point."""
    flat_i, flat_j = wp.abs(pi) <= ZERO, wp.abs(pj) <= ZERO
    if flat_i and flat_j:
        if aj <= ai:
            return wp.vec2d(pi, wp.where(pj < real(0.0), -aj, aj))
        return wp.vec2d(wp.where(pi < real(0.0), -ai, ai), pj)
    if flat_i:
        return on_short_axis(ai, aj, pi, pj)
    if flat_j:
        swapped = on_short_axis(aj, ai, pj, pi)
        return wp.vec2d(swapped[1], swapped[0])
    return eberly_flat(ai, aj, pi, pj)


@wp.func
def nearest_in_plane(a: wp.vec3d, p: wp.vec3d, normal: int) -> wp.vec3d:
    """Return the nearest point of the ellipsoid's cut across an axis, in whose plane of symmetry p lies."""
    if normal == 0:
        yz = nearest_on_ellipse(a[1], a[2], p[1], p[2])
        return wp.vec3d(p[0], yz[0], yz[1])
    if normal == 1:
        zx = nearest_on_ellipse(a[2], a[0], p[2], p[0])
        return wp.vec3d(zx[1], p[1], zx[0])
    xy = nearest_on_ellipse(a[0], a[1], p[0], p[1])
    return wp.vec3d(xy[0], xy[1], p[2])


@wp.func
def nearest_on_ellipsoid(a: wp.vec3d, p: wp.vec3d) -> wp.vec3d:
    """Return the point of an ellipsoid nearest to a point."""
    plane, least = int(-1), real(1e300)
    for i in range(3):
        others = a[0] + a[1] + a[2] - a[i]
        if wp.abs(p[i]) <= ZERO and others < least:
            plane = i
            least = others
    if plane >= 0:
        return nearest_in_plane(a, p, plane)
    return eberly(a, p)


@wp.func
def ray(a: wp.vec3d, r1: wp.vec3d, inner: wp.vec3d, number: int) -> wp.vec3d:
    """Return the direction from a point of the line inside to the nearest one of the surface."""
    sample = r1 + (real(number) / FAN) * inner
    return wp.normalize(nearest_on_ellipsoid(a, sample) - sample)


@wp.func
def fan_sum(a: wp.vec3d, r1: wp.vec3d, inner: wp.vec3d, sampled: bool) -> wp.vec3d:
    """Sum of all rays; sampled: of cubics through every ninth, where these bend little."""
    total = wp.vec3d()
    if not sampled:
        for i in range(FAN_RAYS):
            total += ray(a, r1, inner, i + 1)
        return total
    begin = ray(a, r1, inner, 1)
    for block in range(BLOCKS):
        first = 1 + 3 * SPACING * block
        one, two = ray(a, r1, inner, first + SPACING), ray(a, r1, inner, first + 2 * SPACING)
        end = ray(a, r1, inner, first + 3 * SPACING)
        if wp.length_sq(end - begin + real(3.0) * (one - two)) < BENT:
            # Sums of Lagrange's cubics over 27 rays, the last one left to the next block.
            total += real(35.0 / 9.0) * begin + real(91.0 / 9.0) * (one + two) + real(26.0 / 9.0) * end
        else:
            total += begin
            for i in range(1, 3 * SPACING):
                total += ray(a, r1, inner, first + i)
        begin = end
    return total + begin


@wp.func
def plane_point(line: wp.vec3d, r1: wp.vec3d, r2: wp.vec3d, a: wp.vec3d, method: int) -> Plane:
    """Return the point that sets the plane: midpoint, axial, or a blend with the mean of the fan."""
    plane = Plane()
    inner = r2 - r1
    middle = r1 + real(0.5) * inner
    if method == MIDPOINT:
        plane.point = nearest_on_ellipsoid(a, middle)
        plane.begin1 = plane.point
        plane.begin2 = plane.point
        return plane
    slopes = wp.normalize(line)
    main, slope = int(0), wp.abs(slopes[0])
    for i in range(1, 3):
        if wp.abs(slopes[i]) > slope:
            main = i
            slope = wp.abs(slopes[i])
    t = -r1[main] / inner[main]
    axial = nearest_in_plane(a, r1 + t * inner, main)
    if method == AXIAL:
        use = t > real(0.0) and t < real(1.0)
        plane.point = axial
        plane.begin1 = wp.where(use, axial, r1)
        plane.begin2 = wp.where(use, axial, r2)
        return plane
    if slope > FAN_BELOW:
        fade = wp.clamp(wp.min(t, real(1.0) - t) / EDGE, real(0.0), real(1.0))
        slope = FAN_BELOW + fade * (slope - FAN_BELOW)
    share = (slope - FAN_BELOW) / (AXIAL_ABOVE - FAN_BELOW)
    plane.point = axial
    if slope < AXIAL_ABOVE:
        total = fan_sum(a, r1, inner, method == SAMPLED)
        spread = nearest_on_ellipsoid(a, middle + wp.normalize(total))
        plane.point = spread
        if share > real(0.0):
            plane.point = nearest_on_ellipsoid(a, share * axial + (real(1.0) - share) * spread)
    plane.fan = wp.min(real(1.0) - share, real(1.0))
    plane.begin1 = plane.point
    plane.begin2 = plane.point
    return plane


@wp.func
def tangent_errors(
    r: wp.vec3d, d: wp.float64, p: wp.vec3d, a: wp.vec3d, normal: wp.vec3d, offset: wp.float64
) -> wp.vec4d:
    """Return distances from plane and surface, and of tangency at r and at p."""
    gradient = real(2.0) * wp.cw_div(r, wp.cw_mul(a, a))
    return wp.vec4d(
        wp.dot(normal, r) + offset, surface_value(a, r), wp.dot(gradient, r) + d, wp.dot(gradient, p) + d
    )


@wp.func
def solved(m: wp.mat44d, b: wp.vec4d) -> wp.vec4d:
    """Return x with m x = b, m symmetric and positive, by its factors L D L'."""
    d0 = m[0, 0]
    l10, l20, l30 = m[1, 0] / d0, m[2, 0] / d0, m[3, 0] / d0
    d1 = m[1, 1] - l10 * m[1, 0]
    l21, l31 = (m[2, 1] - l20 * m[1, 0]) / d1, (m[3, 1] - l30 * m[1, 0]) / d1
    d2 = m[2, 2] - l20 * m[2, 0] - l21 * l21 * d1
    l32 = (m[3, 2] - l30 * m[2, 0] - l31 * l21 * d1) / d2
    d3 = m[3, 3] - l30 * m[3, 0] - l31 * l31 * d1 - l32 * l32 * d2
    y1 = b[1] - l10 * b[0]
    y2 = b[2] - l20 * b[0] - l21 * y1
    y3 = b[3] - l30 * b[0] - l31 * y1 - l32 * y2
    x3 = y3 / d3
    x2 = y2 / d2 - l32 * x3
    x1 = y1 / d1 - l21 * x2 - l31 * x3
    return wp.vec4d(b[0] / d0 - l10 * x1 - l20 * x2 - l30 * x3, x1, x2, x3)


@wp.func
def tangent_point(
    begin: wp.vec3d, p: wp.vec3d, a: wp.vec3d, normal: wp.vec3d, offset: wp.float64
) -> wp.vec3d:
    """Return a point of plane and surface whose tangent passes p, by OpenSim's damped least squares.

    Each round damps until the error no longer falls, then doubles the step until it no longer falls.
    """
    if wp.abs(surface_value(a, p)) < SURFACE:
        return p
    squares = wp.cw_mul(a, a)
    r = wp.vec3d(begin[0], begin[1], begin[2])
    d = real(-2.0) * (surface_value(a, begin) + real(1.0))
    error = tangent_errors(r, d, p, a, normal, offset)
    squared = wp.dot(error, error)
    damping = real(0.01)
    for _ in range(TANGENT_STEPS):
        if not (squared > TANGENT_ERROR):
            break
        gradient = real(2.0) * wp.cw_div(r, squares)
        at_p = real(2.0) * wp.cw_div(p, squares)
        j = wp.matrix_from_rows(
            wp.vec4d(normal[0], gradient[0], real(2.0) * gradient[0], at_p[0]),
            wp.vec4d(normal[1], gradient[1], real(2.0) * gradient[1], at_p[1]),
            wp.vec4d(normal[2], gradient[2], real(2.0) * gradient[2], at_p[2]),
            wp.vec4d(real(0.0), real(0.0), real(1.0), real(1.0)),
        )
        cosine = line_of_sight(p - r, p)
        factor = real(1.0) / real(16.0)
        if cosine > real(0.1):
            factor *= real(1.0) - wp.pow(wp.abs(cosine), real(100.0))
        descent = -(j * error)
        m = j * wp.transpose(j)
        step = wp.vec4d()
        before = real(squared)
        now = real(squared)
        for _search in range(SEARCH_STEPS):
            if not (now >= before):
                break
            step = factor * solved(m + damping * wp.diag(wp.get_diag(m)), descent)
            r += wp.vec3d(step[0], step[1], step[2])
            d += step[3]
            before = now
            error = tangent_errors(r, d, p, a, normal, offset)
            now = wp.dot(error, error)
            damping *= real(4.0)
        damping /= real(8.0)
        reach = real(0.5)
        for _search in range(SEARCH_STEPS):
            if not (now <= before):
                break
            reach *= real(2.0)
            r += reach * wp.vec3d(step[0], step[1], step[2])
            d += reach * step[3]
            before = now
            error = tangent_errors(r, d, p, a, normal, offset)
            now = wp.dot(error, error)
        r -= reach * wp.vec3d(step[0], step[1], step[2])
        d -= reach * step[3]
        error = tangent_errors(r, d, p, a, normal, offset)
        squared = wp.dot(error, error)
    return r


@wp.func
def arc_over(
    first: wp.vec3d,
    last: wp.vec3d,
    a: wp.vec3d,
    normal: wp.vec3d,
    offset: wp.float64,
    scale: wp.float64,
    far: bool,
) -> Arc:
    """Length of the plane's cut with the surface, in rays of equal angles from the cut's centre."""
    arc = Arc()
    chord = wp.length(first - last)
    arc.pieces = wp.min(int(chord / scale / SEGMENT), 499)
    largest = int(0)
    for i in range(1, 3):
        if wp.abs(normal[i]) > wp.abs(normal[largest]):
            largest = i
    centre = wp.vec3d()
    centre[largest] = -offset / normal[largest]
    along, towards = wp.normalize(first - centre), wp.normalize(last - centre)
    opening = wp.acos(wp.clamp(wp.dot(along, towards), real(-1.0), real(1.0)))
    if far:
        opening -= real(2.0) * real(wp.pi)
    across = wp.cross(wp.normalize(wp.cross(along, towards)), along)
    middle = wp.cw_div(centre, a)
    cc = wp.length_sq(middle) - real(1.0)
    before = wp.vec3d(first[0], first[1], first[2])
    arc.second = last
    arc.next_to_last = first
    for i in range(1, wp.max(arc.pieces, 1) + 1):
        point = last
        if i < arc.pieces:
            angle = opening * real(i) / real(arc.pieces)
            ray = wp.cos(angle) * along + wp.sin(angle) * across
            scaled = wp.cw_div(ray, a)
            aa, bb = wp.length_sq(scaled), real(2.0) * wp.dot(scaled, middle)
            root = wp.sqrt(wp.max(bb * bb - real(4.0) * aa * cc, real(0.0)))
            point = centre + ((root - bb) / (real(2.0) * aa)) * ray
        arc.length += wp.length(point - before)
        if i == 1:
            arc.second = point
        arc.next_to_last = before
        before = point
    if chord / scale < SEGMENT:
        arc.length = chord
    return arc


@wp.func
def wrap_ellipsoid(
    start: wp.vec3d, end: wp.vec3d, radii: wp.vec3d, axis: int, sign: int, method: int
) -> Wrap:
    """A path in the plane through both ends and a point of the surface; only lines that intersect wrap."""
    wrap = Wrap()
    wrap.status = NONE
    scale = real(3.0) / (radii[0] + radii[1] + radii[2])
    a, p1, p2 = scale * radii, scale * start, scale * end
    if surface_value(a, p1) < -SURFACE or surface_value(a, p2) < -SURFACE:
        wrap.status = INSIDE
        return wrap
    line = wp.cw_div(p1 - p2, a)
    aa, bb, cc = wp.length_sq(line), real(2.0) * wp.dot(line, wp.cw_div(p2, a)), surface_value(a, p2)
    discriminant = bb * bb - real(4.0) * aa * cc
    if wp.abs(line_of_sight(p1, p2) - real(1.0)) < real(1e-4) or not (discriminant >= real(0.0)):
        return wrap
    root = wp.sqrt(discriminant)
    enter, leave = (-bb + root) / (real(2.0) * aa), (-bb - root) / (real(2.0) * aa)
    if not (enter > real(0.0) and enter < real(1.0) and leave > real(0.0) and leave < real(1.0)):
        return wrap
    wrap.status = MANDATORY
    plane = plane_point(p1 - p2, p2 + enter * (p1 - p2), p2 + leave * (p1 - p2), a, method)
    if sign != 0 and not on_side(plane.point[axis], sign):
        mirror = wp.vec3d(real(1.0), real(1.0), real(1.0))
        mirror[axis] = real(-1.0)
        plane.point = wp.cw_mul(mirror, plane.point)
        plane.begin1 = plane.point
        plane.begin2 = plane.point
        if plane.fan > real(0.0):  # halfway between a coordinate and its mirror image is 0
            mirror[axis] = real(1.0) - plane.fan
            plane.point = nearest_on_ellipsoid(a, wp.cw_mul(mirror, plane.point))
    normal = wp.normalize(wp.cross(p1 - p2, p1 - plane.point))
    offset = -wp.dot(normal, plane.point)
    first = tangent_point(plane.begin1, p1, a, normal, offset)
    last = tangent_point(plane.begin2, p2, a, normal, offset)
    arc = arc_over(first, last, a, normal, offset, scale, False)
    length = arc.length
    if sign != 0 and arc.pieces > 1:
        back = wp.dot(p1 - first, arc.second - first) > real(0.0)
        if back or wp.dot(p2 - last, arc.next_to_last - last) > real(0.0):
            other_way = arc_over(first, last, a, normal, offset, scale, True)
            length = other_way.length
    wrap.first = first / scale
    wrap.last = last / scale
    wrap.length = length / scale
    return wrap
