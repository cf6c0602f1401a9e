"""A musculoskeletal model as OpenSim describes it, whatever version of the file format it came from.

Frames are resolved while reading: every point, wrap object, marker and joint frame is given in a body
(or in `GROUND`), never in an offset frame. A joint is a chain of slides and hinges, so that no later
stage knows OpenSim's joint classes. Units are SI and radians, also where the file uses degrees;
vectors are float64 arrays of shape (3,), rotations (3, 3) with the axes of the frame as columns.
Dictionaries keep the order of the file; joints are ordered parents first.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Literal

import numpy as np

from myowarp.osim.document.elements import (
    BodyActuator,
    Bushing,
    ContactForce,
    CoordinateActuator,
    CoordinateFormula,
    CoordinateLimitForce,
    CoordinateSpring,
    Ligament,
    Path,
    PathActuator,
    Pose,
    PrescribedForce,
    Shape,
)
from myowarp.osim.document.functions import Function

GROUND = "ground"
UNBOUNDED = 2 * math.pi
"""A coordinate whose stated range is wider on one side [rad, m] was given none by its author."""
DEFAULT_REACH = {True: math.pi / 2, False: 0.5}
"""Sampled to both sides of the default where there is no range; by `rotational` [rad, m]."""

Array = np.ndarray


@dataclass(frozen=True)
class Note:
    """One thing that was not carried over exactly."""

    path: str
    """Element, such as `/forceset/vasti_r` or `knee_r/knee_angle_r`."""
    rule: str
    """The replacement, one sentence."""
    error_bound: str | None = None
    """Bound of the error, with its unit; None: not bounded."""


@dataclass(frozen=True)
class Loss(Note):
    """Something that acts in the document and not, or not as there, in the result."""

    code: str = ""
    """Word that accepts it: OpenSim's class, or a word of ours."""
    effect: Literal["force", "motion", "mass", "contact", "control"] = "force"
    """Kind of change."""
    largest: float | None = None
    """Its greatest force in the poses of the check; None: not measured."""
    unit: str = "N"
    """Of that."""
    names: frozenset[str] = frozenset()
    """Words of its element, of paths the last part; coordinates and bodies that it names are among them."""


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body."""

    name: str
    mass: float
    """[kg], may be 0."""
    mass_center: Array
    """[m], in the body."""
    inertia: Array
    """xx yy zz xy xz yz about the mass centre [kg m^2], shape (6,)."""


@dataclass(frozen=True, eq=False)
class Move:
    """One elementary motion of a joint: a slide along, or a hinge about, an axis by `function(q)`."""

    kind: Literal["slide", "hinge"]
    axis: Array
    """Unit vector in the frame that all earlier moves have carried along, shape (3,)."""
    function: Function
    """Distance [m] or angle [rad] as a function of the coordinate."""
    coordinate: str | None
    """Name of its coordinate; None for a constant."""


@dataclass(frozen=True, eq=False)
class Joint:
    """Connects a frame of the parent to a frame of the child by a chain of moves.

    Pose of the child in the parent = parent_frame @ moves[0] @ ... @ moves[-1] @ inverse(child_frame).
    """

    name: str
    type: str
    """OpenSim's class, such as `CustomJoint`."""
    parent: str
    """Body, or `GROUND`."""
    child: str
    parent_frame: Pose
    child_frame: Pose
    moves: tuple[Move, ...]


@dataclass(frozen=True)
class Coordinate:
    """A generalised coordinate."""

    name: str
    joint: str
    rotational: bool
    """Whether it is an angle [rad]; else a length [m]."""
    default: float
    """[rad] or [m]."""
    range: tuple[float, float]
    """Low, high [rad] or [m]; meaningless where nobody set it."""
    clamped: bool
    """Whether the range is a limit."""
    locked: bool
    """Whether it stays at its default."""

    @property
    def sampling_range(self) -> tuple[float, float]:
        """Low and high between which it is sampled and fitted [rad] or [m]."""
        if self.locked:
            return self.default, self.default
        low, high = self.range
        reach = DEFAULT_REACH[self.rotational]
        low = self.default - reach if low < -UNBOUNDED else low
        high = self.default + reach if high > UNBOUNDED else high
        return (low, high) if low < high else (self.default - reach, self.default + reach)


@dataclass(frozen=True)
class Coupler:
    """dependent = function(independent)."""

    name: str
    dependent: str
    independent: str
    function: Function


@dataclass(frozen=True, eq=False)
class Constraint:
    """A constraint between bodies other than a coupler: it closes a loop."""

    name: str
    kind: Literal["weld", "point"]
    bodies: tuple[str, str]
    frames: tuple[Pose, Pose]
    """Frames that coincide (weld), or whose origins do (point)."""


