"""Parts of an OpenSim model that paths and forces are made of; conventions as in `model`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from myowarp.laws.expressions import Expression
from myowarp.osim.document.functions import Function

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and orientation of a frame in a body."""

    position: Array
    """Origin [m], shape (3,)."""
    rotation: Array
    """Axes of the frame as columns [1], shape (3, 3)."""

    def __matmul__(self, other: "Pose") -> "Pose":
        """Return the pose of a frame that is given in this frame."""
        return Pose(self.position + self.rotation @ other.position, self.rotation @ other.rotation)

    def inverse(self) -> "Pose":
        """Return the pose of the body in this frame."""
        return Pose(-self.rotation.T @ self.position, self.rotation.T)

    def point(self, location: Array) -> Array:
        """Return a point of this frame in the body [m]."""
        return self.position + self.rotation @ location


@dataclass(frozen=True, eq=False)
class PathPoint:
    """A point fixed in a body."""

    name: str
    body: str
    location: Array
    """[m], in the body."""


@dataclass(frozen=True, eq=False)
class ConditionalPathPoint:
    """A point that is part of the path only while a coordinate is in a range (ends included)."""

    name: str
    body: str
    location: Array
    """[m], in the body."""
    coordinate: str
    range: tuple[float, float]
    """[rad] or [m]."""


@dataclass(frozen=True, eq=False)
class MovingPathPoint:
    """A point whose location is a function of coordinates, one for each axis of its frame."""

    name: str
    body: str
    frame: Pose
    """Frame in the body in which x, y, z are given; mostly the body itself."""
    functions: tuple[Function, Function, Function]
    """x, y, z [m]."""
    coordinates: tuple[str | None, str | None, str | None]
    """Argument of each function; None where it is constant."""


Point = PathPoint | ConditionalPathPoint | MovingPathPoint


@dataclass(frozen=True)
class PathWrap:
    """A path may wrap over an object."""

    object: str
    """Key in `Model.wraps`."""
    method: Literal["hybrid", "midpoint", "axial"]
    """Concerns ellipsoids only."""
    range: tuple[int, int]
    """First and last path point, counted from 1, between which the path may wrap; -1: the end."""


