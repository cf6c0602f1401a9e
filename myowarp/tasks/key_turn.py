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

from dataclasses import dataclass, field

import mujoco
import numpy as np
import warp as wp

from myowarp.kernels.observe import pack, pack_range, pack_vec3
from myowarp.kernels.random import GOAL, START, RandomKeys, open_stream
from myowarp.kernels.reward import activation_effort, indicator
from myowarp.models.bodies.contact_hand import HAND_JOINTS, add_object
from myowarp.spec.scene import Scene
from myowarp.spec.task import TASKS, Column, RewardTerm, TaskSpec

KEY = wp.constant(23)  # joint of the key, after the hand's
GRIP = wp.constant(0.03)  # m, wanted distance of a tip from the key head
LOOSE = wp.constant(0.05)  # m, error beyond which a tip is penalised
LOST = wp.constant(0.1)  # m, error beyond which the episode fails
HALF_TURN = wp.constant(np.pi)
QUARTER_TURN = wp.constant(0.5 * np.pi)

ALIVE = wp.constant(7)  # column of the term of that name

KEY_POS = (-0.15, -0.55, 1.425)  # m, world
KEY_TILT = 2.2  # rad about the vertical
ALIVE_WEIGHT = 60.0
"""What a step without failure earns, more than the 58.4 that it can cost: penalties 2 * 25, distances of at
most 0.1 m 2 * 1, effort 1 / sqrt(39) = 0.16, and a key turned the wrong way by a revolution 6.28."""


