"""The path of a muscle in MuJoCo: sites and wrapping geoms, their length, and the tendon in an `MjSpec`.

A tendon of MuJoCo needs a site between any two geoms, so a path is a row of sites with at most one
surface between neighbours.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from myowarp.osim.convert.tendon.surface import Surface, over_surface
from myowarp.osim.document.elements import MovingPathPoint, Path
from myowarp.osim.document.kinematics import Frames
from myowarp.osim.document.model import GROUND

GEOM_GROUP = 4
"""Group of wrapping geoms for viewers; collision geoms and meshes are in others."""
SITE_GROUP = 4
SIDE_REACH = 1.3
"""Distance of a side site from the centre, in radii: only its direction matters."""
SIDE_MARGIN = 0.005
"""[m] added to that, so that a very small surface has a side site that can be seen."""
CYLINDER_HALF_LENGTH = 0.03
"""[m] of a cylinder as it is drawn; for wrapping it is endless."""
SITE_SIZE = 0.002
"""[m] as drawn."""


@dataclass(frozen=True)
class Via:
    """The path passes a point of the muscle.

    Attributes:
        point: number of the path point, from 0.
    """

    point: int


@dataclass(frozen=True, eq=False)
class Over:
    """The path may wrap over a surface of its own.

    Attributes:
        name: of the wrap object or conditional point that it stands for.
        body: that carries it.
        surface: in the body.
    """

    name: str
    body: str
    surface: Surface


@dataclass(frozen=True)
class TendonPath:
    """The path of one muscle.

    Attributes:
        muscle: name.
        elements: from origin to insertion; first and last are `Via`, and no two `Over` are neighbours.
    """

    muscle: str
    elements: tuple[Via | Over, ...]

    @property
    def surfaces(self) -> list[Over]:
        """The surfaces in order."""
        return [element for element in self.elements if isinstance(element, Over)]

    def with_surfaces(self, surfaces: list[Surface]) -> "TendonPath":
        """Return the same path with other surfaces, in order."""
        left = list(surfaces)
        return replace(
            self,
            elements=tuple(
                replace(element, surface=left.pop(0)) if isinstance(element, Over) else element
                for element in self.elements
            ),
        )


@dataclass(frozen=True, eq=False)
class Lengths:
    """Lengths of a tendon path.

    Attributes:
        length: [m], shape `(n,)`.
        gradients: by surface, see `wrap_mujoco.Path`, each of shape `(n, 7)`.
    """

    length: np.ndarray
    gradients: list[np.ndarray]


def lengths(tendon: TendonPath, points: np.ndarray, frames: Frames) -> Lengths:
    """Return lengths of a tendon path as MuJoCo computes them.

    Args:
        tendon: the path.
        points: of the muscle in ground [m], shape `(n, points, 3)`.
        frames: of the bodies.
    """
    total = np.zeros(len(points))
    gradients = []
    before: Via | None = None
    over: Over | None = None
    for element in tendon.elements:
        if isinstance(element, Over):
            over = element
            continue
        if before is not None:
            ends = points[:, before.point], points[:, element.point]
            if over is None:
                total += np.linalg.norm(ends[0] - ends[1], axis=1)
            else:
                rotation, origin = frames[over.body]
                local = [np.einsum("nji,nj->ni", rotation, end - origin) for end in ends]
                path = over_surface(over.surface, *local)
                total += path.length
                gradients.append(path.gradient)
        before, over = element, None
    return Lengths(total, gradients)


def add_tendon(
    spec: mujoco.MjSpec, tendon: TendonPath, path: Path, moving: Mapping[int, str]
) -> mujoco.MjsTendon:
    """Add the sites, geoms and the spatial tendon of a muscle to a model, named after it.

    Args:
        spec: has all bodies; ground is its world body or a body called `ground`.
        tendon: the path to add.
        path: the muscle's, whose points `Via` numbers.
        moving: name of the massless body that carries each `MovingPathPoint`, by its number.

    Returns:
        The tendon, named like the muscle.
    """
    added = spec.add_tendon(name=tendon.muscle)
    for element in tendon.elements:
        if isinstance(element, Via):
            point = path.points[element.point]
            name = f"{tendon.muscle}-P{element.point + 1}"
            if isinstance(point, MovingPathPoint):
                _add_site(_body(spec, moving[element.point]), name, np.zeros(3))
            else:
                _add_site(_body(spec, point.body), name, point.location)
            added.wrap_site(name)
        else:
            name = f"{tendon.muscle}-{element.name}"
            again = sum(geom.name.split("#")[0] == name for geom in spec.geoms)
            _add_surface(spec, added, element, f"{name}#{again + 1}" if again else name)
    return added


def _body(spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
    body = spec.body(name)
    return spec.worldbody if body is None and name == GROUND else body


def _add_site(body: mujoco.MjsBody, name: str, position: np.ndarray) -> None:
    body.add_site(name=name, pos=position, size=[SITE_SIZE] * 3, group=SITE_GROUP)


def _add_surface(spec: mujoco.MjSpec, added: mujoco.MjsTendon, over: Over, name: str) -> None:
    """Add a geom, and its side site where it has one, to the end of a tendon."""
    body, surface = _body(spec, over.body), over.surface
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(surface.rotation).ravel())
    sphere = surface.kind == "sphere"
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_SPHERE if sphere else mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=surface.centre,
        quat=quaternion,
        size=[surface.radius, 0.0 if sphere else CYLINDER_HALF_LENGTH, 0.0],
        contype=0,
        conaffinity=0,
        mass=0.0,
        group=GEOM_GROUP,
        rgba=[0.3, 0.6, 0.8, 0.3],
    )
    side = ""
    if surface.inside or surface.side is not None:
        side = f"{name}-side"
        reach = SIDE_REACH * surface.radius + SIDE_MARGIN
        offset = np.zeros(3) if surface.side is None else reach * surface.side
        _add_site(body, side, surface.centre if surface.inside else surface.centre + offset)
    added.wrap_geom(name, side)
