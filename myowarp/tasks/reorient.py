"""Hand reorient: turn an object on the hand until its axis has a wanted direction, without dropping it.

    reward = -p + c - 5 |act| / n - 5 1[p > 0.075] + 10 (1[c > 0.9] + 5 1[c > 0.95]) 1[p < 0.075]

with p the distance of the object from its place on the hand [m] and c the cosine between its axis and the
wanted one; c > 0.95 is solved, p > 0.075 fails. That is the reward of pen twirl, on a hand whose fingers do
not touch each other, with an object of 1.2 kg that is a capsule, an ellipsoid, a cylinder or a box of a size
that each episode draws from a table; muscles are observed, too. Source: MyoSuite 3.0.0, family Reorient (Berg
et al. 2023, arXiv:2307.03716); the sizes are recorded from its wheel, Apache-2.0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, FREE_RATES, XYZ
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec
from myowarp.engine.stages.arrays import filled
from myowarp.kernels.reward import EFFORT, is_far, minus_error, minus_failed
from myowarp.kernels.world_function import Row
from myowarp.models.bodies.contact_hand import HAND_JOINTS, PALM_UP, add_object_joints
from myowarp.tasks.euler_angles import turned, wxyz
from myowarp.tasks.markers import add_tip_targets
from myowarp.tasks.pen_twirl import (
    ALIGNED,
    ALIGNED_BONUS,
    CLOSE,
    DROPPED,
    aligned_bonus,
    axis_error,
    both_aligned,
    free_rates,
    is_aligned,
    pen_axis,
    pen_cosine,
    pen_position,
    wanted_axis,
)
from myowarp.tasks.reorient_shapes import add_kinds, shape_drawn, shapes, weigh_shape
from myowarp.tasks.seen_muscles import MuscleProgram, of_muscles
from myowarp.tasks.solids import BATCHED_SHAPE, BATCHED_WEIGHT, Shapes, Weights

PLACE = (-0.248, -0.532, 1.445)  # m, world; on the palm
ON_PALM = wp.constant(wp.vec3(*PLACE))
START_POS = (-0.248, -0.532, 1.450)  # m, world
TILT = 1.27  # rad about world y: nearly lying
TARGET_POS = (-0.248, -0.54, 1.65)  # m, world; above the hand
TURNS = (-1.0, -0.8), (1.0, 1.2)  # rad, of the wanted axis about x, then about its own y
LENGTH_OF_AXIS = 0.045  # m
SLIDING, SPINNING = 3, 4  # dimensions of contacts


@wp.func
def from_place(position: wp.vec3) -> wp.vec3:
    """From the place on the palm to the object."""
    return position - ON_PALM


@wp.func
def place_distance(position: wp.vec3) -> float:
    """p = |object - place|."""
    return wp.length(position - ON_PALM)


@wp.func
def mujoco_force(tension: wp.array[float], i: int) -> float:
    """MuJoCo's force [N], minus the tension."""
    return -tension[i]


@wp.kernel(enable_backward=False)
def turn_target(
    # In:
    wanted_turn: wp.array2d[float],
    mask: wp.array[bool],
    # Data out:
    mocap_quat_out: wp.array2d[wp.quat],
):
    """The target has the wanted axis; components w, x, y, z."""
    worldid = wp.tid()
    if mask[worldid]:
        q = turned(wp.vec3(wanted_turn[worldid, 0], wanted_turn[worldid, 1], 0.0))
        mocap_quat_out[worldid, 0] = wxyz(q)


class ReorientProgram(MuscleProgram):
    """A reorient task bound to a scene.

    Attributes:
        row: Drawn row of the table of shapes, to be rounded down, shape (num_worlds, 1).
        wanted_turn: Angles of the wanted axis about x, then about its own y [rad], shape (num_worlds, 2).
    """

    spec: ReorientTask

    def __init__(self, spec: ReorientTask, scene: Scene) -> None:
        """Resolve object and target, load the shapes."""
        super().__init__(spec, scene)
        oracle = scene.oracle
        self.object_body, self.target_body = oracle.body("Object").id, oracle.body("target").id
        self.object_geom, self.target_geom = (oracle.body(name).geomadr[0] for name in ("Object", "target"))
        self.object_dof = int(HAND_JOINTS)
        self.table = wp.array(shapes(spec.table), dtype=float)
        self.shape_fields, self.weights = filled(Shapes, scene.model), filled(Weights, scene.model)

    def sample_start(self, mask: wp.array) -> None:
        """Draw the object's shape, and give it to it."""
        super().sample_start(mask)
        self.shape(mask)

    def shape(self, mask: wp.array) -> None:
        """Write into the model what follows from the drawn shape in the worlds of `mask`."""
        self.launch(shape_drawn, mask=mask)
        self.launch(weigh_shape, mask=mask)

    def sample_goal(self, mask: wp.array) -> None:
        super().sample_goal(mask)
        self.launch(turn_target, mask=mask)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return the target of the end of the object's axis."""
        wanted = self.scene.data.xmat.numpy()[world, self.target_body, :, 2]
        return {"object_top_target": np.array(PLACE) + LENGTH_OF_AXIS * wanted}


