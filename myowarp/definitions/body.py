"""What a body is: a function that returns a fresh, editable `mujoco.MjSpec`, and what tasks know of it."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass

import mujoco

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
class Body:
    """A body.

    Attributes:
        build: Returns the full model as a fresh spec.
        tips: Names of the sites at the ends of the limb, which tasks show or steer.
        palm: Name of the body on which objects lie; None where none can.
        coarse_step: Physics steps of coarse presets; a task family may have its own.
    """

    build: Callable[[], mujoco.MjSpec]
    tips: tuple[str, ...]
    palm: str | None = None
    coarse_step: CoarseStep = CAUTIOUS_STEP

    @property
    def doc(self) -> str:
        """What it is, for people: what `build` says that it returns; "" where it says nothing."""
        said = inspect.getdoc(self.build) if inspect.isfunction(self.build) else None
        sentence = " ".join((said or "").split("\n\n")[0].split())
        return sentence.removeprefix("Return the ").removeprefix("Return ")


BODIES: Registry[Body] = Registry("body")
