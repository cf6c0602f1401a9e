"""Baoding balls: let two balls circle each other on the palm.

    reward = -5 |p1 - t1| - 5 |p2 - t2|

with ball i's position p_i and target t_i [m]. The targets stand opposite each other on an ellipse in the
frame of the trapezium, so that they ride with the wrist. In step k after the reset they are at the angles

    angle_i = start + direction 2 pi (k - 1) control_dt / period - (i - 1) pi.

The episode fails when a ball falls below 1.25 m. Source: MyoSuite 3.0.0, family Baoding, ids
`myoChallengeBaodingP1-v1` and `P2-v1` (paper: Caggiano et al. 2022, arXiv:2205.13600, where the tasks are
called Fixed and Random and reward and start differ).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
import warp as wp

from myowarp.kernels.observe import pack, pack_range, pack_vec3
from myowarp.kernels.random import GOAL, RandomKeys, open_stream
from myowarp.kernels.reward import activation_effort
from myowarp.models.bodies.contact_hand import HAND_JOINTS, add_object
from myowarp.scene import Scene
from myowarp.spec import TASKS, Column, RewardTerm, TaskSpec
from myowarp.tasks.baoding_balls import BATCHED, BallDraw, BallRanges, Range
from myowarp.tasks.markers import add_tip_targets

BALL_QPOS = wp.constant(wp.vec2i(23, 30))  # where the free joints start in qpos
BALL_QVEL = wp.constant(wp.vec2i(23, 29))
ELLIPSE_CENTER = wp.constant(wp.vec3(-0.0125, -0.07, -0.02))  # m, frame of the trapezium
NEAR = wp.constant(0.015)  # m, distance of each ball within which the task is solved
DROPPED = wp.constant(1.25)  # m, height of a ball's centre below which the episode fails
TWO_PI = wp.constant(2.0 * np.pi)

PALM_UP = -1.57  # rad, pronation at the start
BALLS = {"ball1": (-0.227, -0.511, 1.452), "ball2": (-0.256, -0.552, 1.442)}  # m, world
COLORS = ((0.8, 0.25, 0.2, 1.0), (0.2, 0.4, 0.8, 1.0))
BALL_RADIUS, BALL_MASS = 0.022, 0.043  # m, kg
BALL_FRICTION = (1.0, 0.005, 0.0001)  # slide, spin, roll
FRICTION_RANGE = ((0.8, 0.004, 0.00008), (1.2, 0.006, 0.00012))  # nominal -+ (0.2, 0.001, 0.00002)


@dataclass(frozen=True)
class BaodingTask(TaskSpec):
    """Circle two balls.

    Attributes:
        directions: Senses of rotation to choose from: 1 counter-clockwise, -1 clockwise, 0 hold.
        angle: Bounds of the first ball's start angle [rad].
        radius_x: Bounds of the ellipse's half axis along x [m].
        radius_y: Bounds of its half axis along y [m].
        period: Bounds of the duration of a revolution [s].
        balls: Bounds of the balls' properties; None: always the nominal ones.
    """

    directions: tuple[float, ...] = field(default=(1.0,), kw_only=True)
    angle: Range = field(default=(0.25 * np.pi, 0.25 * np.pi), kw_only=True)
    radius_x: Range = field(default=(0.025, 0.025), kw_only=True)
    radius_y: Range = field(default=(0.028, 0.028), kw_only=True)
    period: Range = field(default=(5.0, 5.0), kw_only=True)
    balls: BallRanges | None = field(default=None, kw_only=True)

    @property
    def sites(self) -> tuple[str, ...]:
        """Origin of the frame in which the targets move."""
        return ("palm_frame",)

    @property
    def batched(self) -> tuple[str, ...]:
        """What differs between balls."""
        return () if self.balls is None else BATCHED

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Open hand, palm up, the balls above it."""
        qpos = model.qpos0.copy()
        qpos[0] = PALM_UP
        return qpos

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the frame of the targets and two free balls."""
        spec.body("trapezium_r").add_site(name="palm_frame")
        for (name, pos), color in zip(BALLS.items(), COLORS, strict=True):
            body = add_object(spec, name, pos)
            body.add_freejoint(name=name)
            ball = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE)
            ball.size, ball.mass, ball.rgba = (BALL_RADIUS, 0.0, 0.0), BALL_MASS, color
            ball.contype, ball.conaffinity, ball.condim, ball.friction = 1, 1, 4, BALL_FRICTION
            body.add_site(name=name, size=(0.005, 0.005, 0.005))
        add_tip_targets(spec, BALLS)

    def columns(self, num_joints: int, num_muscles: int) -> tuple[Column, ...]:
        """Hand, balls, targets, what separates them, activations."""
        balls = (("object1", "object2"), ("pos", "m"), ("velp", "m per control step"))
        motion = [Column(f"{name}_{what}", 3, unit) for name in balls[0] for what, unit in balls[1:]]
        targets = [Column(f"target{i}_{what}", 3, "m") for what in ("pos", "err") for i in (1, 2)]
        hand = Column("hand_pos", num_joints - 14, "rad")
        return (hand, *motion, *targets, Column("act", num_muscles, "1"))

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """In the order in which `score_baoding` writes them."""
        return (
            RewardTerm("pos_dist_1", 5.0),
            RewardTerm("pos_dist_2", 5.0),
            RewardTerm("act_reg", 0.0),
            RewardTerm("sparse", 0.0),
        )

    def bind(self, scene: Scene) -> BaodingProgram:
        """Resolve the palm and the balls, allocate the targets."""
        return BaodingProgram(self, scene)


@wp.struct
class OrbitRanges:
    """Bounds of the uniformly drawn orbits, as in `BaodingTask`; radii along (x, y)."""

    directions: wp.array[float]
    angle: wp.vec2
    radii_low: wp.vec2
    radii_high: wp.vec2
    period: wp.vec2


@wp.struct
class Orbits:
    """The orbit of every world's targets; all arrays (num_worlds,).

    Attributes:
        direction: 1 counter-clockwise, -1 clockwise, 0 hold.
        start_angle: Angle of the first target at the reset [rad].
        radii: Half axes of the ellipse [m].
        period: Duration of a revolution [s].
    """

    direction: wp.array[float]
    start_angle: wp.array[float]
    radii: wp.array[wp.vec2]
    period: wp.array[float]


@wp.func
def orbit_point(orbits: Orbits, worldid: int, ball: int, elapsed: float) -> wp.vec3:
    """Target of ball 0 or 1 after `elapsed` [s], in the frame of the trapezium [m]."""
    turn = orbits.direction[worldid] * TWO_PI * elapsed / orbits.period[worldid]
    angle = orbits.start_angle[worldid] + turn - 0.5 * TWO_PI * float(ball)
    radii = orbits.radii[worldid]
    return ELLIPSE_CENTER + wp.vec3(radii[0] * wp.cos(angle), radii[1] * wp.sin(angle), 0.0)


@wp.func
def position_of(qpos: wp.array2d[float], worldid: int, ball: int) -> wp.vec3:
    """Centre of ball 0 or 1 in the world [m]."""
    first = BALL_QPOS[ball]
    return wp.vec3(qpos[worldid, first], qpos[worldid, first + 1], qpos[worldid, first + 2])


@wp.kernel(enable_backward=False)
def sample_orbit(
    # Params:
    orbit_ranges: OrbitRanges,
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    orbits: Orbits,
    target: wp.array2d[wp.vec3],
):
    """direction ~ choice, all else ~ U(low, high); the targets are at their start angles."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, GOAL)
    r = orbit_ranges
    orbits.direction[worldid] = r.directions[wp.randi(state, 0, r.directions.shape[0])]
    orbits.start_angle[worldid] = wp.randf(state, r.angle[0], r.angle[1])
    radius_x = wp.randf(state, r.radii_low[0], r.radii_high[0])
    radius_y = wp.randf(state, r.radii_low[1], r.radii_high[1])
    orbits.radii[worldid] = wp.vec2(radius_x, radius_y)
    orbits.period[worldid] = wp.randf(state, r.period[0], r.period[1])
    for ball in range(2):
        target[worldid, ball] = orbit_point(orbits, worldid, ball, 0.0)


