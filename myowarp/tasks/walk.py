"""Walking: move the center of mass at a velocity, on legs that begin in the middle of a step.

    reward = 5 (exp(-(1.2 - v_y)^2) + exp(-v_x^2)) - 10 |h - h*| + 10 exp(-5 |q - q*|) + 5 exp(-5 m)
             - 100 1[fallen]

with v the velocity of the center of mass [m/s], h the flexion of left and right hip and h* that of a cycle of
100 steps, 0.8 cos(2 pi phase) right and its opposite left [rad], q the root's quaternion and q* that of
looking ahead, m the mean absolute adduction and rotation of the hips [rad]. It is solved while the velocity
is within 0.5 m/s; it fails when the center of mass is below 0.8 m or the root turns away by more than 53
degrees.
Actions are excitations in proportion, not by the sigmoid. Source: MyoSuite 3.0.0, myoLegWalk, whose actions
are from 0 to 1.

As there, v is minus the mean of MuJoCo's `cvel` over masses: ahead is +y in v, and -y in the world. What is
observed of muscles belongs to the state that the step led to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.entries import (
    ACTIVATION,
    COORDINATES,
    QUATERNION,
    VELOCITIES,
    Entry,
    axes,
    coordinates,
)
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec, task
from myowarp.kernels.reward import EFFORT, indicator, minus_effort
from myowarp.kernels.world_function import Row
from myowarp.tasks.seen_muscles import MuscleProgram, of_muscles
from myowarp.tasks.stand import STANDING_POSE

PERIOD = wp.constant(100)  # steps of a cycle
HIP_AMPLITUDE = wp.constant(0.8)  # rad
LEAST_HEIGHT = wp.constant(0.8)  # m
MOST_TURN = wp.constant(0.8)  # of the root's x axis along the world's
VELOCITY_NEAR = wp.constant(0.5)  # m/s
KILO = wp.constant(1000.0)
MOST = wp.constant(100.0)  # of observed velocities [m/s] and forces [kN]
TWO_PI = wp.constant(2.0 * np.pi)


@wp.func
def center_velocity(cvel: wp.array[wp.spatial_vector], share: wp.array[float]) -> wp.vec2:
    """v = -sum of masses times linear velocities over the mass, x and y [m/s]."""
    velocity = wp.vec2(0.0, 0.0)
    for body in range(share.shape[0]):
        velocity -= share[body] * wp.vec2(cvel[body][3], cvel[body][4])
    return velocity


@wp.func
def center_height(xipos: wp.array[wp.vec3], share: wp.array[float]) -> float:
    """Height of the center of mass [m]."""
    height = float(0.0)
    for body in range(share.shape[0]):
        height += share[body] * xipos[body][2]
    return height


@wp.func
def is_down(height: float, qpos: wp.array[float]) -> bool:
    """height < 0.8 or |x axis of the root along the world's| > 0.8."""
    squares = qpos[3] * qpos[3] + qpos[4] * qpos[4] + qpos[5] * qpos[5] + qpos[6] * qpos[6]
    along = 1.0 - 2.0 * (qpos[5] * qpos[5] + qpos[6] * qpos[6]) / squares
    return height < LEAST_HEIGHT or wp.abs(along) > MOST_TURN


@wp.func
def keeps_up(velocity: wp.vec2, command: wp.array[float], failed: bool) -> bool:
    """|v - (0, speed)| < 0.5 m/s, upright."""
    return wp.length(velocity - wp.vec2(0.0, command[0])) < VELOCITY_NEAR and not failed


@wp.func
def velocity_reward(velocity: wp.vec2, command: wp.array[float]) -> float:
    """exp(-(speed - v_y)^2) + exp(-v_x^2)."""
    behind = command[0] - velocity[1]
    return wp.exp(-behind * behind) + wp.exp(-velocity[0] * velocity[0])


@wp.func
def cycle_error(qpos: wp.array[float], hip: wp.array[int], phase: wp.array[float]) -> float:
    """|h - h*|, h* = 0.8 cos(2 pi phase) right, its opposite left."""
    wanted = HIP_AMPLITUDE * wp.cos(TWO_PI * phase[0])
    return wp.length(wp.vec2(-wanted - qpos[hip[0]], wanted - qpos[hip[3]]))


@wp.func
def looking_ahead(qpos: wp.array[float], ahead: wp.array[float]) -> float:
    """exp(-|5 (q - q*)|)."""
    total = float(0.0)
    for i in range(4):
        difference = qpos[3 + i] - ahead[i]
        total += difference * difference
    return wp.exp(-5.0 * wp.sqrt(total))


@wp.func
def straight_hips(qpos: wp.array[float], hip: wp.array[int]) -> float:
    """exp(-5 m), m the mean of |adduction| and |rotation|."""
    total = wp.abs(qpos[hip[1]]) + wp.abs(qpos[hip[2]]) + wp.abs(qpos[hip[4]]) + wp.abs(qpos[hip[5]])
    return wp.exp(-5.0 * 0.25 * total)