@dataclass(frozen=True, eq=False)
class WrapObject:
    """A surface that muscle paths wrap over."""

    name: str
    """Unique in the model: `body/name` where a body before it uses the same name."""
    kind: Literal["cylinder", "sphere", "ellipsoid", "torus"]
    body: str
    frame: Pose
    """Cylinder and torus: the axis is z."""
    size: tuple[float, ...]
    """[m]: cylinder (radius, length), sphere (radius,), ellipsoid (three half axes), torus (radius of
    the tube, radius of its centre line)."""
    quadrant: str
    """all, x, y, z (or +x, ...), -x, -y, -z: the half that a path may use."""
    active: bool


@dataclass(frozen=True)
class Muscle:
    """A muscle, with every parameter that its class has, as the file says or by the class's default."""

    name: str
    type: str
    """OpenSim's class, such as `Thelen2003Muscle`."""
    path: Path
    max_isometric_force: float
    """[N]."""
    optimal_fiber_length: float
    """[m]."""
    tendon_slack_length: float
    """[m]."""
    pennation_angle_at_optimal: float
    """[rad]."""
    max_contraction_velocity: float
    """[optimal fiber lengths / s]."""
    ignore_tendon_compliance: bool
    ignore_activation_dynamics: bool
    control_range: tuple[float, float]
    """Least and greatest excitation [1]."""
    applies_force: bool
    """False: switched off in the file."""
    parameters: Mapping[str, float]
    """All other numbers of the class, under OpenSim's names (`FmaxTendonStrain`, `fiber_damping`,
    `default_activation`, ...); those of a nested curve as `ForceVelocityCurve.isometric_slope`.
    A switch is 0 or 1."""
    curves: Mapping[str, Function]
    """Functions of the class (`Schutte1993Muscle_Deprecated`), under OpenSim's names."""
    given: frozenset[str]
    """Names of parameters, also of the fields above, that the file states; the others are defaults."""


@dataclass(frozen=True, eq=False)
class Marker:
    """A point of interest fixed in a body."""

    name: str
    body: str
    location: Array
    """[m], in the body."""


@dataclass(frozen=True)
class Model:
    """Everything that is read from one file."""

    name: str
    source: FilePath
    version: int
    """Of the document: 10901 to 40600."""
    credits: str
    publications: str
    length_units: str
    force_units: str
    gravity: Array
    """In ground [m/s^2], shape (3,)."""
    bodies: Mapping[str, Body]
    """Without ground."""
    joints: Mapping[str, Joint]
    """Every body is the child of one; parents first."""
    coordinates: Mapping[str, Coordinate]
    couplers: Mapping[str, Coupler]
    """By dependent coordinate."""
    constraints: tuple[Constraint, ...]
    wraps: Mapping[str, WrapObject]
    muscles: Mapping[str, Muscle]
    ligaments: Mapping[str, Ligament]
    markers: Mapping[str, Marker]
    coordinate_actuators: tuple[CoordinateActuator, ...]
    path_actuators: tuple[PathActuator, ...]
    body_actuators: tuple[BodyActuator, ...]
    limit_forces: tuple[CoordinateLimitForce, ...]
    coordinate_springs: tuple[CoordinateSpring, ...]
    bushings: tuple[Bushing, ...]
    contact_forces: tuple[ContactForce, ...]
    """Contact forces that act; see `contacts.resting`."""
    shapes: tuple[Shape, ...]
    coordinate_formulas: tuple[CoordinateFormula, ...] = ()
    prescribed_forces: tuple[PrescribedForce, ...] = ()
    notes: tuple[Note, ...] = field(default=())
    """Skipped and approximated elements of the file."""
    frames: Mapping[str, tuple[str, Pose]] = field(default_factory=dict)
    """Body of each frame whose name no other has, bodies and ground included, and the frame in it."""

    @property
    def mass(self) -> float:
        """Of all bodies [kg]."""
        return sum(body.mass for body in self.bodies.values())

    @property
    def independent(self) -> list[str]:
        """The coordinates that are free: neither locked nor driven by a coupler."""
        return [
            name
            for name, coordinate in self.coordinates.items()
            if not coordinate.locked and name not in self.couplers
        ]

    @property
    def pulling(self) -> dict[str, Path]:
        """The paths of all muscles, ligaments and path actuators, by name."""
        paths = {name: muscle.path for name, muscle in self.muscles.items()}
        paths.update((name, ligament.path) for name, ligament in self.ligaments.items())
        paths.update((actuator.name, actuator.path) for actuator in self.path_actuators)
        return paths
