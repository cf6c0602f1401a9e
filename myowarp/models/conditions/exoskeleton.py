"""Exoskeleton of the elbow: an ideal torque that follows the muscles, or a motor of its own.

    torque = assistance sum_m r_m F_m

in every physics step, with moment arm r_m and tendon force F_m of the muscles: the share `assistance` of
their whole torque at the joint, active and passive, signed like it. Source: Caggiano et al. (2022),
arXiv:2205.13600, where policies of muscles and exoskeleton are trained together and its parts weigh 0.101 kg
on the upper arm and 0.111 kg on the forearm. The upper arm of this body is fixed to the world, so only the
latter counts; its shape is MyoSuite 3.0.0's, whose own exoskeleton tasks (`myoElbowPose1D6MExo...`) have
the motor but no mass.

With `motor` the policy commands the torque itself: one more action, the last, times `max_torque`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import mujoco
import warp as wp

from myowarp.definitions.body import Brace, fact_for
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.muscle import BiasParams
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.definitions.task import RewardTerm
from myowarp.kernels.launch import launch
from myowarp.kernels.reset import masked_fill
from myowarp.kernels.write import is_finite
from myowarp.models.conditions.added_mass import BATCHED, AddedMass, HungMass, Part

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec

NAME = "exoskeleton"  # of the actuator
EXO_EFFORT = ("1", "minus the square of the motor's torque over its largest")

_CYLINDER, _BOX = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
CUFF = "exo_forearm"  # name of its body in the model
PARTS = (
    Part(_CYLINDER, (0.03, 0.03, 0.0), 0.1, (0.0, -0.12, 0.035), tilt=1.3),
    Part(_BOX, (0.01, 0.004, 0.06), 0.01, (0.0, -0.05, 0.06), tilt=1.3),
    Part(_CYLINDER, (0.02, 0.01, 0.0), 0.001, (0.0, 0.0, 0.05)),
)
"""Cuff, bar and hinge on the forearm; source: myo-sim 0.2.3, `myoelbow_exo`."""


@dataclass(frozen=True, eq=False)
class Exoskeleton(Condition):
    """A powered elbow brace.

    Attributes:
        assistance: Torque as a share of the muscles' torque [1], >= 0; not used with a motor.
        motor: Whether the policy commands the torque instead.
        forearm_mass: Mass of the part on the forearm [kg], 0 to 100.
        max_torque: Torque of the motor at action 1 [N m].
        effort_weight: Weight of the motor's reward term `exo_effort`, -(torque / max_torque)^2.
    """

    PHASE = Phase.BODY
    WRITES = ("the torque of the exoskeleton",)
    NEUTRAL: ClassVar = {"assistance": 0.0, "forearm_mass": 0.0}
    TITLE = "exoskeleton at the elbow"
    LABELS: ClassVar = {"assistance": "share of muscles"}
    batched = BATCHED  # the muscles have their bias per world already

    assistance: Value = 0.5
    motor: bool = False
    forearm_mass: Value = 0.111
    max_torque: float = 8.5
    effort_weight: float = 0.0

    def __post_init__(self) -> None:
        """Check what is one number for all worlds."""
        for name, number in (("max_torque", self.max_torque), ("effort_weight", self.effort_weight)):
            if not (isinstance(number, (int, float)) and number >= 0.0 and is_finite(number)):
                raise ValueError(f"exoskeleton {name} must be a finite number >= 0, got {number!r}")
        if self.effort_weight and not self.motor:
            raise ValueError("exoskeleton effort_weight is for a motor; give motor=True or leave it out")

    @property
    def scene_key(self) -> tuple[object, ...]:
        """The actuator: none is like another."""
        return (NAME, self.motor, self.max_torque if self.motor else None)

    @property
    def undriven(self) -> tuple[str, ...]:
        """The actuator, where it follows the muscles."""
        return () if self.motor else (NAME,)

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body names no place for it."""
        worn_by(spec.body)

    def edit(self, spec: mujoco.MjSpec, body: str) -> None:
        """Add the cuff, and an actuator that is idle until it is commanded."""
        cuff, joint = worn_by(body)
        cuff.edit(spec)
        actuator = spec.add_actuator(name=NAME, target=joint)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm = [self.max_torque if self.motor else 0.0] + 9 * [0.0]
        actuator.biasprm = 10 * [0.0]
        actuator.ctrllimited, actuator.ctrlrange = True, (-1.0, 1.0)

    def bind(self, scene: Scene, clock: Clock) -> ExoskeletonEffect:
        """Put assistance and mass on the device."""
        cuff = worn_by(scene.spec.body)[0].bind(scene, clock, "exoskeleton forearm_mass", self.forearm_mass)
        if self.motor:
            return MotorEffect(scene, cuff, self)
        if scene.oracle.nv > 1:
            raise ValueError(
                f"an exoskeleton that follows muscles needs a body with one joint; {scene.spec.body!r} has "
                f"{scene.oracle.nv} degrees of freedom; give motor=True"
            )
        whole = "the muscles' torque"
        assistance = Parameter(
            "exoskeleton assistance", self.assistance, scene, (), neutral=0.0, low=0.0, whole=whole
        )
        return AssistEffect(scene, cuff, clock, assistance)


