"""A device at one joint of any body: a spring, a motor, or both, with a mass on the limb that it turns.

    torque = clip(command(t - delay) - stiffness (q - rest), -limit, limit)
    command = assistance sum_m r_m F_m + peak profile(t) + limit u

with moment arm r_m about the joint and tendon force F_m of the muscles, q the joint's angle, and u the last
action where the policy commands the motor. A slide has forces in place of torques. Several devices may be
worn, each at a joint of its own. Sources: springs in parallel to muscles, Collins et al. (2015),
doi:10.1038/nature14288; torque profiles over time, Zhang et al. (2017), doi:10.1126/science.aal5054; a share
of the muscles' torque, Caggiano et al. (2022), arXiv:2205.13600.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import mujoco
import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES, POINT_JOINTS, Body, fact_for
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.muscle import BiasParams
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.definitions.registry import check_choice
from myowarp.kernels.launch import launch
from myowarp.kernels.reset import masked_fill
from myowarp.kernels.write import is_finite
from myowarp.models.conditions.added_mass import BATCHED, AddedMass, HungMass, Part

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec

RADIUS = 0.04
"""Of the sphere that the mass is [m]."""
LONGEST_DELAY = 10.0  # s
PRELOAD = 0.5 * math.pi
"""Distance beyond the joint's range at which a spring may rest [rad]; farther ones are taken for degrees."""

