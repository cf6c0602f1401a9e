"""A load: a weight in the hand, of any mass, that may change within an episode.

A solid sphere that moves with the palm, at the place that the body names (`Body.load`). The elbow holds it
where MyoSuite 3.0.0 puts the weight of its exoskeleton tasks (`carry_weight`); the hands at myo-sim's site
`S_grasp_r`, 5 cm in front of the third metacarpal, which its tasks bring to objects. It weighs and is inert,
but touches nothing: a hand with an object in it carries the load as if strapped on. Source of the masses 0 to
2 kg: Caggiano et al. (2022), arXiv:2205.13600, loads in the tests of the exoskeleton.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import mujoco

from myowarp.definitions.body import Place, fact_for
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.parameter import Clock, Value
from myowarp.kernels.write import is_finite
from myowarp.models.conditions.added_mass import BATCHED, AddedMass, HungMass, Part

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec


@dataclass(frozen=True, eq=False)
class Load(Condition):
    """A weight in the hand.

    Attributes:
        mass: Mass [kg], 0 to 100.
        radius: Radius of the sphere [m]; its inertia is 2/5 mass radius^2.
    """

    PHASE = Phase.BODY
    WRITES = ("the weight in the hand",)
    NEUTRAL: ClassVar = {"mass": 0.0}
    TITLE = "weight in the hand"
    scene_key = ("load",)  # the radius is applied with the mass
    batched = BATCHED

    mass: Value = 1.0
    radius: float = 0.05

    def __post_init__(self) -> None:
        """Check the radius."""
        if not (isinstance(self.radius, (int, float)) and self.radius > 0.0 and is_finite(self.radius)):
            raise ValueError(f"load radius must be a finite length > 0 m, got {self.radius!r}")

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body names no place for it."""
        self._sphere(spec.body)

    def _sphere(self, body: str) -> AddedMass:
        """Return the load of a body."""
        place: Place = fact_for("hold a load", body, "load")
        sphere = Part(mujoco.mjtGeom.mjGEOM_SPHERE, (self.radius, 0.0, 0.0))
        return AddedMass("load", place.limb, place.pos, (sphere,))

    def edit(self, spec: mujoco.MjSpec, body: str) -> None:
        """Add the sphere where the body holds it."""
        self._sphere(body).edit(spec)

    def bind(self, scene: Scene, clock: Clock) -> LoadEffect:
        """Put the masses on the device."""
        sphere = self._sphere(scene.spec.body)
        return LoadEffect(sphere.bind(scene, clock, "load mass", self.mass))


class LoadEffect(Effect):
    """A load in a scene."""

    def __init__(self, sphere: HungMass) -> None:
        self.scene, self.sphere, self.drawn = sphere.scene, sphere, (sphere.mass,)

    def act(self) -> None:
        """Hang the present masses on the palms."""
        self.sphere.launch()


CONDITIONS.add("load", Load)
