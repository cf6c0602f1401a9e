"""The path of a line over a wrapping sphere or torus, as OpenSim 4.6 computes it.

Sources of the rules: `WrapSphere.cpp` and `WrapTorus.cpp` of opensim-core.
"""

import numpy as np
from reference.osim_paths.cylinder import (
    INSIDE,
    MANDATORY,
    NONE,
    WRAPPED,
    Wrap,
    angle_between,
    dot,
    on_side,
    unit,
    wrap_cylinder,
)

TUBE_LENGTH = 10000.0
"""[m] of the cylinder that stands for a torus where the line passes it."""
EVALUATIONS, SEARCH_ERROR, FIRST_REACH = 500, 1e-4, 0.2
"""Of the search for the place where a line passes the ring nearest: limit, tolerance, first scaled step."""


def wrap_sphere(start: np.ndarray, end: np.ndarray, radius: float, axis: int, sign: int) -> Wrap:
    """Wrap lines over a sphere; only a line that intersects it is wrapped, quadrant or not.

    Args:
        start: first end points in the sphere's frame [m], shape `(n, 3)`.
        end: second end points [m], shape `(n, 3)`.
        radius: of the sphere [m].
        axis: coordinate that the quadrant looks at, 0 to 2.
        sign: side of it that the path must take, 0 without a quadrant.

    Returns:
        The wraps; `first`, `last` and `length` mean something where `status` is positive.
    """
    line = start - end
    a, b = dot(line, line), 2 * dot(end, line)
    c = dot(end, end) - radius**2
    inside = (dot(start, start) < radius**2) | (c < 0)
    discriminant = b * b - 4 * a * c
    with np.errstate(invalid="ignore", divide="ignore"):
        roots = [(-b + side * np.sqrt(discriminant)) / (2 * a) for side in (1, -1)]
        crosses = (roots[0] > 0) & (roots[0] < 1) & (roots[1] > 0) & (roots[1] < 1)
        normal = unit(np.cross(unit(line), unit(end)))
        candidates = [_tangent_points(points, normal, radius) for points in (start, end)]
    pairs = [(first, last) for first in candidates[0] for last in candidates[1]]
    best = np.argmax(np.stack([dot(unit(first), unit(last)) for first, last in pairs]), axis=0)
    index = np.arange(len(best))
    first, last = (np.stack([pair[end_] for pair in pairs])[best, index] for end_ in (0, 1))
    far = np.zeros(len(start), bool)
    status = np.full(len(start), WRAPPED)
    if sign:
        ends_on = on_side(start[:, axis], sign), on_side(end[:, axis], sign)
        status = np.where(ends_on[0] | ends_on[1], _of_free_line(start, end, ends_on, axis, sign), WRAPPED)
        held = ~(ends_on[0] & ends_on[1])
        first_held, last_held = _on_quadrant(start, end, candidates, axis, sign)
        first = np.where(held[:, None], first_held, first)
        last = np.where(held[:, None], last_held, last)
        far = held & (dot(first + last, first - start + last - end) < 0)
    angle = angle_between(first, last)
    length = radius * np.where(far, angle - 2 * np.pi, angle)
    return Wrap(np.where(inside, INSIDE, np.where(crosses, status, NONE)), first, last, length)


def _of_free_line(start: np.ndarray, end: np.ndarray, ends_on: tuple, axis: int, sign: int) -> np.ndarray:
    """Return the status of lines with an end on the quadrant's side.

    OpenSim takes the distance [m] from the first end to the nearest point for a fraction of the line:
    beyond one metre it no longer sees that the line intersects.
    """
    along = unit(end - start)
    distance = -dot(start, along)
    near = start + distance[:, None] * along
    passes = (ends_on[0] != ends_on[1]) & ~on_side(near[:, axis], sign)
    return np.where((distance > 0) & (distance < 1.0), MANDATORY, np.where(passes, WRAPPED, NONE))