@dataclass(frozen=True, kw_only=True)
class ReorientTask(TaskSpec):
    """Turn an object on the hand.

    Attributes:
        table: Name of the table of shapes: "8", "100", "id" or "ood".
        condim: Dimensions of contacts with the object: 3 slide, 4 spin, too.
        free: Whether the object has a free joint. Without, as in MyoSuite, it has three slides and three
            hinges along its own axes.
    """

    program: ClassVar[type] = ReorientProgram
    title: ClassVar[str] = "Object reorient"
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained for these objects.",
        "myoHandReorient100-v0",
        "random",
        20,
        1,
    )
    measures: ClassVar = {
        "position": pen_position,
        "axis": pen_axis,
        "wanted": wanted_axis,
        "error": place_distance,
        "cosine": pen_cosine,
        "solved": is_aligned,
        "failed": is_far,
    }
    far: ClassVar[float] = float(DROPPED)
    coarse_step = CoarseStep(0.005, 0.5)
    least_contacts: ClassVar[int] = 20  # boxes had 11 in 10,000 random steps
    large = True  # objects of many kinds and parts touch the hand
    batched = (*BATCHED_SHAPE, *BATCHED_WEIGHT)
    carried = ("Object",)
    start_doc = "the open hand, palm up, with the object on it"
    solved_when = f"the cosine between axis and wanted axis exceeds {ALIGNED:g}, and the object is not lost"
    failed_when = f"the object is lost: it is more than {DROPPED:g} m from its place on the palm"

    body: str = "hand"
    num_substeps: int = 5
    horizon: int = 50
    table: str
    condim: int = SLIDING
    free: bool = False

    @property
    def scene_key(self) -> tuple[object, ...]:
        """The kind of contact and the object's joints are compiled in."""
        return (*super().scene_key, self.condim, self.free)

    @property
    def draws(self) -> tuple[Draw, ...]:
        turns = "by what the wanted axis is turned from upright: about x, then about its own y"
        row = "which shape of the table, rounded down"
        last = (float(len(shapes(self.table))),)
        return (
            Draw("shape row", "1", (0.0,), last, row, (), "start", array="row"),
            Draw("turn", "rad", *TURNS, turns, XYZ[:2], array="wanted_turn"),
        )

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the open hand, palm up, with the object on it."""
        qpos = super().start(model)
        qpos[0] = PALM_UP
        return qpos

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the object, the target above it, and the marker of where the object's end should be."""
        held = spec.worldbody.add_body(name="Object", pos=START_POS)
        held.quat = (np.cos(TILT / 2), 0.0, np.sin(TILT / 2), 0.0)
        add_object_joints(held, free=self.free)
        add_kinds(held, "object", self.condim, (0.25, 0.45, 0.8, 1.0))
        held.add_site(name="object_top", pos=(0.0, 0.0, LENGTH_OF_AXIS), size=(0.005, 0.005, 0.005))
        target = spec.worldbody.add_body(name="target", pos=TARGET_POS, mocap=True)
        target.quat = held.quat
        add_kinds(target, "target", SPINNING, (0.1, 0.68, 0.3, 1.0))
        add_tip_targets(spec, ("object_top",))

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        frame = "world" if self.free else "of three slides and three hinges along the object's own axes"
        meant = f"velocities of the object, {frame}, times the control step"
        rates = free_rates if self.free else Row("qvel", HAND_JOINTS, "control_dt")
        return (
            Column("hand_jnt", HAND_JOINTS, *COORDINATES),
            Column("obj_pos", 3, "m", "position of the object's center, world", XYZ, pen_position),
            Column("obj_vel", 6, "m, rad per control step", meant, FREE_RATES, rates),
            Column("obj_rot", 3, "1", "unit vector along the object's axis, world", XYZ, pen_axis),
            Column("obj_des_rot", 3, "1", "unit vector along the wanted axis, world", XYZ, wanted_axis),
            Column("obj_err_pos", 3, "m", "from the place on the palm to the object", XYZ, from_place),
            Column("obj_err_rot", 3, "1", "obj_rot minus obj_des_rot", XYZ, axis_error),
            Column(
                "mlen", num_muscles, "m", "length of each muscle", of_muscles("m"), Row("actuator_length")
            ),
            Column("mvel", num_muscles, "m/s", "its rate", of_muscles("m/s"), Row("actuator_velocity")),
            Column("mforce", num_muscles, "N", "its force, a pull < 0", of_muscles("N"), mujoco_force),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        distance = "minus the distance of the object from its place on the palm"
        bonus = (
            f"1 where the cosine exceeds {CLOSE:g}, {1 + ALIGNED_BONUS:g} beyond {ALIGNED:g};"
            " 0 where the object is lost"
        )
        return (
            RewardTerm("pos_align", 1.0, "m", distance, minus_error),
            RewardTerm("rot_align", 1.0, "1", "cosine between axis and wanted axis", pen_cosine),
            RewardTerm("act_reg", 5.0, *EFFORT),
            RewardTerm("drop", 5.0, "1", "-1 where the object is lost", minus_failed),
            RewardTerm("bonus", 10.0, "1", bonus, aligned_bonus),
            RewardTerm("sparse", 0.0, "1", "rot_align plus pos_align", both_aligned),
        )
