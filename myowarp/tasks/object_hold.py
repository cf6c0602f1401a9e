"""Object hold: bring an ellipsoid that lies on the open hand to a goal and keep it there.

    reward = -100 x + 4 (1[x < 0.02] + 1[x < 0.01]) - 10 1[x > 0.3]

with x the distance of the object's centre from the goal [m]; x < 0.01 is solved, x > 0.3 fails. Source:
MyoSuite 3.0.0, family ObjHold (paper: Caggiano et al. 2022, arXiv:2205.13600).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, VELOCITIES, XYZ
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec, task
from myowarp.kernels.random import GOAL, START
from myowarp.kernels.reward import EFFORT, is_far, is_near, minus_error, minus_failed, near_bonus
from myowarp.models.bodies.contact_hand import HAND_JOINTS, PALM_UP, add_object
from myowarp.tasks.held_object import BATCHED_MASS, BATCHED_SIZE, DENSITY, resize_object, weigh_object
from myowarp.tasks.markers import add_tip_targets

OBJECT = wp.constant(23)  # first of the object's seven coordinates, after the hand's

NOMINAL_SIZE = (0.025, 0.036, 0.03)  # m, semi-axes
OBJECT_POS = (-0.235, -0.51, 1.45)  # m, world; on the palm


@wp.func
def object_position(qpos: wp.array[float]) -> wp.vec3:
    """Position of the free object [m]."""
    return wp.vec3(qpos[OBJECT], qpos[OBJECT + 1], qpos[OBJECT + 2])


@wp.func
def goal_error(qpos: wp.array[float], goal: wp.array[float]) -> wp.vec3:
    """Goal - object."""
    return wp.vec3(goal[0], goal[1], goal[2]) - object_position(qpos)


@wp.func
def goal_distance(qpos: wp.array[float], goal: wp.array[float]) -> float:
    """x = |goal - object|."""
    return wp.length(goal_error(qpos, goal))


class ObjectHoldProgram(Program):
    """An object hold task bound to a scene.

    Attributes:
        goal: Where the object's centre should be [m], world, shape (num_worlds, 3).
        object_size: Semi-axes of the object [m], shape (num_worlds, 3); after writing them call
            `shape_object`.
    """

    spec: ObjectHoldTask
    goal: wp.array
    object_size: wp.array

    def __init__(self, spec: ObjectHoldTask, scene: Scene) -> None:
        """Resolve the object."""
        super().__init__(spec, scene)
        self.object_geom = scene.oracle.geom("object").id
        self.object_body = scene.oracle.body("object").id

    def sample_start(self, mask: wp.array) -> None:
        """Draw sizes, and give the objects their sizes."""
        super().sample_start(mask)
        self.shape_object(mask)

    def shape_object(self, mask: wp.array) -> None:
        """Write into the model what follows from `object_size` in the worlds of `mask`."""
        self.launch(resize_object, mask=mask)
        if self.spec.true_inertia:
            self.launch(weigh_object, density=DENSITY, mask=mask)

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
    shown: ClassVar[Shown | None] = Shown(
        "A trained hand carries the object to its target.", "myoHandObjHoldRandom-v0", "baseline", 30, 2
    )
    measures: ClassVar = {"error": goal_distance, "solved": is_near, "failed": is_far}
    near: ClassVar[float] = 0.01  # m, error below which the task counts as solved
    wider: ClassVar[float] = 2.0  # times `near`: where the first bonus begins
    far: ClassVar[float] = 0.3  # m, error beyond which the object is lost
    coarse_step = CoarseStep(0.005, 0.5)
    uses_kinematics = False  # the coordinates of the free object are its position
    carried = ("object",)
    start_doc = "the open hand, palm up, with the object on it"

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
    def batched(self) -> tuple[str, ...]:
        """The object's size and what follows from it."""
        return (*BATCHED_SIZE, *BATCHED_MASS) if self.true_inertia else BATCHED_SIZE

    @property
    def solved_when(self) -> str:
        return f"the error, the distance of the object from the goal, is below {self.near:g} m"

    @property
    def failed_when(self) -> str:
        return f"the error exceeds {self.far:g} m"

    @property
    def draws(self) -> tuple[Draw, ...]:
        goal = "where the object should be, world"
        size = "semi-axes of the object, an ellipsoid"
        goals, sizes = (self.goal_low, self.goal_high), (self.size_low, self.size_high)
        return (
            Draw("goal", "m", *goals, goal, XYZ, array="goal", stream=int(GOAL)),
            Draw("object size", "m", *sizes, size, XYZ, "start", array="object_size", stream=int(START)),
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
        return (
            Column("hand_qpos", HAND_JOINTS, *COORDINATES),
            Column("hand_qvel", HAND_JOINTS, *VELOCITIES),
            Column("obj_pos", 3, "m", "position of the object, world", XYZ, object_position),
            Column("obj_err", 3, "m", "from the object to the goal, world", XYZ, goal_error),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        error = "minus the error, the distance of the object from the goal"
        bonus = f"1 where the error is below {self.wider * self.near:g} m, 2 below {self.near:g} m"
        return (
            RewardTerm("goal_dist", 100.0, "m", error, minus_error),
            RewardTerm("bonus", 4.0, "1", bonus, near_bonus),
            RewardTerm("act_reg", 0.0, *EFFORT),
            RewardTerm("penalty", 10.0, "1", f"-1 where the error exceeds {self.far:g} m", minus_failed),
            RewardTerm("sparse", 0.0, "m", "minus the error", minus_error),
        )


CUBE: dict[str, Any] = {"goal_low": (-0.265, -0.54, 1.42), "goal_high": (-0.205, -0.48, 1.48)}
"""Goals [m] of MyoSuite: 30 mm to all sides of the start."""
CLEAR: dict[str, Any] = {"goal_low": (-0.245, -0.54, 1.455), "goal_high": (-0.205, -0.48, 1.48)}
"""The part of the cube that the hand leaves free."""

TRUE_INERTIA = (
    "The object has mass and inertia of its size; in v0, as in MyoSuite 3.0.0, every object weighs 113 g"
    " and its inertia is raised to 1e-4 kg m^2, at least twice the true one."
)
ABOVE_PALM = (
    " Goals lie where the open hand leaves room: at 1% of them the object would overlap it by more than"
    " 5 mm, at 50% in v0."
)


@task("myoHandObjHoldFixed-v1", TRUE_INERTIA, true_inertia=True)
@task("myoHandObjHoldFixed-v0")
def lift() -> ObjectHoldTask:
    """Lift an ellipsoid 20 mm off the palm and hold it."""
    size, goal = NOMINAL_SIZE, (-0.24, -0.52, 1.47)
    return ObjectHoldTask(goal_low=goal, goal_high=goal, size_low=size, size_high=size)


@task("myoHandObjHoldRandom-v1", TRUE_INERTIA + ABOVE_PALM, true_inertia=True, **CLEAR)
@task("myoHandObjHoldRandom-v0")
def hold_anywhere() -> ObjectHoldTask:
    """Hold an ellipsoid of random size at a random place."""
    smallest, largest = (0.02, 0.02, 0.02), (0.03, 0.03, 0.03)
    return ObjectHoldTask(size_low=smallest, size_high=largest, **CUBE)