@dataclass(frozen=True)
class LengthFunction:
    """The length of a path as a polynomial: a sum of c x_1^p_1 ... x_n^p_n, each x of one coordinate."""

    coordinates: tuple[str, ...]
    functions: tuple[Function, ...]
    """x_i of coordinate i [rad] or [m]; mostly the coordinate itself."""
    coefficients: tuple[float, ...]
    """Of each term [m]."""
    powers: tuple[tuple[int, ...], ...]
    """Of each term, one for each x."""

    def at(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the length [m], shape (n,), and its derivatives by the coordinates, (coordinates, n).

        Args:
            values: Of the coordinates [rad] or [m], each of shape (n,).
        """
        chosen = [values[name] for name in self.coordinates]
        pairs = list(zip(self.functions, chosen, strict=True))
        x = np.stack([function.value(value) for function, value in pairs])
        inner = np.stack([function.derivative(value) for function, value in pairs])
        powers = np.array(self.powers)[:, :, None]
        factors = x**powers
        length = self.coefficients @ factors.prod(axis=1)
        slopes = np.empty_like(x)
        for k in range(len(x)):
            below = factors.copy()
            below[:, k] = powers[:, k] * x[k] ** np.maximum(powers[:, k] - 1, 0)
            slopes[k] = self.coefficients @ below.prod(axis=1)
        return length, slopes * inner


@dataclass(frozen=True)
class Path:
    """Points from origin to insertion, and objects to wrap over; or a length that is a function."""

    points: tuple[Point, ...]
    wraps: tuple[PathWrap, ...]
    function: LengthFunction | None = None
    """Of coordinates, in place of points and objects."""


@dataclass(frozen=True)
class CoordinateActuator:
    """Drives a coordinate with optimal_force * control."""

    name: str
    coordinate: str
    optimal_force: float
    """[N m] or [N]."""
    control_range: tuple[float, float]


@dataclass(frozen=True)
class PathActuator:
    """Pulls along a path with optimal_force * control, without muscle dynamics."""

    name: str
    path: Path
    optimal_force: float
    """[N]."""
    control_range: tuple[float, float]


@dataclass(frozen=True, eq=False)
class BodyActuator:
    """Drives a body with a force at a point, or with a torque, of optimal_force * control."""

    name: str
    kind: Literal["point", "torque"]
    body: str
    """Body on which the force acts."""
    reaction: str
    """Body on which its opposite acts."""
    location: Array
    """Of a force [m], in the body."""
    axis: Array
    """Unit direction, in the body or in ground."""
    in_ground: bool
    """Whether the axis is fixed in ground, not in the body."""
    optimal_force: float
    """[N] or [N m]."""
    control_range: tuple[float, float]


LEAST_TRANSITION = 1e-6
"""rad or m: a limit that sets in at once does so over this."""


@dataclass(frozen=True)
class CoordinateLimitForce:
    """Springs that push a coordinate back from its limits."""

    name: str
    coordinate: str
    limits: tuple[float, float]
    """Low, high [rad] or [m]."""
    stiffness: tuple[float, float]
    """At the low, at the high limit [N m/rad] or [N/m]."""
    damping: float
    """[N m s/rad] or [N s/m]."""
    transition: float
    """Width over which a spring sets in [rad] or [m]."""


@dataclass(frozen=True)
class CoordinateSpring:
    """A linear spring and damper on a coordinate."""

    name: str
    coordinate: str
    stiffness: float
    """[N m/rad] or [N/m]."""
    rest: float
    """[rad] or [m]."""
    damping: float
    """[N m s/rad] or [N s/m]."""


@dataclass(frozen=True)
class CoordinateFormula:
    """A force on a coordinate that is a formula of its value and speed."""

    name: str
    coordinate: str
    formula: Expression
    """[N m] or [N] of [rad] or [m], and [rad/s] or [m/s]."""


@dataclass(frozen=True, eq=False)
class PrescribedForce:
    """A force at a point of a body, and a torque on it, that are functions of time."""

    name: str
    body: str
    formulas: tuple[Expression, ...]
    """Force [N], point [m] and torque [N m], x, y, z each, of time [s]."""
    frame: Pose
    """In the body: axes of what is not in ground."""
    force_in_ground: bool
    """Whether force and torque are along ground's axes."""
    point_in_ground: bool


@dataclass(frozen=True, eq=False)
class Bushing:
    """Springs and dampers between two frames, along and about the three axes."""

    name: str
    bodies: tuple[str, str]
    frames: tuple[Pose, Pose]
    rotational_stiffness: Array
    """[N m/rad], shape (3,)."""
    translational_stiffness: Array
    """[N/m], shape (3,)."""
    rotational_damping: Array
    """[N m s/rad], shape (3,)."""
    translational_damping: Array
    """[N s/m], shape (3,)."""
    type: str = "BushingForce"
    """OpenSim's class."""
    formulas: tuple[Expression, ...] = ()
    """Of the three angles and three distances: the three moments [N m] and forces [N] that spring against
    these, in place of stiffness."""


@dataclass(frozen=True)
class Ligament:
    """A passive path: pulls with `force(length)` [N], length [m]."""

    name: str
    type: str
    """OpenSim's class, such as `Ligament`."""
    path: Path
    resting_length: float
    """[m]; no force below."""
    force: Function
    """Tension at rest [N] over length / resting_length [1]."""
    dissipation: float
    """By how much of that it grows with the speed of lengthening [s/m]."""
    damping: float
    """Its increase by lengthening, beyond a strain of 0.01 [N s/m]."""
    formula: Expression | None = None
    """Tension [N] of length [m] and its speed [m/s], in place of all that, below the resting length, too."""


@dataclass(frozen=True)
class ContactParameters:
    """Contact geometries of one material."""

    geometries: tuple[str, ...]
    """Names of shapes."""
    stiffness: float
    """Plane strain modulus [N/m^2]."""
    dissipation: float
    """[s/m]."""
    static_friction: float
    """[1]."""
    dynamic_friction: float
    """[1]."""
    viscous_friction: float
    """[s/m]."""


@dataclass(frozen=True)
class ContactForce:
    """Pushes contact geometries apart that overlap."""

    name: str
    type: str
    """OpenSim's class."""
    parameters: tuple[ContactParameters, ...]
    transition_velocity: float
    """Slip from which dynamic friction acts [m/s]."""
    smoothing: tuple[float, ...] = ()
    """Of a SmoothSphereHalfSpaceForce: constant contact force [m^2] and smoothing of Hertz's force [1/m] and
    of Hunt and Crossley's [s/m]; of others nothing."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Something to look at, or (`contact`) to collide with."""

    name: str
    kind: Literal["mesh", "sphere", "cylinder", "ellipsoid", "box", "plane"]
    body: str
    frame: Pose
    """Cylinder: the axis is y, as in OpenSim; plane: the normal is -x, its inside +x."""
    size: Array
    """Mesh: scale [1]; sphere: radius; cylinder: radius, half length; others: half sizes [m]."""
    file: str | None
    """Of a mesh, as the model names it."""
    rgba: tuple[float, float, float, float]
    contact: bool
