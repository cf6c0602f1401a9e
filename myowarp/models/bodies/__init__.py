"""Bodies: each a function that returns a fresh, editable `mujoco.MjSpec` built from myo-sim.

A new body is one file here and one import at the foot of this one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from myowarp.registry import Registry


@dataclass(frozen=True)
class Body:
    """A body.

    Attributes:
        build: Returns the full model as a fresh spec.
        tips: Names of the sites at the ends of the limb, which tasks show or steer.
        palm: Name of the body on which objects lie; None where none can.
    """

    build: Callable[[], mujoco.MjSpec]
    tips: tuple[str, ...]
    palm: str | None = None


BODIES: Registry[Body] = Registry("body")

from myowarp.models.bodies import (  # noqa: E402  (they register themselves)
    contact_hand,  # noqa: F401
    elbow,  # noqa: F401
    elbow_exo,  # noqa: F401
    finger,  # noqa: F401
    hand,  # noqa: F401
)