Profile = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class JointDevice(Condition):
    """A spring or a motor at a joint.

    Attributes:
        joint: Name of the joint, a hinge or a slide; "": the one at which the body wears an exoskeleton.
        stiffness: Of the spring [N m/rad], >= 0.
        rest: Angle at which the spring is at rest [rad].
        assistance: Motor torque as a share of the muscles' torque at the joint [1], >= 0.
        peak: Motor torque where the profile is 1 [N m], positive where the joint's angle grows.
        profile: Motor torque over time: pairs of a time [s] and a share of `peak`, times rising, straight
            lines between them; before and after them it is as at the ends.
        period: Time after which the profile begins anew [s]; 0: it comes once an episode.
        delay: From what the motor is to do until it does it [s]; the next whole number of control steps.
        limit: Largest torque of spring and motor together [N m].
        motor: Whether the policy commands the motor, too: one more action, times `limit`.
        mass: Mass on the limb that the joint turns [kg], 0 to 100: a sphere of 4 cm radius.
        place: Where its center is [m], in the limb's frame; None: at the limb's center of mass.
    """

    PHASE = Phase.BODY
    NEUTRAL: ClassVar = {"stiffness": 0.0, "assistance": 0.0, "peak": 0.0, "mass": 0.0}
    TITLE = "device at a joint"
    LABELS: ClassVar = {"stiffness": "spring", "assistance": "share of muscles", "peak": "motor"}
    batched = BATCHED

    joint: str = ""
    stiffness: Value = 5.0
    rest: float = 0.0
    assistance: Value = 0.0
    peak: Value = 0.0
    profile: Profile = ((0.0, 1.0),)
    period: float = 0.0
    delay: float = 0.0
    limit: float = 100.0
    motor: bool = False
    mass: Value = 0.0
    place: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check what is the same in all worlds."""
        if not isinstance(self.joint, str):
            raise ValueError(f"joint_device joint must be the name of a joint, got {self.joint!r}")
        for name, least in (("rest", -np.inf), ("period", 0.0), ("delay", 0.0), ("limit", 0.0)):
            number = getattr(self, name)
            if not (_is_number(number) and number >= least):
                bound = "" if least < 0.0 else " >= 0"
                raise ValueError(f"joint_device {name} must be a finite number{bound}, got {number!r}")
        if self.limit == 0.0:
            raise ValueError(
                "joint_device limit must be above 0, got 0; leave a device out that does nothing"
            )
        if self.delay > LONGEST_DELAY:
            raise ValueError(f"joint_device delay must be at most {LONGEST_DELAY:g} s, got {self.delay!r}")
        place = self.place
        three = isinstance(place, (tuple, list)) and len(place) == 3 and all(map(_is_number, place))
        if not (place is None or three):
            raise ValueError(f"joint_device place must be three finite numbers, got {place!r}")
        self._check_profile()

    def _check_profile(self) -> None:
        """Check times and shares of the profile."""
        pairs = self.profile
        if not (
            isinstance(pairs, (tuple, list))
            and pairs
            and all(
                isinstance(pair, (tuple, list)) and len(pair) == 2 and all(map(_is_number, pair))
                for pair in pairs
            )
        ):
            raise ValueError(f"joint_device profile must be pairs (time, share of the peak), got {pairs!r}")
        times = [time for time, _ in pairs]
        if times[0] < 0.0 or any(later <= time for time, later in pairwise(times)):
            raise ValueError(f"joint_device profile needs rising times >= 0 s, got {times!r}")
        if self.period and times[-1] > self.period:
            raise ValueError(
                f"joint_device period must be 0 or at least the last time of the profile, {times[-1]:g} s, "
                f"got {self.period!r}"
            )

    @property
    def WRITES(self) -> tuple[str, ...]:  # type: ignore[override]  # noqa: N802 (of each joint)
        """The torque at its joint."""
        return (f"the torque of a device at {self.joint or 'the joint of the exoskeleton'}",)

    @property
    def scene_key(self) -> tuple[object, ...]:
        """Actuator and body."""
        return ("joint_device", self.joint, self.limit, self.motor, self.place and tuple(self.place))

    @property
    def undriven(self) -> tuple[str, ...]:
        """The actuator, where the policy does not command it."""
        return () if self.motor else (f"device_{self.joint}",)

    @classmethod
    def neutrals(cls, spec: TaskSpec) -> tuple[Condition, ...]:
        """Return one at each joint where the body has room for devices, `Body.devices`."""
        if not (joints := BODIES[spec.body].devices):
            return super().neutrals(spec)
        worn: Callable[..., Condition] = cls
        return tuple(worn(joint, **cls.NEUTRAL) for joint in joints)

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body has no such joint, or the spring rests far beyond its range."""
        joint, _ = self.worn_by(spec.body)
        low, high = limbs_of(BODIES[spec.body])[joint].span
        if not low - PRELOAD <= self.rest <= high + PRELOAD:
            raise ValueError(
                f"joint_device rest must be near the range of {joint}, {low:.3g} to {high:.3g} rad, got "
                f"{self.rest:g}; for {self.rest:g} degrees write {math.radians(self.rest):.3g}"
            )

    def worn_by(self, body: str) -> tuple[str, AddedMass]:
        """Return the joint in a body, and the mass on the limb that it turns; ValueError if there is none."""
        joint = self.joint or fact_for("have a joint_device without a joint named", body, "exoskeleton").joint
        limbs = limbs_of(BODIES[body])
        check_choice(f"body {body!r}: joint_device joint", joint, list(limbs))
        sphere = Part(mujoco.mjtGeom.mjGEOM_SPHERE, (RADIUS, 0.0, 0.0))
        limb = limbs[joint]
        return joint, AddedMass(f"device_{self.joint}", limb.name, self.place or limb.middle, (sphere,))

    def edit(self, spec: mujoco.MjSpec, body: str) -> None:
        """Add the mass, and an actuator that is idle until it is driven."""
        joint, sphere = self.worn_by(body)
        sphere.edit(spec)
        actuator = spec.add_actuator(name=sphere.name, target=joint)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm = [self.limit if self.motor else 0.0] + 9 * [0.0]
        actuator.biasprm = 10 * [0.0]
        actuator.ctrllimited, actuator.ctrlrange = True, (-1.0, 1.0)
        actuator.forcelimited, actuator.forcerange = True, (-self.limit, self.limit)

    def bind(self, scene: Scene, clock: Clock) -> JointDeviceEffect:
        """Put its parameters on the device."""
        return JointDeviceEffect(scene, clock, self)


def _is_number(number: object) -> bool:
    """Whether it is a finite number."""
    return isinstance(number, (int, float)) and not isinstance(number, bool) and bool(is_finite(number))