@wp.func
def has_fallen(failed: bool) -> float:
    """1[fallen]."""
    return indicator(failed)


@wp.func
def effort(activation: wp.array[float]) -> float:
    """|act| / n."""
    return -minus_effort(activation)


@wp.func
def torso_turn(xquat: wp.array[wp.quat], torso: int) -> wp.vec4:
    """Orientation of the torso, w first."""
    quat = xquat[torso]  # MuJoCo's order in Warp's type
    return wp.vec4(quat[0], quat[1], quat[2], quat[3])


@wp.func
def foot_height(xpos: wp.array[wp.vec3], foot: wp.array[int], i: int) -> float:
    """Height of the ankle [m]."""
    return xpos[foot[i]][2]


@wp.func
def foot_place(xpos: wp.array[wp.vec3], foot: wp.array[int], pelvis: int, i: int) -> wp.vec3:
    """From the pelvis to the ankle [m]."""
    return xpos[foot[i]] - xpos[pelvis]


@wp.func
def muscle_velocity(actuator_velocity: wp.array[float], i: int) -> float:
    """Velocity, at most 100 [m/s]."""
    return wp.clamp(actuator_velocity[i], -MOST, MOST)


@wp.func
def muscle_force(tension: wp.array[float], i: int) -> float:
    """MuJoCo's force in kN, minus the tension, at least -100."""
    return wp.clamp(-tension[i] / KILO, -MOST, MOST)


@wp.kernel(enable_backward=False)
def set_velocity(
    # Params:
    start_velocity: wp.array[float],
    # In:
    mask: wp.array[bool],
    # Data out:
    qvel_out: wp.array2d[float],
):
    """qvel = that of the start."""
    worldid = wp.tid()
    if mask[worldid]:
        for i in range(start_velocity.shape[0]):
            qvel_out[worldid, i] = start_velocity[i]


@wp.kernel(enable_backward=False)
def begin_cycle(
    # In:
    mask: wp.array[bool],
    # Out:
    phase: wp.array2d[float],
):
    """Phase = 0."""
    worldid = wp.tid()
    if mask[worldid]:
        phase[worldid, 0] = 0.0


@wp.kernel(enable_backward=False)
def count_cycle(
    # In:
    step_count: wp.array[int],
    # Out:
    phase: wp.array2d[float],
):
    """Phase = step / 100, modulo 1."""
    worldid = wp.tid()
    phase[worldid, 0] = float(step_count[worldid] % PERIOD) / float(PERIOD)


class WalkProgram(MuscleProgram):
    """A walking task bound to a scene.

    Attributes:
        phase: Where in the cycle the legs should be [1], shape (num_worlds, 1).
        command: Speed to walk at [m/s], shape (num_worlds, 1).
    """

    spec: WalkTask
    command: wp.array

    def __init__(self, spec: WalkTask, scene: Scene) -> None:
        """Find bodies and joints."""
        super().__init__(spec, scene)
        model = scene.oracle
        self.phase = scene.zeros("task.phase", 1)
        self.share = wp.array(model.body_mass / model.body_mass.sum(), dtype=float)
        self.torso, self.pelvis = (int(model.body(name).id) for name in ("torso", "pelvis"))
        self.foot = wp.array([model.body(f"talus_{side}").id for side in "lr"], dtype=int)
        hips = [f"hip_{turn}_{side}" for side in "lr" for turn in ("flexion", "adduction", "rotation")]
        self.hip = wp.array([model.joint(name).qposadr[0] for name in hips], dtype=int)
        self.ahead = wp.array(STANDING_POSE[3:7], dtype=float)
        self.start_velocity = wp.array(spec.start_velocity, dtype=float)

    def sample_start(self, mask: wp.array) -> None:
        """Give the legs the velocity of the start, unless their posture is random."""
        super().sample_start(mask)
        if self.scene.reset != "random":
            self.launch(set_velocity, mask=mask)

    def sample_goal(self, mask: wp.array) -> None:
        super().sample_goal(mask)
        self.launch(begin_cycle, mask=mask)

    def advance(self, step_count: wp.array) -> None:
        self.launch(count_cycle, step_count=step_count)


def coordinates_but_place(model: mujoco.MjModel) -> tuple[Entry, ...]:
    """Return the entries of qpos without x and y of the root."""
    return tuple(coordinates(model)[2:])


