"""Tip reach: bring the tip of a finger or an arm, or of all five fingers, to target points.

    reward = -x + 4 (1[x < 2 near] + 1[x < near]) - 50 1[x > far],    x = |targets - tips|

with x the norm over all 3 k coordinates of k tips, near = 0.0125 k, far = far_per_tip k [m]; the episode
fails beyond far from its second step on. Source: MyoSuite 3.0.0, families FingerReach and HandReach
(paper: Caggiano et al. 2022, arXiv:2205.13600).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES
from myowarp.definitions.entries import ACTIVATION, COORDINATES, VELOCITIES, axes
from myowarp.definitions.program import Program
from myowarp.definitions.registry import check_bounds
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, Judgement, RewardTerm, Shown, TaskSpec
from myowarp.kernels.random import GOAL, RandomKeys, open_stream
from myowarp.kernels.reward import EFFORT, is_near, minus_error, minus_failed, near_bonus
from myowarp.models.reachability import reachable, unsolved
from myowarp.tasks.markers import add_tip_targets

NEAR_PER_TIP = 0.0125  # m; MyoSuite 3.0.0
EXACT = 1e-3  # m, error of a target that counts as none
FIRST_FAILING_STEP = wp.constant(2)  # upstream tests data.time > 2 dt, which rounding makes true at step 2


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
def tip_position(site_xpos: wp.array[wp.vec3], tip_site: wp.array[int], i: int) -> wp.vec3:
    """Position of tip i [m]."""
    return site_xpos[tip_site[i]]


@wp.func
def tip_error(
    site_xpos: wp.array[wp.vec3], tip_site: wp.array[int], target: wp.array[float], i: int
) -> wp.vec3:
    """From tip i to its target [m]."""
    return wp.vec3(target[3 * i], target[3 * i + 1], target[3 * i + 2]) - site_xpos[tip_site[i]]


@wp.func
def reach_error(site_xpos: wp.array[wp.vec3], tip_site: wp.array[int], target: wp.array[float]) -> float:
    """x = |targets - tips|."""
    total = float(0.0)
    for i in range(tip_site.shape[0]):
        total += wp.length_sq(tip_error(site_xpos, tip_site, target, i))
    return wp.sqrt(total)


@wp.func
def is_far_later(error: float, far: float, step_count: int) -> bool:
    """Error > far, from the first failing step on."""
    return error > far and step_count >= FIRST_FAILING_STEP


class ReachProgram(Program):
    """A reach task bound to a scene.

    Attributes:
        target: Target points [m], shape (num_worlds, 3 num_tips).
    """

    spec: ReachTask

    def __init__(self, spec: ReachTask, scene: Scene) -> None:
        """Allocate targets, and what they are drawn from."""
        super().__init__(spec, scene)
        low, high = np.asarray(spec.low), np.asarray(spec.high)
        table = np.asarray(spec.center)[None]
        if spec.table is not None:
            table = spec.table(spec, spec.tips, spec.center, spec.low, spec.high)
            low = high = np.zeros(table.shape[1])
        self.target = scene.zeros("task.target", table.shape[1])
        self.table = wp.array(table, dtype=float)
        self.target_low = wp.array(low, dtype=float)
        self.target_high = wp.array(high, dtype=float)
        self.tip_site = wp.array([scene.site_id(name) for name in spec.tips], dtype=int)

    def sample_goal(self, mask: wp.array) -> None:
        super().sample_goal(mask)
        self.launch(sample_reach, mask=mask)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """The target points."""
        points = self.target.numpy()[world].reshape(-1, 3)
        return {f"{tip}_target": point for tip, point in zip(self.spec.tips, points, strict=True)}


@dataclass(frozen=True, kw_only=True)
class ReachTask(TaskSpec):
    """Reach points with the tips of the body.

    Attributes:
        center: Target points [m], world coordinates, three entries a tip.
        low: Lower bound of the uniform offset from `center` [m].
        high: Upper bound.
        far_per_tip: Failure radius divided by the number of tips [m].
        near_per_tip: Success radius divided by the number of tips [m].
        table: Returns targets within the reach of the tips, a row each, to draw from instead of the box;
            called like `reach_targets.sampled`.
    """

    program: ClassVar[type] = ReachProgram
    shown: ClassVar[Shown | None] = Shown(
        "A trained finger brings its tip to the green ball.", "myoFingerReachRandom-v0", "baseline", 40, 1
    )
    measures: ClassVar = {"error": reach_error, "solved": is_near, "failed": is_far_later}
    wider: ClassVar[float] = 2.0  # times `near`: where the first bonus begins

    num_substeps: int = 10
    horizon: int = 100
    center: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    far_per_tip: float
    near_per_tip: float = NEAR_PER_TIP
    table: Callable[..., np.ndarray] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bounds("low", self.low, self.high)

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
        return self.near_per_tip * len(self.tips)

    @property
    def far(self) -> float:
        """Distance norm beyond which the episode fails [m]."""
        return self.far_per_tip * len(self.tips)

    @property
    def solved_when(self) -> str:
        return f"the error, the norm of all distances of tips from targets, is below {self.near:.4g} m"

    @property
    def failed_when(self) -> str:
        return f"the error exceeds {self.far:.4g} m, from step {FIRST_FAILING_STEP} on"

    @property
    def draws(self) -> tuple[Draw, ...]:
        low, high = (tuple(np.add(self.center, end).tolist()) for end in (self.low, self.high))
        source = "" if self.table is None else "; a row of a table of targets within reach, which lie in"
        return (Draw("target", "m", low, high, f"target of each tip, world{source}", axes(self.tips)),)

    def judge(self, model: mujoco.MjModel, targets: np.ndarray) -> Judgement:
        if why := unsolved(model):
            raise ValueError(why)
        miss, _ = reachable(model, self.tips, targets)
        return miss < self.near, miss <= EXACT, miss

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the target markers."""
        add_tip_targets(spec, self.tips)

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        size, names = 3 * len(self.tips), axes(self.tips)
        return (
            Column("qpos", nq, *COORDINATES),
            Column("qvel", nv, *VELOCITIES),
            Column("tip_pos", size, "m", "position of each tip, world", names, tip_position),
            Column("reach_err", size, "m", "from each tip to its target, world", names, tip_error),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        error = "minus the error, the norm of all distances of tips from targets"
        bonus = f"1 where the error is below {self.wider * self.near:.4g} m, 2 below {self.near:.4g} m"
        return (
            RewardTerm("reach", 1.0, "m", error, minus_error),
            RewardTerm("bonus", 4.0, "1", bonus, near_bonus),
            RewardTerm("penalty", 50.0, "1", "-1 where the episode fails", minus_failed),
            RewardTerm("act_reg", 0.0, *EFFORT),
            RewardTerm("sparse", 0.0, "m", "minus the error", minus_error),
        )
