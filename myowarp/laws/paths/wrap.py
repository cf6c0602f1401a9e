"""Common parts of lines over OpenSim's wrap objects, in float64: float32 would change which way some go.

The oracle of this folder is the float64 NumPy of `tests/reference/osim_paths`, one function beside each here.
"""

import warp as wp

real = wp.float64

INSIDE = wp.constant(-1)
NONE = wp.constant(0)
WRAPPED = wp.constant(1)
MANDATORY = wp.constant(2)


@wp.struct
class Wrap:
    """A line over one wrap object, in its frame.

    Attributes:
        status: INSIDE (an end point is), NONE, WRAPPED (possible), MANDATORY (it intersects).
        first: Point where the line arrives at the surface [m].
        last: Point where it leaves the surface [m].
        length: Of the path between them, over the surface [m].
    """

    status: int
    first: wp.vec3d
    last: wp.vec3d
    length: wp.float64


@wp.func
def flat_dot(a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """Return the scalar product of the parts in the plane z = 0."""
    return a[0] * b[0] + a[1] * b[1]


@wp.func
def flat_length(a: wp.vec3d) -> wp.float64:
    """Return the distance from the z axis."""
    return wp.sqrt(flat_dot(a, a))


@wp.func
def flat_cosine(a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """Return the cosine of the angle that two points make at the z axis, 0 for a point on it."""
    size = flat_length(a) * flat_length(b)
    if size == real(0.0):
        return real(0.0)
    return wp.clamp(flat_dot(a, b) / size, real(-1.0), real(1.0))


@wp.func
def on_side(value: wp.float64, sign: int) -> bool:
    """Whether a coordinate lies on the side of a sign; zero counts as positive."""
    return (value >= real(0.0)) == (sign > 0)


@wp.func
def line_of_sight(a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """Return the cosine of the angle between two vectors."""
    return wp.dot(wp.normalize(a), wp.normalize(b))