@dataclass(frozen=True, kw_only=True)
class WalkTask(TaskSpec):
    """Walk at a velocity.

    Attributes:
        speed: Bounds of the uniformly drawn velocity ahead [m/s].
        start_velocity: Velocities with which episodes start, shape (nv,).
    """

    program: ClassVar[type] = WalkProgram
    shown: ClassVar[Shown | None] = Shown("Trained legs walk.", "myoLegWalk-v0", "baseline", 60, 4)
    measures: ClassVar = {
        "height": center_height,
        "velocity": center_velocity,
        "failed": is_down,
        "solved": keeps_up,
    }
    linear_excitation: ClassVar[bool] = True
    start_doc = "in the middle of a step, at 1.5 m/s"
    solved_when = f"the center of mass is within {VELOCITY_NEAR:g} m/s of the commanded speed, ahead"
    failed_when = (
        f"the center of mass is below {LEAST_HEIGHT:g} m, or the x axis of the root has a part beyond "
        f"{MOST_TURN:g} along that of the world"
    )

    body: str = "legs"
    num_substeps: int = 10
    horizon: int = 1000
    physics_dt: float = 0.001
    speed: tuple[float, float]
    start_velocity: tuple[float, ...]

    @property
    def draws(self) -> tuple[Draw, ...]:
        low, high = self.speed
        return (Draw("speed", "m/s", (low,), (high,), "commanded speed ahead", ("ahead",), array="command"),)

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Nothing is added."""

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        turn, feet = "orientation of the torso", ("left ankle", "right ankle")
        phase = "share of the cycle of the hips that is over"
        height = "height of the center of mass"
        return (
            Column("qpos_without_xy", nq - 2, *COORDINATES[:2], coordinates_but_place, Row("qpos", first=2)),
            Column("qvel", nv, *VELOCITIES),
            Column(
                "com_vel", 2, "m/s", "minus the velocity of the center of mass", ("x", "y"), center_velocity
            ),
            Column("torso_angle", 4, "1", turn, QUATERNION, torso_turn),
            Column("feet_heights", 2, "m", "height of each ankle", feet, foot_height),
            Column("height", 1, "m", height, ("center of mass",), center_height),
            Column(
                "feet_rel_positions", 6, "m", "from the pelvis to each ankle, world", axes(feet), foot_place
            ),
            Column("phase_var", 1, "1", phase, ("phase",), Row("phase")),
            Column(
                "muscle_length",
                num_muscles,
                "m",
                "length of each muscle",
                of_muscles("m"),
                Row("actuator_length"),
            ),
            Column("muscle_velocity", num_muscles, "m/s", "its rate", of_muscles("m/s"), muscle_velocity),
            Column(
                "muscle_force", num_muscles, "kN", "its force, a pull < 0", of_muscles("kN"), muscle_force
            ),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        speed = "exp(-(v_y - speed)^2) + exp(-v_x^2) in m/s, v minus the velocity of the center of mass"
        cycle = "norm of the errors of both hip flexions against the cycle"
        ahead = "exp(-5 times the norm of the root's quaternion minus that of looking ahead)"
        hips = "exp(-5 times the mean of absolute hip adductions and rotations)"
        return (
            RewardTerm("vel_reward", 5.0, "1", speed, velocity_reward),
            RewardTerm("done", -100.0, "1", "1 where the episode fails", has_fallen),
            RewardTerm("cyclic_hip", -10.0, "rad", cycle, cycle_error),
            RewardTerm("ref_rot", 10.0, "1", ahead, looking_ahead),
            RewardTerm("joint_angle_rew", 5.0, "1", hips, straight_hips),
            RewardTerm(
                "act_mag", 0.0, EFFORT[0], "effort: norm of the activations over their number", effort
            ),
            RewardTerm("sparse", 0.0, "1", speed, velocity_reward),
        )


AHEAD = (0.0, 0.0, 1.0, *STANDING_POSE[3:7])
HIP, KNEE, TOES, KNEECAP = (
    STANDING_POSE[8:10],
    STANDING_POSE[13:15],
    STANDING_POSE[16:18],
    STANDING_POSE[18:21],
)
STEPPING_POSE = (
    *AHEAD,
    *(-0.2326, *HIP, 0.00247908, 0.00101098, 1.227, *KNEE, 0.1672, *TOES, *KNEECAP),  # right, which swings
    *(-0.1652, *HIP, 0.00247908, 0.0010198, 0.0888, *KNEE, -0.019, *TOES, *KNEECAP),  # left
)  # rad, m; MyoSuite 3.0.0
STEPPING_VELOCITY = (
    *(0.0, -1.5, 0.0, 0.0, 0.0, 0.0),  # -y is ahead
    *(4.9066, 0.0, 0.0, 0.0, 0.0, -3.597, 0.0, 0.0, 0.633, 0.0, 0.0, 0.0, 0.0, 0.0),
    *(0.175, 0.0, 0.0, 0.0, 0.0, 0.175, 0.0, 0.0, 0.988, 0.0, 0.0, 0.0, 0.0, 0.0),
)  # rad/s, m/s; MyoSuite 3.0.0


@task("myoLegWalk-v0")
def leg_walk() -> WalkTask:
    """Walk ahead at 1.2 m/s on flat ground."""
    return WalkTask(speed=(1.2, 1.2), start_pose=STEPPING_POSE, start_velocity=STEPPING_VELOCITY)
