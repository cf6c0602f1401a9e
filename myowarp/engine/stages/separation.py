"""Signed distance of ellipsoids to spheres, capsules and ellipsoids by the support function.

The signed distance of two convex bodies at c_1 and c_2 is

    d = max over unit n of f(n),    f(n) = n . (c_2 - c_1) - h_1(n) - h_2(n),

with the support functions h(n) = sqrt(n' E n) of an ellipsoid, E = R diag(size^2) R', and r + L |a . n| of a
capsule along a. The maximum is the contact normal, from the first body to the second; its support
points are the witness points. One formula serves bodies apart and bodies in each other, and Newton's method
on the sphere needs three to six steps to float32's precision, where the engine's polytope expansion in
float32 loses contacts deep inside or close to the margin.

Source: R. Schneider, Convex Bodies: The Brunn-Minkowski Theory, 1.7 (support function of a Minkowski sum);
P.-A. Absil, R. Mahony, R. Sepulchre, Optimization Algorithms on Matrix Manifolds, 6.2 (Newton on the sphere).
"""

import warp as wp

MAX_STEPS = wp.constant(40)
MAX_HALVINGS = wp.constant(6)
LONGEST_STEP = wp.constant(0.5)  # rad
CONVERGED = wp.constant(1e-4)  # rad; the next error is its square
FAR = wp.constant(1e10)  # m
LEAST_CURVATURE = wp.constant(1e-3)  # of the bodies' size; the Hessian is lifted to it


@wp.struct
class Bodies:
    """Two bodies, of which f(n) tells the signed distance.

    Attributes:
        p: From the first center to the second [m].
        start: Unit vector from which the search begins.
        e1: E of the first ellipsoid [m^2]; 0 for a point.
        e2: E of the second.
        rotation1: Axes of the first ellipsoid; those of the second beside a point.
        rotation2: Axes of the second.
        axis: n is sought on the circle across this unit vector; 0: on the whole sphere.
        roundness: Least radius of curvature of the bodies' Minkowski sum [m].
        cutoff: Distance [m] beyond which the bodies do not touch.
    """

    p: wp.vec3
    start: wp.vec3
    e1: wp.mat33
    e2: wp.mat33
    rotation1: wp.mat33
    rotation2: wp.mat33
    axis: wp.vec3
    roundness: float
    cutoff: float


@wp.struct
class Reach:
    """An ellipsoid where it reaches farthest along n.

    Attributes:
        s: Support point [m].
        uu: u' (d2h/dn2) u [m] for the first of two tangents u, v.
        uv: u' (d2h/dn2) v.
        vv: v' (d2h/dn2) v.
    """

    s: wp.vec3
    uu: float
    uv: float
    vv: float


@wp.struct
class Touch:
    """Two bodies at their closest, or at their least overlap.

    Attributes:
        dist: Signed distance [m], negative inside; beyond the cutoff a lower bound.
        normal: From the first body to the second.
        pos: Midpoint of the witness points [m].
    """

    dist: float
    normal: wp.vec3
    pos: wp.vec3


@wp.func
def ellipsoid_matrix(size: wp.vec3, rotation: wp.mat33) -> wp.mat33:
    """E = R diag(size^2) R' [m^2]."""
    scaled = rotation @ wp.diag(size)
    return scaled @ wp.transpose(scaled)


@wp.func
def roundness(size: wp.vec3) -> float:
    """Least radius of curvature of an ellipsoid [m]: least semi-axis squared over the greatest."""
    return wp.min(size) * wp.min(size) / wp.max(size)


@wp.func
def support(e: wp.mat33, n: wp.vec3) -> float:
    """h(n) = sqrt(n' E n) [m]; 0 for a point, E = 0."""
    return wp.sqrt(wp.max(wp.dot(n, e @ n), 0.0))


@wp.func
def support_point(e: wp.mat33, n: wp.vec3) -> wp.vec3:
    """s(n) = E n / h(n) [m], where the body reaches farthest along n."""
    return e @ n / wp.max(support(e, n), 1e-12)


