"""Joint pose: bring every joint of a finger, an elbow or a hand to its target angle.

    reward = -d + 4 (1[d < near] + 1[d < 1.5 near]) - 50 1[d > far] - w |act| / n

with d the norm of the joint errors [rad] and, in MyoSuite, far = 2 pi, where the episode fails. Source:
MyoSuite 3.0.0, families FingerPose, ElbowPose1D6M, HandPose (paper: Caggiano et al. 2022, arXiv:2205.13600).
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import warp as wp

from myowarp.kernels.observe import pack, pack_difference
from myowarp.kernels.random import GOAL, START, RandomKeys, open_stream
from myowarp.kernels.reward import activation_effort, indicator, squared_distance
from myowarp.sim.build import full_model
from myowarp.spec.body import BODIES
from myowarp.spec.scene import Scene
from myowarp.spec.task import TASKS, Column, RewardTerm, TaskSpec
from myowarp.tasks.carried_weight import BATCHED, CarriedWeight
from myowarp.tasks.hand_poses import DIGITS, RELAXED, as_in_myosuite_3, bounds
from myowarp.tasks.markers import add_tip_targets


@dataclass(frozen=True)
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
        joints: Ids of the hinges and slides that have a target; () means all joints.
        start_pose: Start configuration, shape (nq,); () means the model's zero.
        num_quaternions: Ball and free joints, which have one coordinate more than velocities.
    """

    target_low: tuple[float, ...] = field(kw_only=True)
    target_high: tuple[float, ...] = field(kw_only=True)
    near: float = field(kw_only=True)
    far: float = field(default=2.0 * np.pi, kw_only=True)
    effort_weight: float = field(default=1.0, kw_only=True)
    random_start: bool = field(default=False, kw_only=True)
    weight: tuple[float, ...] = field(default=(), kw_only=True)
    joints: tuple[int, ...] = field(default=(), kw_only=True)
    start_pose: tuple[float, ...] = field(default=(), kw_only=True)
    num_quaternions: int = field(default=0, kw_only=True)

    @property
    def batched(self) -> tuple[str, ...]:
        """What follows from the weight, where one is drawn."""
        return BATCHED if self.weight else ()

    @property
    def uses_kinematics(self) -> bool:
        """Joint angles say everything."""
        return False

    @property
    def sites(self) -> tuple[str, ...]:
        """None: joint angles say everything."""
        return ()

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return `start_pose`."""
        return np.array(self.start_pose) if self.start_pose else super().start(model)

    def target_joints(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the ids of the joints that have a target, in its order."""
        return np.array(self.joints or range(model.njnt))

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the markers that show where the tips of the target pose are."""
        add_tip_targets(spec, BODIES[self.body].tips)

    def columns(self, num_joints: int, num_muscles: int) -> tuple[Column, ...]:
        """Angles, angular velocities times the control step, errors, activations."""
        return (
            Column("qpos", num_joints, "rad"),
            Column("qvel", num_joints - self.num_quaternions, "rad per control step"),
            Column("pose_err", len(self.target_low), "rad"),
            Column("act", num_muscles, "1"),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """In the order in which `score_pose` writes them."""
        return (
            RewardTerm("pose", 1.0),
            RewardTerm("bonus", 4.0),
            RewardTerm("penalty", 50.0),
            RewardTerm("act_reg", self.effort_weight),
            RewardTerm("sparse", 0.0),
        )

    def bind(self, scene: Scene) -> "PoseProgram":
        """Allocate targets for every world."""
        return PoseProgram(self, scene)


@wp.kernel(enable_backward=False)
def sample_pose(
    # Params:
    target_low: wp.array[float],
    target_high: wp.array[float],
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    target: wp.array2d[float],
):
    """target ~ U(low, high)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    goal = open_stream(keys, worldid, GOAL)
    for i in range(target.shape[1]):
        target[worldid, i] = wp.randf(goal, target_low[i], target_high[i])


