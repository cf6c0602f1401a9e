"""What a task is, before any array exists: frozen, hashable, checked on the host.

A task family (`tasks/<family>.py`) subclasses `TaskSpec` once and registers one instance for every id.
From its tables (`columns`, `reward_terms`) follow the spaces, the info keys, the documentation and the
tests.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from myowarp.spec.registry import Registry

if TYPE_CHECKING:
    import mujoco
    import numpy as np
    import warp as wp

    from myowarp.spec.scene import Scene


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


@dataclass(frozen=True)
class CoarseStep:
    """The longest physics steps that are still accurate.

    Attributes:
        dt: Time step [s]; the control step is cut evenly into steps that are no longer.
        implicitness: Share of the muscles' dF/dvelocity that the integrator takes in: 0.5 is the trapezoidal
            rule, 1 fully implicit.
    """

    dt: float
    implicitness: float


class Program(Protocol):
    """A task bound to the arrays of a scene: three kernels and what they need.

    Every method only launches kernels, so that a whole environment step can be captured as one graph.
    """

    def sample_start(self, mask: wp.array) -> None:
        """Draw what an episode starts from, in the worlds of `mask` (num_worlds,) bool.

        The common start configuration is in place; objects, and their properties, are drawn here.
        """

    def sample_goal(self, mask: wp.array) -> None:
        """Draw what the episode asks for, in the worlds of `mask` (num_worlds,) bool."""

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Write `obs` (num_worlds, obs_size) in the worlds of `mask`."""

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Write the raw reward terms (num_worlds, num_terms), and whether a world is solved, failed.

        `step_count` (num_worlds,) counts the steps of the episode, the present one included.
        """

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """World positions [m] of the goal's markers in one world by site name; host, for pictures."""


@dataclass(frozen=True)
class TaskSpec(abc.ABC):
    """A task, complete but for the number of worlds and the device.

    Attributes:
        name: Upstream's name of the task, such as `myoHandPoseFixed`.
        version: Version of our id; 0 keeps MyoSuite 3.0.0's semantics.
        body: Name in `BODIES`.
        num_substeps: Physics steps in a control step, upstream's `frame_skip`.
        physics_dt: Upstream's physics time step [s].
        integrator: Upstream's integrator, as in `PhysicsPreset`.
        horizon: Control steps in an episode.
        doc: One sentence: what the task asks for, and why this version exists.
    """

    name: str
    version: int
    body: str
    num_substeps: int
    horizon: int
    doc: str
    physics_dt: float = field(default=0.002, kw_only=True)
    integrator: str = field(default="EULER", kw_only=True)

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
        """Physics steps of coarse presets."""
        return COARSE_STEPS.get(self.family, COARSE_STEPS.get(self.body, CAUTIOUS_STEP))

    @property
    def scene_key(self) -> tuple[object, ...]:
        """What the compiled model depends on; tasks that agree in it share one on disk."""
        return (self.family, self.body, self.sites, self.physics_dt)

    @property
    def uses_kinematics(self) -> bool:
        """Whether observation or reward read body or site positions."""
        return True

    @property
    @abc.abstractmethod
    def sites(self) -> tuple[str, ...]:
        """Names of the sites that the task reads; they survive slimming."""

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
    def columns(self, num_joints: int, num_muscles: int) -> tuple[Column, ...]:
        """The observation vector, block by block."""

    @abc.abstractmethod
    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """The reward, term by term."""

    @abc.abstractmethod
    def bind(self, scene: Scene) -> Program:
        """Resolve names and allocate the arrays of the task in a compiled scene."""


PHYSICS = {
    "parity": PhysicsPreset(None, midstep=False, coarse=False),
    "fast": PhysicsPreset("IMPLICITFAST", midstep=True, coarse=True),
}
"""`parity`: MyoSuite's integrator and step. `fast`: implicit in velocity, activation exactly integrated, few
steps."""

COARSE_STEPS = {
    "elbow": CoarseStep(0.010, 1.0),
    "elbow_exo": CoarseStep(0.010, 1.0),
    "finger": CoarseStep(0.020 / 6, 0.6),
    "hand": CoarseStep(0.020 / 3, 0.5),
    "keyturn": CoarseStep(0.004, 0.35),
    "objecthold": CoarseStep(0.005, 0.5),
    "pentwirl": CoarseStep(0.005, 0.5),
    "baoding": CoarseStep(0.005, 0.35),
}
"""By task family, else by body: what keeps the root mean square error of the joints below 0.02 rad, against
steps of 0.1 ms over 0.2 s of policy-like excitations (benchmarks/accuracy.py)."""

CAUTIOUS_STEP = CoarseStep(0.004, 0.5)  # where nothing was measured

RESETS = ("task", "fixed", "random", "none")
"""What a new episode starts from: the task's own way; the task's start configuration; a random posture that
carries along what lies in the hand, free of penetration and of immediate failure; or the state that the last
episode left (reset-free, only goal and counters are new)."""

TASKS: Registry[TaskSpec] = Registry("task")
