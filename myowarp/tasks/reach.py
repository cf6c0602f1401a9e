"""Tip reach: bring the tips of a finger or of all five fingers to target points.

    reward = -x + 4 (1[x < 2 near] + 1[x < near]) - 50 1[x > far],    x = |targets - tips|

with x the norm over all 3 k coordinates of k tips, near = 0.0125 k, far = far_per_tip k [m]; the episode
fails beyond far from its second step on. Source: MyoSuite 3.0.0, families FingerReach and HandReach
(paper: Caggiano et al. 2022, arXiv:2205.13600).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES
from myowarp.definitions.entries import ACTIVATION, COORDINATES, VELOCITIES, axes
from myowarp.definitions.program import Program
from myowarp.definitions.registry import check_bounds
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, TaskSpec, blocks, weighted
from myowarp.kernels.observe import pack, pack_vec3
from myowarp.kernels.random import GOAL, RandomKeys, open_stream
from myowarp.kernels.reward import EFFORT, activation_effort, indicator
from myowarp.tasks.markers import add_tip_targets

NEAR_PER_TIP = 0.0125  # m; MyoSuite 3.0.0
WIDER = wp.constant(2.0)  # times `near`: where the first bonus begins
FIRST_FAILING_STEP = wp.constant(2)  # upstream tests data.time > 2 dt, which rounding makes true at step 2


Obs = IntEnum("Obs", "qpos qvel tip_pos reach_err act", start=0)
"""Blocks of the observation, in the order of their columns."""

Term = IntEnum("Term", "reach bonus penalty act_reg sparse", start=0)
"""Terms of the reward, in the order of their columns."""


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
    first: wp.array[int],
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
    pack(obs, worldid, first[Obs.qpos], qpos_in, 1.0)
    pack(obs, worldid, first[Obs.qvel], qvel_in, control_dt)
    for tip in range(tip_site.shape[0]):
        position = site_xpos_in[worldid, tip_site[tip]]
        pack_vec3(obs, worldid, first[Obs.tip_pos] + 3 * tip, position)
        error = reach_error(target, worldid, tip, position)
        pack_vec3(obs, worldid, first[Obs.reach_err] + 3 * tip, error)
    pack(obs, worldid, first[Obs.act], activation, 1.0)


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
    terms[worldid, Term.reach] = -x
    terms[worldid, Term.bonus] = indicator(x < WIDER * near) + indicator(x < near)
    terms[worldid, Term.penalty] = -indicator(lost)
    terms[worldid, Term.act_reg] = -activation_effort(activation, worldid)
    terms[worldid, Term.sparse] = -x
    solved[worldid] = x < near
    failed[worldid] = lost


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
        self.launch(sample_reach, mask=mask)

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        self.launch(observe_reach, mask=mask, obs=obs)

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        self.launch(score_reach, step_count=step_count, terms=terms, solved=solved, failed=failed)

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

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the target markers."""
        add_tip_targets(spec, self.tips)

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        return blocks(
            {
                Obs.qpos: (nq, *COORDINATES),
                Obs.qvel: (nv, *VELOCITIES),
                Obs.tip_pos: (3 * len(self.tips), "m", "position of each tip, world", axes(self.tips)),
                Obs.reach_err: (
                    3 * len(self.tips),
                    "m",
                    "from each tip to its target, world",
                    axes(self.tips),
                ),
                Obs.act: (num_muscles, *ACTIVATION),
            }
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        return weighted(
            {
                Term.reach: (1.0, "m", "minus the error, the norm of all distances of tips from targets"),
                Term.bonus: (
                    4.0,
                    "1",
                    f"1 where the error is below {WIDER * self.near:.4g} m, 2 below {self.near:.4g} m",
                ),
                Term.penalty: (50.0, "1", "-1 where the episode fails"),
                Term.act_reg: (0.0, *EFFORT),
                Term.sparse: (0.0, "m", "minus the error"),
            }
        )
