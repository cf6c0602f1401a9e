"""Stages: kernels in place of a part of the engine's physics step; same results, less work.

A stage depends on the engine's internals. It is therefore imported when a step is made, and one that cannot
be, because a private name of the engine is gone, is left to mujoco-warp and says so once; one whose step
differs from the engine's is found out by `verify`. A new stage is one file in `stages/` and its name in
`STAGES`.
"""

from __future__ import annotations

import abc
import contextlib
import importlib
from collections.abc import Callable, Iterator
from functools import cache
from typing import ClassVar

import mujoco_warp as mjw
import warp as wp

from myowarp.engine.stepped import Stepped
from myowarp.process import warn_once

Launches = Callable[[mjw.Model, mjw.Data], None]
Obstacles = dict[str, Callable[[Stepped], bool]]
"""A reason in words, and whether what is stepped has it."""

STAGES = {
    "contact_search": "ContactSearch",
    "contact_solve": "ContactSolve",
    "constraint_rows": "ConstraintRows",
    "affine_actuators": "AffineActuators",
    "integrate": "Integrate",
    "muscle_path": "MusclePath",
    "rigid_body": "RigidBody",
}
"""Name of a file in `stages/` and of its class, in the order in which they are verified: the solver early,
because it amplifies rounding less than the engine's."""


class Stage(abc.ABC):
    """Kernels of ours for one or more places of the physics step.

    Attributes:
        REPLACES: Places in `step.ORDER` that it fills, with one launch in the first.
        SPARES: Kernels of the engine whose results nobody reads beside it, by name.
        OBSTACLES: What a model must not have, beside `step.UNCOVERED`.
        ON_CUDA: Whether it is worth its launches on CUDA, too.
        TOLERANCE: Largest difference that it makes to a step's change of velocity or of position, as a share
            of the largest such change in the state (float32 sums in another order), beyond
            `verify.ROUNDINGS` of the state.
        replaces: `REPLACES`, or the part of it that applies here.
        data: The engine's data that it steps.
    """

    REPLACES: ClassVar[tuple[str, ...]]
    SPARES: ClassVar[frozenset[str]] = frozenset()
    OBSTACLES: ClassVar[Obstacles]
    ON_CUDA = False
    TOLERANCE = 1e-4

    @classmethod
    def obstacle(cls, stepped: Stepped) -> str | None:
        """Return why the stage cannot step this, None if it can."""
        if not (cls.ON_CUDA or stepped.device.is_cpu):
            return "the device is not the CPU"
        return first_reason(cls.OBSTACLES, stepped)

    def __init__(self, stepped: Stepped) -> None:
        """Allocate all that the kernels need, on the device of what is stepped."""
        self.replaces, self.data = self.REPLACES, stepped.data

    def launcher(self, stages: tuple[Stage, ...], mask: wp.array | None = None) -> Launches:
        """Return what the step launches in the first place, knowing all stages of ours in it.

        Only the worlds of a mask, shape (num_worlds,) bool, matter to whoever gives one.
        """
        return self.launch

    def begin(self) -> None:
        """Launch what comes before the first of several physics steps."""
        return

    def refresh(self, model: mjw.Model, data: mjw.Data, mask: wp.array | None) -> bool:
        """Bring poses of bodies and of the task's sites up to date in masked worlds, or return False."""
        return False

    @abc.abstractmethod
    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Launch our kernels."""


def first_reason(obstacles: Obstacles, stepped: Stepped) -> str | None:
    """Return the first reason that holds, None if none does."""
    return next((reason for reason, holds in obstacles.items() if holds(stepped)), None)


@cache
def load(name: str) -> type[Stage] | None:
    """Return a stage's class, None where the engine has changed too much for it, which is logged once.

    Raises:
        ValueError: No such stage.
    """
    if name not in STAGES:
        raise ValueError(f"stage {name!r} unknown; available: {', '.join(STAGES)}")
    with or_the_engines(name):
        module = importlib.import_module(f"myowarp.engine.stages.{name}")
        kind: type[Stage] = getattr(module, STAGES[name])
        return kind
    return None


@contextlib.contextmanager
def or_the_engines(name: str) -> Iterator[None]:
    """End the block where a name of the engine is gone, and log once that the engine does `name` itself."""
    try:
        yield
    except (ImportError, AttributeError) as error:
        warn_once(f"{name} is left to mujoco-warp {mjw.__version__}, which has changed: {error}")
