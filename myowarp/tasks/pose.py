"""Joint pose: bring every joint of a finger, an elbow, a hand or a trunk to its target angle.

    reward = -d + 4 (1[d < near] + 1[d < 1.5 near]) - 50 1[d > far] - w |act| / n

with d the norm of the joint errors [rad] and, in MyoSuite, far = 2 pi, where the episode fails. Source:
MyoSuite 3.0.0, families FingerPose, ElbowPose1D6M, HandPose (paper: Caggiano et al. 2022, arXiv:2205.13600).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp
from mujoco_warp import JointType

from myowarp.definitions.body import BODIES, POINT_JOINTS
from myowarp.definitions.entries import ACTIVATION, COORDINATES, VELOCITIES, Entry, of_joints
from myowarp.definitions.program import Program
from myowarp.definitions.registry import check_bounds
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, Judgement, RewardTerm, Shown, TaskSpec
from myowarp.kernels.random import GOAL, START, RandomKeys, open_stream
from myowarp.kernels.reward import EFFORT, is_far, is_near, minus_error, minus_failed, near_bonus
from myowarp.osim.bundle.couplings import follow
from myowarp.sim.build import full_model
from myowarp.tasks.carried_weight import BATCHED, CarriedWeight
from myowarp.tasks.markers import add_tip_targets

ON_THE_BOUND = 1e-5  # rad, float32; of a target that is within the ranges


@wp.func
def joint_error(qpos: wp.array[float], target: wp.array[float], address: wp.array[int], i: int) -> float:
    """target - qpos[address], of joint i."""
    return target[i] - qpos[address[i]]


@wp.func
def pose_error(qpos: wp.array[float], target: wp.array[float], address: wp.array[int]) -> float:
    """d = |target - qpos[address]|."""
    total = float(0.0)
    for i in range(target.shape[0]):
        difference = joint_error(qpos, target, address, i)
        total += difference * difference
    return wp.sqrt(total)


@wp.kernel(enable_backward=False)
def sample_configuration(
    # Model:
    jnt_type: wp.array[int],
    jnt_qposadr: wp.array[int],
    jnt_range: wp.array2d[wp.vec2],
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Data out:
    qpos_out: wp.array2d[float],
):
    """qpos ~ U(joint range) of hinges and slides with a range; other joints stay where they are."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    start = open_stream(keys, worldid, START)
    for i in range(jnt_type.shape[0]):
        limits = jnt_range[worldid % jnt_range.shape[0], i]
        if jnt_type[i] >= JointType.SLIDE and limits[0] < limits[1]:
            qpos_out[worldid, jnt_qposadr[i]] = wp.randf(start, limits[0], limits[1])


