"""Pen twirl: turn a pen that lies on the hand until it is parallel to another pen, without dropping it.

    reward = -p + c - 5 |act| / n - 5 1[p > 0.075] + 10 (1[c > 0.9] + 5 1[c > 0.95]) 1[p < 0.075]

with p the distance of the pen's centre from its start [m] and c the cosine between the two pens; c > 0.95
is solved, p > 0.075 fails. Source: MyoSuite 3.0.0, family PenTwirl (paper: Caggiano et al. 2022,
arXiv:2205.13600).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, FREE_RATES, XYZ
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec, task
from myowarp.kernels.random import GOAL, RandomKeys, open_stream
from myowarp.kernels.reward import EFFORT, indicator, is_far, minus_error, minus_failed
from myowarp.kernels.world_function import Row
from myowarp.models.bodies.contact_hand import HAND_JOINTS, PALM_UP, add_object, add_object_joints
from myowarp.tasks.markers import add_tip_targets

DROPPED = wp.constant(0.075)  # m, distance from the start beyond which the pen is lost
CLOSE = wp.constant(0.9)  # cosines with bonus
ALIGNED = wp.constant(0.95)
ALIGNED_BONUS = wp.constant(5.0)  # what it adds to the 1 of CLOSE

PEN_POS = (-0.23, -0.53, 1.445)  # m, world; on the fingers
PEN_START = wp.constant(wp.vec3(*PEN_POS))
PEN_TILT = 1.27  # rad about world y: nearly lying
TARGET_POS = (0.0, -0.54, 1.382)  # m, world; beside the hand
RADIUS, HALF_LENGTH = 0.015, 0.065  # m
TRIMMINGS = (
    (mujoco.mjtGeom.mjGEOM_CYLINDER, (0.017, 0.02, 0.0), (0.0, 0.0, -0.0455)),
    (mujoco.mjtGeom.mjGEOM_CYLINDER, (0.013, 0.002, 0.0), (0.0, 0.0, 0.067)),
    (mujoco.mjtGeom.mjGEOM_BOX, (0.004, 0.006, 0.03), (-0.015, 0.0, -0.0255)),
)  # cap, end and clip: shape, size [m], position [m]; they weigh, but touch nothing
TRIMMING_DENSITY = 1000.0  # kg/m^3


def add_pen(body: mujoco.MjsBody, name: str, density: float, rgba: tuple[float, ...]) -> None:
    """Add the geoms of a pen along z; `density` [kg/m^3] is that of its shaft."""
    shaft = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CYLINDER, density=density)
    shaft.size = (RADIUS, HALF_LENGTH, 0.0)
    shaft.contype, shaft.conaffinity, shaft.condim = 1, 1, 4
    shaft.rgba = rgba
    for kind, size, pos in TRIMMINGS:
        part = body.add_geom(type=kind, size=size, pos=pos, density=TRIMMING_DENSITY)
        part.contype = part.conaffinity = 0
        part.rgba = (0.2, 0.22, 0.28, rgba[3])


@wp.kernel(enable_backward=False)
def sample_pen(
    # Params:
    tilt: float,
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Data out:
    mocap_quat_out: wp.array2d[wp.quat],
):
    """Target orientation Rx(u) Ry(v), u and v ~ U(-tilt, tilt); components w, x, y, z."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    goal = open_stream(keys, worldid, GOAL)
    u = 0.5 * wp.randf(goal, -tilt, tilt)
    v = 0.5 * wp.randf(goal, -tilt, tilt)
    mocap_quat_out[worldid, 0] = wp.quat(
        wp.cos(u) * wp.cos(v), wp.sin(u) * wp.cos(v), wp.cos(u) * wp.sin(v), wp.sin(u) * wp.sin(v)
    )


@wp.func
def long_axis(frame: wp.mat33) -> wp.vec3:
    """Return the unit vector from a pen's bottom to its top, the z axis of its frame."""
    return wp.vec3(frame[0, 2], frame[1, 2], frame[2, 2])


@wp.func
def pen_position(xpos: wp.array[wp.vec3], object_body: int) -> wp.vec3:
    """Centre of the pen."""
    return xpos[object_body]


