"""Segments of a tendon that bend round a sphere or a cylinder (MuJoCo's documentation, *Wrapping geometry*).

All is done in world axes, relative to the centre of the geom. On the plane through both ends of the segment
and the centre, on a cylinder the plane across its axis, the path runs straight to the circle of radius r,
along it, and straight on. With an end e, the normal n of the plane and the sense of turn s = 1 or -1 it
leaves the first end, and reaches the last, along

    u = (s r n x e - t e) / e^2,    u = (s r n x e + t e) / e^2,    t = sqrt(e^2 - r^2)

where t is the length of the straight piece, and the arc is the angle between both u. Without a side site it
bends only where the straight segment would cut the circle, the short way round. A side site says on which
side the path passes: MuJoCo 4 compares the winding angle of the path over the side site with that of the
straight segment. They differ exactly if the triangle of ends and side site holds the centre, which is three
signs of cross products, and the path then winds as the side site does. So only a path that bends costs
an arc tangent. A side site inside the geom makes the path pass through it and touch it where it is shortest.
Where ends all but lie on the surface, finding that point is left to mujoco-warp.
"""

import warp as wp
from mujoco_warp._src.util_misc import wrap_inside

STRAIGHT = wp.constant(0)
SPHERE = wp.constant(1)
CYLINDER = wp.constant(2)

NEWTON_STEPS = wp.constant(8)
STILL = wp.constant(3e-4)  # rad, after which a step of Newton's leaves what float32 cannot see
TINY = wp.constant(1e-15)
"""mjMINVAL: MuJoCo takes shorter vectors as zero."""


@wp.struct
class Bend:
    """A segment that bends.

    Attributes:
        length: Its length [m], < 0 where it stays straight.
        onto: Direction in which it leaves the near site.
        off: Direction in which it reaches the far site.
    """

    length: float
    onto: wp.vec3
    off: wp.vec3


@wp.func
def unit(vector: wp.vec3, length: float) -> wp.vec3:
    """Return vector / length, (1, 0, 0) for a zero vector as MuJoCo does."""
    if length < TINY:
        return wp.vec3(1.0, 0.0, 0.0)
    return vector / length


@wp.func
def sphere_normal(near: wp.vec3, far: wp.vec3) -> wp.vec3:
    """Return the normal of the plane through two points and the centre; of any one if these are in line."""
    normal = wp.cross(near, wp.cross(wp.cross(near, far), near))  # square to `near` in spite of rounding
    length = wp.length(normal)
    if length == 0.0:
        other = wp.where(wp.abs(near[0]) < wp.abs(near[1]), wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0))
        normal = wp.cross(near, other)
        length = wp.length(normal)
    return normal / wp.max(length, TINY * TINY)


@wp.func
def bend_outside(
    near: wp.vec3, far: wp.vec3, normal: wp.vec3, side: wp.vec3, has_side: bool, radius: float
) -> Bend:
    """Bend round a circle, in its plane."""
    bend = Bend()
    bend.length = -1.0
    near2, far2, radius2 = wp.dot(near, near), wp.dot(far, far), radius * radius
    step = far - near
    step2 = wp.dot(step, step)
    if near2 < radius2 or far2 < radius2 or radius < TINY or step2 < TINY:
        return bend
    turn = wp.dot(normal, wp.cross(near, step))
    encloses = bool(False)
    if has_side:
        to_side = wp.dot(normal, wp.cross(near, side))
        from_side = wp.dot(normal, wp.cross(side, far))
        encloses = (to_side > 0.0 and from_side > 0.0 and turn <= 0.0) or (
            to_side < 0.0 and from_side < 0.0 and turn >= 0.0
        )
        if encloses:
            turn = to_side
    if not encloses:
        along = -wp.dot(step, near)
        if along <= 0.0 or along >= step2 or turn * turn > radius2 * step2:
            return bend
    sign = wp.where(turn < 0.0, -1.0, 1.0)
    near_tangent, far_tangent = wp.sqrt(near2 - radius2), wp.sqrt(far2 - radius2)
    bend.onto = (sign * radius * wp.cross(normal, near) - near_tangent * near) / near2
    bend.off = (sign * radius * wp.cross(normal, far) + far_tangent * far) / far2
    arc = wp.atan2(sign * wp.dot(normal, wp.cross(bend.onto, bend.off)), wp.dot(bend.onto, bend.off))
    if arc < 0.0:
        if not encloses:
            return bend
        arc += 2.0 * wp.pi
    bend.length = near_tangent + radius * arc + far_tangent
    return bend


