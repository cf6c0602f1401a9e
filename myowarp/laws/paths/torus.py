"""The path of a line over the inside of a wrapping torus about z, as OpenSim 4.6 computes it.

Source of the rules: `WrapTorus.cpp` of opensim-core. The line wraps over a cylinder where it passes the ring
nearest; OpenSim finds that place by MINPACK's `lmdif` (Moré 1978, doi:10.1007/BFb0067700) from a derivative
that has the ring's term twice, so what it finds depends on how `lmdif` limits its steps.
"""

import warp as wp

from myowarp.laws.paths.cylinder import wrap_cylinder
from myowarp.laws.paths.wrap import NONE, WRAPPED, Wrap, flat_dot, flat_length, on_side, real

TUBE_LENGTH = wp.constant(wp.float64(10000.0))  # m
EVALUATIONS = wp.constant(500)
SEARCH_ERROR = wp.constant(wp.float64(1e-4))
FIRST_REACH = wp.constant(wp.float64(0.2))
TENTH = wp.constant(wp.float64(0.1))


@wp.func
def limited(
    f: wp.float64, j: wp.float64, scale: wp.float64, reach: wp.float64, damping: wp.float64
) -> wp.vec2d:
    """Return a step no longer than the reach, to a tenth, and the damping that makes it so."""
    newton = scale * wp.abs(f / j)
    if not (newton - reach > TENTH * reach):
        return wp.vec2d(-f / j, real(0.0))
    low = (newton - reach) / reach * (j / scale) * (j / scale)
    steepest = wp.abs(j * f) / scale
    high = steepest / reach
    par = wp.clamp(damping, low, high)
    if par == real(0.0):
        par = steepest / newton
    for _ in range(10):
        damped = j * j + par * scale * scale
        excess = scale * wp.abs(j * f) / damped - reach
        if not (wp.abs(excess) > TENTH * reach):
            break
        if excess > real(0.0):
            low = wp.max(low, par)
        else:
            high = wp.min(high, par)
        par = wp.max(low, par + excess / reach * damped / (scale * scale))
    return wp.vec2d(-j * f / (j * j + par * scale * scale), par)


@wp.func
def nearest_to_ring(start: wp.vec3d, end: wp.vec3d, ring: wp.float64) -> wp.vec3d:
    """Return the point of a line that OpenSim takes for nearest to a ring, found from its start."""
    along = wp.normalize(end - start)
    c3, c4, c5 = flat_dot(start, along), flat_dot(along, along), flat_dot(start, start)
    height = wp.dot(start, along)
    u = real(0.0)
    damping = real(0.0)
    reach = real(FIRST_REACH)
    scale = real(0.0)
    first = bool(True)
    radius = wp.sqrt(wp.max(c5, real(1e-300)))
    f = real(2.0) * height - real(4.0) * ring * c3 / radius
    for _ in range(EVALUATIONS):
        radius = wp.sqrt(wp.max(u * u * c4 + real(2.0) * c3 * u + c5, real(1e-300)))
        rise = c4 * u + c3
        j = real(2.0) - real(4.0) * ring * (c4 / radius - rise * rise / (radius * radius * radius))
        scale = wp.max(scale, wp.abs(j))
        if first and j == real(0.0):
            scale = real(1.0)
        if f == real(0.0):
            break
        found = limited(f, j, scale, reach, damping)
        step = found[0]
        damping = found[1]
        size = scale * wp.abs(step)
        if first:
            reach = wp.min(reach, size)
        v = u + step
        radius = wp.sqrt(wp.max(v * v * c4 + real(2.0) * c3 * v + c5, real(1e-300)))
        new = real(2.0) * (height + v) - real(4.0) * ring * (c4 * v + c3) / radius
        improves = TENTH * wp.abs(new) < wp.abs(f)
        actual = wp.where(improves, real(1.0) - (new / f) * (new / f), real(-1.0))
        linear, held = (j * step / f) * (j * step / f), damping * (size / f) * (size / f)
        predicted = linear + real(2.0) * held
        ratio = actual / predicted
        if ratio <= real(0.25):
            shrink = real(0.5)
            if actual < real(0.0):
                shrink = real(0.5) * (linear + held) / (linear + held - real(0.5) * actual)
            if not improves or shrink < TENTH:
                shrink = TENTH
            reach = shrink * wp.min(reach, real(10.0) * size)
            damping = damping / shrink
        elif damping == real(0.0) or ratio >= real(0.75):
            reach = real(2.0) * size
            damping = real(0.5) * damping
        if ratio >= SEARCH_ERROR:
            u = v
            f = new
            first = False
        if (wp.abs(actual) <= SEARCH_ERROR and predicted <= SEARCH_ERROR and ratio <= real(2.0)) or (
            reach <= SEARCH_ERROR * scale * wp.abs(u) or not wp.isfinite(ratio)
        ):
            break
    return start + u * along


@wp.func
def gap(point: wp.vec3d, ring: wp.float64) -> wp.float64:
    """Return the squared distance of a point from the ring."""
    return wp.length_sq(point) + ring * ring - real(2.0) * ring * flat_length(point)


@wp.func
def wrap_torus(
    start: wp.vec3d, end: wp.vec3d, tube: wp.float64, ring: wp.float64, axis: int, sign: int, adjust: bool
) -> Wrap:
    """A cylinder of the tube's radius, tangent to the ring where the line passes it nearest."""
    near, other = nearest_to_ring(start, end, ring), nearest_to_ring(end, start, ring)
    use = bool(gap(near, ring) < gap(other, ring))
    on_ring = bool(True)
    if sign != 0:
        side1, side2 = on_side(near[axis], sign), on_side(other[axis], sign)
        if side1 != side2:
            use = side1
        on_ring = side1 or side2
    outward = wp.where(use, near, other)
    x = -wp.normalize(wp.vec3d(outward[0], outward[1], real(0.0)))
    y = wp.vec3d(real(0.0), real(0.0), real(-1.0))
    frame = wp.matrix_from_rows(x, y, wp.cross(x, y))
    shift = wp.vec3d(ring, real(0.0), real(0.0))
    wrap = wrap_cylinder(frame * start + shift, frame * end + shift, tube, TUBE_LENGTH, 0, 1, adjust)
    wrap.status = wp.where(on_ring and wrap.status > 0, WRAPPED, NONE)
    wrap.first = wp.transpose(frame) * (wrap.first - shift)
    wrap.last = wp.transpose(frame) * (wrap.last - shift)
    return wrap
