"""Tasks before any array exists: frozen, hashable, checked on the host.

A task family (`tasks/<family>.py`) subclasses `TaskSpec` once; a function under `@task` returns the instance
of each id. From its tables (`columns`, `reward_terms`, `draws`) follow the kernels, the spaces, the info
keys, the documentation and the tests.
"""

from __future__ import annotations

import abc
import dataclasses
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES, CoarseStep
from myowarp.definitions.entries import Entry, Names, entries
from myowarp.definitions.registry import Registry, is_integer
from myowarp.kernels.world_function import Source

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True)
class Column:
    """A named block of the observation vector.

    Attributes:
        name: Name of the block.
        size: How many numbers it has.
        unit: Their unit; "1" for none.
        doc: What they are.
        names: What each is called; () where they are only counted.
        source: What is copied there, or a function of one world that returns a number or a vector
            (`kernels.world_function`); None: the program's own `observe` writes it.
    """

    name: str
    size: int
    unit: str
    doc: str = ""
    names: Names = ()
    source: Source | None = None

    def entries(self, model: mujoco.MjModel) -> tuple[Entry, ...]:
        """Return name and unit of each of its numbers, which are the first ones that `names` finds.

        Raises:
            ValueError: There are fewer names than numbers.
        """
        found = entries(self.names or tuple(map(str, range(self.size))), self.unit, model)
        if len(found) < self.size:
            raise ValueError(f"column {self.name!r} has {self.size} numbers, but {len(found)} names")
        return found[: self.size]


@dataclass(frozen=True)
class RewardTerm:
    """A named term of the reward; `reward = sum(weight * term)`. Weight 0: logged only.

    Attributes:
        name: Name of the term.
        weight: Its weight.
        unit: Unit of the term before weighting; "1" for none.
        doc: What it is.
        source: A function of one world that returns the term; None: the program's own `score` writes it.
    """

    name: str
    weight: float
    unit: str = ""
    doc: str = ""
    source: wp.Function | None = None


@dataclass(frozen=True)
class Draw:
    """A quantity that a new episode draws uniformly; with equal bounds it always has that value.

    Attributes:
        name: Name of the quantity.
        unit: Its unit.
        low: Lower bounds, one for each of its numbers; () stands for the ranges of the joints.
        high: Upper bounds.
        doc: What it is.
        names: What each number is called, as in `Column`.
        when: "goal": in every episode; "start": where the state is reset, which reset "none" does not;
            "posture": under reset "task" only.
        choices: Values that are equally likely, in place of bounds.
        array: Name of the program's array (num_worlds, n) to draw it into, state `task.<array>`; "": the
            program's own `sample_start` or `sample_goal` draws it.
        stream: Its stream of random numbers; None: one of its own, which follows from its name.

    Raises:
        ValueError: It has an array, but neither bounds in pairs nor choices, or another `when`.
    """

    name: str
    unit: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    doc: str
    names: Names = ()
    when: str = "goal"
    choices: tuple[float, ...] = ()
    array: str = ""
    stream: int | None = None

    def __post_init__(self) -> None:
        """Check what can be drawn."""
        if self.array and not (self.choices or 0 < len(self.low) == len(self.high)):
            raise ValueError(
                f"draw {self.name!r} must have as many lower as upper bounds, or choices, "
                f"got {self.low!r} and {self.high!r}"
            )
        if self.array and self.when not in ("goal", "start"):
            raise ValueError(f"draw {self.name!r} must be drawn at 'goal' or 'start', got {self.when!r}")

    @property
    def size(self) -> int:
        """Return its count of numbers."""
        return len(self.low) or 1

    @property
    def varies(self) -> bool:
        """Whether episodes differ in it."""
        return len(self.choices) > 1 if self.choices else not self.low or self.low != self.high


@dataclass(frozen=True)
class PhysicsPreset:
    """The division of a control step into physics steps.

    Attributes:
        integrator: Name of a `mujoco.mjtIntegrator` member without its prefix; None: the task's.
        midstep: Whether a muscle pulls with its activation in the middle of the physics step, exactly
            integrated, rather than with that at its start (MuJoCo's order).
        coarse: Whether physics steps are the task's `coarse_step`, rather than upstream's, and joints that
            follow others do so exactly, where they can, rather than by springs.
    """

    integrator: str | None
    midstep: bool
    coarse: bool


