"""The path of a muscle over points and wrap objects, as OpenSim 4.6 computes it, for every world.

A thread follows one path in one world: conditional points while their value is in range, then every wrap
object in turn takes the first straight piece that intersects it, else the one that it lengthens least; with
several objects up to eight rounds, until the length changes by less than 0.5 mm. That is what OpenSim
reports, not the shortest path: it caches where a wrap point is in ground when it first asks, so lengths and
directions keep the wrap points of the first round, while arcs are those of the last. Source of the rules:
`GeometryPath.cpp` of opensim-core, and what 4.6 returns; the oracle is
`tests/reference/osim_paths/path.py`.

What pulls on bodies is what `computeMomentArm` and OpenSim's forces use: unit tension along the straight
pieces between different bodies, wrap points being fixed in the bodies of their objects (Sherman, Seth, Delp
2013, doi:10.1115/DETC2013-13633).
"""

import warp as wp

from myowarp.laws.paths.cylinder import wrap_cylinder
from myowarp.laws.paths.ellipsoid import wrap_ellipsoid
from myowarp.laws.paths.sphere import wrap_sphere
from myowarp.laws.paths.torus import wrap_torus
from myowarp.laws.paths.wrap import INSIDE, MANDATORY, NONE, WRAPPED, Wrap, real

CYLINDER = wp.constant(0)
SPHERE = wp.constant(1)
ELLIPSOID = wp.constant(2)
TORUS = wp.constant(3)

ROUNDS = wp.constant(8)  # over several wrap objects
MOST_VARIABLES = 6  # of a length that is a polynomial
Slopes = wp.types.vector(length=MOST_VARIABLES, dtype=wp.float64)

SETTLED = wp.constant(wp.float64(0.0005))  # m of change in length after which no further round follows


@wp.struct
class Point:
    """A point of a path.

    Attributes:
        body: Whose frame it is in.
        handle: Where what pulls on that body is gathered.
        moving: Number in `PathTables.moving`; -1: it is fixed.
        condition: Number of the value that says whether it is part of the path; -1: it always is.
        low: Least such value.
        high: Greatest such value.
        location: In the body [m]; of a moving point the origin of its frame.
    """

    body: int
    handle: int
    moving: int
    condition: int
    low: wp.float64
    high: wp.float64
    location: wp.vec3d


@wp.struct
class MovingPoint:
    """A point's place in a frame.

    Attributes:
        value: Numbers of the values that are its x, y, z; -1: that one does not move.
        rest: x, y, z that do not move [m].
        rotation: Of the frame in the body.
    """

    value: wp.vec3i
    rest: wp.vec3d
    rotation: wp.mat33d


@wp.struct
class Surface:
    """A wrap object.

    Attributes:
        kind: CYLINDER, SPHERE, ELLIPSOID or TORUS.
        body: In which it is fixed.
        axis: Coordinate that the quadrant looks at.
        sign: Side of it that a path must take; 0: any.
        active: 0: no path wraps over it.
        size: [m], as in `osim.document.model.WrapObject`.
        position: Of its frame in the body [m].
        rotation: Of its frame in the body.
    """

    kind: int
    body: int
    axis: int
    sign: int
    active: int
    size: wp.vec3d
    position: wp.vec3d
    rotation: wp.mat33d


@wp.struct
class PathWrap:
    """A surface that a path may wrap over.

    Attributes:
        surface: Number of the surface.
        like: First wrap of the path over the same surface, counted in the path.
        handle: Where what pulls on the surface's body is gathered.
        method: Of an ellipsoid.
        first: First point between which it may, counted in the path.
        last: Last such point.
    """

    surface: int
    like: int
    handle: int
    method: int
    first: int
    last: int


