"""Pen twirl: turn a pen that lies on the hand until it is parallel to another pen, without dropping it.

    reward = -p + c - 5 |act| / n - 5 1[p > 0.075] + 10 (1[c > 0.9] + 5 1[c > 0.95]) 1[p < 0.075]

with p the distance of the pen's centre from its start [m] and c the cosine between the two pens; c > 0.95
is solved, p > 0.075 fails. Source: MyoSuite 3.0.0, family PenTwirl (paper: Caggiano et al. 2022,
arXiv:2205.13600).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, FREE_RATES, XYZ
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, TaskSpec, blocks, task, weighted
from myowarp.kernels.observe import pack, pack_range, pack_vec3
from myowarp.kernels.random import GOAL, RandomKeys, open_stream
from myowarp.kernels.reward import EFFORT, activation_effort, indicator
from myowarp.models.bodies.contact_hand import HAND_JOINTS, add_object
from myowarp.tasks.markers import add_tip_targets

DROPPED = wp.constant(0.075)  # m, distance from the start beyond which the pen is lost
CLOSE = wp.constant(0.9)  # cosines with bonus
ALIGNED = wp.constant(0.95)
ALIGNED_BONUS = wp.constant(5.0)  # what it adds to the 1 of CLOSE

PALM_UP = -1.5  # rad, forearm rotation at the start, joint 0
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
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


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


Obs = IntEnum("Obs", "hand_jnt obj_pos obj_vel obj_rot obj_des_rot obj_err_pos obj_err_rot act", start=0)
"""Blocks of the observation, in the order of their columns."""

Term = IntEnum("Term", "pos_align rot_align act_reg drop bonus sparse", start=0)
"""Terms of the reward, in the order of their columns."""


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


@wp.kernel(enable_backward=False)
def observe_pen(
    # Params:
    pen_body: int,
    target_body: int,
    free: bool,
    first: wp.array[int],
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    xpos_in: wp.array2d[wp.vec3],
    xmat_in: wp.array2d[wp.mat33],
    # In:
    activation: wp.array2d[float],
    control_dt: float,
    mask: wp.array[bool],
    # Out:
    obs: wp.array2d[float],
):
    """obs = [hand qpos, pen, pen rates dt, axis, wanted axis, pen - start, axis - wanted, activation].

    Rates of a free pen: linear and angular velocity in the world; else those of its six joints.
    """
    worldid = wp.tid()
    if not mask[worldid]:
        return
    position = xpos_in[worldid, pen_body]
    frame = xmat_in[worldid, pen_body]
    axis = long_axis(frame)
    wanted = long_axis(xmat_in[worldid, target_body])
    pack_range(obs, worldid, first[Obs.hand_jnt], qpos_in, 0, HAND_JOINTS, 1.0)
    pack_vec3(obs, worldid, first[Obs.obj_pos], position)
    pack_range(obs, worldid, first[Obs.obj_vel], qvel_in, HAND_JOINTS, 6, control_dt)
    if free:
        rates = qvel_in[worldid]
        spin = wp.vec3(rates[HAND_JOINTS + 3], rates[HAND_JOINTS + 4], rates[HAND_JOINTS + 5])
        pack_vec3(obs, worldid, first[Obs.obj_vel] + 3, control_dt * (frame @ spin))
    pack_vec3(obs, worldid, first[Obs.obj_rot], axis)
    pack_vec3(obs, worldid, first[Obs.obj_des_rot], wanted)
    pack_vec3(obs, worldid, first[Obs.obj_err_pos], position - PEN_START)
    pack_vec3(obs, worldid, first[Obs.obj_err_rot], axis - wanted)
    pack(obs, worldid, first[Obs.act], activation, 1.0)


@wp.kernel(enable_backward=False)
def score_pen(
    # Params:
    pen_body: int,
    target_body: int,
    # Data in:
    xpos_in: wp.array2d[wp.vec3],
    xmat_in: wp.array2d[wp.mat33],
    # In:
    activation: wp.array2d[float],
    # Out:
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """Terms pos_align, rot_align, act_reg, drop, bonus, sparse from p and c."""
    worldid = wp.tid()
    p = wp.length(xpos_in[worldid, pen_body] - PEN_START)
    c = wp.dot(long_axis(xmat_in[worldid, pen_body]), long_axis(xmat_in[worldid, target_body]))
    terms[worldid, Term.pos_align] = -p
    terms[worldid, Term.rot_align] = c
    terms[worldid, Term.act_reg] = -activation_effort(activation, worldid)
    terms[worldid, Term.drop] = -indicator(p > DROPPED)
    terms[worldid, Term.bonus] = (indicator(c > CLOSE) + ALIGNED_BONUS * indicator(c > ALIGNED)) * indicator(
        p < DROPPED
    )
    terms[worldid, Term.sparse] = c - p
    solved[worldid] = c > ALIGNED and p <= DROPPED
    failed[worldid] = p > DROPPED


class PenTwirlProgram(Program):
    """A pen twirl task bound to a scene.

    Attributes:
        target_quat: Orientation of the target pen (w, x, y, z), the engine's `mocap_quat`, shape
            (num_worlds, 1) of quat.
    """

    def __init__(self, spec: PenTwirlTask, scene: Scene) -> None:
        """Resolve the two pens."""
        super().__init__(spec, scene)
        self.pen_body = scene.oracle.body("Object").id
        self.target_body = scene.oracle.body("target").id
        self.target_quat = scene.data.mocap_quat

    def sample_goal(self, mask: wp.array) -> None:
        self.launch(sample_pen, mask=mask)

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        self.launch(observe_pen, mask=mask, obs=obs)

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        self.launch(score_pen, terms=terms, solved=solved, failed=failed)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Where the top of the pen should be, its centre being where it started."""
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
    coarse_step = CoarseStep(0.005, 0.5)

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
    def carried(self) -> tuple[str, ...]:
        """The pen."""
        return ("Object",)

    @property
    def start_doc(self) -> str:
        return "the open hand, palm up, with the pen on it"

    @property
    def solved_when(self) -> str:
        return f"the cosine between pen and wanted pen exceeds {ALIGNED:g}, and the pen is not lost"

    @property
    def failed_when(self) -> str:
        return f"the pen is lost: its centre is more than {DROPPED:g} m from where it started"

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
        if self.free:
            pen.add_joint(name="OBJ", type=mujoco.mjtJoint.mjJNT_FREE)
        else:
            for prefix, kind in (("T", mujoco.mjtJoint.mjJNT_SLIDE), ("R", mujoco.mjtJoint.mjJNT_HINGE)):
                for letter, axis in AXES.items():
                    pen.add_joint(name=f"OBJ{prefix}{letter}", type=kind, axis=axis)
        # The engine never moves a static geom; a mocap body is as immovable, and turned for each world.
        target = add_object(spec, "target", TARGET_POS, mocap=True)
        add_pen(target, "target", 1000.0, (0.1, 0.68, 0.3, 1.0))
        add_tip_targets(spec, ("object_top",))

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        frame = "world" if self.free else "of three slides and three hinges along the pen's own axes"
        return blocks(
            {
                Obs.hand_jnt: (HAND_JOINTS, *COORDINATES),
                Obs.obj_pos: (3, "m", "position of the pen's centre, world", XYZ),
                Obs.obj_vel: (
                    6,
                    "m, rad per control step",
                    f"velocities of the pen, {frame}, times the control step",
                    FREE_RATES,
                ),
                Obs.obj_rot: (3, "1", "unit vector along the pen, to its top, world", XYZ),
                Obs.obj_des_rot: (3, "1", "unit vector along the wanted pen, world", XYZ),
                Obs.obj_err_pos: (3, "m", "from the pen's start to its centre, world", XYZ),
                Obs.obj_err_rot: (3, "1", "obj_rot minus obj_des_rot", XYZ),
                Obs.act: (num_muscles, *ACTIVATION),
            }
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        return weighted(
            {
                Term.pos_align: (1.0, "m", "minus the distance of the pen's centre from its start"),
                Term.rot_align: (1.0, "1", "cosine between pen and wanted pen"),
                Term.act_reg: (5.0, *EFFORT),
                Term.drop: (5.0, "1", "-1 where the pen is lost"),
                Term.bonus: (
                    10.0,
                    "1",
                    f"1 where the cosine exceeds {CLOSE:g}, {1 + ALIGNED_BONUS:g} beyond {ALIGNED:g};"
                    " 0 where the pen is lost",
                ),
                Term.sparse: (0.0, "1", "rot_align plus pos_align"),
            }
        )


FREE = (
    "The pen has a free joint and its true inertia; in v0, as in MyoSuite 3.0.0, it loses a direction of"
    " rotation where the second of its three hinges is at a right angle, its rates are about turned axes, and"
    " its inertia about the long axis is raised from 2e-5 to 1e-4 kg m^2."
)


@task("myoHandPenTwirlFixed-v0")
def fixed_v0() -> PenTwirlTask:
    """Stand a pen upright in the hand."""
    return PenTwirlTask()


@task("myoHandPenTwirlRandom-v0")
def random_v0() -> PenTwirlTask:
    """Turn a pen in the hand to an orientation drawn anew each episode."""
    return PenTwirlTask(tilt=1.0)


@task("myoHandPenTwirlFixed-v1", FREE)
def fixed() -> PenTwirlTask:
    """Stand a pen upright in the hand."""
    return PenTwirlTask(free=True)


@task("myoHandPenTwirlRandom-v1", FREE)
def random() -> PenTwirlTask:
    """Turn a pen in the hand to an orientation drawn anew each episode."""
    return PenTwirlTask(tilt=1.0, free=True)
