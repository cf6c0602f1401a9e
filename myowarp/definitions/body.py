"""Bodies: a function that returns a fresh, editable `mujoco.MjSpec`, and facts for all others.

Tasks, conditions and signals name no muscle, joint or bone of a certain body: they find them here.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco

from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.registry import Registry

POINT_JOINTS = (mujoco.mjtJoint.mjJNT_HINGE.value, mujoco.mjtJoint.mjJNT_SLIDE.value)
"""Kinds of joints with one coordinate."""


@dataclass(frozen=True)
class CoarseStep:
    """The longest physics steps that are still accurate.

    They keep the root mean square error of the joints below 0.02 rad, against steps of 0.1 ms over 0.2 s of
    policy-like excitations (benchmarks/accuracy.py).

    Attributes:
        dt: Time step [s]; the control step is cut evenly into steps that are no longer.
        implicitness: Share of the muscles' dF/dvelocity that the integrator takes in: 0.5 is the trapezoidal
            rule, 1 fully implicit.
    """

    dt: float
    implicitness: float


CAUTIOUS_STEP = CoarseStep(0.004, 0.5)  # where nothing was measured


@dataclass(frozen=True)
class FatigueRates:
    """Rates at which a muscle tires and recovers: parameters of the condition `fatigue_3ccr`.

    Attributes:
        fatigue_rate: F [1/s].
        recovery_rate: R [1/s].
        rest_recovery_factor: r, how much faster a resting muscle recovers [1].
    """

    fatigue_rate: float
    recovery_rate: float
    rest_recovery_factor: float


@dataclass(frozen=True)
class Place:
    """A place on a limb.

    Attributes:
        limb: Name of the body that the limb is in the model.
        pos: Where on it [m], in the limb's frame.
    """

    limb: str
    pos: tuple[float, float, float]


@dataclass(frozen=True)
class Brace:
    """The place of an exoskeleton.

    Attributes:
        joint: Joint that it turns.
        limb: Name of the body that carries its mass.
    """

    joint: str
    limb: str


@dataclass(frozen=True)
class Transfer:
    """Muscles between which a tendon can be transferred.

    Attributes:
        donor: Muscle that is rerouted.
        lost: Muscle in whose place it pulls.
        path: The donor's new path: sites; or a wrapping surface and the site on the side where the tendon
            passes, "" for either side.
    """

    donor: str
    lost: str
    path: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class Body:
    """A body. Muscles are named without the side suffix `_r`.

    Attributes:
        build: Returns the full model as a fresh spec.
        tips: Names of the sites at the ends of the limb, which tasks show or steer.
        palm: Name of the body on which objects lie; None where none can.
        coarse_step: Physics steps of coarse presets; a task family may have its own.
        groups: What muscles do: the group of each, by name.
        fatigue_rates: How fast muscles tire and recover, by name.
        load: Center of a load that the hand holds; None where none can.
        exoskeleton: Where an exoskeleton is worn; None where none can.
        root: Free joint of the trunk of a body that walks; None where none does.
        devices: Joints at which a page offers a device, beside that of an exoskeleton.
        transfer: What a tendon transfer is about; None where there is none.
        torn: Muscles that a tendon tear is about where it names none.
        antagonists: Pairs of a flexor and an extensor whose nerves can be crossed; None where there are none.
        approach: Muscles that bend and spread it; a posture that is reached from there is more often stable.
            The policy "muscle-control" begins with them.
        muscles: Parameters of its muscles beside those in the model, for the muscle model that they name.
        muscle: Muscle model that runs where none is asked for.
        title: Its name for people, where that is not its name in `BODIES`.
        large: Whether a step costs many times that of a hand.
    """

    build: Callable[[], mujoco.MjSpec]
    tips: tuple[str, ...]
    palm: str | None = None
    coarse_step: CoarseStep = CAUTIOUS_STEP
    groups: Mapping[str, str] = field(default_factory=dict, repr=False)
    fatigue_rates: Mapping[str, FatigueRates] = field(default_factory=dict, repr=False)
    load: Place | None = None
    exoskeleton: Brace | None = None
    root: str | None = None
    devices: tuple[str, ...] = ()
    transfer: Transfer | None = None
    torn: tuple[str, ...] = ()
    antagonists: tuple[tuple[str, str], ...] | None = None
    approach: tuple[str, ...] = ()
    muscles: MuscleTable | None = field(default=None, repr=False)
    muscle: str = "mujoco"
    title: str = ""
    large: bool = False

    @property
    def doc(self) -> str:
        """Return its description from `build`'s docstring, after "Return"; "" if there is none."""
        said = inspect.getdoc(self.build) if inspect.isfunction(self.build) else None
        sentence = " ".join((said or "").split("\n\n")[0].split())
        return sentence.removeprefix("Return the ").removeprefix("Return ")

    @cached_property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of the muscles of its full model, with their side suffixes."""
        actuators = self.build().actuators
        return tuple(a.name for a in actuators if a.dyntype == mujoco.mjtDyn.mjDYN_MUSCLE)

    def group_of(self, muscle: str) -> str:
        """Return the group of a muscle, with or without the side suffix `_r`; "" where none is known."""
        return self.groups.get(muscle.removesuffix("_r"), "")


BODIES: Registry[Body] = Registry("body")


def fact_for(what: str, body: str, fact: str) -> Any:
    """Return a fact of a body, a field of `Body`, without which it cannot do something.

    Args:
        what: What it is to do: "hold a load".
        body: Name in `BODIES`.
        fact: Name of the field.

    Raises:
        ValueError: The body has no such fact; the message lists those that have.
    """
    if (found := getattr(BODIES[body], fact)) is None:
        able = ", ".join(name for name in BODIES if getattr(BODIES[name], fact) is not None)
        raise ValueError(f"body {body!r} cannot {what}; bodies that can: {able}")
    return found
