"""Hand reorient: turn an object on the hand until its axis has a wanted direction, without dropping it.

    reward = -p + c - 5 |act| / n - 5 1[p > 0.075] + 10 (1[c > 0.9] + 5 1[c > 0.95]) 1[p < 0.075]

with p the distance of the object from its place on the hand [m] and c the cosine between its axis and the
wanted one; c > 0.95 is solved, p > 0.075 fails. That is the reward of pen twirl, on a hand whose fingers do
not touch each other, with an object of 1.2 kg that is a capsule, an ellipsoid, a cylinder or a box of a size
that each episode draws from a table; muscles are observed, too. Source: MyoSuite 3.0.0, family Reorient (Berg
et al. 2023, arXiv:2307.03716); the sizes are recorded from its wheel, Apache-2.0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, FREE_RATES, XYZ
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, TaskSpec, task
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
from myowarp.tasks.seen_muscles import MuscleProgram, of_muscles
from myowarp.tasks.solids import (
    BATCHED_SHAPE,
    BATCHED_WEIGHT,
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    TINY,
    Shapes,
    Weights,
    gyration,
    hide,
    shifted_inertia,
    volume,
    write_shape,
    write_weight,
)

TABLES = Path(__file__).with_name("reorient_shapes.npz")
KINDS = tuple(int(kind) for kind in (CAPSULE, ELLIPSOID, CYLINDER, BOX))  # in this order
NUM_KINDS = wp.constant(len(KINDS))
PLACE = (-0.248, -0.532, 1.445)  # m, world; on the palm
ON_PALM = wp.constant(wp.vec3(*PLACE))
START_POS = (-0.248, -0.532, 1.450)  # m, world
TILT = 1.27  # rad about world y: nearly lying
TARGET_POS = (-0.248, -0.54, 1.65)  # m, world; above the hand
MASS = wp.constant(1.2)  # kg
DENSITY, CAP_DENSITY = wp.constant(1500.0), wp.constant(1000.0)  # kg/m^3, before the mass is set
CAP = wp.constant(wp.vec3(0.013, 0.002, 0.0))  # m: two discs at the ends of the axis, which weigh only
CAPSULE_CAP = wp.constant(1.3)  # half lengths from a capsule's center to its discs
NO_LEAST = wp.constant(0.0)
NOMINAL = (0.015, 0.015, 0.045)  # m, semi-axes of the ellipsoid that is compiled in
TURNS = (-1.0, -0.8), (1.0, 1.2)  # rad, of the wanted axis about x, then about its own y
LENGTH_OF_AXIS = 0.045  # m
SLIDING, SPINNING = 3, 4  # dimensions of contacts


@cache
def shapes(table: str) -> np.ndarray:
    """Return a table of shapes: kind, a number of `mujoco.mjtGeom`, and sizes [m], shape (n, 4)."""
    with np.load(TABLES) as tables:
        return tables[table]


def add_kinds(body: mujoco.MjsBody, name: str, condim: int, rgba: tuple[float, ...]) -> None:
    """Add a geom of every kind, of which the ellipsoid is there until a shape is drawn."""
    for kind in KINDS:
        geom = body.add_geom(name=f"{name}_{kind}", type=mujoco.mjtGeom(kind), rgba=rgba)
        geom.size = NOMINAL if kind == int(ELLIPSOID) else 3 * (TINY,)
        geom.contype, geom.conaffinity, geom.condim = 1, 1, condim
        geom.density = float(DENSITY)


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


@wp.func
def kind_in(table: wp.array2d[float], row: int) -> int:
    """Kind of a shape."""
    return int(table[row, 0])


@wp.func
def size_in(table: wp.array2d[float], row: int) -> wp.vec3:
    """Sizes of a shape [m]."""
    return wp.vec3(table[row, 1], table[row, 2], table[row, 3])


@wp.func
def drawn_row(table: wp.array2d[float], row: wp.array2d[float], worldid: int) -> int:
    """The drawn number, rounded down."""
    return wp.min(int(row[worldid, 0]), table.shape[0] - 1)


@wp.func
def cap_height(kind: int, size: wp.vec3) -> float:
    """From the center to the discs [m]."""
    if kind == CAPSULE:
        return CAPSULE_CAP * size[1]
    if kind == CYLINDER:
        return size[1]
    return size[2]


@wp.kernel(enable_backward=False)
def shape_drawn(
    # Params:
    object_geom: int,
    target_geom: int,
    table: wp.array2d[float],
    # In:
    row: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    shape_fields: Shapes,
):
    """Of object and target the geom of the drawn kind is there, in the drawn size."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    drawn = drawn_row(table, row, worldid)
    for i in range(NUM_KINDS):
        if CAPSULE + i == kind_in(table, drawn):
            write_shape(shape_fields, worldid, object_geom + i, CAPSULE + i, size_in(table, drawn))
            write_shape(shape_fields, worldid, target_geom + i, CAPSULE + i, size_in(table, drawn))
        else:
            hide(shape_fields, worldid, object_geom + i)
            hide(shape_fields, worldid, target_geom + i)


