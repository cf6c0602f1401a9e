"""Tip reach: bring the tips of a finger or of all five fingers to target points.

    reward = -x + 4 (1[x < 2 near] + 1[x < near]) - 50 1[x > far],    x = |targets - tips|

with x the norm over all 3 k coordinates of k tips, near = 0.0125 k, far = far_per_tip k [m]; the episode
fails beyond far from its second step on. Source: MyoSuite 3.0.0, families FingerReach and HandReach
(paper: Caggiano et al. 2022, arXiv:2205.13600).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
import warp as wp

from myowarp.kernels.observe import pack, pack_vec3
from myowarp.kernels.random import GOAL, RandomKeys, open_stream
from myowarp.kernels.reward import activation_effort, indicator
from myowarp.spec.body import BODIES
from myowarp.spec.scene import Scene
from myowarp.spec.task import TASKS, Column, RewardTerm, TaskSpec
from myowarp.tasks import reach_targets
from myowarp.tasks.markers import add_tip_targets

NEAR_PER_TIP = 0.0125  # m
FIRST_FAILING_STEP = wp.constant(2)  # upstream tests data.time > 2 dt, which rounding makes true at step 2


@dataclass(frozen=True)
class ReachTask(TaskSpec):
    """Reach points with the tips of the body.

    Attributes:
        center: Target points [m], world coordinates, three entries a tip.
        low: Lower bound of the uniform offset from `center` [m].
        high: Upper bound.
        far_per_tip: Failure radius divided by the number of tips [m].
        table: Returns targets within the reach of the tips, a row each, to draw from instead of the box;
            called like `reach_targets.sampled`.
    """

    center: tuple[float, ...] = field(kw_only=True)
    low: tuple[float, ...] = field(kw_only=True)
    high: tuple[float, ...] = field(kw_only=True)
    far_per_tip: float = field(kw_only=True)
    table: Callable[..., np.ndarray] | None = field(default=None, kw_only=True)

    @property
    def tips(self) -> tuple[str, ...]:
        """Names of the tip sites, in the order of the targets."""
        return BODIES[self.body].tips

    @property
    def sites(self) -> tuple[str, ...]:
        """The tips."""
        return self.tips

    @property
    def near(self) -> float:
        """Distance norm below which the task counts as solved [m]."""
        return NEAR_PER_TIP * len(self.tips)

    @property
    def far(self) -> float:
        """Distance norm beyond which the episode fails [m]."""
        return self.far_per_tip * len(self.tips)

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the target markers."""
        add_tip_targets(spec, self.tips)

    def columns(self, num_joints: int, num_muscles: int) -> tuple[Column, ...]:
        """Angles, angular velocities times the control step, tips, errors, activations."""
        return (
            Column("qpos", num_joints, "rad"),
            Column("qvel", num_joints, "rad per control step"),
            Column("tip_pos", 3 * len(self.tips), "m"),
            Column("reach_err", 3 * len(self.tips), "m"),
            Column("act", num_muscles, "1"),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """In the order in which `score_reach` writes them."""
        return (
            RewardTerm("reach", 1.0),
            RewardTerm("bonus", 4.0),
            RewardTerm("penalty", 50.0),
            RewardTerm("act_reg", 0.0),
            RewardTerm("sparse", 0.0),
        )

    def bind(self, scene: Scene) -> ReachProgram:
        """Allocate targets for every world."""
        return ReachProgram(self, scene)


@wp.kernel(enable_backward=False)
def sample_reach(
    # Params:
    table: wp.array2d[float],
    target_low: wp.array[float],
    target_high: wp.array[float],
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    target: wp.array2d[float],
):
    """target = a row of the table, drawn uniformly, plus U(low, high)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    goal = open_stream(keys, worldid, GOAL)
    row = wp.randi(goal, 0, table.shape[0])
    for i in range(target.shape[1]):
        target[worldid, i] = table[row, i] + wp.randf(goal, target_low[i], target_high[i])


@wp.func
def reach_error(target: wp.array2d[float], worldid: int, tip: int, position: wp.vec3) -> wp.vec3:
    """Vector from a tip to its target [m]."""
    i = 3 * tip
    point = wp.vec3(target[worldid, i], target[worldid, i + 1], target[worldid, i + 2])
    return point - position


@wp.kernel(enable_backward=False)
def observe_reach(
    # Params:
    tip_site: wp.array[int],
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    site_xpos_in: wp.array2d[wp.vec3],
    # In:
    activation: wp.array2d[float],
    target: wp.array2d[float],
    control_dt: float,
    mask: wp.array[bool],
    # Out:
    obs: wp.array2d[float],
):
    """obs = [qpos, qvel dt, tips, targets - tips, activation]."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    column = pack(obs, worldid, 0, qpos_in, 1.0)
    column = pack(obs, worldid, column, qvel_in, control_dt)
    for tip in range(tip_site.shape[0]):
        column = pack_vec3(obs, worldid, column, site_xpos_in[worldid, tip_site[tip]])
    for tip in range(tip_site.shape[0]):
        position = site_xpos_in[worldid, tip_site[tip]]
        column = pack_vec3(obs, worldid, column, reach_error(target, worldid, tip, position))
    pack(obs, worldid, column, activation, 1.0)


@wp.kernel(enable_backward=False)
def score_reach(
    # Params:
    tip_site: wp.array[int],
    # Data in:
    site_xpos_in: wp.array2d[wp.vec3],
    # In:
    activation: wp.array2d[float],
    target: wp.array2d[float],
    near: float,
    far: float,
    step_count: wp.array[int],
    # Out:
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """Terms reach, bonus, penalty, act_reg, sparse from x = |targets - tips|."""
    worldid = wp.tid()
    total = float(0.0)
    for tip in range(tip_site.shape[0]):
        position = site_xpos_in[worldid, tip_site[tip]]
        total += wp.length_sq(reach_error(target, worldid, tip, position))
    x = wp.sqrt(total)
    lost = x > far and step_count[worldid] >= FIRST_FAILING_STEP
    terms[worldid, 0] = -x
    terms[worldid, 1] = indicator(x < 2.0 * near) + indicator(x < near)
    terms[worldid, 2] = -indicator(lost)
    terms[worldid, 3] = -activation_effort(activation, worldid)
    terms[worldid, 4] = -x
    solved[worldid] = x < near
    failed[worldid] = lost


class ReachProgram:
    """A reach task bound to a scene.

    Attributes:
        target: Target points [m], shape (num_worlds, 3 num_tips).
    """

    def __init__(self, spec: ReachTask, scene: Scene) -> None:
        """Allocate on the scene's device."""
        self.spec, self.scene = spec, scene
        low, high = np.asarray(spec.low), np.asarray(spec.high)
        table = np.asarray(spec.center)[None]
        if spec.table is not None:
            table = spec.table(spec, spec.tips, spec.center, spec.low, spec.high)
            low = high = np.zeros(table.shape[1])
        self.target = wp.zeros((scene.num_worlds, table.shape[1]), dtype=float)
        self.table = wp.array(table, dtype=float)
        self.target_low = wp.array(low, dtype=float)
        self.target_high = wp.array(high, dtype=float)
        self.tip_site = wp.array([scene.site_id(name) for name in spec.tips], dtype=int)

    def sample_start(self, mask: wp.array) -> None:
        """Nothing to draw: the common start is the task's."""

    def sample_goal(self, mask: wp.array) -> None:
        """Launch `sample_reach`."""
        wp.launch(
            sample_reach,
            dim=self.scene.num_worlds,
            inputs=[self.table, self.target_low, self.target_high, self.scene.keys, mask],
            outputs=[self.target],
        )

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Launch `observe_reach`."""
        scene = self.scene
        wp.launch(
            observe_reach,
            dim=scene.num_worlds,
            inputs=[
                self.tip_site,
                scene.data.qpos,
                scene.data.qvel,
                scene.data.site_xpos,
                scene.muscles.activation,
                self.target,
                scene.control_dt,
                mask,
            ],
            outputs=[obs],
        )

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Launch `score_reach`."""
        scene = self.scene
        wp.launch(
            score_reach,
            dim=scene.num_worlds,
            inputs=[
                self.tip_site,
                scene.data.site_xpos,
                scene.muscles.activation,
                self.target,
                self.spec.near,
                self.spec.far,
                step_count,
            ],
            outputs=[terms, solved, failed],
        )

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """The target points."""
        points = self.target.numpy()[world].reshape(-1, 3)
        return {f"{tip}_target": point for tip, point in zip(self.spec.tips, points, strict=True)}


FINGER_FAR, HAND_FAR, HAND_FAR_FIXED_V0 = 0.35, 0.075, 0.044  # m a tip; MyoSuite 3.0.0

for _name, _body, _timing in (
    ("myoFingerReach", "finger", (10, 100)),
    ("motorFingerReach", "motor_finger", (5, 200)),
):
    for _spec in (
        ReachTask(
            f"{_name}Fixed",
            0,
            _body,
            *_timing,
            "Touch one point with the fingertip.",
            center=(0.2, 0.05, 0.2),
            low=(0.0, 0.0, 0.0),
            high=(0.0, 0.0, 0.0),
            far_per_tip=FINGER_FAR,
        ),
        ReachTask(
            f"{_name}Random",
            0,
            _body,
            *_timing,
            "Touch a point drawn anew each episode from the reachable part of a box.",
            center=(0.185, 0.0, 0.2),
            low=(-0.085, -0.1, -0.1),
            high=(0.085, 0.1, 0.1),
            far_per_tip=FINGER_FAR,
            table=reach_targets.sampled,
        ),
    ):
        TASKS.add(_spec.key, _spec)

HAND_CENTER = (
    *(-0.165, -0.537, 1.495),  # thumb
    *(-0.151, -0.547, 1.455),  # index
    *(-0.146, -0.547, 1.447),  # middle
    *(-0.148, -0.543, 1.445),  # ring
    *(-0.148, -0.528, 1.434),  # little
)  # m, world: the tips of the paper's start posture, every joint at mid-range
HAND_LOW = (-0.02, -0.04, -0.04) + 4 * (-0.04, -0.02, -0.01)
HAND_HIGH = (0.04, 0.02, 0.04) + 4 * (0.04, 0.02, 0.01)


def _register_hand(
    name: str,
    version: int,
    random: bool,
    far_per_tip: float,
    doc: str,
    table: Callable[..., np.ndarray] | None = None,
) -> None:
    """Register one hand reach id."""
    still = (0.0,) * len(HAND_CENTER)
    spec = ReachTask(
        name,
        version,
        "hand",
        10,
        100,
        doc,
        center=HAND_CENTER,
        low=HAND_LOW if random else still,
        high=HAND_HIGH if random else still,
        far_per_tip=far_per_tip,
        table=table,
    )
    TASKS.add(spec.key, spec)


_register_hand(
    "myoHandReachFixed",
    0,
    False,
    HAND_FAR_FIXED_V0,
    "Bring all five fingertips to fixed points.",
)
_register_hand(
    "myoHandReachFixed",
    1,
    False,
    HAND_FAR,
    "Bring all five fingertips to fixed points. The failure radius is that of the random task: in v0,"
    " as in MyoSuite 3.0.0, it was set for another start posture, and a resting hand fails at step 18.",
)
_register_hand(
    "myoHandReachRandom",
    0,
    True,
    HAND_FAR,
    "Bring all five fingertips to points drawn anew each episode.",
)
_register_hand(
    "myoHandReachRandom",
    1,
    True,
    HAND_FAR,
    "Bring all five fingertips to points drawn anew each episode, all within reach at once. In v0, as in"
    " MyoSuite 3.0.0, five in six targets are not: the best posture leaves the thumb up to 6 cm off.",
    reach_targets.solved,
)
