"""Baoding balls: let two balls circle each other on the palm, or swap them.

    reward = -5 d1 - 5 d2                                                              (MyoSuite's)
    reward = -5 d1 - 5 d2 + 1[d1 < 0.015] + 1[d2 < 0.015] + 4 1[both] - |act| / n - 500 1[fall]  (corrected)

with d_i the distance of ball i from its target [m]. The targets stand opposite each other on an ellipse in
the frame of the trapezium, so that they ride with the wrist; in step k after the reset they are where
`baoding_orbits` has them at the time (k - 1) control_dt. The episode fails with a fall, when a ball is below
1.25 m. Source: MyoSuite 3.0.0, family Baoding, ids `myoChallengeBaodingP1-v1` and `P2-v1` (paper: Caggiano
et al. 2022, arXiv:2205.13600, where the tasks are called Fixed and Random).

The corrected reward is that of the paper's own code without its term for a still wrist: the targets ride with
the wrist, so that no stillness is asked for. Corrected balls are those of `baoding_balls`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, XYZ
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec
from myowarp.kernels.reward import EFFORT, indicator, minus_failed
from myowarp.kernels.world_function import Row
from myowarp.models.bodies.contact_hand import HAND_JOINTS, SOFT, add_object
from myowarp.tasks.baoding_balls import BATCHED, BATCHED_INERTIA, BallRanges, sample_balls, weigh_balls
from myowarp.tasks.baoding_orbits import (
    OrbitRanges,
    Orbits,
    move_targets,
    new_orbits,
    orbit_turns,
    sample_orbit,
)
from myowarp.tasks.markers import add_tip_targets

BALL_QPOS = wp.constant(wp.vec2i(23, 30))  # where the free joints start in qpos
BALL_QVEL = (23, 29)
NEAR = wp.constant(0.015)  # m, distance of each ball within which the task is solved
BOTH_BONUS = wp.constant(4.0)  # what both balls at their targets add to the 1 of each
DROPPED = wp.constant(1.25)  # m, height of a ball's centre below which the episode fails

PALM_UP = -1.57  # rad, pronation at the start
BALLS = {"ball1": (-0.227, -0.511, 1.452), "ball2": (-0.256, -0.552, 1.442)}  # m, world
COLORS = ((0.8, 0.25, 0.2, 0.6), (0.2, 0.4, 0.8, 0.6))  # let the targets be seen through the balls
BALL_RADIUS, BALL_MASS = 0.022, 0.043  # m, kg
BALL_FRICTION = (1.0, 0.005, 0.0001)  # slide, spin, roll
FRICTIONS = ("slide", "spin", "roll")
NOMINAL_BALLS = BallRanges(2 * (BALL_MASS,), 2 * (BALL_RADIUS,), (BALL_FRICTION, BALL_FRICTION))
DROP_WEIGHT = 500.0
"""Cost of a fall, in the paper's code. It exceeds 200 steps at full effort with both balls as far from
their targets as the hand reaches, 0.19 m: 200 (10 * 0.19 + 0.16) = 412."""


@wp.func
def ball_position(qpos: wp.array[float], ball: int) -> wp.vec3:
    """Centre of ball 0 or 1 in the world [m]."""
    first = BALL_QPOS[ball]
    return wp.vec3(qpos[first], qpos[first + 1], qpos[first + 2])


@wp.func
def palm_place(site_xpos: wp.array[wp.vec3], palm_site: int) -> wp.vec3:
    """Origin of the frame in which the targets move."""
    return site_xpos[palm_site]


@wp.func
def palm_frame(site_xmat: wp.array[wp.mat33], palm_site: int) -> wp.mat33:
    """Its axes."""
    return site_xmat[palm_site]


@wp.func
def target_1(palm: wp.vec3, frame: wp.mat33, target: wp.array[wp.vec3]) -> wp.vec3:
    """Target of ball 1 in the world."""
    return palm + frame * target[0]


@wp.func
def target_2(palm: wp.vec3, frame: wp.mat33, target: wp.array[wp.vec3]) -> wp.vec3:
    """Target of ball 2 in the world."""
    return palm + frame * target[1]


@wp.func
def error_1(target_1: wp.vec3, qpos: wp.array[float]) -> wp.vec3:
    """From ball 1 to its target."""
    return target_1 - ball_position(qpos, 0)


@wp.func
def error_2(target_2: wp.vec3, qpos: wp.array[float]) -> wp.vec3:
    """From ball 2 to its target."""
    return target_2 - ball_position(qpos, 1)


@wp.func
def minus_distance_1(error_1: wp.vec3) -> float:
    """-d1."""
    return -wp.length(error_1)


@wp.func
def minus_distance_2(error_2: wp.vec3) -> float:
    """-d2."""
    return -wp.length(error_2)


@wp.func
def minus_distances(pos_dist_1: float, pos_dist_2: float) -> float:
    """-(d1 + d2)."""
    return pos_dist_1 + pos_dist_2


@wp.func
def num_met(pos_dist_1: float, pos_dist_2: float) -> float:
    """1[d1 < 0.015] + 1[d2 < 0.015]."""
    return indicator(-pos_dist_1 < NEAR) + indicator(-pos_dist_2 < NEAR)


@wp.func
def met_bonus(met: float) -> float:
    """Reward of balls at their targets."""
    return met + BOTH_BONUS * indicator(met == 2.0)


@wp.func
def is_fallen(qpos: wp.array[float]) -> bool:
    """Whether a ball is below 1.25 m."""
    return ball_position(qpos, 0)[2] < DROPPED or ball_position(qpos, 1)[2] < DROPPED


@wp.func
def is_met(
    met: float, failed: bool, orbits: Orbits, control_dt: float, step_count: int, worldid: int
) -> bool:
    """Whether both balls are at their targets; those that jump have to be met after their first jump."""
    begun = orbits.jumps == 0 or orbit_turns(orbits, worldid, control_dt, step_count) > 0.0
    return met == 2.0 and begun and not failed


class BaodingProgram(Program):
    """A baoding task bound to a scene.

    Attributes:
        orbits: How the targets move.
        target: Where they are in this step, frame of the trapezium [m], shape (num_worlds, 2) of vec3.
    """

    spec: BaodingTask

    def __init__(self, spec: BaodingTask, scene: Scene) -> None:
        """Resolve palm and balls, allocate the targets."""
        super().__init__(spec, scene)
        self.palm_site = scene.site_id("palm_frame")
        self.ball_body = wp.vec2i(*(scene.oracle.body(name).id for name in BALLS))
        self.ball_geom = wp.vec2i(*(scene.oracle.geom(name).id for name in BALLS))
        self.ball_bounds = None if spec.balls is None else spec.balls.on_device()
        self.orbit_bounds, self.orbits = spec.orbits.on_device(), new_orbits(scene, spec.orbits)
        self.target = scene.zeros("task.target", 2, dtype=wp.vec3)

    def sample_start(self, mask: wp.array) -> None:
        """Draw the balls where they differ."""
        super().sample_start(mask)
        if self.ball_bounds is not None:
            self.launch(sample_balls, mask=mask)
            if self.spec.corrected:
                self.launch(weigh_balls, mask=mask)

    def sample_goal(self, mask: wp.array) -> None:
        super().sample_goal(mask)
        self.launch(sample_orbit, mask=mask)

    def advance(self, step_count: wp.array) -> None:
        self.launch(move_targets, step_count=step_count)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return the targets of the balls."""
        data = self.scene.data
        palm = data.site_xpos.numpy()[world, self.palm_site]
        frame = data.site_xmat.numpy()[world, self.palm_site]
        places = palm + self.target.numpy()[world] @ frame.T
        return {f"{name}_target": place for name, place in zip(BALLS, places, strict=True)}