@wp.func
def separation(bodies: Bodies, n: wp.vec3) -> float:
    """f(n) = n . p - h_1(n) - h_2(n) [m]."""
    return wp.dot(n, bodies.p) - support(bodies.e1, n) - support(bodies.e2, n)


@wp.func
def reach(e: wp.mat33, n: wp.vec3, u: wp.vec3, v: wp.vec3) -> Reach:
    """s = E n / h;  u' (d2h/dn2) v = (u' E v - (u . s)(v . s)) / h [m], the inverse of a curvature."""
    found = Reach()
    if e[0, 0] == 0.0:
        return found
    inverse = 1.0 / wp.max(support(e, n), 1e-12)
    found.s = inverse * (e @ n)
    eu, ev = e @ u, e @ v
    us, vs = wp.dot(u, found.s), wp.dot(v, found.s)
    found.uu = inverse * (wp.dot(u, eu) - us * us)
    found.uv = inverse * (wp.dot(v, eu) - us * vs)
    found.vv = inverse * (wp.dot(v, ev) - vs * vs)
    return found


@wp.func
def any_across(axis: wp.vec3) -> wp.vec3:
    """Return a unit vector normal to `axis`."""
    helper = wp.where(wp.abs(axis[0]) < 0.6, wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0))
    return wp.normalize(wp.cross(axis, helper))


@wp.func
def across(n: wp.vec3, axis: wp.vec3) -> wp.vec3:
    """Return n made unit and normal to `axis`, if that is not 0."""
    part = n - wp.dot(n, axis) * axis
    if wp.length_sq(part) > 1e-12:
        return wp.normalize(part)
    return any_across(axis)


@wp.func
def newton_step(bodies: Bodies, n: wp.vec3, level: float) -> wp.vec3:
    """Return Newton's step on the sphere or the circle, tangent to it at n, where f = `level`.

    grad f = p - s_1 - s_2;  -Hess f = d2h_1 + d2h_2 + f I on the tangent plane, lifted to be positive.
    """
    on_circle = wp.length_sq(bodies.axis) > 0.0
    u = wp.where(on_circle, wp.cross(bodies.axis, n), any_across(n))
    v = wp.cross(n, u)
    first, second = reach(bodies.e1, n, u, v), reach(bodies.e2, n, u, v)
    gradient = bodies.p - first.s - second.s
    least = LEAST_CURVATURE * (wp.abs(level) + wp.dot(n, second.s))
    huu, gu = first.uu + second.uu + level, wp.dot(u, gradient)
    if on_circle:
        return u * (gu / wp.max(huu, least))
    hvv, gv = first.vv + second.vv + level, wp.dot(v, gradient)
    huv = first.uv + second.uv
    half = 0.5 * (huu - hvv)
    lowest = 0.5 * (huu + hvv) - wp.sqrt(half * half + huv * huv)
    lift = wp.max(least - lowest, 0.0)
    huu, hvv = huu + lift, hvv + lift
    return (u * (hvv * gu - huv * gv) + v * (huu * gv - huv * gu)) / (huu * hvv - huv * huv)


@wp.func
def climb(bodies: Bodies, start: wp.vec3) -> wp.vec3:
    """Return the n at which f has a maximum, uphill from `start`, or one on the way with f > cutoff."""
    n, level = start, separation(bodies, start)
    for _ in range(MAX_STEPS):
        if level > bodies.cutoff:
            return n
        step = newton_step(bodies, n, level)
        angle = wp.length(step)
        step *= wp.min(1.0, LONGEST_STEP / wp.max(angle, 1e-12))
        uphill = wp.normalize(n + step)
        if angle < CONVERGED:
            return uphill
        value = separation(bodies, uphill)
        for _half in range(MAX_HALVINGS):
            if value >= level:
                break
            step *= 0.5
            uphill = wp.normalize(n + step)
            value = separation(bodies, uphill)
        n, level = uphill, value
    return n


