"""Die reorient: turn a die that lies on the open hand to a wanted orientation, near a wanted place.

    reward = -100 p - r

with p the distance of the die from where it should be [m] and r the size of the error of its orientation
[rad]; p < 0.025 and r < 0.262 is solved, p > 0.2 fails. In MyoSuite's version r is the norm of the difference
of the Euler angles about x, y and z, which is not the angle between two orientations. Source: MyoSuite
3.0.0, family DieReorient of the MyoChallenge 2022.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import CoarseStep
from myowarp.definitions.entries import ACTIVATION, COORDINATES, TURN, VELOCITIES, XYZ
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, Draw, RewardTerm, Shown, TaskSpec
from myowarp.kernels.reward import EFFORT, is_far, minus_error, minus_failed, near_bonus
from myowarp.models.bodies.contact_hand import (
    HAND_JOINTS,
    INERTIA_FLOOR,
    PALM_UP,
    SOFT,
    add_object,
    add_object_joints,
)
from myowarp.tasks.die import (
    BATCHED_MASS,
    BATCHED_SHAPE,
    FRICTION,
    MASS,
    PARTS,
    add_die,
    shape_die,
    weigh_die,
)
from myowarp.tasks.euler_angles import euler_angles, same_rotation, turned, wxyz
from myowarp.tasks.markers import add_tip_targets

DIE_POS = (-0.24, -0.535, 1.46)  # m, world; on the palm
BESIDE = (-0.1, 0.0, 0.0)  # m, from where the die should be to where the wanted one is shown
SHOWN = wp.constant(wp.vec3(*BESIDE))
START = wp.constant(wp.vec3(*DIE_POS))
REACH = (-0.25, 0.25)  # m, of the die's three slides
DAMPING = 0.001  # N s/m, N m s/rad, of the die's joints
SPARSE = wp.constant(10.0)  # rad/m


@wp.func
def die_position(xpos: wp.array[wp.vec3], object_body: int) -> wp.vec3:
    """Centre of the die."""
    return xpos[object_body]


@wp.func
def shown_position(xpos: wp.array[wp.vec3], target_body: int) -> wp.vec3:
    """Centre of the wanted die."""
    return xpos[target_body]


@wp.func
def place_error(position: wp.vec3, shown: wp.vec3) -> wp.vec3:
    """Wanted - die, the wanted one moved to the hand."""
    return shown - position - SHOWN


@wp.func
def place_distance(position: wp.vec3, shown: wp.vec3) -> float:
    """p = |error of the place|."""
    return wp.length(place_error(position, shown))


@wp.func
def hinge_angles(qpos: wp.array[float]) -> wp.vec3:
    """Euler angles of a die on three hinges, exact where its matrix, in float32, is too coarse for them."""
    r = HAND_JOINTS + 3
    return same_rotation(wp.vec3(qpos[r], qpos[r + 1], qpos[r + 2]))


@wp.func
def free_angles(xmat: wp.array[wp.mat33], object_body: int) -> wp.vec3:
    """Euler angles of a free die."""
    return euler_angles(xmat[object_body])


@wp.func
def wanted_angles(goal_angles: wp.array[float]) -> wp.vec3:
    """Euler angles of the wanted die."""
    return same_rotation(wp.vec3(goal_angles[0], goal_angles[1], goal_angles[2]))


@wp.func
def angles_error(angles: wp.vec3, wanted: wp.vec3) -> wp.vec3:
    """Wanted - die."""
    return wanted - angles


@wp.func
def rotation_error(xmat: wp.array[wp.mat33], object_body: int, target_body: int) -> wp.vec3:
    """Axis times angle, 0 to pi, of the rotation in the world that turns the die to the wanted one."""
    turn = wp.quat_from_matrix(xmat[target_body] @ wp.transpose(xmat[object_body]))
    if turn[3] < 0.0:
        turn = -turn
    vector = wp.vec3(turn[0], turn[1], turn[2])
    half = wp.length(vector)
    if half == 0.0:
        return vector
    return 2.0 * wp.atan2(half, turn[3]) / half * vector


@wp.func
def rotation_size(rotation: wp.vec3) -> float:
    """r = |error of the orientation|."""
    return wp.length(rotation)


@wp.func
def minus_rotation(rotation_distance: float) -> float:
    """-r."""
    return -rotation_distance


@wp.func
def minus_both(error: float, rotation_distance: float) -> float:
    """-r - 10 p."""
    return -rotation_distance - SPARSE * error


@wp.func
def is_turned(error: float, rotation_distance: float, near: float, aligned: float, far: float) -> bool:
    """p < near, r < aligned, and p <= far."""
    return error < near and rotation_distance < aligned and error <= far


@wp.kernel(enable_backward=False)
def show_wanted(
    # In:
    goal_offset: wp.array2d[float],
    goal_angles: wp.array2d[float],
    mask: wp.array[bool],
    # Data out:
    mocap_pos_out: wp.array2d[wp.vec3],
    mocap_quat_out: wp.array2d[wp.quat],
):
    """Put the wanted die beside the hand, where and as the episode asks; components w, x, y, z."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    by = wp.vec3(goal_offset[worldid, 0], goal_offset[worldid, 1], goal_offset[worldid, 2])
    q = turned(wp.vec3(goal_angles[worldid, 0], goal_angles[worldid, 1], goal_angles[worldid, 2]))
    mocap_pos_out[worldid, 0] = START + SHOWN + by
    mocap_quat_out[worldid, 0] = wxyz(q)


