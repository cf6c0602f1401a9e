"""Overlap of two bodies that touch: half spaces, spheres and ellipsoids.

Of each pair: how deep, midway between the surfaces, along which normal, and how round both are there, as one
sphere of the radius R on a plane would be.

    half space and sphere       d = r - (c - o) . n                  R = r
    two spheres                 d = r1 + r2 - |c2 - c1|              R = r1 r2 / (r1 + r2)
    half space and ellipsoid    d = o . n - (c . n - h(n))           R = det(A over the plane)^(-1/4)
    ellipsoids                  d = least over n of h1(n) + h2(n) - (c2 - c1) . n,
                                R = det(K1 + K2)^(-1/2), K the curvatures at the points p = c +- B n / h

A = diag(1 / a^2) and B = diag(a^2) of half axes a, turned into ground; h(n) = sqrt(n . B n) is how far an
ellipsoid reaches along n.

Source: Simbody, class CollisionDetectionAlgorithm. It searches the points of two ellipsoids; here the
normal is searched by Newton's method, with the same points.
"""

import warp as wp

HALF_SPACE, SPHERE, ELLIPSOID = 0, 1, 2

NEWTON_STEPS = wp.constant(20)
"""Of the normal between two ellipsoids; it stops once a step is rounding."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class Overlap:
    """Overlap of two bodies.

    Attributes:
        depth: [m], below 0 where they are apart.
        location: Midway between the surfaces [m], in ground.
        normal: Out of the first body, into the second.
        radius: Of a sphere that is as round on a plane [m].
    """

    depth: wp.float64
    location: wp.vec3d
    normal: wp.vec3d
    radius: wp.float64


@wp.func
def sphere_in_half_space(rotation: wp.mat33d, origin: wp.vec3d, center: wp.vec3d, radius: wp.float64):
    """Return the overlap of a half space, which is where its x is above 0, and a sphere."""
    found = Overlap()
    found.normal = -wp.vec3d(rotation[0, 0], rotation[1, 0], rotation[2, 0])
    found.depth = radius - wp.dot(center - origin, found.normal)
    found.location = center - (radius - wp.float64(0.5) * found.depth) * found.normal
    found.radius = radius
    return found


@wp.func
def spheres(first: wp.vec3d, first_radius: wp.float64, second: wp.vec3d, second_radius: wp.float64):
    """Return the overlap of two spheres; of those with one centre, none."""
    found = Overlap()
    between = wp.length(second - first)
    found.depth = wp.where(
        between > wp.float64(0.0), first_radius + second_radius - between, wp.float64(-1.0)
    )
    found.normal = wp.normalize(second - first)
    found.location = first + (first_radius - wp.float64(0.5) * found.depth) * found.normal
    found.radius = first_radius * second_radius / (first_radius + second_radius)
    return found


@wp.func
def squared(rotation: wp.mat33d, size: wp.vec3d) -> wp.mat33d:
    """B of an ellipsoid [m^2], in ground."""
    return rotation * wp.diag(wp.cw_mul(size, size)) * wp.transpose(rotation)


@wp.func
def across(normal: wp.vec3d) -> wp.mat33d:
    """Return two unit vectors across a normal, and the normal, as columns."""
    one, zero = wp.float64(1.0), wp.float64(0.0)
    helper = wp.where(
        wp.abs(normal[0]) < wp.float64(0.5), wp.vec3d(one, zero, zero), wp.vec3d(zero, one, zero)
    )
    u = wp.normalize(wp.cross(normal, helper))
    return wp.matrix_from_cols(u, wp.cross(normal, u), normal)


@wp.func
def over_plane(matrix: wp.mat33d, axes: wp.mat33d) -> wp.mat22d:
    """Return a matrix over the plane of the first two axes."""
    turned = wp.transpose(axes) * matrix * axes
    return wp.mat22d(turned[0, 0], turned[0, 1], turned[1, 0], turned[1, 1])


@wp.func
def ellipsoid_in_half_space(
    plane: wp.mat33d, origin: wp.vec3d, rotation: wp.mat33d, center: wp.vec3d, size: wp.vec3d
):
    """Return the overlap of a half space, which is where its x is above 0, and an ellipsoid."""
    found = Overlap()
    found.normal = -wp.vec3d(plane[0, 0], plane[1, 0], plane[2, 0])
    one = wp.float64(1.0)
    reach = squared(rotation, size) * found.normal
    deepest = center - reach / wp.sqrt(wp.dot(found.normal, reach))
    found.depth = wp.dot(origin - deepest, found.normal)
    found.location = deepest + wp.float64(0.5) * found.depth * found.normal
    inverse = squared(rotation, wp.vec3d(one / size[0], one / size[1], one / size[2]))
    found.radius = wp.pow(wp.determinant(over_plane(inverse, across(found.normal))), wp.float64(-0.25))
    return found


@wp.func
def bending(B: wp.mat33d, normal: wp.vec3d) -> wp.mat33d:
    """Second derivative of h(n) = sqrt(n . B n); over the tangents it is the inverse of the curvatures."""
    reach = B * normal
    height = wp.sqrt(wp.dot(normal, reach))
    return B / height - wp.outer(reach, reach) / (height * height * height)


@wp.func
def ellipsoids(
    first_rotation: wp.mat33d,
    first: wp.vec3d,
    first_size: wp.vec3d,
    second_rotation: wp.mat33d,
    second: wp.vec3d,
    second_size: wp.vec3d,
):
    """Return the overlap of two ellipsoids; of those with one centre, none."""
    found = Overlap()
    found.depth = wp.float64(-1.0)
    apart = second - first
    one = wp.float64(1.0)
    if wp.length(apart) == wp.float64(0.0):
        return found
    B, C = squared(first_rotation, first_size), squared(second_rotation, second_size)
    # Spheres of the greatest half axes are apart: so are the ellipsoids.
    if wp.length(apart) > wp.max(first_size) + wp.max(second_size):
        return found
    normal = wp.normalize(apart)
    axes = across(normal)
    for _ in range(NEWTON_STEPS):
        axes = across(normal)
        reach, far = B * normal, C * normal
        out = reach / wp.sqrt(wp.dot(normal, reach)) + far / wp.sqrt(wp.dot(normal, far)) - apart
        slope = wp.vec2d(
            wp.dot(wp.vec3d(axes[0, 0], axes[1, 0], axes[2, 0]), out),
            wp.dot(wp.vec3d(axes[0, 1], axes[1, 1], axes[2, 1]), out),
        )
        bend = over_plane(bending(B, normal) + bending(C, normal), axes)
        # Along the sphere of normals; kept convex, so that the step goes downhill.
        bend = bend - wp.max(wp.dot(normal, out), wp.float64(0.0)) * wp.diag(wp.vec2d(one, one))
        if wp.determinant(bend) <= wp.float64(0.0) or bend[0, 0] <= wp.float64(0.0):
            bend = over_plane(bending(B, normal) + bending(C, normal), axes)
        move = wp.inverse(bend) * slope
        longest = wp.max(wp.length(move) / wp.float64(0.5), one)
        normal = wp.normalize(
            normal
            - wp.vec3d(axes[0, 0], axes[1, 0], axes[2, 0]) * (move[0] / longest)
            - wp.vec3d(axes[0, 1], axes[1, 1], axes[2, 1]) * (move[1] / longest)
        )
        if wp.length(move) < wp.float64(1e-13):
            break
    reach, far = B * normal, C * normal
    begin = first + reach / wp.sqrt(wp.dot(normal, reach))
    end = second - far / wp.sqrt(wp.dot(normal, far))
    axes = across(normal)
    curved = wp.inverse(over_plane(bending(B, normal), axes)) + wp.inverse(
        over_plane(bending(C, normal), axes)
    )
    found.depth = wp.dot(begin - end, normal)
    found.normal = normal
    found.location = wp.float64(0.5) * (begin + end)
    found.radius = wp.pow(wp.determinant(curved), wp.float64(-0.5))
    return found
