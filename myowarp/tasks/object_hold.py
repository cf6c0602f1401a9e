"""Object hold: bring an ellipsoid that lies on the open hand to a goal and keep it there.

    reward = -100 x + 4 (1[x < 0.02] + 1[x < 0.01]) - 10 1[x > 0.3]

with x the distance of the object's centre from the goal [m]; x < 0.01 is solved, x > 0.3 fails. Source:
MyoSuite 3.0.0, family ObjHold (paper: Caggiano et al. 2022, arXiv:2205.13600).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, VELOCITIES, XYZ
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, TaskSpec, blocks, task, weighted
from myowarp.kernels.observe import pack, pack_range, pack_vec3
from myowarp.kernels.random import GOAL, START, RandomKeys, open_stream
from myowarp.kernels.reward import EFFORT, activation_effort, indicator
from myowarp.models.bodies.contact_hand import HAND_JOINTS, add_object
from myowarp.tasks.held_object import BATCHED_MASS, BATCHED_SIZE, DENSITY, resize_object, weigh_object
from myowarp.tasks.markers import add_tip_targets

OBJECT = wp.constant(23)  # first of the object's seven coordinates, after the hand's
NEAR = wp.constant(0.01)  # m, error below which the task counts as solved
WIDER = wp.constant(2.0)  # times NEAR: where the first bonus begins
FAR = wp.constant(0.3)  # m, error beyond which the object is lost

NOMINAL_SIZE = (0.025, 0.036, 0.03)  # m, semi-axes
PALM_UP = -1.5  # rad, forearm rotation at the start, joint 0
OBJECT_POS = (-0.235, -0.51, 1.45)  # m, world; on the palm


Obs = IntEnum("Obs", "hand_qpos hand_qvel obj_pos obj_err act", start=0)
"""Blocks of the observation, in the order of their columns."""

Term = IntEnum("Term", "goal_dist bonus act_reg penalty sparse", start=0)
"""Terms of the reward, in the order of their columns."""


@wp.kernel(enable_backward=False)
def sample_box(
    # In:
    low: wp.vec3,
    high: wp.vec3,
    stream: int,
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    drawn: wp.array[wp.vec3],
):
    """drawn ~ U(low, high)."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    state = open_stream(keys, worldid, stream)
    values = wp.vec3()
    for i in range(3):
        values[i] = wp.randf(state, low[i], high[i])
    drawn[worldid] = values


@wp.func
def object_position(qpos: wp.array2d[float], worldid: int) -> wp.vec3:
    """Return the position of the free object [m]."""
    return wp.vec3(qpos[worldid, OBJECT], qpos[worldid, OBJECT + 1], qpos[worldid, OBJECT + 2])