class PoseProgram(Program):
    """A pose task bound to a scene.

    Attributes:
        target: Target angles [rad], shape (num_worlds, num_targets).
        address: Where in qpos the joints with a target are, shape (num_targets,).
    """

    spec: PoseTask
    target: wp.array

    def __init__(self, spec: PoseTask, scene: Scene) -> None:
        """Find the joints with a target.

        Raises:
            ValueError: The targets do not have one entry a joint.
        """
        address = scene.oracle.jnt_qposadr[spec.target_joints(scene.oracle)]
        if not len(spec.target_low) == len(spec.target_high) == len(address):
            raise ValueError(
                f"task {spec.key!r} needs one target angle for each of the {len(address)} joints, "
                f"got {len(spec.target_low)} and {len(spec.target_high)}"
            )
        super().__init__(spec, scene)
        self.address = wp.array(address, dtype=int)
        self.weight = CarriedWeight(scene, *spec.weight) if spec.weight else None

    def sample_start(self, mask: wp.array) -> None:
        """Draw weights, and configurations where the task's own start is random."""
        super().sample_start(mask)
        if self.weight is not None:
            self.weight.sample(mask)
        if self.spec.random_start and self.scene.reset == "task":
            self.launch(sample_configuration, mask=mask)

    @cached_property
    def _full(self) -> mujoco.MjModel:
        """The body with all its sites, which the slim model lacks."""
        return full_model(self.spec)

    @cached_property
    def _posed(self) -> mujoco.MjData:
        """The body in the target pose."""
        return mujoco.MjData(self._full)

    def goal_pose(self, world: int) -> np.ndarray:
        """The present configuration with the target's angles; joints that follow others follow."""
        qpos = self.scene.data.qpos.numpy()[world].astype(float)
        qpos[self.address.numpy()] = self.target.numpy()[world]
        follow(self.scene.oracle, qpos)
        return qpos

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return the tips in the target pose, by forward kinematics."""
        data = self._posed
        data.qpos[:] = self.goal_pose(world)
        mujoco.mj_kinematics(self._full, data)
        tips = BODIES[self.spec.body].tips
        return {f"{tip}_target": data.site(tip).xpos.copy() for tip in tips}


@dataclass(frozen=True, kw_only=True)
class PoseTask(TaskSpec):
    """Reach a joint configuration.

    Attributes:
        target_low: Lower bound of the uniformly drawn target [rad], one entry a joint with a target.
        target_high: Upper bound.
        near: Error norm below which the task counts as solved [rad].
        far: Error norm beyond which it fails [rad].
        effort_weight: Weight of the mean activation in the reward.
        random_start: Whether episodes start from a random configuration within the joint ranges.
        weight: Bounds of the uniformly drawn weight in the hand [kg]; () leaves the body's.
        joints: Ids of the hinges and slides that have a target; () means all of them.
    """

    program: ClassVar[type] = PoseProgram
    shown: ClassVar[Shown | None] = Shown(
        "A trained elbow bends to the angle of the green ghost.",
        "myoElbowPose1D6MRandom-v0",
        "baseline",
        60,
        2,
    )
    measures: ClassVar = {"error": pose_error, "solved": is_near, "failed": is_far}
    wider: ClassVar[float] = 1.5  # times `near`: where the first bonus begins
    uses_kinematics = False  # joint angles say everything

    num_substeps: int = 10
    horizon: int = 100
    target_low: tuple[float, ...]
    target_high: tuple[float, ...]
    near: float
    far: float = 2.0 * np.pi
    effort_weight: float = 1.0
    random_start: bool = False
    weight: tuple[float, ...] = ()
    joints: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bounds("target_low", self.target_low, self.target_high)

    @property
    def batched(self) -> tuple[str, ...]:
        """Fields that follow from the weight, where one is drawn."""
        return BATCHED if self.weight else ()

    @property
    def start_doc(self) -> str:
        return "the model's start pose" if self.start_pose else super().start_doc

    @property
    def solved_when(self) -> str:
        return f"the error, the norm of all joint errors, is below {self.near:.4g} rad"

    @property
    def failed_when(self) -> str:
        return f"the error exceeds {self.far:.4g} rad"

    @property
    def draws(self) -> tuple[Draw, ...]:
        bounds = self.target_low, self.target_high
        doc = "target of each joint"
        found = [Draw("target", "rad", *bounds, doc, self.target_entries, array="target", stream=int(GOAL))]
        if self.random_start:
            found.append(
                Draw(
                    "configuration",
                    "rad",
                    (),
                    (),
                    "random configuration, every joint within its range",
                    when="posture",
                )
            )
        if self.weight:
            low, high = self.weight
            found.append(
                Draw("weight", "kg", (low,), (high,), "mass of the weight in the hand", when="start")
            )
        return tuple(found)

    def target_joints(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the ids of the joints that have a target, in its order.

        Raises:
            ValueError: One of `joints` is no hinge or slide of the model.
        """
        possible = np.flatnonzero(np.isin(model.jnt_type, POINT_JOINTS))
        if not set(self.joints) <= set(possible.tolist()):
            raise ValueError(
                f"joints of task {self.key!r} must be ids of hinges and slides, of {possible.tolist()}, "
                f"got {self.joints!r}"
            )
        return np.array(self.joints or possible)

    def target_entries(self, model: mujoco.MjModel) -> tuple[Entry, ...]:
        """Return names and units of the joints that have a target, in its order."""
        return of_joints(model, self.target_joints(model))

    def judge(self, model: mujoco.MjModel, targets: np.ndarray) -> Judgement:
        joints = self.target_joints(model)
        limited = model.jnt_limited[joints, None] > 0
        low, high = np.where(limited, model.jnt_range[joints], (-np.inf, np.inf)).T
        beyond = targets - np.clip(targets, low, high)
        miss = np.linalg.norm(beyond, axis=1)
        return miss < self.near, np.abs(beyond).max(axis=1) <= ON_THE_BOUND, miss

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the markers that show where the tips of the target pose are."""
        add_tip_targets(spec, BODIES[self.body].tips)

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        error = "joint error: target minus position"
        return (
            Column("qpos", nq, *COORDINATES),
            Column("qvel", nv, *VELOCITIES),
            Column("pose_err", len(self.target_low), "rad", error, self.target_entries, joint_error),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        near, wide, far = (f"{limit:.4g} rad" for limit in (self.near, self.wider * self.near, self.far))
        bonus = f"1 where the error is below {wide}, 2 below {near}"
        return (
            RewardTerm("pose", 1.0, "rad", "minus the error, the norm of all joint errors", minus_error),
            RewardTerm("bonus", 4.0, "1", bonus, near_bonus),
            RewardTerm("penalty", 50.0, "1", f"-1 where the error exceeds {far}", minus_failed),
            RewardTerm("act_reg", self.effort_weight, *EFFORT),
            RewardTerm("sparse", 0.0, "rad", "minus the error", minus_error),
        )
