"""Key turn: turn a key between thumb and index finger.

    reward = q - 10 a - 10 b - w |act| / n + 4 (1[q > pi/2] + 1[q > pi]) - 25 (1[a > 0.05] + 1[b > 0.05])

with q the key's angle [rad], a and b how far the distances of index tip and thumb tip from the key head are
from 30 mm [m]; the episode fails where a or b exceeds 0.1 m. Source: MyoSuite 3.0.0, family KeyTurn (paper:
Caggiano et al. 2022, arXiv:2205.13600).

Version 1 adds 60 1[not failed], so that living on pays. Both versions keep MyoSuite's floor under the key's
inertia: against the damping of its hinge a free key slows down with a time constant of 1 ms with the floor
and 0.03 ms without, both below the physics step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, VELOCITIES, XYZ
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec, task
from myowarp.kernels.random import GOAL, START, RandomKeys, open_stream
from myowarp.kernels.reward import EFFORT, indicator
from myowarp.kernels.world_function import Row
from myowarp.models.bodies.contact_hand import HAND_JOINTS, add_object

KEY = wp.constant(23)  # joint of the key, after the hand's
GRIP = wp.constant(0.03)  # m, wanted distance of a tip from the key head
LOOSE = wp.constant(0.05)  # m, error beyond which a tip is penalised
LOST = wp.constant(0.1)  # m, error beyond which the episode fails
HALF_TURN = wp.constant(np.pi)
QUARTER_TURN = wp.constant(0.5 * np.pi)

KEY_POS = (-0.15, -0.55, 1.425)  # m, world
KEY_TILT = 2.2  # rad about the vertical
ALIVE_WEIGHT = 60.0
"""Reward of a step without failure, more than the 58.4 that it can cost: penalties 2 * 25, distances of at
most 0.1 m 2 * 1, effort 1 / sqrt(39) = 0.16, and a key turned the wrong way by a revolution 6.28."""


@wp.kernel(enable_backward=False)
def sample_key(
    # Params:
    key_body: int,
    key_pos: wp.vec3,
    jitter: float,
    angle_low: float,
    angle_high: float,
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Data out:
    qpos_out: wp.array2d[float],
    # Out:
    body_pos: wp.array2d[wp.vec3],
):
    """angle ~ U(low, high), position = key_pos + U(-jitter, jitter)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    start = open_stream(keys, worldid, START)
    qpos_out[worldid, KEY] = wp.randf(start, angle_low, angle_high)
    goal = open_stream(keys, worldid, GOAL)
    x = wp.randf(goal, -jitter, jitter)
    y = wp.randf(goal, -jitter, jitter)
    z = wp.randf(goal, -jitter, jitter)
    body_pos[worldid, key_body] = key_pos + wp.vec3(x, y, z)


@wp.func
def index_approach(site_xpos: wp.array[wp.vec3], key_site: int, index_site: int) -> wp.vec3:
    """From the index tip to the key head."""
    return site_xpos[key_site] - site_xpos[index_site]


@wp.func
def thumb_approach(site_xpos: wp.array[wp.vec3], key_site: int, thumb_site: int) -> wp.vec3:
    """From the thumb tip to the key head."""
    return site_xpos[key_site] - site_xpos[thumb_site]


@wp.func
def index_off(index_approach: wp.vec3) -> float:
    """-a = -| |head - index| - 30 mm |."""
    return -wp.abs(wp.length(index_approach) - GRIP)


@wp.func
def thumb_off(thumb_approach: wp.vec3) -> float:
    """-b = -| |head - thumb| - 30 mm |."""
    return -wp.abs(wp.length(thumb_approach) - GRIP)


@wp.func
def key_angle(qpos: wp.array[float]) -> float:
    """q."""
    return qpos[KEY]


@wp.func
def turn_bonus(angle: float) -> float:
    """1[q > pi/2] + 1[q > pi]."""
    return indicator(angle > QUARTER_TURN) + indicator(angle > HALF_TURN)


@wp.func
def minus_loose(index_off: float, thumb_off: float) -> float:
    """-1[a > 0.05] - 1[b > 0.05]."""
    return -indicator(-index_off > LOOSE) - indicator(-thumb_off > LOOSE)


@wp.func
def is_alive(failed: bool) -> float:
    """1[not failed]."""
    return indicator(not failed)


@wp.func
def is_turned(angle: float, goal_angle: float) -> bool:
    """q > goal."""
    return angle > goal_angle


@wp.func
def is_lost(index_off: float, thumb_off: float) -> bool:
    """a > 0.1 m or b > 0.1 m."""
    return -index_off > LOST or -thumb_off > LOST


