"""Springs and dampers that a model brings along: the text `forces`, `forces.json` of `myowarp convert`.

It has OpenSim's limits of coordinates, ligaments and path springs, bushings, formulas and prescribed forces
(`laws.forces`), along the model's joints and tendons and on its bodies, and names the springs and dampers
that stand for them in plain MuJoCo (`coordinates.own_forces`).
"""

import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Self

import mujoco
import numpy as np
import warp as wp

from myowarp.kernels.structs import struct_array
from myowarp.laws.expressions import Expression, added
from myowarp.laws.forces import bushing as bushing_law
from myowarp.laws.forces import ligament as ligament_law
from myowarp.laws.paths.tables import Rows, Vector
from myowarp.laws.pieces import Pieces
from myowarp.osim.bundle.couplings import driven
from myowarp.osim.bundle.paths import frozen
from myowarp.osim.bundle.text import Sidecar, scalar_joints
from myowarp.osim.document.elements import Ligament


@dataclasses.dataclass(frozen=True)
class JointLimit:
    """Spring and damper beyond limits; as `laws.forces.coordinate_limit.CoordinateLimit`.

    Attributes:
        joint: Name of the hinge or slide.
    """

    joint: str
    low: float
    high: float
    low_stiffness: float
    high_stiffness: float
    damping: float
    transition: float


@dataclasses.dataclass(frozen=True)
class TendonSpring:
    """A ligament; as `laws.forces.ligament.Ligament`.

    Attributes:
        tendon: Name of the tendon.
        curves: Its force over length / resting length is last(...(first(that))) [N].
    """

    tendon: str
    resting_length: float
    dissipation: float
    damping: float
    curves: tuple[Pieces, ...]
    formula: Expression | None = None


@dataclasses.dataclass(frozen=True)
class JointPush:
    """A force along a coordinate that is a formula of its value and speed.

    Attributes:
        joint: Name of the hinge or slide.
        scale: What it has for each unit of the coordinate.
        formula: The force along the coordinate.
    """

    joint: str
    scale: float
    formula: Expression


@dataclasses.dataclass(frozen=True)
class BodyBushing:
    """A bushing between two bodies; as `laws.forces.bushing.Bushing`.

    Attributes:
        bodies: Names.
        rotations: Axes of the two frames in these, by rows.
        origins: Origins of the frames [m].
        formulas: Six, in place of stiffness, or none.
    """

    bodies: tuple[str, str]
    rotations: tuple[Rows, Rows]
    origins: tuple[Vector, Vector]
    turn_stiffness: Vector
    shift_stiffness: Vector
    turn_damping: Vector
    shift_damping: Vector
    formulas: tuple[Expression, ...] = ()


@dataclasses.dataclass(frozen=True)
class BodyPush:
    """A force at a point of a body and a torque on it, which are functions of time.

    Attributes:
        body: Its name.
        ground: Name of the body whose axes are ground's.
        rotation: Of the frame whose axes are meant, by rows.
        origin: Of that frame in the body [m].
        force_in_ground: Whether force and torque are along ground's axes.
        point_in_ground: The same of the point.
        formulas: Force, point and torque, x, y, z each.
    """

    body: str
    ground: str
    rotation: Rows
    origin: Vector
    force_in_ground: bool
    point_in_ground: bool
    formulas: tuple[Expression, ...]


@dataclasses.dataclass(frozen=True)
class PassiveForces(Sidecar):
    """Forces beside muscles and motors in an OpenSim document, in terms of a MuJoCo model.

    Attributes:
        limits: Beyond which joints are pushed back.
        ligaments: Tendons that pull by themselves.
        springs: Tendons whose own springs stand for these forces in plain MuJoCo.
        dampers: Damping that stands for them, by joint [N m s/rad or N s/m].
        bare: Stiffness and resting place of joints without springs that stand for them.
        pushes: Of coordinates.
        bushings: That are no springs of joints.
        body_pushes: Of bodies.
    """

    NAME, FILE = "forces", "forces.json"
    KEYS = "'limits', 'ligaments', 'springs' and 'dampers'"
    limits: tuple[JointLimit, ...] = ()
    ligaments: tuple[TendonSpring, ...] = ()
    springs: tuple[str, ...] = ()
    dampers: Mapping[str, float] = dataclasses.field(default_factory=dict)
    bare: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    pushes: tuple[JointPush, ...] = ()
    bushings: tuple[BodyBushing, ...] = ()
    body_pushes: tuple[BodyPush, ...] = ()

    @property
    def acts(self) -> bool:
        """Whether anything is in it."""
        return bool(self.limits or self.ligaments or self.pushes or self.bushings or self.body_pushes)

    @property
    def bodies_apart(self) -> Iterable[str]:
        """Bodies that bushings are fixed to, and that are pushed."""
        return (
            *(name for one in self.bushings for name in one.bodies),
            *(name for p in self.body_pushes for name in (p.body, p.ground)),
        )

    @classmethod
    def from_entry(cls, entry: Any) -> Self:
        """Return what parsed JSON says; see `Sidecar.from_entry`."""
        limits = tuple(JointLimit(**limit) for limit in entry["limits"])
        ligaments = tuple(
            TendonSpring(
                **ligament
                | {"curves": driven({"of": None, "curves": ligament["curves"]})[1]}
                | {"formula": Expression.from_entry(ligament["formula"]) if ligament.get("formula") else None}
            )
            for ligament in entry["ligaments"]
        )

        def others(name: str, kind: Any) -> Any:
            """Return the forces of a kind."""
            return tuple(kind(**frozen(one) | formulas_of(one)) for one in entry.get(name, ()))

        bare = {str(joint): (float(k), float(at)) for joint, (k, at) in entry.get("bare", {}).items()}
        dampers = {str(joint): float(damping) for joint, damping in entry["dampers"].items()}
        springs = tuple(map(str, entry["springs"]))
        found = cls(
            *(limits, ligaments, springs, dampers, bare),
            pushes=others("pushes", JointPush),
            bushings=others("bushings", BodyBushing),
            body_pushes=others("body_pushes", BodyPush),
        )
        _check(found)
        return found

    def as_json(self) -> str:
        """Return the text."""
        ligaments = [
            vars(ligament)
            | {"curves": [curve.entry() for curve in ligament.curves]}
            | {"formula": None if ligament.formula is None else ligament.formula.entry()}
            for ligament in self.ligaments
        ]
        limits = [vars(limit) for limit in self.limits]
        instead = {"springs": self.springs, "dampers": dict(self.dampers), "bare": dict(self.bare)}
        others = {
            name: [vars(one) | entry_of_formulas(one) for one in getattr(self, name)]
            for name in ("pushes", "bushings", "body_pushes")
        }
        return json.dumps({"limits": limits, "ligaments": ligaments, **instead, **others})

    def check(self, model: mujoco.MjModel) -> None:
        """Raise ValueError if it names what a model has not."""
        joints = {*(limit.joint for limit in self.limits), *(push.joint for push in self.pushes)}
        joints |= {*self.dampers, *self.bare}
        self.check_named("body", self.bodies_apart, {model.body(i).name for i in range(model.nbody)})
        tendons = {*(ligament.tendon for ligament in self.ligaments), *self.springs}
        self.check_named("hinge or slide", joints, scalar_joints(model))
        self.check_named("tendon", tendons, {model.tendon(i).name for i in range(model.ntendon)})


