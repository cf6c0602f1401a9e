"""Relocate: carry an object from a table into a bin, with the whole arm.

    reward = -100 p - r

with p the distance of the object from the bin's middle [m] and r the norm of the difference of their Euler
angles about x, y and z [rad], which is not the angle between two orientations. p < 0.1 is solved, whatever
the orientation; the episode fails when the palm is more than 0.5 m from the object. Source: MyoSuite 3.0.0,
family Relocate of the MyoChallenge 2023.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.entries import ACTIVATION, COORDINATES, TURN, VELOCITIES, XYZ, Entry, coordinates
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec
from myowarp.engine.stages.arrays import filled
from myowarp.kernels.reward import EFFORT, minus_error
from myowarp.models.bodies.contact_hand import INERTIA_FLOOR, add_object, add_object_joints
from myowarp.tasks.die_reorient import (
    angles_error,
    die_position,
    free_angles,
    minus_both,
    minus_rotation,
    rotation_error,
    rotation_size,
    wanted_angles,
)
from myowarp.tasks.euler_angles import same_rotation
from myowarp.tasks.markers import add_tip_targets
from myowarp.tasks.relocate_object import (
    BATCHED,
    OBJECT_POS,
    OBJECT_START,
    START,
    Parts,
    Places,
    add_parts,
    kind_draws,
    part_draws,
    shape_parts,
    three,
    weigh_parts,
)
from myowarp.tasks.relocate_scene import add_bin, add_table, keep_apart, put_bin
from myowarp.tasks.solids import Shapes, Weights

ARM_JOINTS = wp.constant(38)  # those of the object come after them
PALM_SITE = "S_grasp_r"
REACH = ((-1.2, 1.55), (-1.1, 1.2), (-1.1, 1.35))  # m, of its three slides
DAMPING = 0.001  # N s/m, N m s/rad, of its joints


@wp.func
def goal_position(xpos: wp.array[wp.vec3], target_body: int) -> wp.vec3:
    """Middle of the bin's ground."""
    return xpos[target_body]


@wp.func
def way_to_goal(position: wp.vec3, goal: wp.vec3) -> wp.vec3:
    """From the object to the bin."""
    return goal - position


@wp.func
def goal_distance(position: wp.vec3, goal: wp.vec3) -> float:
    """p = |bin - object|."""
    return wp.length(goal - position)


@wp.func
def palm_distance(site_xpos: wp.array[wp.vec3], palm_site: int, position: wp.vec3) -> float:
    """From the palm to the object."""
    return wp.length(site_xpos[palm_site] - position)


@wp.func
def object_angles(qpos: wp.array[float], object_dof: int) -> wp.vec3:
    """Euler angles of the object from its hinges."""
    r = object_dof + 3
    return same_rotation(wp.vec3(qpos[r], qpos[r + 1], qpos[r + 2]))


@wp.func
def is_out_of_reach(reach: float, far: float) -> bool:
    """Reach > far."""
    return reach > far


@wp.func
def is_in_bin(error: float, near: float, failed: bool) -> bool:
    """p < near, and the object is within reach."""
    return error < near and not failed


@wp.kernel(enable_backward=False)
def put_object(
    # Params:
    object_body: int,
    # In:
    object_place: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    body_pos: wp.array2d[wp.vec3],
):
    """The object's frame is where it was drawn."""
    worldid = wp.tid()
    if mask[worldid]:
        body_pos[worldid, object_body] = three(object_place, worldid, 0)


@wp.kernel(enable_backward=False)
def put_free_object(
    # In:
    object_place: wp.array2d[float],
    mask: wp.array[bool],
    # Data out:
    qpos_out: wp.array2d[float],
):
    """A free object is where that of version 0 would be with this frame."""
    worldid = wp.tid()
    if mask[worldid]:
        place = three(object_place, worldid, 0) + START
        for i in range(3):
            qpos_out[worldid, ARM_JOINTS + i] = place[i]


@wp.kernel(enable_backward=False)
def move_arm(
    # In:
    offset: wp.array2d[float],
    mask: wp.array[bool],
    # Data out:
    qpos_out: wp.array2d[float],
):
    """q += offset, of the arm's joints."""
    worldid = wp.tid()
    if mask[worldid]:
        for i in range(offset.shape[1]):
            qpos_out[worldid, i] += offset[worldid, i]