@wp.struct
class MusclePath:
    """A path: spans of the tables, and of the working memory.

    Attributes:
        first_point: Its first point.
        points: Number of its points.
        first_wrap: Its first wrap.
        wraps: Number of its wraps.
        place: Its first place; it has one for each point and two for each wrap.
        first_handle: Its first handle.
        handles: Number of bodies that it pulls on.
        longest: By which one wrap may make it longer [m]; more is a jump.
        first_variable: First variable of its length, where that is a polynomial.
        variables: Number of these; 0: it runs over points.
        first_group: First group of terms of the polynomial.
        groups: Number of these.
    """

    first_point: int
    points: int
    first_wrap: int
    wraps: int
    place: int
    first_handle: int
    handles: int
    longest: wp.float64
    first_variable: int
    variables: int
    first_group: int
    groups: int


@wp.struct
class PathTables:
    """All paths of a model; a handle is a body that a path pulls on.

    Attributes:
        paths: All.
        points: Of paths.
        moving: Where points that move are.
        wraps: Of paths.
        surfaces: What these wrap over.
        variable: Numbers of the values that are variables of polynomials.
        power: Of all variables but the last, which a group of terms shares; shape (num_groups, most).
        first_coefficient: Of each group, and the number of all.
        coefficient: Of a group, of ascending powers of the last variable from 0 [m].
    """

    paths: wp.array[MusclePath]
    points: wp.array[Point]
    moving: wp.array[MovingPoint]
    wraps: wp.array[PathWrap]
    surfaces: wp.array[Surface]
    variable: wp.array[int]
    power: wp.array2d[int]
    first_coefficient: wp.array[int]
    coefficient: wp.array[wp.float64]


@wp.struct
class Frames:
    """Places of bodies, and arguments of points and polynomials.

    Attributes:
        origin: Of bodies in ground [m], shape (num_worlds, num_bodies).
        rotation: Of bodies in ground.
        value: Of moving points [m], conditions and polynomials, shape (num_worlds, num_values).
    """

    origin: wp.array2d[wp.vec3d]
    rotation: wp.array2d[wp.mat33d]
    value: wp.array2d[wp.float64]


@wp.struct
class Followed:
    """Working memory of paths, shape (num_worlds, num_places).

    Attributes:
        order: What a path consists of: points, then 2 for each wrap, counted in the path.
        location: Of points and wrap points in ground [m].
        cached: The same as OpenSim remembers it; NaN: not asked for yet.
        arc: Length over each wrap [m], shape (num_worlds, num_wraps).
    """

    order: wp.array2d[int]
    location: wp.array2d[wp.vec3d]
    cached: wp.array2d[wp.vec3d]
    arc: wp.array2d[wp.float64]


@wp.struct
class Pulls:
    """Lengths of paths, and their forces on bodies at unit tension.

    Attributes:
        length: [m], shape (num_worlds, num_paths).
        size: Number of points and wrap points, the same shape.
        force: d length / d position of each handle's body, shape (num_worlds, num_handles).
        torque: The same about the origin of ground [m].
        along: d length / d (x, y, z) of moving points, shape (num_worlds, num_moving).
        within: What moves a moving point against another of its body: it counts for the speed of the length
            and, in OpenSim, not for forces.
        twist: The same of turning such a body, where OpenSim remembers other places than it ends with.
        by_variable: d length / d variable of polynomials, shape (num_worlds, num_variables).
        jumps: How often OpenSim would have taken a wrap that is refused as a jump.
    """

    length: wp.array2d[wp.float64]
    size: wp.array2d[int]
    force: wp.array2d[wp.vec3d]
    torque: wp.array2d[wp.vec3d]
    along: wp.array2d[wp.vec3d]
    within: wp.array2d[wp.vec3d]
    twist: wp.array2d[wp.vec3d]
    by_variable: wp.array2d[wp.float64]
    jumps: wp.array2d[int]


@wp.func
def wrap_line(surface: Surface, method: int, start: wp.vec3d, end: wp.vec3d, adjust: bool) -> Wrap:
    """Return a line over a surface, in the surface's frame."""
    size, axis, sign = surface.size, surface.axis, surface.sign
    if surface.kind == CYLINDER:
        return wrap_cylinder(start, end, size[0], size[1], axis, sign, adjust)
    if surface.kind == SPHERE:
        return wrap_sphere(start, end, size[0], axis, sign)
    if surface.kind == TORUS:
        return wrap_torus(start, end, size[0], size[1], axis, sign, adjust)
    return wrap_ellipsoid(start, end, size, axis, sign, method)


