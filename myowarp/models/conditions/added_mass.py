"""A worn or held mass: rigid, without a joint, one per world and changing over time.

A body of mass 0 is compiled into the model and stays a body of its own (slimming would melt it into the
limb); mass m then gives it mass m and the inertia m I_unit of its shape. Gravity and inertia follow from the
engine; nothing touches it. The softness of joint stops and contacts (`dof_invweight0`, `body_invweight0`)
stays that of the bare limb, where MuJoCo's compiler would harden them with the mass: extensors at full drive
press an elbow with 2 kg 5 mrad into its stop, instead of 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import warp as wp

from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.kernels.body_mass import MASS_FIELDS, WeighedBody, set_body_mass, weighed_body
from myowarp.kernels.launch import launch

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

BATCHED = (*MASS_FIELDS, "body_inertia")
"""Names of the model's fields that an added mass sets per world."""

Triple = tuple[float, float, float]
GRAY = (0.3, 0.3, 0.3, 1.0)
HEAVIEST = 100.0  # kg: a slip of grams is more; nobody lifts it with a hand
USUAL = 2.0  # kg: the greatest load of Caggiano et al. (2022), and the end of a slider


@dataclass(frozen=True)
class Part:
    """A homogeneous solid.

    Attributes:
        kind: Shape.
        size: MuJoCo's size of that shape [m].
        mass: Its share of the whole [kg].
        pos: Center in the frame of the thing [m].
        tilt: Rotation about the x axis [rad].
    """

    kind: mujoco.mjtGeom
    size: Triple
    mass: float = 1.0
    pos: Triple = (0.0, 0.0, 0.0)
    tilt: float = 0.0


@dataclass(frozen=True)
class AddedMass:
    """A rigid thing on a limb.

    Attributes:
        name: Name of its body in the model.
        limb: Name of the body that carries it.
        pos: Where its frame is in that of the limb [m]; they are parallel.
        parts: What it is made of.
    """

    name: str
    limb: str
    pos: Triple
    parts: tuple[Part, ...]

    def _build(self) -> mujoco.MjSpec:
        """Return a model of the thing alone; the inertia floors of some limbs do not hold for it."""
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name=self.name, pos=self.pos)
        for part in self.parts:
            geom = body.add_geom(type=part.kind, size=part.size, pos=part.pos, mass=part.mass, rgba=GRAY)
            geom.quat = (math.cos(0.5 * part.tilt), math.sin(0.5 * part.tilt), 0.0, 0.0)
            geom.contype = geom.conaffinity = 0
        return spec

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add it, massless, to a model."""
        own = self._build()
        alone = own.copy().compile()
        body = spec.body(self.limb).add_frame().attach_body(own.body(self.name), "own_", "")
        body.name = self.name
        body.fuse = 0
        body.explicitinertial = True
        body.mass, body.inertia = 0.0, (0.0, 0.0, 0.0)
        body.ipos, body.iquat = alone.body_ipos[1], alone.body_iquat[1]

    def bind(self, scene: Scene, clock: Clock, label: str, mass: Value) -> HungMass:
        """Put its mass [kg] on the device; `label` names the parameter in messages.

        Raises:
            ValueError: The mass is negative or above `HEAVIEST`, or does not fit the number of worlds.
        """
        alone = self._build().compile()
        unit_inertia = wp.vec3(*(alone.body_inertia[1] / alone.body_mass[1]))
        parameter = Parameter(label, mass, scene, (), neutral=0.0, low=0.0, high=HEAVIEST, usual=USUAL)
        return HungMass(scene, clock, weighed_body(scene.oracle, self.name), unit_inertia, parameter)


@wp.kernel(enable_backward=False)
def hang_mass(
    # Params:
    body: WeighedBody,
    unit_inertia: wp.vec3,
    curve: Curve,
    # In:
    clock: Clock,
    # Out:
    body_mass: wp.array2d[float],
    body_subtreemass: wp.array2d[float],
    body_inertia: wp.array2d[wp.vec3],
):
    """m = curve(t), I = m I_unit."""
    worldid = wp.tid()
    mass = value_of(curve, clock, worldid, 0)
    set_body_mass(body, worldid, mass, body_mass, body_subtreemass)
    body_inertia[worldid, body.bodyid] = mass * unit_inertia


class HungMass:
    """An added mass in a scene."""

    def __init__(
        self, scene: Scene, clock: Clock, body: WeighedBody, unit_inertia: wp.vec3, mass: Parameter
    ) -> None:
        self.scene, self.clock, self.mass = scene, clock, mass
        self.body, self.unit_inertia = body, unit_inertia

    def launch(self) -> None:
        """Launch `hang_mass`."""
        model = self.scene.model
        launch(hang_mass, self.scene.num_worlds, self, self.mass, model)