@wp.kernel(enable_backward=False)
def sample_configuration(
    # Model:
    jnt_range: wp.array2d[wp.vec2],
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Data out:
    qpos_out: wp.array2d[float],
):
    """qpos ~ U(joint range)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    start = open_stream(keys, worldid, START)
    for i in range(qpos_out.shape[1]):
        limits = jnt_range[worldid % jnt_range.shape[0], i]
        qpos_out[worldid, i] = wp.randf(start, limits[0], limits[1])


@wp.kernel(enable_backward=False)
def observe_pose(
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    activation: wp.array2d[float],
    target: wp.array2d[float],
    address: wp.array[int],
    control_dt: float,
    mask: wp.array[bool],
    # Out:
    obs: wp.array2d[float],
):
    """obs = [qpos, qvel dt, target - qpos[address], activation]."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    column = pack(obs, worldid, 0, qpos_in, 1.0)
    column = pack(obs, worldid, column, qvel_in, control_dt)
    column = pack_difference(obs, worldid, column, target, qpos_in, address)
    pack(obs, worldid, column, activation, 1.0)


@wp.kernel(enable_backward=False)
def score_pose(
    # Data in:
    qpos_in: wp.array2d[float],
    # In:
    activation: wp.array2d[float],
    target: wp.array2d[float],
    address: wp.array[int],
    near: float,
    far: float,
    # Out:
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """Terms pose, bonus, penalty, act_reg, sparse from d = |target - qpos[address]|."""
    worldid = wp.tid()
    d = wp.sqrt(squared_distance(target, qpos_in, address, worldid))
    terms[worldid, 0] = -d
    terms[worldid, 1] = indicator(d < near) + indicator(d < 1.5 * near)
    terms[worldid, 2] = -indicator(d > far)
    terms[worldid, 3] = -activation_effort(activation, worldid)
    terms[worldid, 4] = -d
    solved[worldid] = d < near
    failed[worldid] = d > far


class PoseProgram:
    """A pose task bound to a scene.

    Attributes:
        target: Target angles [rad], shape (num_worlds, num_targets).
        address: Where in qpos the joints with a target are, shape (num_targets,).
    """

    def __init__(self, spec: PoseTask, scene: Scene) -> None:
        """Allocate on the scene's device.

        Raises:
            ValueError: The targets do not have one entry a joint.
        """
        address = scene.oracle.jnt_qposadr[spec.target_joints(scene.oracle)]
        if not len(spec.target_low) == len(spec.target_high) == len(address):
            raise ValueError(
                f"task {spec.key!r} needs one target angle for each of the {len(address)} joints, "
                f"got {len(spec.target_low)} and {len(spec.target_high)}"
            )
        self.spec, self.scene = spec, scene
        self.target = wp.zeros((scene.num_worlds, len(address)), dtype=float)
        self.address = wp.array(address, dtype=int)
        self.target_low = wp.array(spec.target_low, dtype=float)
        self.target_high = wp.array(spec.target_high, dtype=float)
        self.weight = CarriedWeight(scene, *spec.weight) if spec.weight else None

    def sample_start(self, mask: wp.array) -> None:
        """Draw weights, and configurations where the task's own start is random."""
        scene = self.scene
        if self.weight is not None:
            self.weight.sample(mask)
        if self.spec.random_start and scene.reset == "task":
            wp.launch(
                sample_configuration,
                dim=scene.num_worlds,
                inputs=[scene.model.jnt_range, scene.keys, mask],
                outputs=[scene.data.qpos],
            )

    def sample_goal(self, mask: wp.array) -> None:
        """Launch `sample_pose`."""
        wp.launch(
            sample_pose,
            dim=self.scene.num_worlds,
            inputs=[self.target_low, self.target_high, self.scene.keys, mask],
            outputs=[self.target],
        )

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Launch `observe_pose`."""
        scene = self.scene
        wp.launch(
            observe_pose,
            dim=scene.num_worlds,
            inputs=[
                scene.data.qpos,
                scene.data.qvel,
                scene.muscles.activation,
                self.target,
                self.address,
                scene.control_dt,
                mask,
            ],
            outputs=[obs],
        )

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Launch `score_pose`."""
        scene = self.scene
        wp.launch(
            score_pose,
            dim=scene.num_worlds,
            inputs=[
                scene.data.qpos,
                scene.muscles.activation,
                self.target,
                self.address,
                self.spec.near,
                self.spec.far,
            ],
            outputs=[terms, solved, failed],
        )

    @cached_property
    def _full(self) -> mujoco.MjModel:
        """The body with all its sites, which the slim model lacks."""
        return full_model(self.spec)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Where the tips are in the target pose, by forward kinematics."""
        data = mujoco.MjData(self._full)
        data.qpos[:] = self.scene.qpos_start.numpy()
        data.qpos[self.address.numpy()] = self.target.numpy()[world]
        mujoco.mj_kinematics(self._full, data)
        tips = BODIES[self.spec.body].tips
        return {f"{tip}_target": data.site(tip).xpos.copy() for tip in tips}


def _register(
    name: str,
    body: str,
    low: tuple[float, ...],
    high: tuple[float, ...] | None = None,
    *,
    doc: str,
    version: int = 0,
    num_substeps: int = 10,
    horizon: int = 100,
    **options: Any,
) -> None:
    """Register one id; a fixed target has no `high`; `options` are further attributes of `PoseTask`."""
    options |= {"target_low": low, "target_high": low if high is None else high}
    spec = PoseTask(name, version, body, num_substeps, horizon, doc, **options)
    TASKS.add(spec.key, spec)


FINGER_NEAR, ELBOW_NEAR, HAND_NEAR = 0.35, 0.175, 0.7  # rad
EXO_EFFORT_WEIGHT = 5.0  # of the muscles; the motor is free

for _name, _body, _num_substeps, _horizon in (
    ("myoFingerPose", "finger", 10, 100),
    ("motorFingerPose", "motor_finger", 5, 200),
):
    _register(
        f"{_name}Fixed",
        _body,
        (0.0, 0.0, 0.75, 0.75),
        near=FINGER_NEAR,
        doc="Bend the finger to one pose.",
        num_substeps=_num_substeps,
        horizon=_horizon,
    )
    _register(
        f"{_name}Random",
        _body,
        (-0.2, -0.4, 0.1, 0.1),
        (0.2, 1.0, 1.0, 1.0),
        near=FINGER_NEAR,
        doc="Bend the finger to a pose drawn anew each episode.",
        num_substeps=_num_substeps,
        horizon=_horizon,
    )

_exo = {"body": "elbow_exo", "effort_weight": EXO_EFFORT_WEIGHT}
for _name, _low, _high, _options, _doc in (
    ("Fixed", 2.0, 2.0, {}, "Flex the elbow to 2 rad from a random angle."),
    ("Random", 0.0, 2.27, {}, "Turn the elbow from a random angle to a random angle."),
    (
        *("ExoFixed", 2.0, 2.0, _exo),
        "Flex the elbow to 2 rad from a random angle, helped by a motor (action 0), with 0.1 kg in the hand.",
    ),
    (
        *("ExoRandom", 0.0, 2.27, _exo | {"weight": (0.1, 2.0)}),
        "Turn the elbow from a random to a random angle, helped by a motor (action 0), with 0.1 to 2 kg.",
    ),
):
    _settings: dict[str, Any] = {"body": "elbow", "near": ELBOW_NEAR, "random_start": True, **_options}
    _register(f"myoElbowPose1D6M{_name}", low=(_low,), high=(_high,), doc=_doc, **_settings)


def _register_hand(
    version: int, relaxed: tuple[float, ...], digits: tuple[tuple[float, ...], ...], why: str
) -> None:
    """Register the twelve hand pose ids of one version."""
    _register(
        "myoHandPoseFixed",
        "hand",
        relaxed,
        near=HAND_NEAR,
        version=version,
        doc=f"Move the hand to a relaxed posture.{why}",
    )
    for digit, pose in enumerate(digits):
        _register(
            f"myoHandPose{digit}Fixed",
            "hand",
            pose,
            near=HAND_NEAR,
            version=version,
            doc=f"Sign the digit {digit} in American Sign Language.{why}",
        )
    low, high = bounds(digits)
    _register(
        "myoHandPoseRandom",
        "hand",
        low,
        high,
        near=HAND_NEAR,
        version=version,
        random_start=True,
        doc=f"Move the hand from a random posture to one drawn between the ten digits.{why}",
    )


_register_hand(0, as_in_myosuite_3(RELAXED), tuple(map(as_in_myosuite_3, DIGITS)), "")
_register_hand(
    1,
    tuple(max(angle, 0.0) if joint == 9 else angle for joint, angle in enumerate(RELAXED)),
    DIGITS,
    " Thumb base angles belong to their axes; in v0, as in MyoSuite 3.0.0, they are swapped and"
    " put the thumb tip up to 48 mm off. The target stays within the joint ranges.",
)
