"""A condition: muscles lose a share of their force with every second of the episode."""

from dataclasses import dataclass, replace
from typing import ClassVar

import warp as wp

import myowarp

RATE = 2.0  # 1/s


@wp.kernel(enable_backward=False)
def fade(rate: float, clock: myowarp.Clock, strength: wp.array2d[float]):
    """strength *= exp(-rate t)."""
    worldid, muscleid = wp.tid()
    time = float(clock.step_count[worldid]) * clock.control_dt
    strength[worldid, muscleid] *= wp.exp(-rate * time)


@dataclass(frozen=True, eq=False)
class Fading(myowarp.Condition):
    PHASE = myowarp.Phase.STRENGTH
    NEUTRAL: ClassVar = {"rate": 0.0}

    rate: float = RATE

    def bind(self, scene, clock):
        if not self.rate >= 0.0:
            raise ValueError(f"rate of fading must be >= 0, got {self.rate}")
        self.muscle_names(scene)
        return FadingEffect(scene, clock, self.rate)


class FadingEffect(myowarp.Effect):
    def __init__(self, scene, clock, rate):
        self.clock, self.rate, self.strength = clock, rate, scene.muscles.anatomy.strength

    def act(self):
        myowarp.launch(fade, self.strength.shape, self)


myowarp.CONDITIONS.add("outside_fading", Fading)


@myowarp.task("outsideElbowFading-v0")
def fading():
    """Bring the elbow to an angle; run it with --conditions outside_fading."""
    return replace(myowarp.TASKS["myoElbowPose1D6MFixed-v0"], horizon=30)
