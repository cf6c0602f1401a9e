"""Support of the pelvis: springs and dampers that keep a walker on a line, upright from side to side.

    force  = -share M (w^2 d + w v)            across the line
    torque = -share (I_r (w^2 r + w r') a + I_y (w^2 y + w y') z)

with d and v the root's place and velocity across the line, r its roll about the line's direction a and y its
turn from it about the vertical z, M and I_r, I_y the inertia of the stiff body at its zero pose, and w =
15 rad/s. The line is where the root begins an episode, along its heading. Nothing acts ahead, up or on the
pitch: with share 1 the body walks as in a plane, the model of Geyer and Herr (2010),
doi:10.1109/TNSRE.2010.2047592, and between 1 and 0 it learns to balance, as with the hand of a therapist.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import warp as wp

from myowarp.definitions.body import fact_for
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.kernels.launch import launch

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec

RATE = wp.constant(15.0)
"""Of the springs on the stiff body, which dampers hold to half of critical damping [rad/s]."""


@dataclass(frozen=True, eq=False)
class PelvisSupport(Condition):
    """Springs and dampers from side to side at the pelvis of a walker.

    Attributes:
        share: Of full support, 0 to 1; with 1 it walks as in a plane.
    """

    PHASE = Phase.BODY
    WRITES = ("the force on the root",)
    NEUTRAL: ClassVar = {"share": 0.0}
    TITLE = "support of the pelvis"
    LABELS: ClassVar = {"share": "support from side to side"}

    share: Value = 1.0

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body does not walk."""
        fact_for("be supported at the pelvis", spec.body, "root")

    def bind(self, scene: Scene, clock: Clock) -> PelvisSupportEffect:
        """Put the shares on the device."""
        share = Parameter("pelvis_support share", self.share, scene, (), neutral=0.0, low=0.0, high=1.0)
        return PelvisSupportEffect(scene, clock, share)


@wp.struct
class Root:
    """A free joint.

    Attributes:
        place: Its first entry of qpos.
        dof: Its first entry of qvel.
        mass: Of the body [kg].
        roll: Inertia of the stiff body about the root's x axis [kg m^2].
        turn: About its z axis [kg m^2].
    """

    place: int
    dof: int
    mass: float
    roll: float
    turn: float


@wp.func
def turn_of(root: Root, qpos: wp.array[float]) -> wp.quat:
    """Turn of the root."""
    at = root.place + 3
    return wp.normalize(wp.quat(qpos[at + 1], qpos[at + 2], qpos[at + 3], qpos[at]))


@wp.func
def level(ahead: wp.vec3) -> wp.vec3:
    """Direction of its horizontal part."""
    return wp.normalize(wp.vec3(ahead[0], ahead[1], 0.0))


@wp.kernel(enable_backward=False)
def draw_line(
    # Params:
    root: Root,
    # Data in:
    qpos_in: wp.array2d[float],
    # In:
    clock: Clock,
    # Out:
    line: wp.array2d[float],
):
    """At the begin of an episode, line = place and heading of the root, x and y each."""
    worldid = wp.tid()
    if clock.step_count[worldid] > 0:
        return
    ahead = level(wp.quat_rotate(turn_of(root, qpos_in[worldid]), wp.vec3(1.0, 0.0, 0.0)))
    for i in range(2):
        line[worldid, i] = qpos_in[worldid, root.place + i]
        line[worldid, 2 + i] = ahead[i]


@wp.kernel(enable_backward=False)
def support(
    # Params:
    root: Root,
    curve: Curve,
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    line: wp.array2d[float],
    clock: Clock,
    # Data out:
    qfrc_applied_out: wp.array2d[float],
):
    """qfrc_applied = force across the line and torque about it and the vertical, in the root's frame."""
    worldid = wp.tid()
    up = wp.vec3(0.0, 0.0, 1.0)
    along = wp.vec3(line[worldid, 2], line[worldid, 3], 0.0)
    across = wp.cross(up, along)
    turn = turn_of(root, qpos_in[worldid])
    place, velocity, spin = wp.vec3(), wp.vec3(), wp.vec3()
    for i in range(3):
        velocity[i] = qvel_in[worldid, root.dof + i]
        spin[i] = qvel_in[worldid, root.dof + 3 + i]
    for i in range(2):
        place[i] = qpos_in[worldid, root.place + i] - line[worldid, i]
    ahead = level(wp.quat_rotate(turn, wp.vec3(1.0, 0.0, 0.0)))
    left_z = wp.quat_rotate(turn, wp.vec3(0.0, 1.0, 0.0))[2]
    up_z = wp.quat_rotate(turn, up)[2]
    spin = wp.quat_rotate(turn, spin)
    roll, yaw = wp.atan2(left_z, up_z), wp.atan2(wp.dot(ahead, across), wp.dot(ahead, along))
    rate = RATE * value_of(curve, clock, worldid, 0)
    force = -rate * root.mass * (RATE * wp.dot(place, across) + wp.dot(velocity, across)) * across
    torque = -rate * root.roll * (RATE * roll + wp.dot(spin, along)) * along
    torque -= rate * root.turn * (RATE * yaw + spin[2]) * up
    torque = wp.quat_rotate_inv(turn, torque)
    for i in range(3):
        qfrc_applied_out[worldid, root.dof + i] = force[i]
        qfrc_applied_out[worldid, root.dof + 3 + i] = torque[i]


class PelvisSupportEffect(Effect):
    """Support in a scene."""

    def __init__(self, scene: Scene, clock: Clock, share: Parameter) -> None:
        self.scene, self.clock, self.share, self.drawn = scene, clock, share, (share,)
        joint = scene.oracle.joint(fact_for("be supported at the pelvis", scene.spec.body, "root"))
        self.root = Root()
        self.root.place, self.root.dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        inertia = scene.oracle.dof_M0[self.root.dof :].tolist()
        self.root.mass, self.root.roll, self.root.turn = inertia[0], inertia[3], inertia[5]
        self.line = scene.zeros("condition.pelvis_support.line", 4)

    def act(self) -> None:
        """Draw the line."""
        scene = self.scene
        launch(draw_line, scene.num_worlds, self, scene.data)

    def act_in_substep(self) -> None:
        """Launch `support`."""
        scene = self.scene
        launch(support, scene.num_worlds, self, self.share, scene.data)


CONDITIONS.add("pelvis_support", PelvisSupport)