def worn_by(body: str) -> tuple[AddedMass, str]:
    """Return the part on the forearm of a body, and the joint that turns; ValueError if there is none."""
    brace: Brace = fact_for("wear an exoskeleton", body, "exoskeleton")
    return AddedMass(CUFF, brace.limb, (0.0, 0.0, 0.0), PARTS), brace.joint


class ExoskeletonEffect(Effect):
    """An exoskeleton in a scene: its mass, and the torque that it shows.

    Attributes:
        torque: Last torque [N m], flexion is positive, shape (num_worlds,).
    """

    def __init__(self, scene: Scene, cuff: HungMass) -> None:
        self.scene, self.cuff, self.drawn = scene, cuff, (cuff.mass,)
        self.exo = scene.oracle.actuator(NAME).id
        self.torque = scene.zeros("condition.exoskeleton.torque")
        self.info = {"exo_torque": self.torque}
        self.info_units = {"exo_torque": "N m"}

    def reset(self, mask: wp.array) -> None:
        """Show no torque."""
        masked_fill(mask, self.torque, 0.0)

    def act(self) -> None:
        """Hang the cuffs on the forearms."""
        self.cuff.launch()


@wp.kernel(enable_backward=False)
def assist(
    # Params:
    exo: int,
    muscle_actuators: wp.array[int],
    curve: Curve,
    # Data in:
    moment_rownnz_in: wp.array2d[int],
    moment_rowadr_in: wp.array2d[int],
    actuator_moment_in: wp.array2d[float],
    actuator_velocity_in: wp.array2d[float],
    # In:
    tension: wp.array2d[float],
    damping: wp.array2d[float],
    clock: Clock,
    # Out:
    torque: wp.array[float],
    actuator_biasprm: wp.array2d[BiasParams],
):
    """torque = -assistance sum_m moment_m tension_m, and its derivative by the joint's velocity.

    The only joint is the elbow, so a muscle has one moment, and the velocity of its path is moment times the
    joint's: d torque / d velocity = -assistance sum_m moment_m^2 damping_m, exactly.
    """
    worldid = wp.tid()
    total, slope = float(0.0), float(0.0)
    for i in range(muscle_actuators.shape[0]):
        actuatorid = muscle_actuators[i]
        if moment_rownnz_in[worldid, actuatorid] == 0:
            continue
        moment = actuator_moment_in[worldid, moment_rowadr_in[worldid, actuatorid]]
        total -= moment * tension[worldid, i]
        slope -= moment * moment * damping[worldid, i]
    assistance = value_of(curve, clock, worldid, 0)
    own = BiasParams()
    own[0] = assistance * (total - slope * actuator_velocity_in[worldid, exo])
    own[2] = assistance * slope
    actuator_biasprm[worldid, exo] = own
    torque[worldid] = assistance * total


class AssistEffect(ExoskeletonEffect):
    """An exoskeleton that follows the muscles."""

    def __init__(self, scene: Scene, cuff: HungMass, clock: Clock, assistance: Parameter) -> None:
        super().__init__(scene, cuff)
        self.clock, self.assistance, self.drawn = clock, assistance, (*self.drawn, assistance)
        self.muscle_actuators = wp.array(scene.muscles.actuator_id, dtype=int)

    def act_in_substep(self) -> None:
        """Launch `assist`."""
        data, model, muscles = self.scene.data, self.scene.model, self.scene.muscles
        launch(assist, self.scene.num_worlds, self, self.assistance, data, muscles, model)


@wp.kernel(enable_backward=False)
def score_motor(
    # Params:
    exo: int,
    max_torque: float,
    # Data in:
    ctrl_in: wp.array2d[float],
    # In:
    column: int,
    # Out:
    torque: wp.array[float],
    terms: wp.array2d[float],
):
    """torque = max_torque u; exo_effort = -u^2."""
    worldid = wp.tid()
    u = ctrl_in[worldid, exo]
    torque[worldid] = max_torque * u
    terms[worldid, column] = -u * u


class MotorEffect(ExoskeletonEffect):
    """An exoskeleton that the policy commands; the engine applies the torque."""

    def __init__(self, scene: Scene, cuff: HungMass, exoskeleton: Exoskeleton) -> None:
        super().__init__(scene, cuff)
        self.max_torque = float(exoskeleton.max_torque)
        self.terms = (RewardTerm("exo_effort", float(exoskeleton.effort_weight), *EXO_EFFORT),)

    def score(self, terms: wp.array, column: int) -> None:
        """Launch `score_motor`."""
        launch(score_motor, self.scene.num_worlds, self, self.scene.data, column=column, terms=terms)


CONDITIONS.add("exoskeleton", Exoskeleton)