def bushing_table(
    bushings: Iterable[BodyBushing], number: Callable[[str], int], formulas: list[Expression]
) -> wp.array:
    """Return bushings on the current device, of the numbers of their bodies; their formulas are appended."""
    rows = [
        (
            *map(number, one.bodies),
            *(part for pair in zip(one.rotations, one.origins, strict=True) for part in pair),
            *(one.turn_stiffness, one.shift_stiffness, one.turn_damping, one.shift_damping),
            added(formulas, one.formulas),
        )
        for one in bushings
    ]
    return struct_array(bushing_law.Bushing, rows)


def ligament_table(
    ligaments: Iterable[TendonSpring | Ligament], numbers: Iterable[int], formulas: list[Expression]
) -> wp.array:
    """Return ligaments on the current device, of the numbers of their paths; their formulas are appended."""
    rows = [
        (
            *(number, one.resting_length, one.dissipation, one.damping),
            added(formulas, () if one.formula is None else (one.formula,)),
        )
        for number, one in zip(numbers, ligaments, strict=True)
    ]
    return struct_array(ligament_law.Ligament, rows)


def formulas_of(entry: dict[str, Any]) -> dict[str, Any]:
    """Return the formulas of parsed JSON."""
    if "formula" in entry:
        return {"formula": Expression.from_entry(entry["formula"])}
    return {"formulas": tuple(map(Expression.from_entry, entry["formulas"]))}


def entry_of_formulas(one: JointPush | BodyBushing | BodyPush) -> dict[str, Any]:
    """Return what `formulas_of` reads."""
    if isinstance(one, JointPush):
        return {"formula": one.formula.entry()}
    return {"formulas": [formula.entry() for formula in one.formulas]}


def _check(acting: PassiveForces) -> None:
    """Raise ValueError if a number cannot be computed with."""
    for push in acting.pushes:
        if not (np.isfinite(push.scale) and push.scale):
            raise ValueError(f"the push of joint {push.joint!r} needs a finite scale other than 0")
    on_bodies: tuple[BodyBushing | BodyPush, ...] = (*acting.bushings, *acting.body_pushes)
    for one in on_bodies:
        parts = [
            value for name, value in vars(one).items() if name not in ("bodies", "body", "ground", "formulas")
        ]
        if not all(np.isfinite(np.array(part, float)).all() for part in parts):
            raise ValueError(f"what acts on {one!r:.60} needs finite numbers")
        if len(one.formulas) not in ((0, 6) if isinstance(one, BodyBushing) else (9,)):
            raise ValueError(f"what acts on {one!r:.60} has {len(one.formulas)} formulas")
    for limit in acting.limits:
        numbers = np.array([value for name, value in vars(limit).items() if name != "joint"], float)
        if not (np.isfinite(numbers).all() and limit.transition > 0):
            raise ValueError(f"the limit of joint {limit.joint!r} needs finite numbers, a transition above 0")
    for ligament in acting.ligaments:
        numbers = np.array([ligament.resting_length, ligament.dissipation, ligament.damping], float)
        if not (np.isfinite(numbers).all() and ligament.resting_length > 0):
            raise ValueError(f"ligament {ligament.tendon!r} needs finite numbers, a resting length above 0")
    for joint, damping in acting.dampers.items():
        if not np.isfinite(damping):
            raise ValueError(f"the damping of joint {joint!r} must be finite, got {damping}")