@wp.func
def pen_axis(xmat: wp.array[wp.mat33], object_body: int) -> wp.vec3:
    """Axis of the pen."""
    return long_axis(xmat[object_body])


@wp.func
def wanted_axis(xmat: wp.array[wp.mat33], target_body: int) -> wp.vec3:
    """Axis of the wanted pen."""
    return long_axis(xmat[target_body])


@wp.func
def free_rates(
    qvel: wp.array[float], xmat: wp.array[wp.mat33], object_body: int, control_dt: float
) -> wp.spatial_vector:
    """Linear and angular velocity of a free pen in the world, times the control step."""
    v = HAND_JOINTS
    spin = control_dt * (xmat[object_body] @ wp.vec3(qvel[v + 3], qvel[v + 4], qvel[v + 5]))
    return wp.spatial_vector(
        control_dt * qvel[v], control_dt * qvel[v + 1], control_dt * qvel[v + 2], spin[0], spin[1], spin[2]
    )


@wp.func
def from_start(position: wp.vec3) -> wp.vec3:
    """From the pen's start to its centre."""
    return position - PEN_START


@wp.func
def axis_error(axis: wp.vec3, wanted: wp.vec3) -> wp.vec3:
    """Axis minus wanted axis."""
    return axis - wanted


@wp.func
def pen_distance(position: wp.vec3) -> float:
    """p = |pen - start|."""
    return wp.length(position - PEN_START)


@wp.func
def pen_cosine(axis: wp.vec3, wanted: wp.vec3) -> float:
    """c = axis . wanted."""
    return wp.dot(axis, wanted)


@wp.func
def aligned_bonus(error: float, cosine: float) -> float:
    """(1[c > 0.9] + 5 1[c > 0.95]) 1[p < 0.075]."""
    return (indicator(cosine > CLOSE) + ALIGNED_BONUS * indicator(cosine > ALIGNED)) * indicator(
        error < DROPPED
    )


@wp.func
def both_aligned(error: float, cosine: float) -> float:
    """c - p."""
    return cosine - error


@wp.func
def is_aligned(error: float, cosine: float) -> bool:
    """c > 0.95 and p <= 0.075."""
    return cosine > ALIGNED and error <= DROPPED


class PenTwirlProgram(Program):
    """A pen twirl task bound to a scene.

    Attributes:
        target_quat: Orientation of the target pen (w, x, y, z), the engine's `mocap_quat`, shape
            (num_worlds, 1) of quat.
    """

    def __init__(self, spec: PenTwirlTask, scene: Scene) -> None:
        """Resolve the two pens."""
        super().__init__(spec, scene)
        self.object_body = scene.oracle.body("Object").id
        self.target_body = scene.oracle.body("target").id
        self.target_quat = scene.data.mocap_quat

    def sample_goal(self, mask: wp.array) -> None:
        super().sample_goal(mask)
        self.launch(sample_pen, mask=mask)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return the target of the pen's top, its centre being at its start."""
        wanted = self.scene.data.xmat.numpy()[world, self.target_body, :, 2]
        return {"object_top_target": np.array(PEN_POS) + HALF_LENGTH * wanted}


