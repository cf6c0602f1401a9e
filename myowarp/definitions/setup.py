"""The description of an environment, which environments, commands, studies and manifests take whole.

    setup = Setup(task="myoElbowPose1D6MRandom-v0", conditions=("sarcopenia(strength=0.3)",), seed=3)

A new option is a field here, and the place where it acts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from myowarp.definitions.body import BODIES
from myowarp.definitions.condition import Condition, condition_from
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.muscle_table import MuscleTable
from myowarp.definitions.option import checked, option, options_of
from myowarp.definitions.registry import check_least
from myowarp.definitions.senses import check_senses
from myowarp.definitions.task import PHYSICS, RESETS, TASKS, TaskSpec

MOST_SEED = 2**63 - 1  # world i has seed + i, a uint64
CONTACTS = ("mujoco", "opensim")
"""Engines that compute contact."""
UNRECORDED = ("task", "shards", "rank")
"""Options that `plain` leaves out: the task, which has a place of its own, and what only this process is."""


def _check_conditions(conditions: tuple[str | Condition, ...]) -> None:
    """Raise ValueError if a text stands for no condition."""
    for condition in conditions:
        if isinstance(condition, str):
            condition_from(condition)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """All that an environment is, but for the number of its worlds.

    A field that is None is what `over` puts in its place: what a training was made with, what a task's id
    says, at last `DEFAULTS`.
    """

    task: str | Path | TaskSpec | None = option(
        None,
        'Task id, with or without "MyoWarp/" (`myowarp tasks` lists them), or file.py:name for your own.',
        "ID",
    )
    physics: str | None = option(
        None,
        "parity: MyoSuite's integrator and step. fast: implicit integrator, muscles integrated exactly, and a"
        " longer step, which `myowarp describe ID` says. By default parity; a training has its preset's, else"
        " fast.",
        choices=PHYSICS,
    )
    muscle: str | MuscleTable | None = option(
        None,
        "Muscle model; by default mujoco, for a converted OpenSim model its own muscles (opensim).",
        choices=MUSCLES,
        check=lambda muscle: isinstance(muscle, MuscleTable) or MUSCLES[muscle],
    )
    muscle_parameters: Path | None = option(
        None,
        "Muscle parameters in place of the model's, .csv: column `muscle`, and one for each parameter.",
        "FILE",
    )
    reset: str | None = option(None, "What episodes start from; by default what the id says.", choices=RESETS)
    conditions: tuple[str | Condition, ...] | None = option(
        None,
        "Muscle conditions besides those of the id, such as fatigue_3ccr 'sarcopenia(strength=0.3)'.",
        "[NAME ...]",
        check=_check_conditions,
    )
    observe: tuple[str, ...] | None = option(
        None,
        "What is observed besides the task's own: history=8, the last 8 observations and actions; parameters,"
        " what the conditions make of the body.",
        "[NAME ...]",
        check=check_senses,
    )
    stops: bool | None = option(
        None,
        "Of --model: joints go beyond their ranges, as coordinates do in OpenSim; by default ranges of"
        " clamped coordinates, and limits of joints of an MJCF file, stop them.",
        flag=True,
    )
    contact: str | None = option(
        None,
        "Of --model: contact as MuJoCo computes it, or as OpenSim does with the file's contact forces; by"
        " default mujoco.",
        choices=CONTACTS,
    )
    horizon: int | None = option(None, "Control steps in an episode; by default the task's.", "INT")
    device: str | None = option(
        None, "Warp device, such as cpu or cuda:0; by default the GPU if there is one.", "NAME"
    )
    shards: int | None = option(
        None,
        "Threads that share the worlds on the CPU, which changes no result; by default all cores.",
        "INT",
        check=lambda shards: check_least(1, shards=shards),
    )
    rank: tuple[int, int] | None = option(None, "Which of how many equal ranks, each a process of its own.")
    seed: int | None = option(
        None,
        "World i resets with seed + i, and random policies draw from it; by default 0, in `myowarp eval`"
        " 1000000.",
        "INT",
        check=lambda seed: check_least(0, MOST_SEED, seed=seed),
    )

    def __post_init__(self) -> None:
        """Take one condition or sense for a tuple of one, and any others for a tuple."""
        for name in ("conditions", "observe"):
            given: Any = getattr(self, name)
            if given is not None and not isinstance(given, tuple):
                one = isinstance(given, (str, Condition)) or not isinstance(given, Iterable)
                object.__setattr__(self, name, (given,) if one else tuple(given))

    @classmethod
    def of(cls, what: Setup | TaskSpec | str | Path, **fields: Any) -> Setup:
        """Return a setup: one that is there, or that of a task, with other fields.

        Raises:
            TypeError: There is no such field.
        """
        setup = what if isinstance(what, Setup) else cls(task=what)
        return dataclasses.replace(setup, **fields)

    @property
    def spec(self) -> TaskSpec:
        """The task.

        Raises:
            ValueError: It is not registered.
        """
        return self.task if isinstance(self.task, TaskSpec) else TASKS[str(self.task)]

    @property
    def episode_steps(self) -> int:
        """Control steps in an episode: the horizon, else the task's."""
        return self.spec.horizon if self.horizon is None else self.horizon

    @property
    def muscles(self) -> MuscleTable:
        """The muscle model and its parameters.

        Raises:
            ValueError: There is no such model, or its file of parameters is wrong.
            OSError: The file cannot be read.
        """
        if not isinstance(self.muscle, MuscleTable):
            return MuscleTable.read(self.muscle or str(DEFAULTS.muscle), self.muscle_parameters)
        if self.muscle_parameters is not None:
            raise ValueError("muscle is a table of parameters already; leave muscle_parameters out")
        return self.muscle

    def over(self, other: Setup) -> Setup:
        """Return another setup with all that is said here in its place."""
        said = {f.name: getattr(self, f.name) for f in dataclasses.fields(Setup)}
        return dataclasses.replace(
            other, **{name: value for name, value in said.items() if value is not None}
        )

    def finished(self) -> Setup:
        """Return it with what its body and `DEFAULTS` say where nothing is said.

        Raises:
            ValueError: The task is not registered.
        """
        return self.over(dataclasses.replace(DEFAULTS, muscle=BODIES[self.spec.body].muscle))

    def check(self) -> None:
        """Raise ValueError, in one sentence, for a value that no task allows."""
        for name, entry in OPTIONS.items():
            if (value := getattr(self, name)) is not None:
                checked(entry, value, name)

    def plain(self) -> dict[str, Any]:
        """Return it as JSON holds it, but for the task and what only this process is; "" is an open text.

        Conditions that are no texts are left to whoever has them, and so are parameters of muscles that are
        in no file. A new option comes as it is.
        """
        muscle = self.muscle.model if isinstance(self.muscle, MuscleTable) else self.muscle
        texts = {"physics": self.physics, "muscle": muscle, "muscle_parameters": self.muscle_parameters}
        texts |= {"reset": self.reset, "device": self.device}
        found: dict[str, Any] = {name: "" if value is None else str(value) for name, value in texts.items()}
        found["conditions"] = [condition for condition in self.conditions or () if isinstance(condition, str)]
        found["observe"] = None if self.observe is None else list(self.observe)
        others = [f.name for f in dataclasses.fields(self) if f.name not in (*found, *UNRECORDED)]
        return found | {name: getattr(self, name) for name in others}

    @classmethod
    def from_plain(cls, recorded: Mapping[str, Any]) -> Setup:
        """Return what `plain` returned, or what earlier versions wrote: an empty text is nothing said."""
        names = cls().plain()
        said = {name: recorded[name] for name in names if recorded.get(name) not in ("", None)}
        if "conditions" in said:
            said["conditions"] = tuple(said["conditions"])
        if "muscle_parameters" in said:
            said["muscle_parameters"] = Path(said["muscle_parameters"])
        return cls(**said)


DEFAULTS = Setup(
    physics="parity", muscle="mujoco", reset="task", conditions=(), observe=(), rank=(0, 1), seed=0
)

OPTIONS = options_of(Setup)
Setup.__doc__ = (
    f"{Setup.__doc__}".rstrip()
    + "\n\n    Attributes:"
    + "".join(f"\n        {name}: {entry.metadata['text']}" for name, entry in OPTIONS.items())
)
