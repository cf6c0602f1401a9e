"""What a body is: a function that returns a fresh, editable `mujoco.MjSpec`, and what tasks know of it."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from myowarp.spec.registry import Registry


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