@wp.kernel(enable_backward=False)
def observe_baoding(
    # Params:
    palm_site: int,
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    site_xpos_in: wp.array2d[wp.vec3],
    site_xmat_in: wp.array2d[wp.mat33],
    # In:
    target: wp.array2d[wp.vec3],
    activation: wp.array2d[float],
    control_dt: float,
    mask: wp.array[bool],
    # Out:
    obs: wp.array2d[float],
):
    """obs = [hand qpos, p1, v1 dt, p2, v2 dt, t1, t2, t1 - p1, t2 - p2, activation]."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    palm, frame = site_xpos_in[worldid, palm_site], site_xmat_in[worldid, palm_site]
    column = pack_range(obs, worldid, 0, qpos_in, 0, HAND_JOINTS, 1.0)
    for i in range(2):
        column = pack_range(obs, worldid, column, qpos_in, BALL_QPOS[i], 3, 1.0)
        column = pack_range(obs, worldid, column, qvel_in, BALL_QVEL[i], 3, control_dt)
    for i in range(2):
        column = pack_vec3(obs, worldid, column, palm + frame * target[worldid, i])
    for i in range(2):
        error = palm + frame * target[worldid, i] - position_of(qpos_in, worldid, i)
        column = pack_vec3(obs, worldid, column, error)
    pack(obs, worldid, column, activation, 1.0)


@wp.kernel(enable_backward=False)
def score_baoding(
    # Params:
    palm_site: int,
    # Data in:
    qpos_in: wp.array2d[float],
    site_xpos_in: wp.array2d[wp.vec3],
    site_xmat_in: wp.array2d[wp.mat33],
    # In:
    activation: wp.array2d[float],
    orbits: Orbits,
    control_dt: float,
    step_count: wp.array[int],
    # Out:
    target: wp.array2d[wp.vec3],
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """Targets of this step; terms pos_dist_1, pos_dist_2, act_reg, sparse."""
    worldid = wp.tid()
    palm, frame = site_xpos_in[worldid, palm_site], site_xmat_in[worldid, palm_site]
    elapsed = control_dt * float(wp.max(step_count[worldid] - 1, 0))
    near, fallen = bool(True), bool(False)
    total = float(0.0)
    for i in range(2):
        target[worldid, i] = orbit_point(orbits, worldid, i, elapsed)
        position = position_of(qpos_in, worldid, i)
        distance = wp.length(palm + frame * target[worldid, i] - position)
        terms[worldid, i] = -distance
        total += distance
        near = near and distance < NEAR
        fallen = fallen or position[2] < DROPPED
    terms[worldid, 2] = -activation_effort(activation, worldid)
    terms[worldid, 3] = -total
    solved[worldid] = near and not fallen
    failed[worldid] = fallen


class BaodingProgram:
    """A baoding task bound to a scene.

    Attributes:
        orbits: How the targets move.
        target: Where they are in this step, frame of the trapezium [m], shape (num_worlds, 2) of vec3.
            `score`, which knows the step, moves them; `observe` comes after it and shows them.
    """

    def __init__(self, spec: BaodingTask, scene: Scene) -> None:
        """Resolve names, allocate the targets."""
        self.spec, self.scene, n = spec, scene, scene.num_worlds
        self.palm_site = scene.site_id("palm_frame")
        self.draw = None if spec.balls is None else BallDraw(spec.balls, scene.oracle, BALLS)
        self.orbit_ranges = OrbitRanges()
        self.orbit_ranges.directions = wp.array(spec.directions, dtype=float)
        self.orbit_ranges.angle, self.orbit_ranges.period = wp.vec2(*spec.angle), wp.vec2(*spec.period)
        low, high = zip(spec.radius_x, spec.radius_y, strict=True)
        self.orbit_ranges.radii_low, self.orbit_ranges.radii_high = wp.vec2(*low), wp.vec2(*high)
        self.orbits = Orbits()
        for name in ("direction", "start_angle", "period"):
            setattr(self.orbits, name, wp.zeros(n, dtype=float))
        self.orbits.radii = wp.zeros(n, dtype=wp.vec2)
        self.target = wp.zeros((n, 2), dtype=wp.vec3)

    def sample_start(self, mask: wp.array) -> None:
        """Draw the balls where they differ."""
        if self.draw is not None:
            self.draw.launch(self.scene.model, self.scene.keys, mask)

    def sample_goal(self, mask: wp.array) -> None:
        """Launch `sample_orbit`."""
        scene = self.scene
        wp.launch(
            sample_orbit,
            dim=scene.num_worlds,
            inputs=[self.orbit_ranges, scene.keys, mask],
            outputs=[self.orbits, self.target],
        )

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Launch `observe_baoding`."""
        scene, data = self.scene, self.scene.data
        wp.launch(
            observe_baoding,
            dim=scene.num_worlds,
            inputs=[
                self.palm_site,
                data.qpos,
                data.qvel,
                data.site_xpos,
                data.site_xmat,
                self.target,
                scene.muscles.activation,
                scene.control_dt,
                mask,
            ],
            outputs=[obs],
        )

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Launch `score_baoding`."""
        scene, data = self.scene, self.scene.data
        wp.launch(
            score_baoding,
            dim=scene.num_worlds,
            inputs=[
                self.palm_site,
                data.qpos,
                data.site_xpos,
                data.site_xmat,
                scene.muscles.activation,
                self.orbits,
                scene.control_dt,
                step_count,
            ],
            outputs=[self.target, terms, solved, failed],
        )

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Where the balls have to be."""
        data = self.scene.data
        palm = data.site_xpos.numpy()[world, self.palm_site]
        frame = data.site_xmat.numpy()[world, self.palm_site]
        places = palm + self.target.numpy()[world] @ frame.T
        return {f"{name}_target": place for name, place in zip(BALLS, places, strict=True)}


_P1 = BaodingTask(
    "myoChallengeBaodingP1",
    1,
    "contact_hand",
    10,
    200,
    "Circle two balls on the palm, counter-clockwise, a revolution in 5 s.",
    physics_dt=0.0025,
)
_P2 = replace(
    _P1,
    name="myoChallengeBaodingP2",
    doc="Circle two balls of unknown mass, size and friction either way, or hold them.",
    directions=(0.0, -1.0, 1.0),
    angle=(0.0, 2.0 * np.pi),
    radius_x=(0.02, 0.03),
    radius_y=(0.022, 0.032),
    period=(4.0, 6.0),
    balls=BallRanges(mass=(0.03, 0.3), radius=(0.018, 0.024), friction=FRICTION_RANGE),
)
for _spec in (
    _P1,
    _P2,
    replace(_P1, name="myoHandBaodingFixed", version=0),
    replace(_P2, name="myoHandBaodingRandom", version=0),
):
    TASKS.add(_spec.key, _spec)
