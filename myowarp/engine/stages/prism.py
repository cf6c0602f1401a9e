"""Signed distance of spheres, capsules and ellipsoids to a column of a height field.

A height field is a grid of triangles, each on top of a prism that goes down to the field's base. Prism and
body are convex, so that their signed distance is the largest separation along any unit n,

    d = max over n of f(n),    f(n) = -h_A(n) - h(n),    h(n) = sqrt(n' E n) + L |a . n| + r,

seen from the body's center, with the support functions h_A of the prism and h of an ellipsoid E, a segment of
half length L along a and a ball of radius r around it (see `separation`). Apart or in each other, n is the
normal of a face, or belongs to an edge or a corner, where n is sought for that edge or corner alone. MuJoCo C
finds the same contact, one a prism, by GJK and EPA (documentation, Computation, "Collision detection").

As there, each prism is taken for itself: a body that is deep below the ground, beside the border of a prism,
may be pushed sideways. Edges of the base are left out, which only a body below the ground can touch. Where
the ground is below the base there is no convex body to search; h_A is then that of the top for n upwards, as
if the base were deeper. MuJoCo's search may begin with a corner of the base there, and then finds a face
through it that is above the ground.
"""

import warp as wp

from myowarp.engine.stages.separation import Bodies, Touch, across, climb, support

FAR = wp.constant(1e10)  # m
NEAR = wp.constant(1e-7)  # m, points that are nearer than this have no direction
UP = wp.constant(wp.vec3(0.0, 0.0, 1.0))


@wp.struct
class Solid:
    """A sphere, capsule or ellipsoid at the origin: h(n) = sqrt(n' E n) + half |axis . n| + radius."""

    e: wp.mat33
    axis: wp.vec3
    half: float
    radius: float


@wp.struct
class Prism:
    """A column of the ground, seen from a body's center.

    Attributes:
        top: Corners of the triangle on top in rows, counterclockwise from above [m].
        bottom: Height of the base [m].
    """

    top: wp.mat33
    bottom: float


@wp.func
def extent(solid: Solid, n: wp.vec3) -> float:
    """h(n) of a body [m]."""
    return support(solid.e, n) + solid.half * wp.abs(wp.dot(solid.axis, n)) + solid.radius


@wp.func
def prism_extent(prism: Prism, n: wp.vec3) -> float:
    """h_A(n) of a prism [m]: of its top where n points up, of its base otherwise."""
    farthest = float(-FAR)
    for k in range(3):
        height = wp.where(n[2] < 0.0, prism.bottom, prism.top[k, 2])
        farthest = wp.max(farthest, n[0] * prism.top[k, 0] + n[1] * prism.top[k, 1] + n[2] * height)
    return farthest


@wp.func
def offered(touch: Touch, solid: Solid, prism: Prism, n: wp.vec3, core: wp.vec3) -> Touch:
    """Return the touch with the larger f, that so far or that along n; `core` is the body's point inside."""
    dist = -prism_extent(prism, n) - extent(solid, n)
    if dist > touch.dist:
        touch.dist = dist
        touch.normal = n
        touch.pos = core - (solid.radius + 0.5 * dist) * n
    return touch


@wp.func
def lowest(solid: Solid, n: wp.vec3) -> wp.vec3:
    """Return the point of the ellipsoid, or of the segment, that is lowest along n."""
    half = wp.where(wp.dot(solid.axis, n) < 0.0, -solid.half, solid.half)
    return -(solid.e @ n) / wp.max(support(solid.e, n), 1e-12) - half * solid.axis


@wp.func
def side_normal(prism: Prism, k: int) -> wp.vec3:
    """Return the outward normal of the side from corner k to the next."""
    edge = prism.top[(k + 1) % 3] - prism.top[k]
    return wp.normalize(wp.vec3(edge[1], -edge[0], 0.0))


@wp.func
def lowest_above(solid: Solid, prism: Prism, n: wp.vec3) -> wp.vec3:
    """Return the lowest point along n of the part of the segment that is above the triangle.

    Where the segment is parallel to the triangle, the whole of it is lowest.
    """
    first, last = -float(solid.half), float(solid.half)
    for k in range(3):
        out = wp.cross(prism.top[(k + 1) % 3] - prism.top[k], n)
        start, slope = wp.dot(out, prism.top[k]), wp.dot(out, solid.axis)
        if slope > 0.0:
            last = wp.min(last, start / slope)
        elif slope < 0.0:
            first = wp.max(first, start / slope)
    if first > last:
        return lowest(solid, n)
    return wp.where(wp.dot(solid.axis, n) < 0.0, last, first) * solid.axis


@wp.func
def closest_on_segment(solid: Solid, start: wp.vec3, edge: wp.vec3) -> tuple[float, float]:
    """Return t and s at which |t axis - (start + s edge)| is least, t within the segment, s from 0 to 1.

    Source: C. Ericson, Real-Time Collision Detection (2005), 5.1.9.
    """
    length, along = wp.dot(edge, edge), wp.dot(solid.axis, edge)
    a, b = wp.dot(solid.axis, start), wp.dot(edge, start)
    room = length - along * along
    t = float(0.0)
    if room > 1e-6 * length:
        t = wp.clamp((a * length - b * along) / room, -solid.half, solid.half)
    s = (t * along - b) / wp.max(length, 1e-12)
    if s < 0.0 or s > 1.0:
        s = wp.clamp(s, 0.0, 1.0)
        t = wp.clamp(a + s * along, -solid.half, solid.half)
    return t, s