class Limb(NamedTuple):
    """A limb that a joint turns.

    Attributes:
        name: Of the body.
        middle: Its center of mass, in its frame [m].
        span: Least and greatest angle of the joint [rad]; without a range, and of a slide, infinite.
    """

    name: str
    middle: tuple[float, float, float]
    span: tuple[float, float]


@lru_cache(maxsize=8)
def limbs_of(body: Body) -> Mapping[str, Limb]:
    """Return what hinges and slides of a body move, by the joint's name."""
    model = body.build().compile()
    found = {}
    for joint in map(model.joint, range(model.njnt)):
        if int(joint.type[0]) in POINT_JOINTS:
            limb = model.body(int(joint.bodyid[0]))
            x, y, z = map(float, limb.ipos)
            low, high = map(float, joint.range)
            hinge = int(joint.type[0]) == mujoco.mjtJoint.mjJNT_HINGE
            span = (low, high) if hinge and low < high else (-math.inf, math.inf)
            found[joint.name] = Limb(limb.name, (x, y, z), span)
    return found


@wp.struct
class Device:
    """A device as kernels see it.

    Attributes:
        actuatorid: Its actuator.
        dof: Of its joint.
        muscle_actuators: Actuators of the muscles.
        stiffness: Of the spring [N m/rad].
        assistance: Share of the muscles' torque.
        peak: Torque where the profile is 1 [N m].
        rest: Angle of the spring at rest [rad].
        limit: Largest torque [N m].
        motor: Whether the policy commands it.
        delay: [control steps].
        times: Of the profile [s].
        shares: Of the profile.
        period: Of the profile [s]; 0: none.
    """

    actuatorid: int
    dof: int
    muscle_actuators: wp.array[int]
    stiffness: Curve
    assistance: Curve
    peak: Curve
    rest: float
    limit: float
    motor: bool
    delay: int
    times: wp.array[float]
    shares: wp.array[float]
    period: float


@wp.func
def profile_at(device: Device, time: float) -> float:
    """Straight lines between the shares, over the time or the time within a period."""
    t = time
    if device.period > 0.0:
        t = time - device.period * wp.floor(time / device.period)
    last = device.times.shape[0] - 1
    if t <= device.times[0]:
        return device.shares[0]
    for i in range(last):
        if t < device.times[i + 1]:
            share = (t - device.times[i]) / (device.times[i + 1] - device.times[i])
            return (1.0 - share) * device.shares[i] + share * device.shares[i + 1]
    return device.shares[last]


@wp.kernel(enable_backward=False)
def drive_device(
    # Params:
    device: Device,
    # Data in:
    ctrl_in: wp.array2d[float],
    actuator_length_in: wp.array2d[float],
    moment_rownnz_in: wp.array2d[int],
    moment_rowadr_in: wp.array2d[int],
    moment_colind_in: wp.array2d[int],
    actuator_moment_in: wp.array2d[float],
    # In:
    tension: wp.array2d[float],
    clock: Clock,
    # Out:
    command: wp.array2d[float],
    torque: wp.array[float],
    actuator_biasprm: wp.array2d[BiasParams],
):
    """torque = clip(command(t - delay) - stiffness (q - rest), -limit, limit).

    The engine adds limit u of a commanded motor, which is taken off here again, and clips.
    """
    worldid = wp.tid()
    of_muscles = float(0.0)
    for i in range(device.muscle_actuators.shape[0]):
        actuatorid = device.muscle_actuators[i]
        first = moment_rowadr_in[worldid, actuatorid]
        for k in range(first, first + moment_rownnz_in[worldid, actuatorid]):
            if moment_colind_in[worldid, k] == device.dof:
                of_muscles -= actuator_moment_in[worldid, k] * tension[worldid, i]
    commanded = float(0.0)
    if device.motor:
        commanded = device.limit * wp.clamp(ctrl_in[worldid, device.actuatorid], -1.0, 1.0)
    time = float(clock.step_count[worldid]) * clock.control_dt
    wanted = commanded + value_of(device.assistance, clock, worldid, 0) * of_muscles
    wanted += value_of(device.peak, clock, worldid, 0) * profile_at(device, time)
    command[worldid, 0] = wanted
    acting = wp.where(device.delay > 0, command[worldid, 1], wanted)
    stiffness = value_of(device.stiffness, clock, worldid, 0)
    own = BiasParams()
    own[0] = acting - commanded + stiffness * device.rest
    own[1] = -stiffness
    actuator_biasprm[worldid, device.actuatorid] = own
    unlimited = acting - stiffness * (actuator_length_in[worldid, device.actuatorid] - device.rest)
    torque[worldid] = wp.clamp(unlimited, -device.limit, device.limit)