def _minus(bounds: tuple[float, ...]) -> tuple[float, ...]:
    """Return lower bounds from upper ones."""
    return tuple(-bound for bound in bounds)


class DieReorientProgram(Program):
    """A die task bound to a scene.

    Attributes:
        goal_offset: From where the die starts to where it should be [m], world, shape (num_worlds, 3).
        goal_angles: Wanted Euler angles [rad], shape (num_worlds, 3).
        die_mass: Mass [kg], shape (num_worlds, 1).
        die_growth: What half sizes and distances of the die's parts have more than nominal ones [m], shape
            (num_worlds, 1).
        die_friction: Coefficients of the parts (slide, spin, roll), shape (num_worlds, 45).
    """

    spec: DieReorientTask
    goal_offset: wp.array
    goal_angles: wp.array

    def __init__(self, spec: DieReorientTask, scene: Scene) -> None:
        """Resolve both dice."""
        super().__init__(spec, scene)
        oracle = scene.oracle
        self.object_body, self.target_body = oracle.body("Object").id, oracle.body("target").id
        self.die_geom, self.die_dof = oracle.body("Object").geomadr[0], int(HAND_JOINTS)
        self.least_inertia = 0.0 if spec.free else INERTIA_FLOOR

    def sample_start(self, mask: wp.array) -> None:
        """Draw the die's properties, and give them to it where they vary."""
        super().sample_start(mask)
        if self.spec.varied:
            self.shape(mask)

    def shape(self, mask: wp.array) -> None:
        """Write into the model what follows from mass, size and friction in the worlds of `mask`."""
        self.launch(shape_die, mask=mask)
        self.launch(weigh_die, mask=mask)

    def sample_goal(self, mask: wp.array) -> None:
        super().sample_goal(mask)
        self.launch(show_wanted, mask=mask)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return the target of the die's centre."""
        return {"object_o_target": np.array(DIE_POS) + self.goal_offset.numpy()[world]}