@wp.func
def placed(point: Point, tables: PathTables, frames: Frames, worldid: int) -> wp.vec3d:
    """Return where a point is in ground."""
    local = point.location
    if point.moving >= 0:
        moving = tables.moving[point.moving]
        at = moving.rest
        for i in range(3):
            if moving.value[i] >= 0:
                at[i] = frames.value[worldid, moving.value[i]]
        local += moving.rotation * at
    return frames.origin[worldid, point.body] + frames.rotation[worldid, point.body] * local


@wp.func
def is_active(point: Point, value: wp.array[wp.float64]) -> bool:
    """Whether a point is part of its path."""
    if point.condition < 0:
        return True
    return value[point.condition] >= point.low and value[point.condition] <= point.high


@wp.func
def remembered(location: wp.array[wp.vec3d], cached: wp.array[wp.vec3d], at: int) -> wp.vec3d:
    """Return where a place is in ground: where it was when this was first asked."""
    if wp.isnan(cached[at][0]):
        cached[at] = location[at]
    return cached[at]


@wp.func
def over_one(path: MusclePath, tables: PathTables, one: int, other: int) -> bool:
    """Whether two places are wrap points on the same surface."""
    if one < path.points or other < path.points:
        return False
    first = tables.wraps[path.first_wrap + (one - path.points) // 2]
    return first.like == tables.wraps[path.first_wrap + (other - path.points) // 2].like


@wp.func
def without(order: wp.array[int], place: int, count: int, first: int) -> int:
    """Take the two places of a wrap out of a path, and return how many are left."""
    kept = int(0)
    for i in range(count):
        at = order[place + i]
        if at != first and at != first + 1:
            order[place + kept] = at
            kept += 1
    return kept


@wp.func
def path_length(
    path: MusclePath, tables: PathTables, memory: Followed, worldid: int, count: int
) -> wp.float64:
    """Return the length of a path as it stands: straight pieces, and arcs."""
    order, arc = memory.order[worldid], memory.arc[worldid]
    location, cached = memory.location[worldid], memory.cached[worldid]
    total = real(0.0)
    for piece in range(path.place, path.place + count - 1):
        one, other = order[piece], order[piece + 1]
        straight = remembered(location, cached, path.place + one)
        straight -= remembered(location, cached, path.place + other)
        if not over_one(path, tables, one, other):
            total += wp.length(straight)
        elif (other - path.points) % 2 == 1:
            total += arc[path.first_wrap + (other - path.points) // 2]
    return total


@wp.func
def detour(start: wp.vec3d, onto: wp.vec3d, end: wp.vec3d, off: wp.vec3d) -> wp.float64:
    """Return by how much the straight pieces to two points are longer than the line itself."""
    return wp.length(start - onto) + wp.length(end - off) - wp.length(start - end)


@wp.func
def wrapped(
    path: MusclePath,
    tables: PathTables,
    frames: Frames,
    memory: Followed,
    worldid: int,
    number: int,
    count: int,
    jumps: wp.array[int],
    pathid: int,
) -> wp.vec2i:
    """Wrap the best piece of a path over one object; return the number of places, and the last status."""
    order, location, cached = memory.order[worldid], memory.location[worldid], memory.cached[worldid]
    value = frames.value[worldid]
    wrap = tables.wraps[path.first_wrap + number]
    surface = tables.surfaces[wrap.surface]
    first, last = int(-1), int(-1)
    for i in range(wrap.first, wrap.last + 1):
        if is_active(tables.points[path.first_point + i], value):
            if first < 0:
                first = i
            last = i
    begin, end = int(0), int(0)
    for i in range(count):
        if order[path.place + i] == first:
            begin = i
        if order[path.place + i] == last:
            end = i
    if first < 0:
        end = begin
    turned = frames.rotation[worldid, surface.body]
    centre = frames.origin[worldid, surface.body] + turned * surface.position
    turned = turned * surface.rotation
    back = wp.transpose(turned)
    status, best, least, refused = int(NONE), int(-1), real(1e300), bool(False)
    best_first, best_last, best_arc = wp.vec3d(), wp.vec3d(), real(0.0)
    for piece in range(begin, end):
        one, other = order[path.place + piece], order[path.place + piece + 1]
        if not over_one(path, tables, one, other):
            start, stop = location[path.place + one], location[path.place + other]
            found = wrap_line(
                surface, wrap.method, back * (start - centre), back * (stop - centre), path.wraps > 1
            )
            status = found.status
            if status > NONE:
                onto, off = centre + turned * found.first, centre + turned * found.last
                change = detour(start, onto, stop, off) + found.length
                if status == WRAPPED:
                    near = remembered(location, cached, path.place + one)
                    change = detour(near, onto, remembered(location, cached, path.place + other), off)
                    change += found.length
                if not (change <= path.longest):
                    refused = True
                elif status == MANDATORY or change < least:
                    best = piece
                    least = change
                    best_first = onto
                    best_last = off
                    best_arc = found.length
                if status == MANDATORY:
                    break
    kept = count
    if refused and (best < 0 or status == MANDATORY):
        jumps[pathid] = jumps[pathid] + 1
    if best >= 0:
        kept += 2
        for i in range(kept - 1, best + 2, -1):
            order[path.place + i] = order[path.place + i - 2]
        at = path.points + 2 * number
        order[path.place + best + 1] = at
        order[path.place + best + 2] = at + 1
        location[path.place + at] = best_first
        location[path.place + at + 1] = best_last
        memory.arc[worldid, path.first_wrap + number] = best_arc
    return wp.vec2i(kept, status)


@wp.func
def followed(
    path: MusclePath,
    tables: PathTables,
    frames: Frames,
    memory: Followed,
    worldid: int,
    jumps: wp.array[int],
    pathid: int,
) -> int:
    """Iterate a path as OpenSim does, and return of how many places it consists."""
    order, location, cached = memory.order[worldid], memory.location[worldid], memory.cached[worldid]
    unknown = wp.vec3d(real(wp.nan), real(wp.nan), real(wp.nan))
    count = int(0)
    for i in range(path.points + 2 * path.wraps):
        cached[path.place + i] = unknown
        if i < path.points:
            point = tables.points[path.first_point + i]
            location[path.place + i] = placed(point, tables, frames, worldid)
            if is_active(point, frames.value[worldid]):
                order[path.place + count] = i
                count += 1
    jumps[pathid] = 0
    swapped, before = bool(False), real(1e300)
    rounds = wp.where(path.wraps > 1, ROUNDS, wp.min(path.wraps, 1))
    for sweep in range(rounds):
        status0, status1 = int(NONE), int(NONE)
        for place in range(path.wraps):
            number = int(place)
            if swapped and place < 2:
                number = 1 - place
            count = without(order, path.place, count, path.points + 2 * number)
            if tables.surfaces[tables.wraps[path.first_wrap + number].surface].active != 0:
                done = wrapped(path, tables, frames, memory, worldid, number, count, jumps, pathid)
                count = done[0]
                if place == 0:
                    status0 = done[1]
                if place == 1:
                    status1 = done[1]
        length = path_length(path, tables, memory, worldid, count)
        if wp.abs(length - before) < SETTLED:
            break
        before = length
        if sweep == 0 and path.wraps > 1 and status0 == NONE and status1 == INSIDE:
            swapped = True
            count = without(order, path.place, count, path.points)
    return count


@wp.func
def place_handle(path: MusclePath, tables: PathTables, at: int) -> int:
    """Return the handle of a place."""
    if at < path.points:
        return tables.points[path.first_point + at].handle
    return tables.wraps[path.first_wrap + (at - path.points) // 2].handle


@wp.func
def pull_moving(
    path: MusclePath,
    tables: PathTables,
    frames: Frames,
    worldid: int,
    at: int,
    force: wp.vec3d,
    into: wp.array[wp.vec3d],
):
    """Add what moves a moving point along its axes."""
    if at < path.points:
        point = tables.points[path.first_point + at]
        if point.moving >= 0:
            axes = frames.rotation[worldid, point.body] * tables.moving[point.moving].rotation
            into[point.moving] = into[point.moving] + wp.transpose(axes) * force


@wp.func
def polynomial_length(
    path: MusclePath, tables: PathTables, value: wp.array[wp.float64], by_variable: wp.array[wp.float64]
) -> wp.float64:
    """Return sum c x_1^p_1 ... x_n^p_n, and write its derivatives by the variables.

    Terms that differ in the power of the last variable alone are one polynomial of it, by Horner's rule.
    """
    total, slopes, x = real(0.0), Slopes(), Slopes()
    last = path.variables - 1
    for k in range(path.variables):
        x[k] = value[tables.variable[path.first_variable + k]]
    for group in range(path.first_group, path.first_group + path.groups):
        inner, steep = real(0.0), real(0.0)
        for c in range(tables.first_coefficient[group + 1] - 1, tables.first_coefficient[group] - 1, -1):
            steep = steep * x[last] + inner
            inner = inner * x[last] + tables.coefficient[c]
        product, by = real(1.0), Slopes()
        for k in range(last):
            power = tables.power[group, k]
            if power > 0:
                below = real(1.0)
                for _ in range(power - 1):
                    below *= x[k]
                for before in range(k):
                    by[before] = by[before] * below * x[k]
                by[k] = product * real(power) * below
                product *= below * x[k]
        total += product * inner
        slopes += inner * by
        slopes[last] = slopes[last] + product * steep
    for k in range(path.variables):
        by_variable[path.first_variable + k] = slopes[k]
    return total


@wp.kernel(enable_backward=False)
def follow_paths(
    # Params:
    tables: PathTables,
    numbers: wp.array[int],
    # In:
    frames: Frames,
    # Out:
    memory: Followed,
    pulls: Pulls,
):
    """Length = straight pieces + arcs; force, torque = sum over pieces between bodies of +-u, x cross +-u.

    Or the length is a polynomial, with its derivatives by the variables.
    """
    worldid, place = wp.tid()
    pathid = numbers[place]
    path = tables.paths[pathid]
    if path.variables > 0:
        pulls.size[worldid, pathid] = 0
        pulls.length[worldid, pathid] = polynomial_length(
            path, tables, frames.value[worldid], pulls.by_variable[worldid]
        )
        return
    count = followed(path, tables, frames, memory, worldid, pulls.jumps[worldid], pathid)
    pulls.size[worldid, pathid] = count
    pulls.length[worldid, pathid] = path_length(path, tables, memory, worldid, count)
    order, location, cached = memory.order[worldid], memory.location[worldid], memory.cached[worldid]
    force, torque = pulls.force[worldid], pulls.torque[worldid]
    along, within, twist = pulls.along[worldid], pulls.within[worldid], pulls.twist[worldid]
    for i in range(path.first_handle, path.first_handle + path.handles):
        force[i] = wp.vec3d()
        torque[i] = wp.vec3d()
        twist[i] = wp.vec3d()
    for i in range(path.first_point, path.first_point + path.points):
        moving = tables.points[i].moving
        if moving >= 0:
            along[moving] = wp.vec3d()
            within[moving] = wp.vec3d()
    for piece in range(path.place, path.place + count - 1):
        one, other = order[piece], order[piece + 1]
        near, far = path.place + one, path.place + other
        u = wp.normalize(remembered(location, cached, far) - remembered(location, cached, near))
        h1, h2 = place_handle(path, tables, one), place_handle(path, tables, other)
        if h1 != h2:
            force[h1] = force[h1] - u
            torque[h1] = torque[h1] - wp.cross(location[near], u)
            force[h2] = force[h2] + u
            torque[h2] = torque[h2] + wp.cross(location[far], u)
            pull_moving(path, tables, frames, worldid, one, -u, along)
            pull_moving(path, tables, frames, worldid, other, u, along)
        else:
            twist[h1] = twist[h1] + wp.cross(location[far] - location[near], u)
            pull_moving(path, tables, frames, worldid, one, -u, within)
            pull_moving(path, tables, frames, worldid, other, u, within)