@dataclass(frozen=True)
class KeyTurnTask(TaskSpec):
    """Turn the key.

    Attributes:
        angle_low: Lower bound of the key's uniformly drawn start angle [rad].
        angle_high: Upper bound.
        jitter: Half width of the uniform offset of the key's position, each axis [m].
        goal_angle: Angle beyond which the task counts as solved [rad].
        alive_weight: What a step without failure earns; 0: there is no such term, as in MyoSuite.
    """

    goal_angle: float = field(kw_only=True)
    angle_low: float = field(default=0.0, kw_only=True)
    angle_high: float = field(default=0.0, kw_only=True)
    jitter: float = field(default=0.0, kw_only=True)
    alive_weight: float = field(default=0.0, kw_only=True)

    @property
    def sites(self) -> tuple[str, ...]:
        """Key head and the two tips."""
        return ("keyhead", "IFtip_r", "THtip_r")

    @property
    def batched(self) -> tuple[str, ...]:
        """The key's position."""
        return ("body_pos",)

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

    def columns(self, num_joints: int, num_muscles: int) -> tuple[Column, ...]:
        """Hand, key, where the tips have to go, activations."""
        num_hand = num_joints - 1
        return (
            Column("hand_qpos", num_hand, "rad"),
            Column("hand_qvel", num_hand, "rad per control step"),
            Column("key_qpos", 1, "rad"),
            Column("key_qvel", 1, "rad per control step"),
            Column("IFtip_approach", 3, "m"),
            Column("THtip_approach", 3, "m"),
            Column("act", num_muscles, "1"),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """In the order in which `score_key` writes them."""
        alive = (RewardTerm("alive", self.alive_weight),) if self.alive_weight else ()
        return (
            RewardTerm("key_turn", 1.0),
            RewardTerm("IFtip_approach", 10.0),
            RewardTerm("THtip_approach", 10.0),
            RewardTerm("act_reg", 1.0),
            RewardTerm("bonus", 4.0),
            RewardTerm("penalty", 25.0),
            RewardTerm("sparse", 0.0),
            *alive,
        )

    def bind(self, scene: Scene) -> KeyTurnProgram:
        """Resolve key and tips."""
        return KeyTurnProgram(self, scene)


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


@wp.kernel(enable_backward=False)
def observe_key(
    # Params:
    key_site: int,
    index_site: int,
    thumb_site: int,
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    site_xpos_in: wp.array2d[wp.vec3],
    # In:
    activation: wp.array2d[float],
    control_dt: float,
    mask: wp.array[bool],
    # Out:
    obs: wp.array2d[float],
):
    """obs = [hand qpos, hand qvel dt, key qpos, key qvel dt, head - index, head - thumb, activation]."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    head = site_xpos_in[worldid, key_site]
    column = pack_range(obs, worldid, 0, qpos_in, 0, HAND_JOINTS, 1.0)
    column = pack_range(obs, worldid, column, qvel_in, 0, HAND_JOINTS, control_dt)
    column = pack_range(obs, worldid, column, qpos_in, KEY, 1, 1.0)
    column = pack_range(obs, worldid, column, qvel_in, KEY, 1, control_dt)
    column = pack_vec3(obs, worldid, column, head - site_xpos_in[worldid, index_site])
    column = pack_vec3(obs, worldid, column, head - site_xpos_in[worldid, thumb_site])
    pack(obs, worldid, column, activation, 1.0)


@wp.kernel(enable_backward=False)
def score_key(
    # Params:
    key_site: int,
    index_site: int,
    thumb_site: int,
    goal_angle: float,
    # Data in:
    qpos_in: wp.array2d[float],
    site_xpos_in: wp.array2d[wp.vec3],
    # In:
    activation: wp.array2d[float],
    # Out:
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """Terms key_turn, IFtip_approach, THtip_approach, act_reg, bonus, penalty, sparse, alive if weighted."""
    worldid = wp.tid()
    head = site_xpos_in[worldid, key_site]
    a = wp.abs(wp.length(head - site_xpos_in[worldid, index_site]) - GRIP)
    b = wp.abs(wp.length(head - site_xpos_in[worldid, thumb_site]) - GRIP)
    q = qpos_in[worldid, KEY]
    terms[worldid, 0] = q
    terms[worldid, 1] = -a
    terms[worldid, 2] = -b
    terms[worldid, 3] = -activation_effort(activation, worldid)
    terms[worldid, 4] = indicator(q > QUARTER_TURN) + indicator(q > HALF_TURN)
    terms[worldid, 5] = -indicator(a > LOOSE) - indicator(b > LOOSE)
    terms[worldid, 6] = q
    lost = a > LOST or b > LOST
    if terms.shape[1] > ALIVE:
        terms[worldid, ALIVE] = indicator(not lost)
    solved[worldid] = q > goal_angle
    failed[worldid] = lost


class KeyTurnProgram:
    """A key turn task bound to a scene."""

    def __init__(self, spec: KeyTurnTask, scene: Scene) -> None:
        """Resolve names."""
        self.spec, self.scene = spec, scene
        self.key_body = scene.oracle.body("key").id
        self.key_site, self.index_site, self.thumb_site = map(scene.site_id, spec.sites)

    def sample_goal(self, mask: wp.array) -> None:
        """Nothing to draw: the goal angle is the task's."""

    def sample_start(self, mask: wp.array) -> None:
        """Launch `sample_key`."""
        spec, scene = self.spec, self.scene
        wp.launch(
            sample_key,
            dim=scene.num_worlds,
            inputs=[
                self.key_body,
                wp.vec3(*KEY_POS),
                spec.jitter,
                spec.angle_low,
                spec.angle_high,
                scene.keys,
                mask,
            ],
            outputs=[scene.data.qpos, scene.model.body_pos],
        )

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Launch `observe_key`."""
        scene = self.scene
        wp.launch(
            observe_key,
            dim=scene.num_worlds,
            inputs=[
                self.key_site,
                self.index_site,
                self.thumb_site,
                scene.data.qpos,
                scene.data.qvel,
                scene.data.site_xpos,
                scene.muscles.activation,
                scene.control_dt,
                mask,
            ],
            outputs=[obs],
        )

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Launch `score_key`."""
        scene = self.scene
        wp.launch(
            score_key,
            dim=scene.num_worlds,
            inputs=[
                self.key_site,
                self.index_site,
                self.thumb_site,
                self.spec.goal_angle,
                scene.data.qpos,
                scene.data.site_xpos,
                scene.muscles.activation,
            ],
            outputs=[terms, solved, failed],
        )

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Where the key head is."""
        return {"keyhead": self.scene.data.site_xpos.numpy()[world, self.key_site].copy()}


LIVING_PAYS = (
    " Every step without failure earns 60. In v0, as in MyoSuite 3.0.0, a step can cost 52 and failing ends"
    " the episode for free, so that failing at once is worth more than holding on."
)
HALF = " The task is solved from half a revolution on; in v0 from 3.14 rad, just before the bonus for it."

for _version, _alive_weight, _half_turn, _why, _why_half in (
    (0, 0.0, 3.14, "", ""),
    (1, ALIVE_WEIGHT, np.pi, LIVING_PAYS, HALF),
):
    for _spec in (
        KeyTurnTask(
            "myoHandKeyTurnFixed",
            _version,
            "contact_hand",
            10,
            200,
            f"Turn a key by half a revolution.{_why}{_why_half}",
            goal_angle=_half_turn,
            alive_weight=_alive_weight,
        ),
        KeyTurnTask(
            "myoHandKeyTurnRandom",
            _version,
            "contact_hand",
            10,
            200,
            f"Turn a key, met at a random angle and place, by a full revolution.{_why}",
            goal_angle=2.0 * np.pi,
            angle_low=-0.5 * np.pi,
            angle_high=0.5 * np.pi,
            jitter=0.01,
            alive_weight=_alive_weight,
        ),
    ):
        TASKS.add(_spec.key, _spec)