MOST_SUBSTEPS = 10_000  # physics steps in a control step: one that lasts seconds is a mistake

Judgement = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of each target: whether it can be met well enough to count as solved, whether exactly, and the miss."""


@dataclass(frozen=True)
class Shown:
    """A recording that shows a family of tasks.

    Attributes:
        text: A sentence about what is seen.
        task: Id of the task.
        policy: What acts.
        steps: Control steps.
        every: Control steps from picture to picture.
    """

    text: str
    task: str
    policy: str
    steps: int
    every: int


@dataclass(frozen=True, kw_only=True)
class TaskSpec(abc.ABC):
    """A task, complete but for the number of worlds and the device.

    Attributes:
        program: `definitions.program.Program`, or its subclass; called with the task and a scene.
        measures: Functions of one world whose values others read by these names, such as an error; `solved`
            and `failed` among them say when a world is solved, and when its episode fails.
        linear_excitation: Whether an action from -1 to 1 is an excitation from 0 to 1 in proportion, rather
            than by MyoSuite's sigmoid.
        least_contacts: Contacts that a world must have room for, where random motion from the start does not
            show how many there can be (`sim/capacity.py`).
        world_bytes: Memory of what a world has besides the engine's arrays, where that is much
            (`sim/memory.py`).
        title: Name of the family for people; by default that of its class.
        shown: What shows the family in the documentation; None: nothing does.
        name: Upstream's name of the task, such as `myoHandPoseFixed`; `@task` takes it from the id.
        version: Version of our id, from there too; 0 keeps MyoSuite 3.0.0's semantics.
        body: Name in `BODIES`.
        num_substeps: Physics steps in a control step, upstream's `frame_skip`.
        physics_dt: Upstream's physics time step [s].
        integrator: Upstream's integrator, as in `PhysicsPreset`.
        start_pose: Configuration from which episodes start, shape (nq,); () means the model's zero.
        horizon: Control steps in an episode.
        doc: One sentence: what the task asks for, and why this version exists.
    """

    program: ClassVar[type]
    measures: ClassVar[Mapping[str, wp.Function]] = {}
    linear_excitation: ClassVar[bool] = False
    least_contacts: ClassVar[int] = 0
    world_bytes: ClassVar[int] = 0
    title: ClassVar[str] = ""
    shown: ClassVar[Shown | None] = None

    def __init_subclass__(cls) -> None:
        """Name the family after its class, and show none by what its parent shows."""
        words = re.findall("[A-Z][a-z0-9]*", cls.__name__.removesuffix("Task"))
        cls.title = vars(cls).get("title", " ".join(words).capitalize())
        cls.shown = vars(cls).get("shown")

    name: str = ""
    version: int = 0
    body: str
    num_substeps: int
    horizon: int
    doc: str = ""
    physics_dt: float = 0.002
    integrator: str = "EULER"
    start_pose: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check what needs no model.

        Raises:
            ValueError: A number is NaN, or steps, start or text are not as described.
        """
        if not isinstance(self.doc, str):
            raise ValueError(f"doc must be a sentence, got {self.doc!r}")
        steps = self.num_substeps
        if not is_integer(steps) or not 0 < steps <= MOST_SUBSTEPS:
            raise ValueError(f"num_substeps must be an integer from 1 to {MOST_SUBSTEPS}, got {steps!r}")
        if not self.physics_dt > 0.0 or not np.isfinite([self.physics_dt, *self.start_pose]).all():
            raise ValueError(
                "physics_dt must be positive, and start_pose finite, "
                f"got {self.physics_dt!r} and {self.start_pose!r}"
            )
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, float) and np.isnan(number):
                    raise ValueError(f"{field.name} must hold numbers, got {value!r}")

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
    def summary(self) -> str:
        """Return the aim of the task: the first sentence of `doc`."""
        return self.doc.partition(". ")[0].removesuffix(".") + "."

    @property
    def why(self) -> str:
        """Return the rest of `doc`: corrections of this version, with reasons; "" if there is none."""
        return self.doc.partition(". ")[2]

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
        """Return a key of the compiled model; tasks that agree in it share one on disk."""
        return (self.family, self.body, self.sites, self.physics_dt)

    @property
    def large(self) -> bool:
        """Whether a step costs many times that of a hand, so that not every test is for every day."""
        return BODIES[self.body].large

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

    @property
    def loose(self) -> tuple[str, ...]:
        """Names of the bodies that lie elsewhere; a random start posture leaves them where they are."""
        return ()

    @property
    def start_doc(self) -> str:
        """Return a description of `start`."""
        return "the model's zero pose"

    @property
    def solved_when(self) -> str:
        """When a state counts as solved, for people: a clause, with thresholds and units."""
        return ""

    @property
    def failed_when(self) -> str:
        """When the episode fails and ends, for people: a clause, with thresholds and units."""
        return ""

    @property
    def draws(self) -> tuple[Draw, ...]:
        """Return the quantities that new episodes draw."""
        return ()

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the configuration from which episodes start, shape (nq,).

        Raises:
            ValueError: `start_pose` does not fit the model.
        """
        if len(self.start_pose) not in (0, model.nq):
            raise ValueError(
                f"start_pose of task {self.key!r} must have {model.nq} entries, got {len(self.start_pose)}"
            )
        return np.array(self.start_pose) if self.start_pose else model.qpos0.copy()

    def judge(self, model: mujoco.MjModel, targets: np.ndarray) -> Judgement | None:
        """Judge by joint ranges alone which targets can be met.

        Args:
            model: The task's model.
            targets: Different rows of `task.target`, shape (num_targets, size).

        Returns:
            None where the family has no rule.

        Raises:
            ValueError: The reach of this body is not solved.
        """
        return None

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

RESETS = {
    "task": "the task's own way",
    "fixed": "the task's start configuration",
    "random": "a random posture, free of penetration and of immediate failure",
    "none": "the state that the last episode left (reset-free); a reset that is asked for, and one after a"
    " fault, starts as fixed does",
}
"""Starts of a new episode; a random posture carries along objects in the hand."""

LISTED_BY = "`myowarp tasks` lists them, variants with a condition at the end, and --paper the paper's grid"
TASKS: Registry[TaskSpec] = Registry("task", listed_by=LISTED_BY)

Spec = TypeVar("Spec", bound=TaskSpec)


def split_key(key: str) -> tuple[str, int]:
    """Return name and version of a task id such as `myoHandPoseFixed-v0`.

    Raises:
        ValueError: It is not made of these.
    """
    match = re.fullmatch(r"(\w+)-v(\d+)", key) if isinstance(key, str) else None
    if match is None:
        raise ValueError(f"task id {key!r} must be a name and a version, such as 'myoHandPoseFixed-v0'")
    return match[1], int(match[2])


def task(
    key: str, why: str = "", *, replace: bool = False, **otherwise: Any
) -> Callable[[Callable[[], Spec]], Callable[[], Spec]]:
    """Register the task that a function returns; the function's docstring says what the task asks for.

    Args:
        key: Name and version, such as `myoHandPoseFixed-v0`.
        why: Why this version exists; it follows the docstring in the task's `doc`.
        replace: Whether it may take the place of a task that is registered.
        **otherwise: Fields that this version has otherwise than the task that the function returns.

    Raises:
        ValueError: The key has no version, or is taken.
    """
    name, version = split_key(key)

    def register_made(make: Callable[[], Spec]) -> Callable[[], Spec]:
        doc = " ".join(f"{make.__doc__ or ''} {why}".split())
        spec = make()
        if not isinstance(spec, TaskSpec):
            raise ValueError(f"task {key!r} must be a TaskSpec, got {type(spec).__name__}")
        register(dataclasses.replace(spec, name=name, version=version, doc=doc, **otherwise), replace=replace)
        make.__dict__["key"] = key
        return make

    return register_made


def register(spec: Spec, *, replace: bool = False) -> Spec:
    """Register a task: `gymnasium.make`, `gymnasium.make_vec` and the command line then know its id.

    Args:
        spec: The task; its name and version are the id.
        replace: Whether it may take the place of a task that is registered, such as that of an edited
            notebook cell. Environments made before keep theirs; the package's own tasks stay.

    Returns:
        The task.

    Raises:
        ValueError: It is no task, or its name is none or taken.
    """
    if not isinstance(spec, TaskSpec):
        raise ValueError(f"what is registered must be a TaskSpec, got {type(spec).__name__}")
    split_key(spec.key)
    if spec.body not in BODIES:
        raise ValueError(f"task {spec.key!r} needs a body in BODIES, got {spec.body!r}")
    if spec.key not in TASKS or TASKS[spec.key] != spec:
        TASKS.add(spec.key, spec, replace=replace)
    return spec
