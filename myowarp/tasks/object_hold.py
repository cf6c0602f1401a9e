"""Object hold: bring an ellipsoid that lies on the open hand to a goal and keep it there.

    reward = -100 x + 4 (1[x < 0.02] + 1[x < 0.01]) - 10 1[x > 0.3]

with x the distance of the object's centre from the goal [m]; x < 0.01 is solved, x > 0.3 fails. Source:
MyoSuite 3.0.0, family ObjHold (paper: Caggiano et al. 2022, arXiv:2205.13600).
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
from myowarp.tasks.markers import add_tip_targets

OBJECT = wp.constant(23)  # first of the object's seven coordinates, after the hand's
NEAR = wp.constant(0.01)  # m, error below which the task counts as solved
FAR = wp.constant(0.3)  # m, error beyond which the object is lost

DENSITY = 1000.0  # kg/m^3
PALM_UP = -1.5  # rad, forearm rotation at the start, joint 0
OBJECT_POS = (-0.235, -0.51, 1.45)  # m, world; on the palm


@dataclass(frozen=True)
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

    goal_low: tuple[float, float, float] = field(kw_only=True)
    goal_high: tuple[float, float, float] = field(kw_only=True)
    size_low: tuple[float, float, float] = field(kw_only=True)
    size_high: tuple[float, float, float] = field(kw_only=True)
    true_inertia: bool = field(default=False, kw_only=True)

    @property
    def scene_key(self) -> tuple[object, ...]:
        """The object's inertia is compiled in."""
        return (*super().scene_key, self.true_inertia)

    @property
    def uses_kinematics(self) -> bool:
        """The coordinates of the free object are its position."""
        return False

    @property
    def sites(self) -> tuple[str, ...]:
        """None: joint coordinates say everything."""
        return ()

    @property
    def batched(self) -> tuple[str, ...]:
        """The object's size and what follows from it."""
        shape = ("geom_size", "geom_rbound", "geom_aabb")
        mass = ("body_mass", "body_subtreemass", "body_inertia", "body_invweight0")
        return (*shape, *mass) if self.true_inertia else shape

    @property
    def carried(self) -> tuple[str, ...]:
        """The object."""
        return ("object",)

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

    def columns(self, num_joints: int, num_muscles: int) -> tuple[Column, ...]:
        """Hand, where the object is and has to go, activations."""
        num_hand = num_joints - 7
        return (
            Column("hand_qpos", num_hand, "rad"),
            Column("hand_qvel", num_hand, "rad per control step"),
            Column("obj_pos", 3, "m"),
            Column("obj_err", 3, "m"),
            Column("act", num_muscles, "1"),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """In the order in which `score_hold` writes them."""
        return (
            RewardTerm("goal_dist", 100.0),
            RewardTerm("bonus", 4.0),
            RewardTerm("act_reg", 0.0),
            RewardTerm("penalty", 10.0),
            RewardTerm("sparse", 0.0),
        )

    def bind(self, scene: Scene) -> ObjectHoldProgram:
        """Allocate goal and size for every world."""
        return ObjectHoldProgram(self, scene)


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


@wp.kernel(enable_backward=False)
def resize_object(
    # Params:
    object_geom: int,
    # In:
    object_size: wp.array[wp.vec3],
    mask: wp.array[bool],
    # Out:
    geom_size: wp.array2d[wp.vec3],
    geom_rbound: wp.array2d[float],
    geom_aabb: wp.array3d[wp.vec3],
):
    """Semi-axes, bounding sphere max(a, b, c) and bounding box of the ellipsoid."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    size = object_size[worldid]
    geom_size[worldid, object_geom] = size
    geom_rbound[worldid, object_geom] = wp.max(size)
    geom_aabb[worldid, object_geom, 1] = size


@wp.kernel(enable_backward=False)
def weigh_object(
    # Params:
    object_body: int,
    density: float,
    # In:
    object_size: wp.array[wp.vec3],
    mask: wp.array[bool],
    # Out:
    body_mass: wp.array2d[float],
    body_subtreemass: wp.array2d[float],
    body_inertia: wp.array2d[wp.vec3],
    body_invweight0: wp.array2d[wp.vec2],
):
    """m = 4/3 pi rho a b c, I_x = m (b^2 + c^2) / 5 in cyclic order; inverse weights 1/m, mean of 1/I."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    size = object_size[worldid]
    mass = 4.0 / 3.0 * wp.pi * density * size[0] * size[1] * size[2]
    square = wp.cw_mul(size, size)
    inertia = 0.2 * mass * wp.vec3(square[1] + square[2], square[0] + square[2], square[0] + square[1])
    compliance = (1.0 / inertia[0] + 1.0 / inertia[1] + 1.0 / inertia[2]) / 3.0
    body_mass[worldid, object_body] = mass
    body_subtreemass[worldid, object_body] = mass
    body_inertia[worldid, object_body] = inertia
    body_invweight0[worldid, object_body] = wp.vec2(1.0 / mass, compliance)


@wp.func
def object_position(qpos: wp.array2d[float], worldid: int) -> wp.vec3:
    """Return the position of the free object [m]."""
    return wp.vec3(qpos[worldid, OBJECT], qpos[worldid, OBJECT + 1], qpos[worldid, OBJECT + 2])


@wp.kernel(enable_backward=False)
def observe_hold(
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
    column = pack_range(obs, worldid, 0, qpos_in, 0, HAND_JOINTS, 1.0)
    column = pack_range(obs, worldid, column, qvel_in, 0, HAND_JOINTS, control_dt)
    column = pack_vec3(obs, worldid, column, position)
    column = pack_vec3(obs, worldid, column, goal[worldid] - position)
    pack(obs, worldid, column, activation, 1.0)


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
    terms[worldid, 0] = -x
    terms[worldid, 1] = indicator(x < 2.0 * NEAR) + indicator(x < NEAR)
    terms[worldid, 2] = -activation_effort(activation, worldid)
    terms[worldid, 3] = -indicator(x > FAR)
    terms[worldid, 4] = -x
    solved[worldid] = x < NEAR
    failed[worldid] = x > FAR


class ObjectHoldProgram:
    """An object hold task bound to a scene.

    Attributes:
        goal: Where the object's centre should be [m], world, shape (num_worlds,) of vec3.
        object_size: Semi-axes of the object [m], shape (num_worlds,) of vec3; after writing them call
            `shape_object`.
    """

    def __init__(self, spec: ObjectHoldTask, scene: Scene) -> None:
        """Allocate on the scene's device."""
        self.spec, self.scene = spec, scene
        self.object_geom = scene.oracle.geom("object").id
        self.object_body = scene.oracle.body("object").id
        self.goal = wp.zeros(scene.num_worlds, dtype=wp.vec3)
        self.object_size = wp.zeros(scene.num_worlds, dtype=wp.vec3)

    def _draw(
        self, box: tuple[tuple[float, ...], tuple[float, ...]], stream: int, mask: wp.array, drawn: wp.array
    ) -> None:
        """Launch `sample_box`."""
        low, high = (wp.vec3(*corner) for corner in box)
        wp.launch(
            sample_box,
            dim=self.scene.num_worlds,
            inputs=[low, high, stream, self.scene.keys, mask],
            outputs=[drawn],
        )

    def sample_start(self, mask: wp.array) -> None:
        """Draw sizes, and give the objects their sizes."""
        self._draw((self.spec.size_low, self.spec.size_high), START, mask, self.object_size)
        self.shape_object(mask)

    def sample_goal(self, mask: wp.array) -> None:
        """Draw goals."""
        self._draw((self.spec.goal_low, self.spec.goal_high), GOAL, mask, self.goal)

    def shape_object(self, mask: wp.array) -> None:
        """Write into the model what follows from `object_size` in the worlds of `mask`."""
        scene, model = self.scene, self.scene.model
        wp.launch(
            resize_object,
            dim=scene.num_worlds,
            inputs=[self.object_geom, self.object_size, mask],
            outputs=[model.geom_size, model.geom_rbound, model.geom_aabb],
        )
        if self.spec.true_inertia:
            wp.launch(
                weigh_object,
                dim=scene.num_worlds,
                inputs=[self.object_body, float(DENSITY), self.object_size, mask],
                outputs=[
                    model.body_mass,
                    model.body_subtreemass,
                    model.body_inertia,
                    model.body_invweight0,
                ],
            )

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Launch `observe_hold`."""
        scene = self.scene
        wp.launch(
            observe_hold,
            dim=scene.num_worlds,
            inputs=[
                scene.data.qpos,
                scene.data.qvel,
                scene.muscles.activation,
                self.goal,
                scene.control_dt,
                mask,
            ],
            outputs=[obs],
        )

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Launch `score_hold`."""
        scene = self.scene
        wp.launch(
            score_hold,
            dim=scene.num_worlds,
            inputs=[scene.data.qpos, scene.muscles.activation, self.goal],
            outputs=[terms, solved, failed],
        )

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Where the object should be."""
        return {"object_target": self.goal.numpy()[world].copy()}


NOMINAL_SIZE = (0.025, 0.036, 0.03)  # m, semi-axes
FIXED_GOAL = (-0.24, -0.52, 1.47)  # m, world
CUBE = ((-0.265, -0.54, 1.42), (-0.205, -0.48, 1.48))  # m, MyoSuite's goals: 30 mm to all sides of the start
CLEAR = ((-0.245, -0.54, 1.455), (-0.205, -0.48, 1.48))  # m, the part of the cube that the hand leaves free
SIZES = ((0.02, 0.02, 0.02), (0.03, 0.03, 0.03))  # m, semi-axes

TRUE_INERTIA = (
    " The object has mass and inertia of its size; in v0, as in MyoSuite 3.0.0, every object weighs 113 g"
    " and its inertia is raised to 1e-4 kg m^2, at least twice the true one."
)
ABOVE_PALM = (
    " Goals lie where the open hand leaves room: at 1% of them the object would overlap it by more than"
    " 5 mm, at 50% in v0."
)

for _version, _box, _why, _why_random in (
    (0, CUBE, "", ""),
    (1, CLEAR, TRUE_INERTIA, TRUE_INERTIA + ABOVE_PALM),
):
    for _name, _goal, _size, _doc in (
        (
            "myoHandObjHoldFixed",
            (FIXED_GOAL, FIXED_GOAL),
            (NOMINAL_SIZE, NOMINAL_SIZE),
            f"Lift an ellipsoid 20 mm off the palm and hold it.{_why}",
        ),
        (
            "myoHandObjHoldRandom",
            _box,
            SIZES,
            f"Hold an ellipsoid of random size at a random place.{_why_random}",
        ),
    ):
        _spec = ObjectHoldTask(
            _name,
            _version,
            "contact_hand",
            10,
            75,
            _doc,
            goal_low=_goal[0],
            goal_high=_goal[1],
            size_low=_size[0],
            size_high=_size[1],
            true_inertia=_version > 0,
        )
        TASKS.add(_spec.key, _spec)
