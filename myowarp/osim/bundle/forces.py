"""Springs and dampers that a model brings along: the text `forces`, `forces.json` of `myowarp convert`.

It has OpenSim's limits of coordinates, ligaments and path springs (`laws.forces`), along the model's joints
and tendons, and names the springs and dampers that stand for them in plain MuJoCo (`coordinates.own_forces`).
"""

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, Self

import mujoco
import numpy as np

from myowarp.laws.pieces import Pieces
from myowarp.osim.bundle.couplings import driven
from myowarp.osim.bundle.text import Sidecar, scalar_joints


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


@dataclasses.dataclass(frozen=True)
class PassiveForces(Sidecar):
    """Limits and ligaments of an OpenSim document in terms of a MuJoCo model.

    Attributes:
        limits: Beyond which joints are pushed back.
        ligaments: Tendons that pull by themselves.
        springs: Tendons whose own springs stand for these forces in plain MuJoCo.
        dampers: Damping that stands for them, by joint [N m s/rad or N s/m].
    """

    NAME, FILE = "forces", "forces.json"
    KEYS = "'limits', 'ligaments', 'springs' and 'dampers'"
    limits: tuple[JointLimit, ...] = ()
    ligaments: tuple[TendonSpring, ...] = ()
    springs: tuple[str, ...] = ()
    dampers: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @classmethod
    def from_entry(cls, entry: Any) -> Self:
        """Return what parsed JSON says; see `Sidecar.from_entry`."""
        limits = tuple(JointLimit(**limit) for limit in entry["limits"])
        ligaments = tuple(
            TendonSpring(**ligament | {"curves": driven({"of": None, "curves": ligament["curves"]})[1]})
            for ligament in entry["ligaments"]
        )
        dampers = {str(joint): float(damping) for joint, damping in entry["dampers"].items()}
        found = cls(limits, ligaments, tuple(map(str, entry["springs"])), dampers)
        _check(found)
        return found

    def as_json(self) -> str:
        """Return the text."""
        ligaments = [
            vars(ligament) | {"curves": [curve.entry() for curve in ligament.curves]}
            for ligament in self.ligaments
        ]
        limits = [vars(limit) for limit in self.limits]
        instead = {"springs": self.springs, "dampers": dict(self.dampers)}
        return json.dumps({"limits": limits, "ligaments": ligaments, **instead})

    def check(self, model: mujoco.MjModel) -> None:
        """Raise ValueError if it names what a model has not."""
        joints = {*(limit.joint for limit in self.limits), *self.dampers}
        tendons = {*(ligament.tendon for ligament in self.ligaments), *self.springs}
        self.check_named("hinge or slide", joints, scalar_joints(model))
        self.check_named("tendon", tendons, {model.tendon(i).name for i in range(model.ntendon)})


def _check(acting: PassiveForces) -> None:
    """Raise ValueError if a number cannot be computed with."""
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