@wp.func
def ellipsoid_axis(bodies: Bodies, k: int, towards: wp.vec3) -> wp.vec3:
    """Return the k-th of the six axes of both ellipsoids, pointing `towards` a direction."""
    rotation = wp.where(k < 3, bodies.rotation2, bodies.rotation1)
    column = wp.vec3(rotation[0, k % 3], rotation[1, k % 3], rotation[2, k % 3])
    return across(wp.where(wp.dot(column, towards) < 0.0, -column, column), bodies.axis)


@wp.func
def separating_normal(bodies: Bodies) -> wp.vec3:
    """Return argmax f(n).

    Bodies apart have one maximum. Bodies in each other have several, near their axes: each is climbed. One
    less deep than the bodies are round is the highest: a ball of that radius rolls within their sum.
    """
    best = climb(bodies, across(bodies.start, bodies.axis))
    if separation(bodies, best) < -bodies.roundness:
        for k in range(wp.where(bodies.e1[0, 0] == 0.0, 3, 6)):
            other = climb(bodies, ellipsoid_axis(bodies, k, bodies.p))
            if separation(bodies, other) > separation(bodies, best):
                best = other
    return best


@wp.func
def capsule_normal(bodies: Bodies, axis: wp.vec3, half: float) -> tuple[wp.vec3, float]:
    """Return argmax of f(n) - half |a . n|, the first body being a segment, and what touches.

    That has a ridge at the segment's side, a . n = 0; off the ridge the segment is its end on n's side. Side
    is 0, an end is 1 or -1: rounding alone takes n off the ridge.
    """
    end = bodies
    end.axis = wp.vec3(0.0)
    bodies.axis = axis
    n, level = wp.vec3(bodies.start), float(-FAR)
    for k in range(2):
        if k == 1:
            n = separating_normal(bodies)
            level = separation(bodies, n)
        t = wp.dot(axis, bodies.p - support_point(bodies.e2, n))
        if level > bodies.cutoff or (level >= -bodies.roundness and wp.abs(t) <= half):
            return n, 0.0
        if wp.abs(t) > half:
            end.p = bodies.p - wp.sign(t) * half * axis
            other = climb(end, n)
            if separation(end, other) >= -bodies.roundness and wp.dot(axis, other) * t > 0.0:
                return other, wp.sign(t)
    side = float(0.0)
    for k in range(6):
        tip = wp.where(k < 3, half, -half) * axis
        end.p = bodies.p - tip
        other = climb(end, ellipsoid_axis(end, k % 3, tip))
        value = separation(end, other) + wp.dot(other, tip) - half * wp.abs(wp.dot(axis, other))
        if value > level:
            n, level, side = other, value, wp.where(k < 3, 1.0, -1.0)
    return n, side


@wp.func
def capsule_touch(bodies: Bodies, c1: wp.vec3, axis: wp.vec3, radius: float, half: float) -> Touch:
    """Contact of a sphere (half = 0) or a capsule, at c1 along `axis`, and an ellipsoid."""
    bodies.cutoff += radius
    n, end = wp.normalize(bodies.p), float(0.0)
    if half == 0.0:
        n = separating_normal(bodies)
    elif separation(bodies, n) - half * wp.abs(wp.dot(axis, n)) <= bodies.cutoff:
        n, end = capsule_normal(bodies, axis, half)
    else:
        end = wp.sign(wp.dot(axis, n))
    far = bodies.p - support_point(bodies.e2, n)
    t = wp.where(end == 0.0, wp.clamp(wp.dot(axis, far), -half, half), end * half)
    touch = Touch()
    touch.normal = n
    touch.dist = separation(bodies, n) - end * half * wp.dot(axis, n) - radius
    touch.pos = c1 + 0.5 * (t * axis + radius * n + far)
    return touch


@wp.func
def ellipsoid_touch(bodies: Bodies, c1: wp.vec3) -> Touch:
    """Contact of two ellipsoids, the first at c1."""
    n = separating_normal(bodies)
    touch = Touch()
    touch.normal = n
    touch.dist = separation(bodies, n)
    touch.pos = c1 + 0.5 * (support_point(bodies.e1, n) + bodies.p - support_point(bodies.e2, n))
    return touch
