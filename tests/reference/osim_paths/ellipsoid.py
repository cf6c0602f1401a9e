"""The path of a line over a wrapping ellipsoid, as OpenSim 4.6 computes it.

The path lies in the plane through both end points and one point of the surface, so it is no geodesic and
the lengths that OpenSim reports are not an exact integral of its moment arms. The point comes from the
middle of the line inside the ellipsoid (`midpoint`), from where the line meets a plane of symmetry
(`axial`), or from a blend of that and of the mean direction to the surface (`hybrid`). Source of the
rules and of all constants: `WrapEllipsoid.cpp` of opensim-core; nearest points after D. Eberly.
"""

import numpy as np
from reference.osim_paths.cylinder import INSIDE, MANDATORY, NONE, Wrap, dot, on_side, unit

BLEND = (0.7073, 0.9)
"""Cosine between line and main axis: below, only the fan of `hybrid`, above, only the axial rule."""
EDGE = 0.3
"""Share of the line inside the ellipsoid over which the axial rule fades in."""
FAN = 300
"""Samples of the fan."""
NEWTON_STEPS, NEWTON_ERROR = 64, 1e-9
"""Of the nearest point."""
TANGENT_ERROR, TANGENT_STEPS, SEARCH_STEPS = 1e-8, 50, 1000
"""Of the tangent points: squared error, outer and inner iterations."""
SURFACE = 1e-4
"""Value of the ellipsoid's equation below which an end point counts as on the surface."""
SEGMENT = 0.001
"""[m] of the path's pieces on the surface."""
ZERO = 2e-12
"""Below which OpenSim calls a coordinate zero."""


def wrap_ellipsoid(
    start: np.ndarray, end: np.ndarray, radii: tuple[float, ...], axis: int, sign: int, method: str
) -> Wrap:
    """Wrap lines over an ellipsoid.

    Args:
        start: first end points in the ellipsoid's frame [m], shape `(n, 3)`.
        end: second end points [m], shape `(n, 3)`.
        radii: half axes [m].
        axis: coordinate that the quadrant looks at, 0 to 2.
        sign: side of it that the path must take, 0 without a quadrant.
        method: `hybrid`, `midpoint` or `axial`.

    Returns:
        The wraps; `first`, `last` and `length` mean something where `status` is positive.
    """
    scale = 3.0 / sum(radii)
    a = np.array(radii) * scale
    p1, p2 = start * scale, end * scale
    value1, value2 = (np.sum((p / a) ** 2, axis=1) - 1.0 for p in (p1, p2))
    status = np.where((value1 < -SURFACE) | (value2 < -SURFACE), INSIDE, NONE)
    aligned = np.abs(dot(unit(p1), unit(p2)) - 1.0) < 1e-4
    line = (p1 - p2) / a
    aa, bb, cc = dot(line, line), 2 * dot(line, p2 / a), np.sum((p2 / a) ** 2, axis=1) - 1.0
    discriminant = bb * bb - 4 * aa * cc
    root = np.sqrt(np.maximum(discriminant, 0.0))
    enter, leave = (-bb + root) / (2 * aa), (-bb - root) / (2 * aa)
    crosses = (discriminant >= 0) & (enter > 0) & (enter < 1) & (leave > 0) & (leave < 1)
    chosen = np.flatnonzero((status == NONE) & ~aligned & crosses)
    status[chosen] = MANDATORY
    first, last, length = np.zeros_like(start), np.zeros_like(end), np.zeros(len(start))
    if len(chosen):
        ends = p1[chosen], p2[chosen]
        r1 = ends[1] + enter[chosen, None] * (ends[0] - ends[1])
        r2 = ends[1] + leave[chosen, None] * (ends[0] - ends[1])
        values = value1[chosen], value2[chosen]
        one, other, arc = _path(ends, values, r1, r2, a, axis, sign, method, scale)
        first[chosen], last[chosen], length[chosen] = one / scale, other / scale, arc / scale
    return Wrap(status, first, last, length)


