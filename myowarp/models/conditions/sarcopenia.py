"""Sarcopenia: muscles have lost peak force.

    F = -(strength f_L f_V a F_max + f_P F_P)

The passive force stays. Source: Caggiano et al. (2022), arXiv:2205.13600, where strength is 0.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import warp as wp

from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene


@dataclass(frozen=True, eq=False)
class Sarcopenia(Condition):
    """Weak muscles.

    Attributes:
        strength: What is left of the peak isometric force, >= 0; 1 is healthy.
    """

    PHASE = Phase.STRENGTH
    NEUTRAL: ClassVar = {"strength": 1.0}
    TITLE = "weakness (sarcopenia)"
    LABELS: ClassVar = {"strength": "remaining strength"}

    strength: Value = 0.5

    def bind(self, scene: Scene, clock: Clock) -> SarcopeniaEffect:
        """Put the strengths on the device."""
        names = self.muscle_names(scene)
        strength = Parameter(
            "sarcopenia strength", self.strength, scene, names, neutral=1.0, low=0.0, whole="the healthy one"
        )
        return SarcopeniaEffect(scene, clock, strength)


@wp.kernel(enable_backward=False)
def weaken(
    # Params:
    curve: Curve,
    # In:
    clock: Clock,
    # Out:
    strength: wp.array2d[float],
):
    """strength *= curve(t)."""
    worldid, muscleid = wp.tid()
    strength[worldid, muscleid] *= value_of(curve, clock, worldid, muscleid)


class SarcopeniaEffect(Effect):
    """Sarcopenia in a scene."""

    def __init__(self, scene: Scene, clock: Clock, strength: Parameter) -> None:
        self.scene, self.clock, self.strength, self.drawn = scene, clock, strength, (strength,)

    def act(self) -> None:
        """Launch `weaken`."""
        strength = self.scene.muscles.anatomy.strength
        wp.launch(weaken, dim=strength.shape, inputs=[self.strength.curve, self.clock], outputs=[strength])


CONDITIONS.add("sarcopenia", Sarcopenia)