@dataclass(frozen=True, kw_only=True)
class DieReorientTask(TaskSpec):
    """Turn the die.

    Attributes:
        offset: Largest distance of the wanted place from the start along each axis [m].
        angle: Largest wanted Euler angle [rad].
        near: Error of the place below which the task counts as solved [m].
        growth: Largest change of the die's half sizes [m].
        mass: Bounds of its mass [kg].
        friction: Largest change of its coefficients of friction (slide, spin, roll).
        free: Whether the die has a free joint, its true inertia and the friction that was drawn, and its
            orientation is judged by the angle between two orientations. Without, as in MyoSuite, it has three
            slides and three hinges, the inertia floor, and the differences of Euler angles.
    """

    program: ClassVar[type] = DieReorientProgram
    shown: ClassVar[Shown | None] = Shown(
        "Random actions: no policy has been trained for the die.",
        "myoChallengeDieReorientP1-v1",
        "random",
        30,
        2,
    )
    aligned: ClassVar[float] = 0.262  # rad, error of the orientation below which the task counts as solved
    wider: ClassVar[float] = 2.0  # times `near`: where the first bonus begins
    far: ClassVar[float] = 0.2  # m, error beyond which the die is lost
    coarse_step = CoarseStep(0.005, 0.5)
    least_contacts: ClassVar[int] = (
        75  # 51 were the most in 256 worlds and 150 random steps, dice of all sizes
    )
    large = True  # objects of many kinds and parts touch the hand
    carried = ("Object",)
    start_doc = "the open hand, palm up, with the die on it"

    body: str = "contact_hand"
    num_substeps: int = 5
    horizon: int = 150
    offset: float
    angle: float
    near: float = 0.025
    growth: float = 0.0
    mass: tuple[float, float] = (MASS, MASS)
    friction: tuple[float, float, float] = (0.0, 0.0, 0.0)
    free: bool = False

    @property
    def measures(self) -> dict[str, wp.Function]:  # type: ignore[override]
        """Positions, angles and errors of the die."""
        return {
            "position": die_position,
            "shown": shown_position,
            "angles": free_angles if self.free else hinge_angles,
            "wanted": wanted_angles,
            "rotation": rotation_error if self.free else angles_error,
            "error": place_distance,
            "rotation_distance": rotation_size,
            "solved": is_turned,
            "failed": is_far,
        }

    @property
    def varied(self) -> bool:
        """Whether dice differ."""
        return any((self.growth, self.mass[0] != self.mass[1], *self.friction))

    @property
    def scene_key(self) -> tuple[object, ...]:
        """The die's joints are compiled in."""
        return (*super().scene_key, self.free)

    @property
    def batched(self) -> tuple[str, ...]:
        """Fields that follow from the die's size, mass and friction."""
        return (*BATCHED_SHAPE, *BATCHED_MASS) if self.varied else ()

    @property
    def solved_when(self) -> str:
        near = (
            "" if math.isinf(self.near) else f" and it is less than {self.near:g} m from where it should be"
        )
        return f"the error of the die's orientation is below {self.aligned:g} rad{near}"

    @property
    def failed_when(self) -> str:
        return f"the die is more than {self.far:g} m from where it should be"

    @property
    def draws(self) -> tuple[Draw, ...]:
        place = "from where the die starts to where it should be, world"
        turn = "by what the wanted die is turned about x, then about its own y and z"
        size = "what half sizes and distances of its parts have more than nominal ones"
        friction = "coefficients of its parts, twelve edges and three boxes"
        names = tuple(f"part {i} {kind}" for i in range(PARTS) for kind in ("slide", "spin", "roll"))
        far, wide, growth = 3 * (self.offset,), 3 * (self.angle,), (self.growth,)
        pairs = list(zip(FRICTION, self.friction, strict=True))
        rough = PARTS * tuple(middle - most for middle, most in pairs)
        rougher = PARTS * tuple(middle + most for middle, most in pairs)
        return (
            Draw("goal", "m", _minus(far), far, place, XYZ, array="goal_offset"),
            Draw("turn", "rad", _minus(wide), wide, turn, XYZ, array="goal_angles"),
            Draw(
                "die mass",
                "kg",
                self.mass[:1],
                self.mass[1:],
                "mass of the die",
                (),
                "start",
                array="die_mass",
            ),
            Draw("die growth", "m", _minus(growth), growth, size, (), "start", array="die_growth"),
            Draw("die friction", "1", rough, rougher, friction, names, "start", array="die_friction"),
        )

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the open hand, palm up, with the die on it."""
        qpos = super().start(model)
        qpos[0] = PALM_UP
        return qpos

    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add the die, the wanted die beside the hand, and the marker of where the die should be."""
        die = add_object(spec, "Object", DIE_POS, floored=not self.free)
        for part in add_die(die, "die", (0.25, 0.45, 0.8, 1.0)):
            if self.free:
                part.priority, part.solimp = 1, 0.5 * (part.solimp + np.array(SOFT))
        die.add_site(name="object_o", size=(0.005, 0.005, 0.005))
        add_object_joints(die, free=self.free, reach=3 * (REACH,), damping=DAMPING)
        # The engine never moves a static geom; a mocap body is as immovable, and placed for each world.
        wanted = add_object(spec, "target", tuple(np.add(DIE_POS, BESIDE)), mocap=True)
        for part in add_die(wanted, "wanted", (0.1, 0.68, 0.3, 1.0)):
            part.contype = part.conaffinity = 0
        add_tip_targets(spec, ("object_o",))

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        turns = "Euler angles of the {}: about x, its own y, its own z"
        rotation = (
            "axis times angle of the rotation from the die to the wanted one, world"
            if self.free
            else "goal_rot minus obj_rot"
        )
        return (
            Column("hand_qpos_noMD5", HAND_JOINTS - 1, *COORDINATES),
            Column("hand_qvel", HAND_JOINTS, *VELOCITIES),
            Column("obj_pos", 3, "m", "position of the die's centre, world", XYZ, die_position),
            Column("goal_pos", 3, "m", "position of the wanted die, beside the hand", XYZ, shown_position),
            Column("pos_err", 3, "m", "from the die to where it should be, world", XYZ, place_error),
            Column("obj_rot", 3, "rad", turns.format("die"), TURN, self.measures["angles"]),
            Column("goal_rot", 3, "rad", turns.format("wanted die"), TURN, wanted_angles),
            Column("rot_err", 3, "rad", rotation, TURN, self.measures["rotation"]),
            Column("act", num_muscles, *ACTIVATION),
        )

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        distance = "minus the distance of the die from where it should be"
        bonus = f"1 where the distance is below {self.wider * self.near:g} m, 2 below {self.near:g} m"
        return (
            RewardTerm("pos_dist", 100.0, "m", distance, minus_error),
            RewardTerm("rot_dist", 1.0, "rad", "minus the size of rot_err", minus_rotation),
            RewardTerm("bonus", 0.0, "1", bonus, near_bonus),
            RewardTerm("act_reg", 0.0, *EFFORT),
            RewardTerm("penalty", 0.0, "1", "-1 where the die is lost", minus_failed),
            RewardTerm("sparse", 0.0, "rad", f"rot_dist plus {SPARSE:g} times pos_dist", minus_both),
        )
