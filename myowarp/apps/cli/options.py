"""Options that several commands have, each described once; a field of a command names one as its type.

Those of an environment are the fields of `Setup`: a command has `asked: Environment`, or says what it leaves
out, `asked: Annotated[Asked, environment(leave_out=...)]`, and calls `self.asked.setup`.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol

import tyro

from myowarp.definitions.setup import OPTIONS, Setup

UNSET = ""
"""The default, where the help text itself explains it."""


def optional(metavar: str) -> object:
    """Return what tyro is told about an option that need not be given, whose field has a docstring."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=UNSET)


def described(metavar: str, text: str, hint: str | None = None) -> object:
    """Return what tyro is told about an option; `hint` replaces what it says of the default."""
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint=hint)


class Asked(Protocol):
    """A user's options of an environment."""

    @property
    def setup(self) -> Setup:
        """Return the options as a setup.

        Raises:
            ValueError: Both a task and a model's file are given.
        """


@dataclass(frozen=True)
class Said:
    """An `Asked` for a command that another one calls."""

    setup: Setup


MODEL = described(
    "FILE",
    "Instead of a task: a model of OpenSim (.osim), an MJCF file, or the name of a body, such as full_body;"
    " random poses of its joints. Physics parity is then the model's own integrator and step.",
    UNSET,
)


def environment(*, flag: bool = False, only: Iterable[str] = OPTIONS, leave_out: Iterable[str] = ()) -> Any:
    """Return what tyro is told about the options of an environment, all that `Setup` has.

    Args:
        flag: Whether the task is an option, `--task ID`, in place of the first argument.
        only: Fields that a command has.
        leave_out: Fields that a command does not have.
    """
    kinds = typing.get_type_hints(Setup) | COMMAND_LINE
    fields: list[tuple[str, Any, Any]] = []
    for name, option in OPTIONS.items():
        shown = option.metadata["choices"] or option.metadata["form"] or option.metadata["flag"]
        if not shown or name not in only or name in leave_out:
            continue
        fields.append(flag_of(option, kinds[name]))
        if name == "task":
            fields.append(("model", Annotated[Path | None, MODEL], dataclasses.field(default=None)))
            if not flag:
                fields[0] = (name, Annotated[fields[0][1], tyro.conf.Positional], fields[0][2])
    made = dataclasses.make_dataclass(
        "Environment", fields, kw_only=True, namespace={"setup": property(_setup)}
    )
    return tyro.conf.arg(name="", constructor=made)


def flag_of(option: dataclasses.Field[Any], kind: Any, hint: str = UNSET, more: str = "") -> Any:
    """Return an option as a field of a command, None where it is not given.

    Args:
        option: The option.
        kind: Its type.
        hint: What is said of its default, where the text does not.
        more: What is said behind the text.
    """
    told = option.metadata
    choices = ",".join(filter(None, told["choices"]))
    form = f"{{{choices}}}" if choices else told["form"] or FORMS.get(kind, "")
    said, switch = described(form, told["text"] + more, hint), told["flag"]
    default = dataclasses.field(default=True if switch else None)
    return option.name, Annotated[bool if switch else kind | None, said], default


FORMS = {int: "INT", float: "FLOAT", str: "NAME", tuple[int, ...]: "[INT ...]"}
"""Values on a command line, by their type."""
COMMAND_LINE = {"task": str | None, "muscle": str | None, "conditions": tuple[str, ...] | None}
"""Types of what a command line can say, where a setup takes more."""


def _setup(self: Any) -> Setup:
    """Return the setup of an `Asked`."""
    said = {name: None if value is True else value for name, value in vars(self).items()}
    model = said.pop("model", None)
    if model is not None and said["task"] is not None:
        raise ValueError(
            "what to run is a task id or --model with a file, one of them; got "
            f"{said['task']!r} and {str(model)!r}"
        )
    return Setup(**said if model is None else said | {"task": model})


Environment = Annotated[Asked, environment()]


@dataclass(frozen=True)
class Trial:
    """A recorded motion of --model in place of a policy that acts."""

    motion: Annotated[Path | None, optional("FILE")] = None
    """A recorded motion of --model FILE.osim, played in place of a policy: joint angles, .mot or .sto, or a
    folder that `myowarp motion` has written."""
    results: Annotated[Path | None, optional("FOLDER")] = None
    """Muscle forces, activations, moments and electromyograms of the motion, as `myowarp motion` has written
    them; by default beside it."""
    loads: Annotated[Path | None, optional("FILE")] = None
    """OpenSim file of external loads, shown as arrows."""

    def source(self, asked: Asked) -> Path | None:
        """Return the model of the motion; None: there is no motion.

        Raises:
            ValueError: There is a motion without its model, or what belongs to one without a motion.
        """
        if self.motion is None:
            for name in ("results", "loads"):
                if getattr(self, name) is not None:
                    raise ValueError(f"--{name} belongs to a recorded motion; give it with --motion FILE")
            return None
        if asked.setup.stops is not None:
            raise ValueError("--no-stops is of a simulation; leave it out where a recorded motion is played")
        model = asked.setup.task
        if not isinstance(model, Path) or model.suffix.lower() != ".osim":
            raise ValueError("--motion needs the model that moves, --model FILE.osim")
        return model


Recording = Annotated[Trial, tyro.conf.arg(name="")]
Steps = Annotated[int | None, described("INT", "Control steps; by default one episode of the task.", UNSET)]
POLICIES = (
    "random; zero; hold (pose tasks: proportional control of the joints); muscle-control (pose and reach"
    " tasks: activations that move the joints to the target); baseline (the package's trained policy of the"
    " task, or of another version of it; `myowarp baselines list`); baselines/ID (that of another task); the"
    " folder of a trained policy; excitations over time (.sto, .mot, .csv, a column for each muscle); a gait"
    " of reflexes (.json); or your own function, file.py:function or package.module:function, from"
    " observations (num_worlds, n) to actions (num_worlds, m) in [-1, 1]."
)
Policy = Annotated[str, described("NAME", POLICIES)]
OwnPolicy = Annotated[str, described("NAME", POLICIES, "(default: random; with --model zero)")]
Overwrite = Annotated[bool, described("", "Replace output files that exist.")]
TaskIds = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    described(
        "[ID ...]",
        'Task ids, with or without "MyoWarp/", or file.py:name; none means every registered id.',
        UNSET,
    ),
]