@wp.func
def lean(end: wp.vec2, point: wp.vec2, along: wp.vec2) -> wp.vec2:
    """Return -d|end - point| / dangle and its derivative, for a point of the unit circle that moves along."""
    inverse = 1.0 / wp.length(end - point)
    slope = inverse * wp.dot(along, end)
    return wp.vec2(slope, inverse * (slope * slope - wp.dot(point, end)))


@wp.func
def touch_inside(near: wp.vec2, far: wp.vec2, start: wp.vec2) -> wp.vec2:
    """Return the point of the unit circle over which two ends are closest, by Newton's method.

    The way over a point is convex in its angle as long as both ends see it, as they do from the point
    nearest to the segment between them, the start.
    """
    point = wp.normalize(start)
    for _ in range(NEWTON_STEPS):
        along = wp.vec2(-point[1], point[0])
        total = lean(near, point, along) + lean(far, point, along)
        turn = total[0] / wp.max(-total[1], TINY)
        half = 0.5 * wp.clamp(turn, -1.0, 1.0)  # of the tangent: a rotation without a root
        point = ((1.0 - half * half) * point + 2.0 * half * along) / (1.0 + half * half)
        if wp.abs(turn) < STILL:
            return point
    _arc, found, _same = wrap_inside(wp.vec4(near[0], near[1], far[0], far[1]), 1.0)
    return found


@wp.func
def bend_inside(near: wp.vec3, far: wp.vec3, normal: wp.vec3, radius: float) -> Bend:
    """Bend over the inside of a circle, in its plane; straight where the segment cuts the circle."""
    bend = Bend()
    bend.length = -1.0
    distance = wp.length(near)
    if radius < TINY or distance <= radius or wp.length_sq(far) <= radius * radius:
        return bend
    first = near / distance
    second = wp.cross(normal, first)
    near_end = wp.vec2(distance / radius, 0.0)
    far_end = wp.vec2(wp.dot(far, first), wp.dot(far, second)) / radius
    step = far_end - near_end
    share = wp.clamp(-wp.dot(near_end, step) / wp.max(wp.length_sq(step), TINY), 0.0, 1.0)
    nearest = near_end + share * step
    if wp.length_sq(nearest) <= 1.0:
        return bend
    point = radius * touch_inside(near_end, far_end, nearest)
    touch = point[0] * first + point[1] * second
    onto, off = touch - near, far - touch
    onto_length, off_length = wp.length(onto), wp.length(off)
    bend.length = onto_length + off_length
    bend.onto = unit(onto, onto_length)
    bend.off = unit(off, off_length)
    return bend


@wp.func
def bend_round(
    kind: int, near: wp.vec3, far: wp.vec3, axis: wp.vec3, side: wp.vec3, has_side: bool, radius: float
) -> Bend:
    """Bend round a geom; points relative to its centre, `axis` is the cylinder's."""
    flat_near, flat_far, rise = near, far, float(0.0)
    if kind == CYLINDER:
        low, high = wp.dot(near, axis), wp.dot(far, axis)
        flat_near, flat_far, rise = near - low * axis, far - high * axis, high - low
        normal = axis
    else:
        normal = sphere_normal(near, far)
    if has_side and wp.length_sq(side) < radius * radius:
        bend = bend_inside(flat_near, flat_far, normal, radius)
    else:
        bend = bend_outside(flat_near, flat_far, normal, side, has_side, radius)
    if bend.length < 0.0:
        return bend
    # A cylinder's path rises at one slope from end to end.
    length = wp.sqrt(bend.length * bend.length + rise * rise)
    bend.onto = (bend.length * bend.onto + rise * axis) / length
    bend.off = (bend.length * bend.off + rise * axis) / length
    bend.length = length
    return bend
