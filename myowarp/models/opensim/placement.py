"""Which surfaces stand between which points of a tendon path, as far as that is a matter of counting.

From the reference path in many poses: which points are always part of it, which object it wraps over and
after which point. Between two points that it always passes there is a gap. What may stand in a gap is
enumerated: nothing, a conditional point as a site or as a tiny sphere that the path may leave to one side,
an object as it is or as a similar sphere or cylinder, with each class of winding that the data show.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from myowarp.models.opensim.elements import ConditionalPathPoint, Path
from myowarp.models.opensim.kinematics import Frames
from myowarp.models.opensim.model import Model, WrapObject
from myowarp.models.opensim.path import Solution, quadrant
from myowarp.models.opensim.tendon import Over, Via
from myowarp.models.opensim.wrap_cylinder import dot, unit
from myowarp.models.opensim.wrap_mujoco import Surface

TINY = 0.001
"""[m] radius of a sphere that stands for a conditional point."""
RADII = (TINY, 0.01, 0.03)
"""[m] of spheres that touch a conditional point and from which a fit starts."""
TILTS = np.deg2rad([0, -20, 20, -40, 40, -60, 60, -75, 75])
"""[rad] between the side of such a sphere and the mean direction to it: a tilted side lets go of a path that
bends sharply, as OpenSim lets go of a point beyond its range."""
RARE = 0.002
"""Share of poses below which a wrap or a conditional point is left out."""
MAX_CONDITIONAL = 5
"""Conditional points in one gap of which all subsets are tried."""

Elements = tuple[Via | Over, ...]


@dataclass(frozen=True, eq=False)
class Observed:
    """A muscle's reference path in n poses.

    Attributes:
        model: to which it belongs.
        path: of the muscle.
        frames: of the bodies.
        points: of the path in ground [m], shape `(n, points, 3)`.
        active: which points are part of it, shape `(n, points)`.
        solution: OpenSim's path.
    """

    model: Model
    path: Path
    frames: Frames
    points: np.ndarray
    active: np.ndarray
    solution: Solution


def gaps(observed: Observed) -> list[tuple[int, int]]:
    """Return pairs of neighbouring points that are always part of the path."""
    always = [
        number
        for number, point in enumerate(observed.path.points)
        if not isinstance(point, ConditionalPathPoint) or observed.active[:, number].mean() > 1 - RARE
    ]
    return list(zip(always[:-1], always[1:], strict=True))


def fillings(observed: Observed, gap: tuple[int, int]) -> list[Elements]:
    """Return what may stand between two points, the points left out."""
    first, last = gap
    inner = [n for n in range(first + 1, last) if observed.active[:, n].mean() > RARE][:MAX_CONDITIONAL]
    found = []
    for count in range(len(inner) + 1):
        for sites in combinations(inner, count):
            ends = [first, *sites, last]
            found += list(_rows(observed, list(zip(ends[:-1], ends[1:], strict=True))))
    return found


def _rows(observed: Observed, pieces: list[tuple[int, int]]) -> Iterator[Elements]:
    """Return all rows of elements over pieces that meet in sites, with at most one surface in each."""
    (first, last), rest = pieces[0], pieces[1:]
    tails = [(Via(last), *tail) for tail in _rows(observed, rest)] if rest else [()]
    for surface in (None, *_surfaces(observed, first, last)):
        for tail in tails:
            yield tail if surface is None else (surface, *tail)


def _surfaces(observed: Observed, first: int, last: int) -> list[Over]:
    """Return the surfaces that may stand between two points."""
    found = []
    for number in range(first + 1, last):
        if observed.active[:, number].mean() > RARE:
            found += _of_conditional(observed, first, number, last)
    for number, wrap in enumerate(observed.path.wraps):
        here = observed.solution.before(number)
        here = (here >= first) & (here < last)
        if here.mean() > RARE:
            found += _of_object(observed, number, observed.model.wraps[wrap.object], here)
    return found


def _of_conditional(observed: Observed, first: int, number: int, last: int) -> list[Over]:
    """Return spheres that touch a conditional point, their side away from the line that skips it."""
    point = observed.path.points[number]
    active = observed.active[:, number]
    start, end, here = (observed.points[active, n] for n in (first, last, number))
    along = end - start
    t = np.clip(dot(here - start, along) / np.maximum(dot(along, along), 1e-12), 0.0, 1.0)
    away = here - (start + t[:, None] * along)
    rotation = observed.frames[point.body][0][active]
    side, normal = (
        unit(np.einsum("nji,nj->i", rotation, unit(vectors))) for vectors in (away, np.cross(along, away))
    )
    across = np.cross(normal, side)
    spheres = [
        Surface(
            "sphere",
            point.location - (radius - TINY) * side,
            np.eye(3),
            radius,
            unit(np.cos(tilt) * side + np.sin(tilt) * across),
        )
        for radius in RADII
        for tilt in TILTS
    ]
    return [Over(f"P{number + 1}", point.body, sphere) for sphere in spheres]


def _of_object(observed: Observed, number: int, wrap: WrapObject, here: np.ndarray) -> list[Over]:
    """Return surfaces for a wrap object, with the sides that the data and its quadrant show."""
    count = len(observed.path.points) + 2 * number
    rotation, origin = (values[here] for values in observed.frames[wrap.body])
    middle = observed.solution.location[here, count] + observed.solution.location[here, count + 1]
    touched = np.einsum("nji,nj->ni", rotation, middle / 2 - origin)
    found = []
    for surface in _shapes(wrap, touched):
        if surface.inside:
            found.append(surface)
            continue
        outward = touched - surface.centre
        if surface.kind == "cylinder":
            axis = surface.rotation[:, 2]
            outward = outward - (outward @ axis)[:, None] * axis
        sides = [None, unit(unit(outward).mean(axis=0))]
        axis, sign = quadrant(wrap.quadrant)
        if sign and wrap.kind != "torus":
            sides.append(sign * wrap.frame.rotation[:, axis])
        for side in sides:
            if side is None or np.linalg.norm(side) > 0.5:
                found.append(Surface(surface.kind, surface.centre, surface.rotation, surface.radius, side))
    return [Over(wrap.name.replace("/", "-"), wrap.body, surface) for surface in found]


def _shapes(wrap: WrapObject, touched: np.ndarray) -> list[Surface]:
    """Return spheres and cylinders like a wrap object, without sides."""
    centre, rotation = wrap.frame.position, wrap.frame.rotation
    if wrap.kind in ("cylinder", "sphere"):
        return [Surface(wrap.kind, centre, rotation, wrap.size[0])]
    if wrap.kind == "torus":
        return _of_torus(wrap, touched)
    radii = np.array(wrap.size)
    found = [Surface("sphere", centre, rotation, radius) for radius in sorted(set(radii))]
    for axis in range(3):
        others = [(axis + 1) % 3, (axis + 2) % 3]
        turned = rotation[:, [*others, axis]]
        found.append(Surface("cylinder", centre, turned, float(np.sqrt(radii[others].prod()))))
    return found


def _of_torus(wrap: WrapObject, touched: np.ndarray) -> list[Surface]:
    """Return the hole as a sphere to pass through, and the tube as a cylinder where it is touched."""
    tube, ring = wrap.size
    centre, rotation = wrap.frame.position, wrap.frame.rotation
    found = []
    if ring > tube:
        found.append(Surface("sphere", centre, rotation, ring - tube, None, True))
    local = (touched - centre) @ rotation
    outward = unit(unit(local * [1.0, 1.0, 0.0]).mean(axis=0))
    if np.linalg.norm(outward) > 0.5:
        along = np.cross([0.0, 0.0, 1.0], outward)
        frame = np.stack([outward, [0.0, 0.0, 1.0], -along], axis=1)
        found.append(Surface("cylinder", centre + rotation @ (ring * outward), rotation @ frame, tube))
    return found