@dataclass(frozen=True, kw_only=True)
class BaodingTask(TaskSpec):
    """Circle two balls, or swap them.

    Attributes:
        orbits: How the targets move.
        balls: Bounds of the balls' properties; None: always the nominal ones.
        corrected: Whether the reward is the corrected one, and the balls are solid spheres with their own
            friction. Without, they have MyoSuite's inertia floor, and a contact the larger friction.
    """

    program: ClassVar[type] = BaodingProgram
    title: ClassVar[str] = "Baoding balls"
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained for the balls.",
        "myoChallengeBaodingP1-v2",
        "random",
        30,
        2,
    )
    measures: ClassVar = {
        "palm": palm_place,
        "frame": palm_frame,
        "target_1": target_1,
        "target_2": target_2,
        "error_1": error_1,
        "error_2": error_2,
        "pos_dist_1": minus_distance_1,
        "pos_dist_2": minus_distance_2,
        "met": num_met,
        "solved": is_met,
        "failed": is_fallen,
    }
    coarse_step = CoarseStep(0.005, 0.35)
    sites = ("palm_frame",)  # the targets move in its frame
    carried = tuple(BALLS)
    start_doc = "the open hand, palm up, with the balls above it"
    failed_when = f"the centre of a ball is below {DROPPED:g} m, height in the world"

    body: str = "contact_hand"
    num_substeps: int = 10
    physics_dt: float = 0.0025
    horizon: int = 200
    orbits: OrbitRanges = field(default=OrbitRanges())
    balls: BallRanges | None = None
    corrected: bool = False

    @property
    def scene_key(self) -> tuple[object, ...]:
        """Inertia and friction of the balls are compiled in."""
        return (*super().scene_key, self.corrected)

    @property
    def batched(self) -> tuple[str, ...]:
        """Fields that differ between balls."""
        inertia = BATCHED_INERTIA if self.corrected else ()
        return () if self.balls is None else (*BATCHED, *inertia)

    @property
    def solved_when(self) -> str:
        jumped = ", and the targets have jumped" if self.orbits.jumps else ""
        return f"both balls are within {NEAR:g} m of their targets{jumped}"

    @property
    def draws(self) -> tuple[Draw, ...]:
        balls = self.balls or NOMINAL_BALLS
        low, high = balls.friction
        return (
            *self.orbits.draws,
            Draw("ball mass", "kg", balls.mass[:1], balls.mass[1:], "mass of each ball", when="start"),
            Draw("ball radius", "m", balls.radius[:1], balls.radius[1:], "radius of each ball", when="start"),
            Draw("ball friction", "1", low, high, "friction of each ball", FRICTIONS, when="start"),
        )

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Open hand, palm up, the balls above it."""
        qpos = model.qpos0.copy()
        qpos[0] = PALM_UP
        return qpos

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the frame of the targets and two free balls."""
        spec.body("trapezium_r").add_site(name="palm_frame")
        for (name, pos), color in zip(BALLS.items(), COLORS, strict=True):
            body = add_object(spec, name, pos, floored=not self.corrected)
            body.add_freejoint(name=name)
            ball = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE)
            ball.size, ball.mass, ball.rgba = (BALL_RADIUS, 0.0, 0.0), BALL_MASS, color
            ball.contype, ball.conaffinity, ball.condim, ball.friction = 1, 1, 4, BALL_FRICTION
            if self.corrected:
                # A contact takes all it has from the geom of higher priority, so the ball gets the mean
                # impedance that it would have with the hand, and only friction differs there.
                ball.priority, ball.solimp = 1, 0.5 * (ball.solimp + np.array(SOFT))
            body.add_site(name=name, size=(0.005, 0.005, 0.005))
        add_tip_targets(spec, BALLS)

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        unit, velocity = "m per control step", "velocity of ball {} times the control step, world"
        (qpos_1, qpos_2), (qvel_1, qvel_2) = BALL_QPOS, BALL_QVEL
        rates = Row("qvel", qvel_1, "control_dt"), Row("qvel", qvel_2, "control_dt")
        return (
            Column("hand_pos", HAND_JOINTS, *COORDINATES),
            Column("object1_pos", 3, "m", "position of ball 1, world", XYZ, Row("qpos", qpos_1)),
            Column("object1_velp", 3, unit, velocity.format(1), XYZ, rates[0]),
            Column("object2_pos", 3, "m", "position of ball 2, world", XYZ, Row("qpos", qpos_2)),
            Column("object2_velp", 3, unit, velocity.format(2), XYZ, rates[1]),
            Column("target1_pos", 3, "m", "target of ball 1, world", XYZ, target_1),
            Column("target2_pos", 3, "m", "target of ball 2, world", XYZ, target_2),
            Column("target1_err", 3, "m", "from ball 1 to its target, world", XYZ, error_1),
            Column("target2_err", 3, "m", "from ball 2 to its target, world", XYZ, error_2),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        away = "minus the distance of ball {} from its target"
        met = f"1 for each ball within {NEAR:g} m of its target, and {BOTH_BONUS:g} more for both"
        terms = (
            RewardTerm("pos_dist_1", 5.0, "m", away.format(1), minus_distance_1),
            RewardTerm("pos_dist_2", 5.0, "m", away.format(2), minus_distance_2),
            RewardTerm("act_reg", float(self.corrected), *EFFORT),
            RewardTerm("sparse", 0.0, "m", "minus the sum of both distances", minus_distances),
        )
        if not self.corrected:
            return terms
        drop = RewardTerm("drop", DROP_WEIGHT, "1", "-1 where the episode fails", minus_failed)
        return (*terms, drop, RewardTerm("bonus", 1.0, "1", met, met_bonus))
