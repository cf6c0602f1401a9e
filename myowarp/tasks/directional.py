"""Walking in a direction: move the root at a velocity, from standing.

    reward = exp(-|v* - v|^2) - 1[fallen] - 0.1 mean(act^2)

with v the velocity of the root and v* the commanded one, in the plane [m/s]. It is solved while the two are
within 0.5 m/s; it fails when the root is below 0.7 m. Actions are excitations in proportion. Source: MyoSuite
3.0.0, myoLegDirectional{Forward,Backward,Random}, whose actions are from 0 to 1.

A flat height field lies 5 mm below the floor, as upstream's does: feet that sink in so deep touch both.

A fall is fast enough: with zero actions every episode of a fixed direction counts as solved, and falls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.entries import ACTIVATION, COORDINATES, VELOCITIES
from myowarp.definitions.program import Program
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec, task
from myowarp.kernels.reward import indicator
from myowarp.kernels.world_function import Row
from myowarp.tasks.field import FIELD_POINTS, add_field
from myowarp.tasks.stand import STANDING_POSE
from myowarp.tasks.walk import VELOCITY_NEAR

LEAST_ROOT_HEIGHT = wp.constant(0.7)  # m
EFFORT_WEIGHT = 0.1
"""Cost of the mean square of all activations; the velocity earns 1 at most."""


@wp.func
def direction(angle: wp.array[float]) -> wp.vec2:
    """(cos, sin) of the angle."""
    return wp.vec2(wp.cos(angle[0]), wp.sin(angle[0]))


@wp.func
def planar_velocity(qvel: wp.array[float]) -> wp.vec2:
    """Velocity of the root, x and y [m/s]."""
    return wp.vec2(qvel[0], qvel[1])


@wp.func
def missed_velocity(heading: wp.vec2, speed: float, qvel: wp.array[float]) -> float:
    """|speed (cos, sin) - v| [m/s]."""
    return wp.length(speed * heading - planar_velocity(qvel))


@wp.func
def is_low(qpos: wp.array[float]) -> bool:
    """Root height < 0.7."""
    return qpos[2] < LEAST_ROOT_HEIGHT


@wp.func
def follows(error: float, failed: bool) -> bool:
    """|v* - v| < 0.5 m/s, upright."""
    return error < VELOCITY_NEAR and not failed


@wp.func
def tracking(error: float) -> float:
    """exp(-|v* - v|^2)."""
    return wp.exp(-error * error)


@wp.func
def tracking_upright(error: float, failed: bool) -> float:
    """exp(-|v* - v|^2) - 1[fallen]."""
    return tracking(error) - indicator(failed)


@wp.func
def minus_mean_square(activation: wp.array[float]) -> float:
    """-mean(act^2)."""
    total = float(0.0)
    for i in range(activation.shape[0]):
        total += activation[i] * activation[i]
    return -total / float(activation.shape[0])


@dataclass(frozen=True, kw_only=True)
class DirectionalTask(TaskSpec):
    """Move the root in a direction.

    Attributes:
        speed: Commanded velocity of the root [m/s].
        angle: Bounds of the uniformly drawn direction [rad], from the world's x axis towards y.
    """

    program: ClassVar[type] = Program
    title: ClassVar[str] = "Directional walking"
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained for these directions.",
        "myoLegDirectionalForward-v1",
        "random",
        60,
        4,
    )
    measures: ClassVar = {
        "heading": direction,
        "error": missed_velocity,
        "failed": is_low,
        "solved": follows,
    }
    linear_excitation: ClassVar[bool] = True
    uses_kinematics = False  # coordinates and velocities say all
    start_doc = "standing with slightly bent knees"
    solved_when = (
        f"the velocity of the root is within {VELOCITY_NEAR:g} m/s of the commanded one, and it is up"
    )
    failed_when = f"the root is below {LEAST_ROOT_HEIGHT:g} m"

    body: str = "legs"
    num_substeps: int = 5
    horizon: int = 500
    physics_dt: float = 0.001
    start_pose: tuple[float, ...] = STANDING_POSE
    speed: float
    angle: tuple[float, float]

    @property
    def draws(self) -> tuple[Draw, ...]:
        low, high = self.angle
        doc = "commanded direction, from the world's x axis towards y"
        return (Draw("heading", "rad", (low,), (high,), doc, ("angle",), array="angle"),)

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the second ground."""
        add_field(spec, np.zeros((FIELD_POINTS, FIELD_POINTS)), -0.005)

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        command = "commanded direction, a unit vector"
        return (
            Column("joint_pos", nq, *COORDINATES),
            Column("joint_vel", nv, *VELOCITIES),
            Column("muscle_act", num_muscles, *ACTIVATION),
            Column("root_planar_vel", 2, "m/s", "velocity of the root", ("x", "y"), Row("qvel")),
            Column("heading_cmd", 2, "1", command, ("x", "y"), direction),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        near = "exp(-|v* - v|^2) in m/s, v the velocity of the root and v* the commanded one"
        effort = "minus the mean square of the activations"
        return (
            RewardTerm("heading", 1.0, "1", f"{near}, minus 1 where the episode fails", tracking_upright),
            RewardTerm("act_reg", EFFORT_WEIGHT, "1", effort, minus_mean_square),
            RewardTerm("sparse", 0.0, "1", near, tracking),
        )


AHEAD, BACK = -0.5 * np.pi, 0.5 * np.pi
"""Heading of the legs in the start pose, and the opposite [rad]."""
LOOKS = "Upstream's legs look along -y, and its commands have the opposite sign."


@task("myoLegDirectionalForward-v0")
def forward() -> DirectionalTask:
    """Move along +y at 1.2 m/s, which is backwards for these legs."""
    return DirectionalTask(speed=1.2, angle=(BACK, BACK))


@task("myoLegDirectionalBackward-v0")
def backward() -> DirectionalTask:
    """Move along -y at 1 m/s, which is ahead for these legs."""
    return DirectionalTask(speed=1.0, angle=(AHEAD, AHEAD))


@task("myoLegDirectionalRandom-v0")
def in_any_direction() -> DirectionalTask:
    """Move at 1.2 m/s in a direction drawn anew each episode."""
    return DirectionalTask(speed=1.2, angle=(0.0, 2.0 * np.pi))


@task("myoLegDirectionalForward-v1", LOOKS)
def forward_ahead() -> DirectionalTask:
    """Walk ahead at 1.2 m/s."""
    return DirectionalTask(speed=1.2, angle=(AHEAD, AHEAD))


@task("myoLegDirectionalBackward-v1", LOOKS)
def backward_back() -> DirectionalTask:
    """Walk backwards at 1 m/s."""
    return DirectionalTask(speed=1.0, angle=(BACK, BACK))