@wp.kernel(enable_backward=False)
def weigh_shape(
    # Params:
    object_body: int,
    object_dof: int,
    free: bool,
    table: wp.array2d[float],
    # In:
    row: wp.array2d[float],
    mask: wp.array[bool],
    # Out:
    weights: Weights,
):
    """m = 1.2 kg, of a solid of 1500 kg/m^3 and two discs of 1000 kg/m^3 in proportion."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    drawn = drawn_row(table, row, worldid)
    kind, size = kind_in(table, drawn), size_in(table, drawn)
    solid, cap = DENSITY * volume(kind, size), CAP_DENSITY * volume(CYLINDER, CAP)
    scale = MASS / (solid + 2.0 * cap)
    inertia = wp.diag(scale * (solid * gyration(kind, size) + 2.0 * cap * gyration(CYLINDER, CAP)))
    inertia += shifted_inertia(2.0 * scale * cap, wp.vec3(0.0, 0.0, cap_height(kind, size)))
    write_weight(
        weights,
        worldid,
        object_body,
        object_dof,
        MASS,
        wp.vec3(0.0, 0.0, 0.0),
        inertia,
        NO_LEAST,
        free,
    )


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
        """Where the end of the object's axis should be."""
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
    def batched(self) -> tuple[str, ...]:
        """What follows from the object's shape."""
        return (*BATCHED_SHAPE, *BATCHED_WEIGHT)

    @property
    def carried(self) -> tuple[str, ...]:
        """The object."""
        return ("Object",)

    @property
    def start_doc(self) -> str:
        return "the open hand, palm up, with the object on it"

    @property
    def solved_when(self) -> str:
        return f"the cosine between axis and wanted axis exceeds {ALIGNED:g}, and the object is not lost"

    @property
    def failed_when(self) -> str:
        return f"the object is lost: it is more than {DROPPED:g} m from its place on the palm"

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


@task("myoHandReorient8-v0")
def reorient_8() -> ReorientTask:
    """Turn one of eight objects on the hand to a direction drawn anew each episode."""
    return ReorientTask(table="8", condim=SPINNING)


@task("myoHandReorient100-v0")
def reorient_100() -> ReorientTask:
    """Turn one of a hundred objects on the hand to a direction drawn anew each episode."""
    return ReorientTask(table="100")


@task("myoHandReorientID-v0")
def reorient_in_distribution() -> ReorientTask:
    """Turn one of a thousand objects like those of the hundred on the hand to a random direction."""
    return ReorientTask(table="id")


@task("myoHandReorientOOD-v0")
def reorient_out_of_distribution() -> ReorientTask:
    """Turn one of a thousand objects unlike those of the hundred on the hand to a random direction."""
    return ReorientTask(table="ood")


FREE = (
    "The object has a free joint; in v0, as in MyoSuite 3.0.0, it loses a direction of rotation where the"
    " second of its three hinges is at a right angle, its rates are about turned axes, and a few of ten"
    " thousand random steps have no finite result."
)


@task("myoHandReorient8-v1", FREE)
def free_8() -> ReorientTask:
    """Turn one of eight objects on the hand to a direction drawn anew each episode."""
    return replace(reorient_8(), free=True)


@task("myoHandReorient100-v1", FREE)
def free_100() -> ReorientTask:
    """Turn one of a hundred objects on the hand to a direction drawn anew each episode."""
    return replace(reorient_100(), free=True)


@task("myoHandReorientID-v1", FREE)
def free_in_distribution() -> ReorientTask:
    """Turn one of a thousand objects like those of the hundred on the hand to a random direction."""
    return replace(reorient_in_distribution(), free=True)


@task("myoHandReorientOOD-v1", FREE)
def free_out_of_distribution() -> ReorientTask:
    """Turn one of a thousand objects unlike those of the hundred on the hand to a random direction."""
    return replace(reorient_out_of_distribution(), free=True)