def arm_entries(model: mujoco.MjModel) -> tuple[Entry, ...]:
    """Return names and units of the arm's coordinates."""
    return tuple(coordinates(model)[: int(ARM_JOINTS)])


class RelocateProgram(Program):
    """A relocate task bound to a scene.

    Attributes:
        goal_place: Where the bin is [m], world, shape (num_worlds, 3).
        goal_angles: Its Euler angles [rad], shape (num_worlds, 3).
        parts: What is drawn of the object's parts, where it varies.
    """

    spec: RelocateTask
    goal_place: wp.array
    goal_angles: wp.array

    def __init__(self, spec: RelocateTask, scene: Scene) -> None:
        """Resolve object, bin and palm."""
        super().__init__(spec, scene)
        oracle = scene.oracle
        self.object_body, self.target_body = oracle.body("Object").id, oracle.body("target").id
        self.object_geom, self.object_dof = oracle.body("Object").geomadr[0], int(ARM_JOINTS)
        self.palm_site = scene.site_id(PALM_SITE)
        self.least_inertia = 0.0 if spec.free else INERTIA_FLOOR
        if spec.varied:
            self.parts = filled(Parts, self)
            self.place_low, self.place_high = wp.vec3(*spec.goal_low), wp.vec3(*spec.goal_high)
            self.shapes, self.places, self.weights = (
                filled(kind, scene.model) for kind in (Shapes, Places, Weights)
            )

    def sample_start(self, mask: wp.array) -> None:
        """Draw the object and its place; and the arm's posture, where the task's own start is asked for."""
        super().sample_start(mask)
        if not self.spec.varied:
            return
        if self.spec.free:
            self.launch(put_free_object, mask=mask)
        else:
            self.launch(put_object, mask=mask)
        self.shape(mask)
        if self.scene.reset == "task":
            self.launch(move_arm, mask=mask)

    def shape(self, mask: wp.array) -> None:
        """Write into the model what follows from the drawn parts in the worlds of `mask`."""
        self.launch(shape_parts, mask=mask)
        self.launch(weigh_parts, mask=mask)

    def sample_goal(self, mask: wp.array) -> None:
        super().sample_goal(mask)
        if self.spec.varied:
            self.launch(keep_apart, mask=mask)
        self.launch(put_bin, mask=mask)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return the target of the object."""
        return {"object_o_target": self.goal_place.numpy()[world]}


@dataclass(frozen=True, kw_only=True)
class RelocateTask(TaskSpec):
    """Carry an object into a bin.

    Attributes:
        goal_low: Lower bounds of the bin's place [m], world.
        goal_high: Upper bounds.
        angle: Largest Euler angle of the bin [rad].
        offset: Largest change of each coordinate of the arm's start [rad].
        object_low: Lower bounds of the place of the object's frame [m]; () where objects do not vary.
        object_high: Upper bounds.
        size: Bounds of the sizes of the object's parts [m].
        mass: Bounds of its mass [kg].
        friction: Bounds of its coefficients of friction (slide, spin, roll).
        free: Whether the object has a free joint, its true inertia and the friction that was drawn, and its
            turn against the bin is the angle between two orientations. Without, as in MyoSuite, it has three
            slides and three hinges, the inertia floor, and the differences of Euler angles.
    """

    program: ClassVar[type] = RelocateProgram
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained for carrying.",
        "myoChallengeRelocateP1-v0",
        "random",
        40,
        3,
    )
    near: ClassVar[float] = 0.1  # m, distance from the bin's middle below which the task counts as solved
    far: ClassVar[float] = 0.5  # m, distance of the palm from the object beyond which it is lost
    least_contacts: ClassVar[int] = 48  # three parts in a corner, four with each side, and a hand around them
    sites = (PALM_SITE,)
    loose = ("Object",)
    start_doc = "the arm bent over the table, the object in the air just above it"

    body: str = "whole_arm"
    num_substeps: int = 5
    horizon: int = 150
    goal_low: tuple[float, float, float]
    goal_high: tuple[float, float, float]
    angle: float = 0.0
    offset: float = 0.0
    object_low: tuple[float, ...] = ()
    object_high: tuple[float, ...] = ()
    size: tuple[float, float] = (0.0, 0.0)
    mass: tuple[float, float] = (0.0, 0.0)
    friction: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    free: bool = False

    @property
    def measures(self) -> dict[str, wp.Function]:  # type: ignore[override]
        """Positions, angles and errors of the object."""
        return {
            "position": die_position,
            "goal": goal_position,
            "angles": free_angles if self.free else object_angles,
            "wanted": wanted_angles,
            "rotation": rotation_error if self.free else angles_error,
            "rotation_distance": rotation_size,
            "error": goal_distance,
            "reach": palm_distance,
            "failed": is_out_of_reach,
            "solved": is_in_bin,
        }

    @property
    def varied(self) -> bool:
        """Whether objects differ."""
        return bool(self.object_low)

    @property
    def scene_key(self) -> tuple[object, ...]:
        """Geoms of every kind are compiled in where objects differ, and the object's joints."""
        return (*super().scene_key, self.varied, self.free)

    @property
    def batched(self) -> tuple[str, ...]:
        """Fields that follow from the object's parts and place."""
        return (*BATCHED, *(() if self.free else ("body_pos",))) if self.varied else ()

    @property
    def solved_when(self) -> str:
        return f"the object is less than {self.near:g} m from the middle of the bin's ground, within reach"

    @property
    def failed_when(self) -> str:
        return f"the palm is more than {self.far:g} m from the object"

    @property
    def draws(self) -> tuple[Draw, ...]:
        turn = "by what the bin is turned about x, then about its own y and z"
        angle = 3 * (self.angle,)
        goal = (
            Draw("goal", "m", self.goal_low, self.goal_high, "place of the bin", XYZ, array="goal_place"),
            Draw("turn", "rad", tuple(-a for a in angle), angle, turn, XYZ, array="goal_angles"),
        )
        if not self.varied:
            return goal
        offset = int(ARM_JOINTS) * (self.offset,)
        place, added = "place of the object's frame, world", "added to each joint of the arm's start"
        bounds, minus = (self.object_low, self.object_high), tuple(-o for o in offset)
        return (
            *goal,
            *kind_draws(),
            Draw("object place", "m", *bounds, place, XYZ, "start", array="object_place"),
            *part_draws(self.size, self.friction, self.mass),
            Draw("offset", "rad", minus, offset, added, arm_entries, "start", array="offset"),
        )

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the arm over the table; a free object is where its joints would put it."""
        if not self.free:
            return super().start(model)
        place = np.add(OBJECT_POS, OBJECT_START[:3])
        return np.concatenate([self.start_pose[:ARM_JOINTS], place, (1.0, 0.0, 0.0, 0.0)])

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add table, object and bin, and the marker of where the object should be."""
        add_table(spec)
        held = add_object(spec, "Object", OBJECT_POS, floored=not self.free)
        add_object_joints(held, free=self.free, reach=REACH, damping=DAMPING)
        add_parts(held, self.varied, priority=int(self.free))
        held.add_site(name="object_o", size=(0.005, 0.005, 0.005))
        add_bin(spec)
        add_tip_targets(spec, ("object_o",))

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        turns = "Euler angles of the {}: about x, its own y, its own z"
        rotation = (
            "axis times angle of the rotation from the object to the bin, world"
            if self.free
            else "goal_rot minus obj_rot"
        )
        return (
            Column("hand_qpos", ARM_JOINTS, *COORDINATES),
            Column("hand_qvel", ARM_JOINTS, *VELOCITIES),
            Column("obj_pos", 3, "m", "position of the object's frame, world", XYZ, die_position),
            Column("goal_pos", 3, "m", "middle of the bin's ground, world", XYZ, goal_position),
            Column("pos_err", 3, "m", "from the object to the bin, world", XYZ, way_to_goal),
            Column("obj_rot", 3, "rad", turns.format("object"), TURN, self.measures["angles"]),
            Column("goal_rot", 3, "rad", turns.format("bin"), TURN, wanted_angles),
            Column("rot_err", 3, "rad", rotation, TURN, self.measures["rotation"]),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        distance = "minus the distance of the object from the middle of the bin's ground"
        return (
            RewardTerm("pos_dist", 100.0, "m", distance, minus_error),
            RewardTerm("rot_dist", 1.0, "rad", "minus the norm of rot_err", minus_rotation),
            RewardTerm("act_reg", 0.0, *EFFORT),
            RewardTerm("sparse", 0.0, "rad", "rot_dist plus 10 times pos_dist", minus_both),
        )