def _tangent_points(points: np.ndarray, normal: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return both points where a line from each point touches the sphere in the plane of the normal."""
    distance = np.linalg.norm(points, axis=1, keepdims=True)
    inward = -points / distance
    across = np.cross(normal, inward)
    sine = np.minimum(radius / distance, 1.0)
    cosine = np.sqrt(1 - sine**2)
    reach = distance * cosine
    return (
        points + reach * (cosine * inward - sine * across),
        points + reach * (cosine * inward + sine * across),
    )


def _on_quadrant(
    start: np.ndarray, end: np.ndarray, candidates: list, axis: int, sign: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the tangent points that keep the path on the quadrant's side."""
    middle = unit(-start - end)
    taken, left = [], []
    for one, other in candidates:
        better = (dot(unit(one), middle) > dot(unit(other), middle))[:, None]
        taken.append(np.where(better, one, other))
        left.append(np.where(better, other, one))
    reach = taken[0] - start + taken[1] - end
    flip = (reach[:, axis] * sign < 0)[:, None]
    return np.where(flip, left[0], taken[0]), np.where(flip, left[1], taken[1])


def wrap_torus(
    start: np.ndarray, end: np.ndarray, tube: float, ring: float, axis: int, sign: int, adjust: bool
) -> Wrap:
    """Wrap lines over the inside of a torus: over a cylinder where a line passes the ring nearest.

    Args:
        start: first end points in the torus's frame [m], shape `(n, 3)`; its axis is z.
        end: second end points [m], shape `(n, 3)`.
        tube: OpenSim's `inner_radius`: of the tube [m].
        ring: OpenSim's `outer_radius`: of the tube's centre line [m].
        axis: coordinate that the quadrant looks at, 0 to 2.
        sign: side of it where the line must pass the ring, 0 without a quadrant.
        adjust: whether tangent points are adjusted (muscles with several wrap objects).

    Returns:
        The wraps; `first`, `last` and `length` mean something where `status` is positive.
    """
    passes = [_nearest_to_ring(one, other, ring) for one, other in ((start, end), (end, start))]
    gaps = [
        np.linalg.norm(point, axis=1) ** 2 + ring**2 - 2 * ring * np.hypot(point[:, 0], point[:, 1])
        for point in passes
    ]
    first = gaps[0] < gaps[1]
    on_ring = np.ones(len(start), bool)
    if sign:
        sides = [on_side(point[:, axis], sign) for point in passes]
        first = np.where(sides[0] == sides[1], first, sides[0])
        on_ring = sides[0] | sides[1]
    outward = np.where(first[:, None], *passes) * [1.0, 1.0, 0.0]
    x = -unit(outward)
    y = np.broadcast_to(np.array([0.0, 0.0, -1.0]), x.shape)
    frame = np.stack([x, y, np.cross(x, y)], axis=1)
    shift = np.array([ring, 0.0, 0.0])
    ends = [np.einsum("nij,nj->ni", frame, points) + shift for points in (start, end)]
    wrap = wrap_cylinder(ends[0], ends[1], tube, TUBE_LENGTH, 0, 1, adjust)
    status = np.where(on_ring & (wrap.status > 0), WRAPPED, NONE)
    back = [np.einsum("nji,nj->ni", frame, points - shift) for points in (wrap.first, wrap.last)]
    return Wrap(status, back[0], back[1], wrap.length)


def _nearest_to_ring(start: np.ndarray, end: np.ndarray, ring: float) -> np.ndarray:
    """Return the points of lines that OpenSim takes for nearest to a ring, found from their start.

    Its derivative of the squared distance has the ring's term twice, and the root that MINPACK's `lmdif`
    finds depends on how that limits its steps; so this is `lmdif` for one variable (Moré 1978,
    doi:10.1007/BFb0067700).
    """
    along = unit(end - start)
    flat, base = along[:, :2], start[:, :2]
    c3, c4, c5 = dot(base, flat), dot(flat, flat), dot(base, base)
    height = dot(start, along)

    def residual(u: np.ndarray) -> np.ndarray:
        radius = np.sqrt(np.maximum(u * u * c4 + 2 * c3 * u + c5, 1e-300))
        return 2 * (height + u) - 4 * ring * (c4 * u + c3) / radius

    def slope(u: np.ndarray) -> np.ndarray:
        radius = np.sqrt(np.maximum(u * u * c4 + 2 * c3 * u + c5, 1e-300))
        return 2 - 4 * ring * (c4 / radius - (c4 * u + c3) ** 2 / radius**3)

    u = np.zeros(len(start))
    f, j = residual(u), slope(u)
    scale = np.where(j == 0, 1.0, np.abs(j))
    reach, damping = np.full(len(u), FIRST_REACH), np.zeros(len(u))
    busy, first = f != 0, np.ones(len(u), bool)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(EVALUATIONS):
            if not busy.any():
                break
            scale = np.maximum(scale, np.abs(j))
            step, damping = _limited(f, j, scale, reach, damping)
            size = scale * np.abs(step)
            reach = np.where(first, np.minimum(reach, size), reach)
            new = residual(u + step)
            actual = np.where(0.1 * np.abs(new) < np.abs(f), 1 - (new / f) ** 2, -1.0)
            linear, held = (j * step / f) ** 2, damping * (size / f) ** 2
            predicted, ratio = linear + 2 * held, actual / (linear + 2 * held)
            shrink = np.where(actual >= 0, 0.5, 0.5 * (linear + held) / (linear + held - 0.5 * actual))
            shrink = np.where((0.1 * np.abs(new) >= np.abs(f)) | (shrink < 0.1), 0.1, shrink)
            poor = ratio <= 0.25
            fair = ~poor & ((damping == 0) | (ratio >= 0.75))
            reach = np.where(poor, shrink * np.minimum(reach, 10 * size), np.where(fair, 2 * size, reach))
            damping = np.where(poor, damping / shrink, np.where(fair, 0.5 * damping, damping))
            taken = busy & (ratio >= 1e-4)
            u, f, first = np.where(taken, u + step, u), np.where(taken, new, f), first & ~taken
            j = slope(u)
            settled = (np.abs(actual) <= SEARCH_ERROR) & (predicted <= SEARCH_ERROR) & (ratio <= 2)
            settled |= (reach <= SEARCH_ERROR * scale * np.abs(u)) | (f == 0) | ~np.isfinite(ratio)
            busy &= ~settled
    return start + u[:, None] * along


def _limited(
    f: np.ndarray, j: np.ndarray, scale: np.ndarray, reach: np.ndarray, damping: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return steps no longer than the reach, to a tenth, and the damping that makes them so."""
    newton = scale * np.abs(f / j)
    long = newton - reach > 0.1 * reach
    low = (newton - reach) / reach * (j / scale) ** 2
    steepest = np.abs(j * f) / scale
    high = steepest / reach
    par = np.clip(damping, low, high)
    par = np.where(par == 0, steepest / newton, par)
    open_ = long.copy()
    for _ in range(10):
        size = scale * np.abs(j * f) / (j * j + par * scale**2)
        excess = size - reach
        open_ &= np.abs(excess) > 0.1 * reach
        if not open_.any():
            break
        change = excess / reach * (j * j + par * scale**2) / scale**2
        low = np.where(open_ & (excess > 0), np.maximum(low, par), low)
        high = np.where(open_ & (excess < 0), np.minimum(high, par), high)
        par = np.where(open_, np.maximum(low, par + change), par)
    par = np.where(long, par, 0.0)
    return -j * f / (j * j + par * scale**2), par
