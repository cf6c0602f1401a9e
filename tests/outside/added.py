"""A block of the observation, a term of the reward and a draw on top of a family: each in one place."""

from dataclasses import dataclass

import warp as wp

import myowarp


@wp.func
def speed_off(qvel: wp.array[float], speed: wp.array[float]) -> float:
    """Minus how far the speed of the elbow is from the one that was drawn."""
    return -wp.abs(wp.abs(qvel[0]) - speed[0])


@dataclass(frozen=True, kw_only=True)
class PacedTask(myowarp.PoseTask):
    """Reach a joint configuration at a speed that each episode draws."""

    @property
    def draws(self):
        paced = myowarp.Draw("speed", "rad/s", (0.5,), (2.0,), "speed of the elbow", array="speed")
        return (*super().draws, paced)

    def columns(self, nq, nv, num_muscles):
        speed = myowarp.Column("speed", 1, "rad/s", "speed that is asked for", source=myowarp.Row("speed"))
        return (*super().columns(nq, nv, num_muscles), speed)

    def reward_terms(self):
        off = "minus the difference between the elbow's speed and the one that is asked for"
        return (*super().reward_terms(), myowarp.RewardTerm("pace", 0.5, "rad/s", off, speed_off))


@myowarp.task("outsidePacedRandom-v0")
def paced():
    """Flex the elbow at a speed drawn anew each episode."""
    return PacedTask(body="elbow", target_low=(1.0,), target_high=(2.0,), near=0.2)
