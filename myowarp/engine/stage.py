"""What a stage of ours is: kernels in place of a part of the engine's physics step; same results, less work.

A stage depends on the engine's internals. It is therefore imported when a scene is built, and one that cannot
be, because a private name of the engine is gone, is left to mujoco-warp and says so once; one whose step
differs from the engine's is found out by `verify`. A new stage is one file in `stages/` and its name in
`STAGES`.
"""

from __future__ import annotations

import abc
import importlib
import logging
from collections.abc import Callable, Iterable
from functools import cache
from typing import ClassVar

import mujoco_warp as mjw
import warp as wp

from myowarp.definitions.scene import Scene
from myowarp.engine.said import say_once

logger = logging.getLogger("myowarp")

Launches = Callable[[mjw.Model, mjw.Data], None]
Obstacles = dict[str, Callable[[Scene], bool]]
"""A reason in words, and whether a scene has it."""

STAGES = {
    "free_coordinates": "FreeCoordinates",
    "contact_search": "ContactSearch",
    "contact_solve": "ContactSolve",
    "constraint_rows": "ConstraintRows",
    "affine_actuators": "AffineActuators",
    "integrate": "Integrate",
    "muscle_path": "MusclePath",
    "rigid_body": "RigidBody",
}
"""Name of a file in `stages/` and of its class, in the order in which they are verified: first what makes it
another step, the solver early, because it makes less of a rounding in what comes before it than theirs."""

INNER = ("acceleration", "solve", "integrate")
"""Places that a stage with an `inner` scene has step that scene."""


class Stage(abc.ABC):
    """Kernels of ours for one or more places of the physics step.

    Attributes:
        REPLACES: Places in `step.ORDER` that it fills, with one launch in the first.
        OBSTACLES: What a scene must not have, beside `step.UNCOVERED`.
        ON_CUDA: Whether it is worth its launches on CUDA, too.
        TOLERANCE: Largest difference that it makes to a step's change of velocity or of position, as a share
            of the largest such change in the state (float32 sums in another order), beyond
            `verify.ROUNDINGS` of the state.
        replaces: `REPLACES`, or the part of it that applies here.
        inner: What the places `INNER` step in place of the scene; None: the scene.
    """

    inner: Scene | None = None

    REPLACES: ClassVar[tuple[str, ...]]
    OBSTACLES: ClassVar[Obstacles]
    ON_CUDA = False
    TOLERANCE = 1e-4

    @classmethod
    def obstacle(cls, scene: Scene) -> str | None:
        """Return why this scene cannot use the stage, None if it can."""
        if not (cls.ON_CUDA or scene.device.is_cpu):
            return "the device is not the CPU"
        return first_reason(cls.OBSTACLES, scene)

    def __init__(self, scene: Scene) -> None:
        """Allocate all that the kernels need, on the scene's device."""
        self.replaces = self.REPLACES

    def launches(self, replaced: frozenset[str]) -> dict[str, Launches]:
        """Return what the step launches, place by place, knowing which places of it are ours."""
        return {self.replaces[0]: self.launcher(replaced)}

    def launcher(self, replaced: frozenset[str]) -> Launches:
        """Return what the step launches in the first place, knowing which places of it are ours."""
        return self.launch

    def refresh(self, model: mjw.Model, data: mjw.Data, mask: wp.array | None) -> bool:
        """Bring poses of bodies and of the task's sites up to date in masked worlds, or return False."""
        return False

    @abc.abstractmethod
    def launch(self, model: mjw.Model, data: mjw.Data) -> None:
        """Launch our kernels."""


def first_reason(obstacles: Obstacles, scene: Scene) -> str | None:
    """Return the first reason that holds for a scene, None if none does."""
    return next((reason for reason, holds in obstacles.items() if holds(scene)), None)


@cache
def load(name: str) -> type[Stage] | None:
    """Return a stage's class, None where the engine has changed too much for it, which is logged once.

    Raises:
        ValueError: No such stage.
    """
    if name not in STAGES:
        raise ValueError(f"stage {name!r} unknown; available: {', '.join(STAGES)}")
    try:
        module = importlib.import_module(f"myowarp.engine.stages.{name}")
    except (ImportError, AttributeError) as error:
        _left_to_the_engine(name, error)
        return None
    kind: type[Stage] = getattr(module, STAGES[name])
    return kind


def applicable_stages(scene: Scene, names: Iterable[str] = STAGES) -> tuple[Stage, ...]:
    """Return the stages of these names that a scene can use, in the order of the names."""
    found: list[Stage] = []
    for name in names:
        kind = load(name)
        try:
            if kind is not None and kind.obstacle(stepped(scene, kind, found)) is None:
                found.append(kind(stepped(scene, kind, found)))
        except AttributeError as error:  # a field of the engine's model or data is gone
            _left_to_the_engine(name, error)
    return tuple(found)


def stepped(scene: Scene, kind: type[Stage], before: Iterable[Stage]) -> Scene:
    """Return what a stage of a kind steps, after others: the scene, or the inner one of another stage."""
    inner = next((stage.inner for stage in before if stage.inner is not None), None)
    return scene if inner is None or kind.REPLACES[0] not in INNER else inner


def same_stages(scene: Scene, stages: Iterable[Stage]) -> tuple[Stage, ...]:
    """Return stages of the same kinds for another part of the worlds."""
    made: list[Stage] = []
    for stage in stages:
        made.append(type(stage)(stepped(scene, type(stage), made)))
    return tuple(made)


def not_exact(reason: str) -> None:
    """Say that joints that should follow others exactly do not, and why."""
    logger.warning("joints follow others by the engine's springs, not exactly: %s", reason)


def _left_to_the_engine(name: str, error: Exception) -> None:
    say_once(f"{name} is left to mujoco-warp {mjw.__version__}, which has changed: {error}")