class KeyTurnProgram(Program):
    """A key turn task bound to a scene."""

    def __init__(self, spec: KeyTurnTask, scene: Scene) -> None:
        """Resolve key and tips."""
        super().__init__(spec, scene)
        self.key_body, self.key_pos = scene.oracle.body("key").id, wp.vec3(*KEY_POS)
        self.key_site, self.index_site, self.thumb_site = map(scene.site_id, spec.sites)

    def sample_start(self, mask: wp.array) -> None:
        super().sample_start(mask)
        self.launch(sample_key, mask=mask)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return the place of the key head."""
        return {"keyhead": self.scene.data.site_xpos.numpy()[world, self.key_site].copy()}


@dataclass(frozen=True, kw_only=True)
class KeyTurnTask(TaskSpec):
    """Turn the key.

    Attributes:
        angle_low: Lower bound of the key's uniformly drawn start angle [rad].
        angle_high: Upper bound.
        jitter: Half width of the uniform offset of the key's position, each axis [m].
        goal_angle: Angle beyond which the task counts as solved [rad].
        alive_weight: What a step without failure earns; 0: there is no such term, as in MyoSuite.
    """

    program: ClassVar[type] = KeyTurnProgram
    shown: ClassVar[Shown | None] = Shown(
        "A trained hand turns the key by half a turn.", "myoHandKeyTurnFixed-v0", "baseline", 80, 2
    )
    measures: ClassVar = {
        "index_approach": index_approach,
        "thumb_approach": thumb_approach,
        "index_off": index_off,
        "thumb_off": thumb_off,
        "angle": key_angle,
        "solved": is_turned,
        "failed": is_lost,
    }
    coarse_step = CoarseStep(0.004, 0.35)
    sites = ("keyhead", "IFtip_r", "THtip_r")
    batched = ("body_pos",)
    start_doc = "the open hand, every joint at 0, beside the key"
    failed_when = f"the distance of a tip from the key head differs from {GRIP:g} m by more than {LOST:g} m"

    body: str = "contact_hand"
    num_substeps: int = 10
    horizon: int = 200
    goal_angle: float
    angle_low: float = 0.0
    angle_high: float = 0.0
    jitter: float = 0.0
    alive_weight: float = 0.0

    @property
    def solved_when(self) -> str:
        return f"the key's angle exceeds {self.goal_angle:.4g} rad"

    @property
    def draws(self) -> tuple[Draw, ...]:
        low, high = (tuple(np.add(KEY_POS, jitter).tolist()) for jitter in (-self.jitter, self.jitter))
        angle = (self.angle_low,), (self.angle_high,)
        return (
            Draw("key angle", "rad", *angle, "angle of the key", when="start"),
            Draw("key position", "m", low, high, "where the key is, world", XYZ, when="start"),
        )

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the key: an elliptic head, a shaft and a bit, on a hinge."""
        key = add_object(spec, "key", KEY_POS)
        key.quat = (np.cos(KEY_TILT / 2), 0.0, 0.0, np.sin(KEY_TILT / 2))
        head = key.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=(0.03, 0.03, 0.004))
        head.name = "keyhead"
        shaft = key.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(0.005, 0.07, 0.0))
        shaft.pos = (-0.045, 0.0, 0.0)
        shaft.quat = (np.cos(1.57 / 2), 0.0, np.sin(1.57 / 2), 0.0)
        bit = key.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.015, 0.01, 0.004))
        bit.pos = (-0.1, 0.008, 0.0)
        for geom in (head, shaft, bit):
            geom.contype, geom.conaffinity, geom.condim = 1, 1, 3
            geom.rgba = (0.75, 0.6, 0.25, 1.0)
        joint = key.add_joint(name="keyjoint", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(1.0, 0.0, 0.0))
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.damping[0], joint.frictionloss = 0.1, 0.02
        key.add_site(name="keyhead", size=(0.005, 0.005, 0.005))

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        hinge = ("keyjoint",)
        to_head = "from the {} tip to the key head, world"
        speed = "rad per control step", "velocity of the key times the control step"
        return (
            Column("hand_qpos", HAND_JOINTS, *COORDINATES),
            Column("hand_qvel", HAND_JOINTS, *VELOCITIES),
            Column("key_qpos", 1, "rad", "angle of the key", hinge, Row("qpos", KEY)),
            Column("key_qvel", 1, *speed, hinge, Row("qvel", KEY, "control_dt")),
            Column("IFtip_approach", 3, "m", to_head.format("index"), XYZ, index_approach),
            Column("THtip_approach", 3, "m", to_head.format("thumb"), XYZ, thumb_approach),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        off = f"minus |distance of the {{}} tip from the key head - {GRIP:g} m|"
        turns = f"1 where the key's angle exceeds {QUARTER_TURN:.4g} rad, 2 beyond {HALF_TURN:.4g} rad"
        loose = f"-1 for each tip whose distance differs from {GRIP:g} m by more than {LOOSE:g} m"
        alive = RewardTerm("alive", self.alive_weight, "1", "1 where the episode does not fail", is_alive)
        return (
            RewardTerm("key_turn", 1.0, "rad", "angle of the key", key_angle),
            RewardTerm("IFtip_approach", 10.0, "m", off.format("index"), index_off),
            RewardTerm("THtip_approach", 10.0, "m", off.format("thumb"), thumb_off),
            RewardTerm("act_reg", 1.0, *EFFORT),
            RewardTerm("bonus", 4.0, "1", turns, turn_bonus),
            RewardTerm("penalty", 25.0, "1", loose, minus_loose),
            RewardTerm("sparse", 0.0, "rad", "angle of the key", key_angle),
            *((alive,) if self.alive_weight else ()),
        )


LIVING_PAYS = (
    "Every step without failure earns 60. In v0, as in MyoSuite 3.0.0, a step can cost 52 and failing ends"
    " the episode for free, so that failing at once is worth more than holding on."
)
HALF = " The task is solved from half a revolution on; in v0 from 3.14 rad, just before the bonus for it."


@task("myoHandKeyTurnFixed-v1", LIVING_PAYS + HALF, goal_angle=np.pi, alive_weight=ALIVE_WEIGHT)
@task("myoHandKeyTurnFixed-v0")
def by_half_a_revolution() -> KeyTurnTask:
    """Turn a key by half a revolution."""
    return KeyTurnTask(goal_angle=3.14)


@task("myoHandKeyTurnRandom-v1", LIVING_PAYS, alive_weight=ALIVE_WEIGHT)
@task("myoHandKeyTurnRandom-v0")
def by_a_revolution() -> KeyTurnTask:
    """Turn a key, met at a random angle and place, by a full revolution."""
    turn, half = 2.0 * np.pi, 0.5 * np.pi
    return KeyTurnTask(goal_angle=turn, angle_low=-half, angle_high=half, jitter=0.01)
