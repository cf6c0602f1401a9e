"""What a task is, before any array exists: frozen, hashable, checked on the host.

A task family (`tasks/<family>.py`) subclasses `TaskSpec` once; a function under `@task` returns the instance
of each id. From its tables (`columns`, `reward_terms`) follow the spaces, the info keys, the documentation
and the tests.
"""

from __future__ import annotations

import abc
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING, ClassVar, TypeVar

from myowarp.spec.body import BODIES, CoarseStep
from myowarp.spec.registry import Registry

if TYPE_CHECKING:
    import mujoco
    import numpy as np


@dataclass(frozen=True)
class Column:
    """A named block of the observation vector."""

    name: str
    size: int
    unit: str


@dataclass(frozen=True)
class RewardTerm:
    """A named term of the reward; `reward = sum(weight * term)`. Weight 0: logged only."""

    name: str
    weight: float


Columns = TypeVar("Columns", bound=IntEnum)


def blocks(sizes: Mapping[Columns, tuple[int, str]]) -> tuple[Column, ...]:
    """Return the columns of an observation.

    Args:
        sizes: Size and unit of each block; the keys are the enum by which the kernel finds its columns.
    """
    _check_order(sizes)
    return tuple(Column(block.name, *size) for block, size in sizes.items())


def weighted(weights: Mapping[Columns, float]) -> tuple[RewardTerm, ...]:
    """Return the terms of a reward.

    Args:
        weights: Weight of each term; the keys are the enum by which the kernel finds its columns, or the
            first members of it.
    """
    _check_order(weights)
    return tuple(RewardTerm(term.name, float(weight)) for term, weight in weights.items())


def _check_order(members: Iterable[IntEnum]) -> None:
    """Raise ValueError if the members do not count from 0 on, which would give columns the wrong names."""
    numbers = [int(member) for member in members]
    if numbers != list(range(len(numbers))):
        raise ValueError(f"columns must be given in their order, 0 to {len(numbers) - 1}, got {numbers}")


@dataclass(frozen=True)
class PhysicsPreset:
    """How a control step is cut into physics steps.

    Attributes:
        integrator: Name of a `mujoco.mjtIntegrator` member without its prefix; None: the task's.
        midstep: Whether a muscle pulls with its activation in the middle of the physics step, exactly
            integrated, rather than with that at its start (MuJoCo's order).
        coarse: Whether physics steps are the task's `coarse_step`, rather than upstream's.
    """

    integrator: str | None
    midstep: bool
    coarse: bool


@dataclass(frozen=True, kw_only=True)
class TaskSpec(abc.ABC):
    """A task, complete but for the number of worlds and the device.

    Attributes:
        program: Subclass of `spec.program.Program`; called with the task and a scene.
        name: Upstream's name of the task, such as `myoHandPoseFixed`; `@task` takes it from the id.
        version: Version of our id, from there too; 0 keeps MyoSuite 3.0.0's semantics.
        body: Name in `BODIES`.
        num_substeps: Physics steps in a control step, upstream's `frame_skip`.
        physics_dt: Upstream's physics time step [s].
        integrator: Upstream's integrator, as in `PhysicsPreset`.
        horizon: Control steps in an episode.
        doc: One sentence: what the task asks for, and why this version exists.
    """

    program: ClassVar[type]

    name: str = ""
    version: int = 0
    body: str
    num_substeps: int
    horizon: int
    doc: str = ""
    physics_dt: float = 0.002
    integrator: str = "EULER"

    @property
    def key(self) -> str:
        """Name with version, such as `myoHandPoseFixed-v0`."""
        return f"{self.name}-v{self.version}"

    @property
    def env_id(self) -> str:
        """Gymnasium id, such as `MyoWarp/myoHandPoseFixed-v0`."""
        return f"MyoWarp/{self.key}"

    @property
    def family(self) -> str:
        """Name of the task family."""
        return type(self).__name__.removesuffix("Task").lower()

    @property
    def control_dt(self) -> float:
        """Duration of a control step [s]."""
        return self.num_substeps * self.physics_dt

    @property
    def coarse_step(self) -> CoarseStep:
        """Physics steps of coarse presets; the body's, unless a family has its own."""
        return BODIES[self.body].coarse_step

    @property
    def scene_key(self) -> tuple[object, ...]:
        """What the compiled model depends on; tasks that agree in it share one on disk."""
        return (self.family, self.body, self.sites, self.physics_dt)

    @property
    def uses_kinematics(self) -> bool:
        """Whether observation or reward read body or site positions."""
        return True

    @property
    def sites(self) -> tuple[str, ...]:
        """Names of the sites that the task reads; they survive slimming."""
        return ()

    @property
    def batched(self) -> tuple[str, ...]:
        """Names of the model's fields that the task sets per world."""
        return ()

    @property
    def carried(self) -> tuple[str, ...]:
        """Names of the bodies that lie in the hand; a random start posture carries them along."""
        return ()

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the configuration from which episodes start, shape (nq,)."""
        return model.qpos0.copy()

    @abc.abstractmethod
    def edit(self, spec: mujoco.MjSpec) -> None:
        """Add what the task puts into the scene to the body's `MjSpec`, in place."""

    @abc.abstractmethod
    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        """The observation vector, block by block.

        Args:
            nq: Number of coordinates in qpos.
            nv: Number of velocities in qvel; smaller than `nq` by one for each ball or free joint.
            num_muscles: Number of muscles.
        """

    @abc.abstractmethod
    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """The reward, term by term."""


PHYSICS = {
    "parity": PhysicsPreset(None, midstep=False, coarse=False),
    "fast": PhysicsPreset("IMPLICITFAST", midstep=True, coarse=True),
}
"""`parity`: MyoSuite's integrator and step. `fast`: implicit in velocity, activation exactly integrated, few
steps."""

RESETS = ("task", "fixed", "random", "none")
"""What a new episode starts from: the task's own way; the task's start configuration; a random posture that
carries along what lies in the hand, free of penetration and of immediate failure; or the state that the last
episode left (reset-free, only goal and counters are new)."""

TASKS: Registry[TaskSpec] = Registry("task")

Spec = TypeVar("Spec", bound=TaskSpec)


def task(key: str, why: str = "") -> Callable[[Callable[[], Spec]], Callable[[], Spec]]:
    """Register the task that a function returns; the function's docstring says what the task asks for.

    Args:
        key: Name and version, such as `myoHandPoseFixed-v0`.
        why: Why this version exists; it follows the docstring in the task's `doc`.

    Raises:
        ValueError: The key has no version, or is taken.
    """
    match = re.fullmatch(r"(\w+)-v(\d+)", key)
    if match is None:
        raise ValueError(f"task id {key!r} must be a name and a version, such as 'myoHandPoseFixed-v0'")
    name, version = match.groups()

    def register(make: Callable[[], Spec]) -> Callable[[], Spec]:
        doc = " ".join(f"{make.__doc__ or ''} {why}".split())
        TASKS.add(key, replace(make(), name=name, version=int(version), doc=doc))
        return make

    return register
