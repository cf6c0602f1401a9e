"""Standing: hold the pelvis at a point near where it starts, on legs that start with random joint angles.

    reward = 10 - x - 10 |v| + 4 (1[x < 2 near] + 1[x < near]) - 50 1[x > far] - 100 |act| / n

with x the distance of the pelvis from its target, |v| the norm of all velocities times the control step,
near = 0.05 m and far = 0.44 m, beyond which the episode fails from its second step on. Source:
MyoSuite 3.0.0, myoLegStandRandom.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import mujoco
import warp as wp

from myowarp.definitions.body import POINT_JOINTS
from myowarp.definitions.entries import Entry, of_joints
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Draw, RewardTerm, Shown, task
from myowarp.kernels.reward import minus_effort
from myowarp.tasks.reach import ReachProgram, ReachTask

STANDING = 10.0
"""Reward of a step at rest on the target; velocities cost as much for each 1 rad a control step."""
EFFORT_SCALE = 100.0


@wp.func
def still_and_near(error: float, qvel: wp.array[float], control_dt: float) -> float:
    """10 - x - 10 |v|."""
    total = float(0.0)
    for i in range(qvel.shape[0]):
        total += qvel[i] * qvel[i]
    return STANDING - error - STANDING * control_dt * wp.sqrt(total)


@wp.func
def minus_scaled_effort(activation: wp.array[float]) -> float:
    """-100 |act| / n."""
    return EFFORT_SCALE * minus_effort(activation)


@wp.kernel(enable_backward=False)
def offset_joints(
    # Model:
    jnt_range: wp.array2d[wp.vec2],
    # Params:
    joint: wp.array[int],
    address: wp.array[int],
    # In:
    offset: wp.array2d[float],
    mask: wp.array[bool],
    # Data out:
    qpos_out: wp.array2d[float],
):
    """q = clip(q + offset, range), of hinges and slides."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    for i in range(joint.shape[0]):
        limits = jnt_range[worldid % jnt_range.shape[0], joint[i]]
        moved = qpos_out[worldid, address[i]] + offset[worldid, i]
        qpos_out[worldid, address[i]] = wp.clamp(moved, limits[0], limits[1])


def point_joints(model: mujoco.MjModel) -> list[int]:
    """Return the ids of a model's hinges and slides."""
    return [joint for joint in range(model.njnt) if int(model.jnt_type[joint]) in POINT_JOINTS]


def joint_entries(model: mujoco.MjModel) -> tuple[Entry, ...]:
    """Return names and units of hinges and slides."""
    return of_joints(model, point_joints(model))


class StandProgram(ReachProgram):
    """A standing task bound to a scene.

    Attributes:
        offset: What is added to the angles of the start pose [rad, m], shape (num_worlds, num_joints).
    """

    spec: StandTask
    offset: wp.array

    def __init__(self, spec: StandTask, scene: Scene) -> None:
        """Find the joints with random angles."""
        super().__init__(spec, scene)
        joints = point_joints(scene.oracle)
        self.joint = wp.array(joints, dtype=int)
        self.address = wp.array(scene.oracle.jnt_qposadr[joints], dtype=int)

    def sample_start(self, mask: wp.array) -> None:
        """Draw offsets; they move the joints where the task's own start is asked for."""
        super().sample_start(mask)
        if self.scene.reset == "task":
            self.launch(offset_joints, mask=mask)


@dataclass(frozen=True, kw_only=True)
class StandTask(ReachTask):
    """Stand where the pelvis is near a point.

    Attributes:
        offset: Largest change of each angle of the start pose [rad, m]; angles stay within their ranges.
        num_joints: Number of hinges and slides.
    """

    program: ClassVar[type] = StandProgram
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: legs fall.", "myoLegStandRandom-v0", "random", 60, 4
    )
    large = False  # legs that stand are tried every day, for all legs
    start_doc = "standing with slightly bent knees"

    horizon: int = 150
    physics_dt: float = 0.001
    offset: float
    num_joints: int

    @property
    def draws(self) -> tuple[Draw, ...]:
        bounds = (-self.offset,) * self.num_joints, (self.offset,) * self.num_joints
        doc = "added to each joint of the start pose, within its range"
        return (
            *super().draws,
            Draw("offset", "rad", *bounds, doc, joint_entries, when="start", array="offset"),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        reach, bonus, penalty, _, sparse = super().reward_terms()
        doc = "10, minus the error, minus 10 times the norm of all velocities times the control step"
        effort = "minus 100 times the effort: Euclidean norm of the activations over their number"
        return (
            replace(reach, doc=doc, source=still_and_near),
            bonus,
            penalty,
            RewardTerm("act_reg", 1.0, "1", effort, minus_scaled_effort),
            sparse,
        )


KNEE = (0.00247908, 0.00101098, 0.461137, 0.0275069, 0.136817)
LEG = (
    *(0.161153, -0.0279385, -0.041886),  # hip
    *KNEE,
    *(0.334, -0.00117055, -0.000125295),  # ankle, subtalar joint, toes
    *(-0.0302192, 0.0395202, -0.194029),  # kneecap
)  # rad, m; MyoSuite 3.0.0
HEIGHT = 0.92  # m
ROOT = (0.0, 0.0, HEIGHT, 0.7073882252434113, 0.0, 0.0, -0.7068252250641434)
STANDING_POSE = (*ROOT, *LEG, *LEG)


@task("myoLegStandRandom-v0")
def leg_stand() -> StandTask:
    """Stand on both legs with the pelvis at a point drawn anew each episode, from random joint angles."""
    return StandTask(
        body="legs",
        center=(0.0, 0.0, HEIGHT),
        low=(-0.05, -0.05, 0.0),
        high=(0.05, 0.05, 0.0),
        near_per_tip=0.05,
        far_per_tip=0.44,
        offset=0.2,
        num_joints=2 * len(LEG),
        start_pose=STANDING_POSE,
    )