@wp.kernel(enable_backward=False)
def observe_hold(
    # Params:
    first: wp.array[int],
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    activation: wp.array2d[float],
    goal: wp.array[wp.vec3],
    control_dt: float,
    mask: wp.array[bool],
    # Out:
    obs: wp.array2d[float],
):
    """obs = [hand qpos, hand qvel dt, object, goal - object, activation]."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    position = object_position(qpos_in, worldid)
    pack_range(obs, worldid, first[Obs.hand_qpos], qpos_in, 0, HAND_JOINTS, 1.0)
    pack_range(obs, worldid, first[Obs.hand_qvel], qvel_in, 0, HAND_JOINTS, control_dt)
    pack_vec3(obs, worldid, first[Obs.obj_pos], position)
    pack_vec3(obs, worldid, first[Obs.obj_err], goal[worldid] - position)
    pack(obs, worldid, first[Obs.act], activation, 1.0)


@wp.kernel(enable_backward=False)
def score_hold(
    # Data in:
    qpos_in: wp.array2d[float],
    # In:
    activation: wp.array2d[float],
    goal: wp.array[wp.vec3],
    # Out:
    terms: wp.array2d[float],
    solved: wp.array[bool],
    failed: wp.array[bool],
):
    """Terms goal_dist, bonus, act_reg, penalty, sparse from x = |goal - object|."""
    worldid = wp.tid()
    x = wp.length(goal[worldid] - object_position(qpos_in, worldid))
    terms[worldid, Term.goal_dist] = -x
    terms[worldid, Term.bonus] = indicator(x < WIDER * NEAR) + indicator(x < NEAR)
    terms[worldid, Term.act_reg] = -activation_effort(activation, worldid)
    terms[worldid, Term.penalty] = -indicator(x > FAR)
    terms[worldid, Term.sparse] = -x
    solved[worldid] = x < NEAR
    failed[worldid] = x > FAR


class ObjectHoldProgram(Program):
    """An object hold task bound to a scene.

    Attributes:
        goal: Where the object's centre should be [m], world, shape (num_worlds,) of vec3.
        object_size: Semi-axes of the object [m], shape (num_worlds,) of vec3; after writing them call
            `shape_object`.
    """

    spec: ObjectHoldTask

    def __init__(self, spec: ObjectHoldTask, scene: Scene) -> None:
        """Allocate goal and size."""
        super().__init__(spec, scene)
        self.object_geom = scene.oracle.geom("object").id
        self.object_body = scene.oracle.body("object").id
        self.goal = scene.zeros("task.goal", dtype=wp.vec3)
        self.object_size = scene.zeros("task.object_size", dtype=wp.vec3)

    def sample_start(self, mask: wp.array) -> None:
        """Draw sizes, and give the objects their sizes."""
        low, high = wp.vec3(*self.spec.size_low), wp.vec3(*self.spec.size_high)
        self.launch(sample_box, low=low, high=high, stream=START, mask=mask, drawn=self.object_size)
        self.shape_object(mask)

    def sample_goal(self, mask: wp.array) -> None:
        low, high = wp.vec3(*self.spec.goal_low), wp.vec3(*self.spec.goal_high)
        self.launch(sample_box, low=low, high=high, stream=GOAL, mask=mask, drawn=self.goal)

    def shape_object(self, mask: wp.array) -> None:
        """Write into the model what follows from `object_size` in the worlds of `mask`."""
        self.launch(resize_object, mask=mask)
        if self.spec.true_inertia:
            self.launch(weigh_object, density=DENSITY, mask=mask)

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        self.launch(observe_hold, mask=mask, obs=obs)

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        self.launch(score_hold, terms=terms, solved=solved, failed=failed)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        return {"object_target": self.goal.numpy()[world].copy()}


@dataclass(frozen=True, kw_only=True)
class ObjectHoldTask(TaskSpec):
    """Hold the object at a goal.

    Attributes:
        goal_low: Lower corner of the box from which the goal is drawn [m], world.
        goal_high: Upper corner.
        size_low: Lower bounds of the object's uniformly drawn semi-axes [m].
        size_high: Upper bounds.
        true_inertia: Whether the object has mass and inertia of its size. Without, it has MyoSuite's: the
            mass of `NOMINAL_SIZE` and the inertia floor.
    """

    program: ClassVar[type] = ObjectHoldProgram
    coarse_step = CoarseStep(0.005, 0.5)

    body: str = "contact_hand"
    num_substeps: int = 10
    horizon: int = 75
    goal_low: tuple[float, float, float]
    goal_high: tuple[float, float, float]
    size_low: tuple[float, float, float]
    size_high: tuple[float, float, float]
    true_inertia: bool = False

    @property
    def scene_key(self) -> tuple[object, ...]:
        """The object's inertia is compiled in."""
        return (*super().scene_key, self.true_inertia)

    @property
    def uses_kinematics(self) -> bool:
        """The coordinates of the free object are its position."""
        return False

    @property
    def batched(self) -> tuple[str, ...]:
        """The object's size and what follows from it."""
        return (*BATCHED_SIZE, *BATCHED_MASS) if self.true_inertia else BATCHED_SIZE

    @property
    def carried(self) -> tuple[str, ...]:
        return ("object",)

    @property
    def start_doc(self) -> str:
        return "the open hand, palm up, with the object on it"

    @property
    def solved_when(self) -> str:
        return f"the error, the distance of the object from the goal, is below {NEAR:g} m"

    @property
    def failed_when(self) -> str:
        return f"the error exceeds {FAR:g} m"

    @property
    def draws(self) -> tuple[Draw, ...]:
        size = "semi-axes of the object, an ellipsoid"
        return (
            Draw("goal", "m", self.goal_low, self.goal_high, "where the object should be, world", XYZ),
            Draw("object size", "m", self.size_low, self.size_high, size, XYZ, when="start"),
        )

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the open hand, palm up, with the object on it."""
        qpos = super().start(model)
        qpos[0] = PALM_UP
        return qpos

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the object and the marker of its goal."""
        thing = add_object(spec, "object", OBJECT_POS, floored=not self.true_inertia)
        shape = thing.add_geom(type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=NOMINAL_SIZE, density=DENSITY)
        shape.name = "object"
        shape.contype, shape.conaffinity, shape.condim = 1, 1, 1
        shape.rgba = (0.25, 0.45, 0.8, 0.6)  # lets the goal be seen through it
        thing.add_joint(name="object", type=mujoco.mjtJoint.mjJNT_FREE)
        thing.add_site(name="object", size=(0.005, 0.005, 0.005))
        add_tip_targets(spec, ("object",))

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        return blocks(
            {
                Obs.hand_qpos: (HAND_JOINTS, *COORDINATES),
                Obs.hand_qvel: (HAND_JOINTS, *VELOCITIES),
                Obs.obj_pos: (3, "m", "position of the object, world", XYZ),
                Obs.obj_err: (3, "m", "from the object to the goal, world", XYZ),
                Obs.act: (num_muscles, *ACTIVATION),
            }
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        return weighted(
            {
                Term.goal_dist: (100.0, "m", "minus the error, the distance of the object from the goal"),
                Term.bonus: (
                    4.0,
                    "1",
                    f"1 where the error is below {WIDER * NEAR:g} m, 2 below {NEAR:g} m",
                ),
                Term.act_reg: (0.0, *EFFORT),
                Term.penalty: (10.0, "1", f"-1 where the error exceeds {FAR:g} m"),
                Term.sparse: (0.0, "m", "minus the error"),
            }
        )


CUBE = ((-0.265, -0.54, 1.42), (-0.205, -0.48, 1.48))  # m, MyoSuite's goals: 30 mm to all sides of the start
CLEAR = ((-0.245, -0.54, 1.455), (-0.205, -0.48, 1.48))  # m, the part of the cube that the hand leaves free

TRUE_INERTIA = (
    "The object has mass and inertia of its size; in v0, as in MyoSuite 3.0.0, every object weighs 113 g"
    " and its inertia is raised to 1e-4 kg m^2, at least twice the true one."
)
ABOVE_PALM = (
    " Goals lie where the open hand leaves room: at 1% of them the object would overlap it by more than"
    " 5 mm, at 50% in v0."
)


def lift() -> ObjectHoldTask:
    """Return the task with one object and one goal, as in MyoSuite."""
    size, goal = NOMINAL_SIZE, (-0.24, -0.52, 1.47)
    return ObjectHoldTask(goal_low=goal, goal_high=goal, size_low=size, size_high=size)


def hold_anywhere(low: tuple[float, float, float], high: tuple[float, float, float]) -> ObjectHoldTask:
    """Return the task with a random object and goals between `low` and `high`, as in MyoSuite."""
    smallest, largest = (0.02, 0.02, 0.02), (0.03, 0.03, 0.03)
    return ObjectHoldTask(goal_low=low, goal_high=high, size_low=smallest, size_high=largest)


@task("myoHandObjHoldFixed-v0")
def fixed_v0() -> ObjectHoldTask:
    """Lift an ellipsoid 20 mm off the palm and hold it."""
    return lift()


@task("myoHandObjHoldRandom-v0")
def random_v0() -> ObjectHoldTask:
    """Hold an ellipsoid of random size at a random place."""
    return hold_anywhere(*CUBE)


@task("myoHandObjHoldFixed-v1", TRUE_INERTIA)
def fixed() -> ObjectHoldTask:
    """Lift an ellipsoid 20 mm off the palm and hold it."""
    return replace(lift(), true_inertia=True)


@task("myoHandObjHoldRandom-v1", TRUE_INERTIA + ABOVE_PALM)
def random() -> ObjectHoldTask:
    """Hold an ellipsoid of random size at a random place."""
    return replace(hold_anywhere(*CLEAR), true_inertia=True)