@dataclass(frozen=True, kw_only=True)
class PenTwirlTask(TaskSpec):
    """Turn the pen.

    Attributes:
        tilt: Largest of the uniform angles by which the target is turned about x and then y [rad].
        free: Whether the pen has a free joint and its true inertia. Without, as in MyoSuite, it has three
            slides and three hinges along its own axes, and the inertia floor.
    """

    program: ClassVar[type] = PenTwirlProgram
    shown: ClassVar[Shown | None] = Shown(
        "A trained hand turns the pen.", "myoHandPenTwirlFixed-v0", "baseline", 45, 3
    )
    measures: ClassVar = {
        "position": pen_position,
        "axis": pen_axis,
        "wanted": wanted_axis,
        "error": pen_distance,
        "cosine": pen_cosine,
        "solved": is_aligned,
        "failed": is_far,
    }
    far: ClassVar[float] = float(DROPPED)
    coarse_step = CoarseStep(0.005, 0.5)
    carried = ("Object",)
    start_doc = "the open hand, palm up, with the pen on it"
    solved_when = f"the cosine between pen and wanted pen exceeds {ALIGNED:g}, and the pen is not lost"
    failed_when = f"the pen is lost: its centre is more than {DROPPED:g} m from where it started"

    body: str = "contact_hand"
    num_substeps: int = 5
    horizon: int = 50
    tilt: float = 0.0
    free: bool = False

    @property
    def scene_key(self) -> tuple[object, ...]:
        """The pen's joints are compiled in."""
        return (*super().scene_key, self.free)

    @property
    def draws(self) -> tuple[Draw, ...]:
        turns = "by what the wanted pen is turned from upright: about x, then about its own y"
        return (Draw("tilt", "rad", 2 * (-self.tilt,), 2 * (self.tilt,), turns, XYZ[:2]),)

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the open hand, palm up, with the pen on it."""
        qpos = super().start(model)
        qpos[0] = PALM_UP
        return qpos

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the pen, the target pen, and the marker of where the pen's top should be."""
        pen = add_object(spec, "Object", PEN_POS, floored=not self.free)
        pen.quat = (np.cos(PEN_TILT / 2), 0.0, np.sin(PEN_TILT / 2), 0.0)
        add_pen(pen, "pen", 1500.0, (0.25, 0.45, 0.8, 1.0))
        pen.add_site(name="object_top", pos=(0.0, 0.0, HALF_LENGTH), size=(0.005, 0.005, 0.005))
        add_object_joints(pen, free=self.free)
        # The engine never moves a static geom; a mocap body is as immovable, and turned for each world.
        target = add_object(spec, "target", TARGET_POS, mocap=True)
        add_pen(target, "target", 1000.0, (0.1, 0.68, 0.3, 1.0))
        add_tip_targets(spec, ("object_top",))

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        frame = "world" if self.free else "of three slides and three hinges along the pen's own axes"
        velocities = f"velocities of the pen, {frame}, times the control step"
        rates = free_rates if self.free else Row("qvel", HAND_JOINTS, "control_dt")
        return (
            Column("hand_jnt", HAND_JOINTS, *COORDINATES),
            Column("obj_pos", 3, "m", "position of the pen's centre, world", XYZ, pen_position),
            Column("obj_vel", 6, "m, rad per control step", velocities, FREE_RATES, rates),
            Column("obj_rot", 3, "1", "unit vector along the pen, to its top, world", XYZ, pen_axis),
            Column("obj_des_rot", 3, "1", "unit vector along the wanted pen, world", XYZ, wanted_axis),
            Column("obj_err_pos", 3, "m", "from the pen's start to its centre, world", XYZ, from_start),
            Column("obj_err_rot", 3, "1", "obj_rot minus obj_des_rot", XYZ, axis_error),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        distance = "minus the distance of the pen's centre from its start"
        bonus = (
            f"1 where the cosine exceeds {CLOSE:g}, {1 + ALIGNED_BONUS:g} beyond {ALIGNED:g};"
            " 0 where the pen is lost"
        )
        return (
            RewardTerm("pos_align", 1.0, "m", distance, minus_error),
            RewardTerm("rot_align", 1.0, "1", "cosine between pen and wanted pen", pen_cosine),
            RewardTerm("act_reg", 5.0, *EFFORT),
            RewardTerm("drop", 5.0, "1", "-1 where the pen is lost", minus_failed),
            RewardTerm("bonus", 10.0, "1", bonus, aligned_bonus),
            RewardTerm("sparse", 0.0, "1", "rot_align plus pos_align", both_aligned),
        )


FREE = (
    "The pen has a free joint and its true inertia; in v0, as in MyoSuite 3.0.0, it loses a direction of"
    " rotation where the second of its three hinges is at a right angle, its rates are about turned axes, and"
    " its inertia about the long axis is raised from 2e-5 to 1e-4 kg m^2."
)


@task("myoHandPenTwirlFixed-v1", FREE, free=True)
@task("myoHandPenTwirlFixed-v0")
def upright() -> PenTwirlTask:
    """Stand a pen upright in the hand."""
    return PenTwirlTask()


@task("myoHandPenTwirlRandom-v1", FREE, free=True)
@task("myoHandPenTwirlRandom-v0")
def tilted() -> PenTwirlTask:
    """Turn a pen in the hand to an orientation drawn anew each episode."""
    return PenTwirlTask(tilt=1.0)
