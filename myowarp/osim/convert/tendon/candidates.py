"""Surfaces that may stand between two sites of a tendon, from the reference path in many poses.

Between two sites there is nothing or one surface: a conditional point as a small sphere that the path may
leave to one side, or an object as it is, or as a similar sphere or cylinder, with each class of winding
that its quadrant or the data show.
"""

from dataclasses import dataclass

import numpy as np

from myowarp.osim.body.described import quadrant
from myowarp.osim.body.path_solution import Solution
from myowarp.osim.convert.tendon.path import Over
from myowarp.osim.convert.tendon.surface import Surface, dot, unit
from myowarp.osim.document.elements import ConditionalPathPoint, Path
from myowarp.osim.document.kinematics import Frames
from myowarp.osim.document.model import Model, WrapObject

TINY = 0.001
"""[m] radius of a sphere that stands for a conditional point."""
RADII = (TINY, 0.01, 0.03)
"""[m] of spheres that touch a conditional point and from which a fit starts."""
TILTS = np.deg2rad([0, -20, 20, -40, 40, -60, 60, -75, 75])
"""[rad] between the side of such a sphere and the mean direction to it: a tilted side lets go of a path that
bends sharply, as OpenSim lets go of a point beyond its range."""
RARE = 0.002
"""Share of poses below which a wrap or a conditional point is left out."""


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


def always(observed: Observed) -> list[int]:
    """Return the points that the path always passes; its ends count as such."""
    points = observed.path.points
    return [
        number
        for number, point in enumerate(points)
        if not isinstance(point, ConditionalPathPoint)
        or observed.active[:, number].mean() > 1 - RARE
        or number in (0, len(points) - 1)
    ]


def sometimes(observed: Observed) -> list[int]:
    """Return the conditional points that the path passes in some poses only."""
    rest = set(range(len(observed.path.points))) - set(always(observed))
    return [number for number in sorted(rest) if observed.active[:, number].mean() > RARE]


def surfaces(observed: Observed, first: int, last: int) -> list[Over]:
    """Return the surfaces that may stand between two neighbouring sites, given as numbers of points."""
    found = []
    for number in sometimes(observed):
        if first < number < last:
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
    assert isinstance(point, ConditionalPathPoint)
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
            upright = surface.rotation[:, 2]
            outward = outward - (outward @ upright)[:, None] * upright
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