def _path(
    ends: tuple, values: tuple, r1: np.ndarray, r2: np.ndarray, a: np.ndarray, axis: int, sign: int,
    method: str, scale: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return tangent points and length over the surface for lines that cross it at r1 and r2."""
    p1, p2 = ends
    c, fan, begin1, begin2 = _surface_point(p1 - p2, r1, r2, a, method)
    if sign:
        wrong = ~on_side(c[:, axis], sign)
        mirrored = c.copy()
        mirrored[:, axis] *= -1
        begin1, begin2 = (np.where(wrong[:, None], mirrored, b) for b in (begin1, begin2))
        # The halfway point of a coordinate and its mirror image is 0.
        faded = mirrored.copy()
        faded[:, axis] *= 1 - fan
        faded = np.where((fan > 0)[:, None], nearest_on_ellipsoid(a, faded), mirrored)
        c = np.where(wrong[:, None], faded, c)
    normal = unit(np.cross(p1 - p2, p1 - c))
    offset = -dot(normal, c)
    first = _tangent_point(values[0], begin1, p1, a, normal, offset)
    last = _tangent_point(values[1], begin2, p2, a, normal, offset)
    arc, second, next_to_last, pieces = _arc(first, last, a, normal, offset, scale, False)
    if sign:
        back = (dot(p1 - first, second - first) > 0) | (dot(p2 - last, next_to_last - last) > 0)
        back &= pieces > 1
        arc = np.where(back, _arc(first, last, a, normal, offset, scale, True)[0], arc)
    return first, last, arc


def _surface_point(
    line: np.ndarray, r1: np.ndarray, r2: np.ndarray, a: np.ndarray, method: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the point of the surface that sets the plane, the fan's weight, and starts of the tangents."""
    index = np.arange(len(r1))
    inner = r2 - r1
    slopes = np.abs(unit(line))
    main = np.argmax(slopes, axis=1)
    slope = slopes[index, main]
    if method == "midpoint":
        c = nearest_on_ellipsoid(a, r1 + 0.5 * inner)
        return c, np.zeros(len(c)), c, c
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -r1[index, main] / inner[index, main]
    at_plane = r1 + t[:, None] * inner
    axial = np.stack([nearest_on_ellipsoid(a, at_plane, special) for special in range(3)])[main, index]
    if method == "axial":
        use = ((t > 0) & (t < 1))[:, None]
        return axial, np.zeros(len(t)), np.where(use, axial, r1), np.where(use, axial, r2)
    inside = np.clip(np.minimum(t, 1 - t) / EDGE, 0.0, 1.0)
    slope = np.where(slope > BLEND[0], BLEND[0] + inside * (slope - BLEND[0]), slope)
    middle = r1 + 0.5 * inner
    c = axial.copy()
    fanned = np.flatnonzero(slope < BLEND[1])
    if len(fanned):
        spread = nearest_on_ellipsoid(a, middle[fanned] + _fan(a, r1[fanned], inner[fanned]))
        share = np.clip((slope[fanned] - BLEND[0]) / (BLEND[1] - BLEND[0]), 0.0, None)[:, None]
        blended = nearest_on_ellipsoid(a, share * axial[fanned] + (1 - share) * spread)
        c[fanned] = np.where(share > 0, blended, spread)
    fan = np.clip(1 - (slope - BLEND[0]) / (BLEND[1] - BLEND[0]), None, 1.0)
    return c, fan, c, c


def _fan(a: np.ndarray, r1: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Return the mean direction from samples of the line to the surface."""
    total = np.zeros_like(r1)
    samples = np.arange(1, FAN - 1) / FAN
    for some in np.array_split(samples, 10):
        points = r1[:, None] + some[None, :, None] * inner[:, None]
        nearest = nearest_on_ellipsoid(a, points.reshape(-1, 3)).reshape(points.shape)
        total += unit(nearest - points).sum(axis=1)
    return unit(total)


def nearest_on_ellipsoid(a: np.ndarray, points: np.ndarray, special: int = -1) -> np.ndarray:
    """Return points of an ellipsoid nearest to points [same unit as `a`], shape `(n, 3)`.

    Args:
        a: half axes, shape `(3,)`.
        points: shape `(n, 3)`.
        special: axis across which points are taken as lying in a plane of symmetry; -1: those that do.
    """
    result = np.empty_like(points)
    if special < 0:
        flat = np.abs(points) <= ZERO
        others = a.sum() - a
        plane = np.where(flat.any(axis=1), np.argmin(np.where(flat, others, np.inf), axis=1), -1)
    else:
        plane = np.full(len(points), special)
    general = np.flatnonzero(plane < 0)
    result[general] = _newton(a, points[general])
    for normal in range(3):
        chosen = np.flatnonzero(plane == normal)
        if len(chosen):
            i, j = (normal + 1) % 3, (normal + 2) % 3
            result[chosen, normal] = points[chosen, normal]
            result[chosen[:, None], [i, j]] = _nearest_on_ellipse(a[[i, j]], points[chosen][:, [i, j]])
    return result


def _nearest_on_ellipse(a: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points of an ellipse nearest to points, shape `(n, 2)`."""
    result = _newton(a, points)
    flat = np.abs(points) <= ZERO
    for i, j in ((0, 1), (1, 0)):
        on_axis = np.flatnonzero(flat[:, i] & ~flat[:, j])
        if not len(on_axis):
            continue
        along = points[on_axis, j]
        at_end = (a[i] >= a[j]) | (np.abs(along) >= a[j] - a[i] ** 2 / a[j])
        height = np.where(at_end, np.where(along >= 0, a[j], -a[j]), 0.0)
        aside = np.where(at_end, points[on_axis, i], 0.0)
        if not at_end.all():
            beside = a[j] ** 2 * along / (a[j] ** 2 - a[i] ** 2)
            height = np.where(at_end, height, beside)
            aside = np.where(at_end, aside, a[i] * np.sqrt(np.abs(1 - (beside / a[j]) ** 2)))
        result[on_axis, j], result[on_axis, i] = height, aside
    both = flat.all(axis=1)
    short = int(a[1] <= a[0])
    result[both] = points[both]
    result[both, short] = np.where(points[both, short] < 0, -a[short], a[short])
    return result


def _newton(a: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return nearest points of an ellipsoid or ellipse by Eberly's polynomial in t."""
    squares = (a**2)[:, None]
    weights = squares * points.T**2
    outside = np.sum((points / a) ** 2, axis=1) >= 1.0
    t = np.where(outside, a.max() * np.linalg.norm(points, axis=1), 0.0)
    busy = np.arange(len(points))
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(NEWTON_STEPS):
            shifted = t[busy] + squares
            ratio = weights / (shifted * shifted)
            # OpenSim multiplies with this square, and its stop is on the value so scaled.
            scale = np.multiply.reduce(shifted) ** 2
            value = 1 - ratio.sum(axis=0)
            slope = 2 * ((1 / shifted).sum(axis=0) * value + (ratio / shifted).sum(axis=0))
            open_ = np.abs(scale * value) >= NEWTON_ERROR
            t[busy] -= np.where(open_, value / slope, 0.0)
            busy, weights = busy[open_], weights[:, open_]
            if not len(busy):
                break
        return squares.T * points / (t[:, None] + squares.T)


def _tangent_point(
    value: np.ndarray, begin: np.ndarray, p: np.ndarray, a: np.ndarray, normal: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """Return points of plane and surface whose tangent passes p, by OpenSim's damped least squares.

    The solver stops at a squared error of 1e-8, so its inaccuracy is part of the reference.
    """
    on_surface = np.abs(value) < SURFACE
    x = np.concatenate([begin, -2 * np.sum((begin / a) ** 2, axis=1)[:, None]], axis=1)
    error = _errors(x, p, a, normal, offset)
    squared = dot(error, error)
    damping = np.full(len(x), 0.01)
    busy = np.flatnonzero(~on_surface & (squared > TANGENT_ERROR))
    for _ in range(TANGENT_STEPS):
        if not len(busy):
            break
        args = p[busy], a, normal[busy], offset[busy]
        x[busy], damping[busy] = _step(x[busy], damping[busy], squared[busy], *args)
        error = _errors(x[busy], *args)
        squared[busy] = dot(error, error)
        busy = busy[squared[busy] > TANGENT_ERROR]
    return np.where(on_surface[:, None], p, x[:, :3])


def _errors(
    x: np.ndarray, p: np.ndarray, a: np.ndarray, normal: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """Return distances from plane, surface, and tangency at x and at p, shape `(n, 4)`."""
    r, d = x[:, :3], x[:, 3]
    gradient = 2 * r / a**2
    return np.stack(
        [
            dot(normal, r) + offset,
            np.sum((r / a) ** 2, axis=1) - 1,
            dot(gradient, r) + d,
            dot(gradient, p) + d,
        ],
        axis=1,
    )


def _step(
    x: np.ndarray, damping: np.ndarray, squared: np.ndarray, p: np.ndarray, a: np.ndarray, normal: np.ndarray,
    offset: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return x and damping after one outer iteration: damp until the error falls, then double the step."""
    r = x[:, :3]
    jacobian = np.zeros((len(x), 4, 4))
    jacobian[:, :3, 0] = normal
    jacobian[:, :3, 1] = 2 * r / a**2
    jacobian[:, :3, 2] = 4 * r / a**2
    jacobian[:, :3, 3] = 2 * p / a**2
    jacobian[:, 3, 2:] = 1.0
    cosine = dot(unit(p - r), unit(p))
    factor = np.where(cosine > 0.1, 1 - np.abs(cosine) ** 100, 1.0) / 16
    descent = -np.einsum("nij,nj->ni", jacobian, _errors(x, p, a, normal, offset))
    matrix = jacobian @ jacobian.transpose(0, 2, 1)
    diagonal = np.einsum("nii->ni", matrix).copy()
    x, damping, before, now = x.copy(), damping.copy(), squared.copy(), squared.copy()
    step = np.zeros_like(x)
    busy = np.arange(len(x))
    for _ in range(SEARCH_STEPS):
        busy = busy[now[busy] >= before[busy]]
        if not len(busy):
            break
        damped = matrix[busy].copy()
        damped[:, range(4), range(4)] = diagonal[busy] * (1 + damping[busy, None])
        step[busy] = factor[busy, None] * np.linalg.solve(damped, descent[busy][:, :, None])[:, :, 0]
        x[busy] += step[busy]
        before[busy] = now[busy]
        error = _errors(x[busy], p[busy], a, normal[busy], offset[busy])
        now[busy] = dot(error, error)
        damping[busy] *= 4.0
    damping /= 8.0
    reach = np.full(len(x), 0.5)
    busy = np.arange(len(x))
    for _ in range(SEARCH_STEPS):
        busy = busy[now[busy] <= before[busy]]
        if not len(busy):
            break
        reach[busy] *= 2.0
        x[busy] += step[busy] * reach[busy, None]
        before[busy] = now[busy]
        error = _errors(x[busy], p[busy], a, normal[busy], offset[busy])
        now[busy] = dot(error, error)
    return x - step * reach[:, None], damping


def _arc(
    first: np.ndarray, last: np.ndarray, a: np.ndarray, normal: np.ndarray, offset: np.ndarray, scale: float,
    far: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return length of the plane's cut between points, its second and last but one point, and its pieces."""
    index = np.arange(len(first))
    chord = np.linalg.norm(first - last, axis=1)
    pieces = np.minimum((chord / scale / SEGMENT).astype(int), 499)
    largest = np.argmax(np.abs(normal), axis=1)
    centre = np.zeros_like(first)
    centre[index, largest] = -offset / normal[index, largest]
    along, towards = unit(first - centre), unit(last - centre)
    opening = np.arccos(np.clip(dot(along, towards), -1.0, 1.0))
    opening = opening - 2 * np.pi if far else opening
    across = np.cross(unit(np.cross(along, towards)), along)
    count = max(int(pieces.max(initial=1)), 1)
    share = np.arange(count + 1) / np.maximum(pieces, 1)[:, None]
    angle = opening[:, None] * np.minimum(share, 1.0)
    rays = np.cos(angle)[..., None] * along[:, None] + np.sin(angle)[..., None] * across[:, None]
    scaled, middle = rays / a, (centre / a)[:, None]
    aa, bb, cc = dot(scaled, scaled), 2 * dot(scaled, middle), dot(middle, middle) - 1
    reach = (-bb + np.sqrt(np.maximum(bb * bb - 4 * aa * cc, 0.0))) / (2 * aa)
    points = centre[:, None] + reach[..., None] * rays
    points[:, 0] = first
    points = np.where((share >= 1.0)[..., None], last[:, None], points)
    length = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)
    length = np.where(chord / scale < SEGMENT, chord, length)
    return length, points[:, 1], points[index, np.maximum(pieces - 1, 0)], pieces
