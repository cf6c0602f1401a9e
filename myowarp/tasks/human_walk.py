"""Walking as people do: at a commanded speed, for little metabolic power, with no cycle to follow.

    reward = 5 (exp(-((v_y - speed) / 0.15)^2) + exp(-(v_x / 0.15)^2)) - 0.2 e + 10 exp(-5 |q - q*|)
             - 100 1[fallen]

with v, q and q* as in `walk`, and the metabolic rate e of the muscles after Bhargava (2004) [W/kg of the
body], rest left out. Episodes begin on the left foot, early in its stance, with all muscles activated a
little: a body whose muscles are at rest falls before reflexes hold it. Ends and success are those of `walk`.
This task is ours; MyoSuite has none like it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import warp as wp

from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, RewardTerm, Shown, task
from myowarp.kernels.reset import masked_fill
from myowarp.kernels.reward import minus_bhargava2004
from myowarp.sim.metabolics import known_metabolics
from myowarp.tasks.stand import STANDING_POSE
from myowarp.tasks.walk import TOES, WalkProgram, WalkTask

WIDTH = wp.constant(0.15)  # m/s, of the velocity's reward
START_ACTIVATION = 0.2


@wp.func
def close_velocity(velocity: wp.vec2, command: wp.array[float]) -> float:
    """exp(-((speed - v_y) / 0.15)^2) + exp(-(v_x / 0.15)^2)."""
    behind, aside = (command[0] - velocity[1]) / WIDTH, velocity[0] / WIDTH
    return wp.exp(-behind * behind) + wp.exp(-aside * aside)


@wp.func
def minus_metabolic_power(bhargava2004: wp.array[float], per_kg: float) -> float:
    """-e, of all muscles over the mass of the body [W/kg]."""
    return minus_bhargava2004(bhargava2004) * per_kg


class HumanWalkProgram(WalkProgram):
    """A walk for little metabolic power, bound to a scene.

    Attributes:
        per_kg: 1 / mass of the body [1/kg].
    """

    def __init__(self, spec: HumanWalkTask, scene: Scene) -> None:
        """Prepare the rates.

        Raises:
            ValueError: The muscle model does not tell what its fibers do.
        """
        super().__init__(spec, scene)
        self._metabolics = known_metabolics(scene, "bhargava2004")
        self.per_kg = 1.0 / self._metabolics.body_mass

    @property
    def bhargava2004(self) -> wp.array:
        """Metabolic rates of the muscles [W], shape (num_worlds, num_muscles)."""
        return self._metabolics.rates.bhargava2004

    def bring_muscles(self) -> None:
        super().bring_muscles()
        self._metabolics.launch()

    def sample_start(self, mask: wp.array) -> None:
        """Activate the muscles."""
        super().sample_start(mask)
        masked_fill(mask, self.scene.muscles.activation, START_ACTIVATION)


@dataclass(frozen=True, kw_only=True)
class HumanWalkTask(WalkTask):
    """Walk as people do."""

    program: ClassVar[type] = HumanWalkProgram
    title: ClassVar[str] = "Walking as people do"
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained yet.", "myoLegWalkHuman-v0", "random", 60, 4
    )
    start_doc = f"on the left foot at 1.25 m/s, all muscles activated to {START_ACTIVATION:g}"

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        """Return the blocks of `walk` without the phase of its cycle."""
        blocks = super().columns(nq, nv, num_muscles)
        return tuple(block for block in blocks if block.name != "phase_var")

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        shared = {term.name: term for term in super().reward_terms()}
        speed = "exp(-((v_y - speed) / 0.15)^2) + exp(-(v_x / 0.15)^2) in m/s, v as observed"
        power = "minus the metabolic rate of the muscles over the mass of the body, after Bhargava 2004"
        return (
            RewardTerm("vel_reward", 5.0, "1", speed, close_velocity),
            shared["done"],
            shared["ref_rot"],
            RewardTerm("metabolic", 0.2, "W/kg", power, minus_metabolic_power),
            RewardTerm("sparse", 0.0, "1", speed, close_velocity),
        )


START_POSE = (
    *(0.0, 0.0, 0.9275, *STANDING_POSE[3:7]),
    *(-0.0873, -0.03, -0.0419, 0.0048, 0.0014, 1.0472, 0.0309, 0.23, -0.0873, *TOES),  # right, which swings
    *(-0.0408, 0.0136, -0.7509),
    *(0.2443, -0.03, -0.0419, 0.0006, 0.0003, 0.1047, 0.0079, 0.0369, -0.1396, *TOES),
    *(-0.0158, 0.0505, -0.0005),
)  # rad, m; knees and kneecaps as the couplings have them, the left foot 4 mm in the ground
START_VELOCITY = (
    *(0.17, -1.25, 0.0, 0.0, 0.0, 0.0),  # -y is ahead, and the body falls to the side of the standing leg
    *(3.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    *(-1.389, 0.189, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.389, 0.0, 0.0, 0.0, 0.0, 0.0),  # over a foot at rest
)  # rad/s, m/s


@task("myoLegWalkHuman-v0")
def human_walk() -> HumanWalkTask:
    """Walk ahead at 1.2 m/s, within 0.15 m/s, for little metabolic power."""
    return HumanWalkTask(speed=(1.2, 1.2), start_pose=START_POSE, start_velocity=START_VELOCITY)