@wp.kernel(enable_backward=False)
def delay_command(
    # Out:
    pending: wp.array2d[float],
    command: wp.array2d[float],
):
    """The last command waits behind the others; the oldest of them acts."""
    worldid = wp.tid()
    last = pending.shape[1] - 1
    for i in range(last):
        pending[worldid, i] = pending[worldid, i + 1]
    pending[worldid, last] = command[worldid, 0]
    command[worldid, 1] = pending[worldid, 0]


class JointDeviceEffect(Effect):
    """A device in a scene: its mass, and the torque that it shows.

    Attributes:
        torque: Last torque [N m], positive where the joint's angle grows, shape (num_worlds,).
    """

    def __init__(self, scene: Scene, clock: Clock, condition: JointDevice) -> None:
        """Put everything on the current Warp device."""
        joint, sphere = condition.worn_by(scene.spec.body)
        self.scene, self.clock = scene, clock
        where = f" of {condition.joint}" if condition.joint else ""
        owner = f"condition.joint_device.{condition.joint or 'brace'}"

        def parameter(name: str, low: float, usual: float, whole: str = "") -> Parameter:
            label = f"joint_device {name}{where}"
            value = getattr(condition, name)
            return Parameter(label, value, scene, (), neutral=0.0, low=low, usual=usual, whole=whole)

        self.parameters = {
            "stiffness": parameter("stiffness", 0.0, 100.0),
            "assistance": parameter("assistance", 0.0, 1.0, "the muscles' torque"),
            "peak": parameter("peak", -np.inf, 50.0),
        }
        self.sphere: HungMass = sphere.bind(scene, clock, f"joint_device mass{where}", condition.mass)
        self.drawn = (*self.parameters.values(), self.sphere.mass)
        self.torque = scene.zeros(f"{owner}.torque")
        self.command = scene.zeros(f"{owner}.command", 2)  # the last one, and the one that acts
        found = scene.oracle.joint(joint)
        shown = f"{condition.joint or 'brace'}_device_torque"
        self.info = {shown: self.torque}
        self.info_units = {shown: "N m" if found.type[0] == mujoco.mjtJoint.mjJNT_HINGE else "N"}
        steps = int(np.ceil(condition.delay / scene.control_dt - 1e-6))
        self.pending = scene.zeros(f"{owner}.pending", max(steps, 1))
        device = self.device = Device()
        device.actuatorid = scene.oracle.actuator(sphere.name).id
        device.dof = int(found.dofadr[0])
        device.muscle_actuators = wp.array(scene.muscles.actuator_id, dtype=int)
        for name, value in self.parameters.items():
            setattr(device, name, value.curve)
        device.rest, device.limit = float(condition.rest), float(condition.limit)
        device.motor, device.delay, device.period = bool(condition.motor), steps, float(condition.period)
        times, shares = np.array(condition.profile, dtype=float).T
        device.times, device.shares = wp.array(times, dtype=float), wp.array(shares, dtype=float)

    def reset(self, mask: wp.array) -> None:
        """Nothing was commanded."""
        for array in (self.torque, self.command, self.pending):
            masked_fill(mask, array, 0.0)

    def act(self) -> None:
        """Hang the mass on the limb, and let the commands of earlier steps come forward."""
        self.sphere.launch()
        if self.device.delay:
            launch(delay_command, self.scene.num_worlds, self)

    def act_in_substep(self) -> None:
        """Launch `drive_device`."""
        data, model, muscles = self.scene.data, self.scene.model, self.scene.muscles
        launch(drive_device, self.scene.num_worlds, self, data, muscles, model)


CONDITIONS.add("joint_device", JointDevice)