@wp.func
def segment_at_edge(touch: Touch, solid: Solid, prism: Prism, start: wp.vec3, edge: wp.vec3) -> Touch:
    """n = +-(p - q): where a capsule's segment and an edge are closest, from outside and from inside."""
    t, s = closest_on_segment(solid, start, edge)
    apart = t * solid.axis - start - s * edge
    if wp.length(apart) > NEAR:
        n = wp.normalize(apart)
        touch = offered(touch, solid, prism, n, t * solid.axis)
        touch = offered(touch, solid, prism, -n, t * solid.axis)
    return touch


@wp.func
def climbed(solid: Solid, corner: wp.vec3, axis: wp.vec3, start: wp.vec3) -> wp.vec3:
    """n = argmax of -n . corner - sqrt(n' E n), across an edge's axis, or of a corner alone, axis 0."""
    bodies = Bodies()
    bodies.p = -corner
    bodies.e2 = solid.e
    bodies.axis = axis
    bodies.cutoff = FAR
    return climb(bodies, start)


@wp.func
def ellipsoid_at_corner(touch: Touch, solid: Solid, prism: Prism, corner: wp.vec3, start: wp.vec3) -> Touch:
    """An ellipsoid at a corner of the top, uphill from a normal."""
    normal = climbed(solid, corner, wp.vec3(0.0), start)
    return offered(touch, solid, prism, normal, lowest(solid, normal))


@wp.func
def ellipsoid_at_edge(touch: Touch, solid: Solid, prism: Prism, k: int, n: wp.vec3) -> Touch:
    """An ellipsoid at the edge from corner k of the top to the next, or at one of them.

    It is there where its lowest point along the normal of one of both faces is beyond the edge.
    """
    start, side = prism.top[k], side_normal(prism, k)
    edge = prism.top[(k + 1) % 3] - start
    normal = wp.vec3(0.0)
    if wp.dot(wp.cross(edge, n), lowest(solid, n) - start) > 0.0:
        normal += n
    if wp.dot(wp.cross(side, edge), lowest(solid, side) - start) > 0.0:
        normal += side
    if wp.length_sq(normal) == 0.0:
        return touch
    axis = wp.normalize(edge)
    normal = climbed(solid, start, axis, across(normal, axis))
    core = lowest(solid, normal)
    touch = offered(touch, solid, prism, normal, core)
    place = wp.dot(core - start, edge) / wp.dot(edge, edge)
    if place < 0.0:
        touch = ellipsoid_at_corner(touch, solid, prism, start, normal)
    if place > 1.0:
        touch = ellipsoid_at_corner(touch, solid, prism, start + edge, normal)
    return touch


@wp.func
def ellipsoid_at_pillar(touch: Touch, solid: Solid, prism: Prism, k: int) -> Touch:
    """An ellipsoid at the vertical edge below corner k, if it reaches around it from both sides."""
    one, two = side_normal(prism, (k + 2) % 3), side_normal(prism, k)
    before, after = lowest(solid, one) - prism.top[k], lowest(solid, two) - prism.top[k]
    if wp.dot(two, before) > 0.0 and wp.dot(one, after) > 0.0:
        normal = climbed(solid, prism.top[k], UP, across(one + two, UP))
        core = lowest(solid, normal)
        touch = offered(touch, solid, prism, normal, core)
        if core[2] > prism.top[k, 2]:
            touch = ellipsoid_at_corner(touch, solid, prism, prism.top[k], normal)
    return touch


@wp.func
def prism_touch(solid: Solid, prism: Prism, cutoff: float) -> Touch:
    """Return the closest points of a body and a prism; beyond the cutoff a bound will do."""
    touch = Touch()
    touch.dist = -FAR
    n = wp.normalize(wp.cross(prism.top[1] - prism.top[0], prism.top[2] - prism.top[0]))
    core = lowest(solid, n)
    touch = offered(touch, solid, prism, n, wp.where(solid.half > 0.0, lowest_above(solid, prism, n), core))
    for k in range(3):
        side = side_normal(prism, k)
        touch = offered(touch, solid, prism, side, lowest(solid, side))
    touch = offered(touch, solid, prism, -UP, lowest(solid, -UP))
    if touch.dist >= cutoff:
        return touch
    for k in range(3):
        corner, edge = prism.top[k], prism.top[(k + 1) % 3] - prism.top[k]
        if solid.e[0, 0] == 0.0:
            touch = segment_at_edge(touch, solid, prism, corner, edge)
            pillar = wp.vec3(0.0, 0.0, prism.bottom - corner[2])
            touch = segment_at_edge(touch, solid, prism, corner, pillar)
        else:
            touch = ellipsoid_at_edge(touch, solid, prism, k, n)
            touch = ellipsoid_at_pillar(touch, solid, prism, k)
    return touch
