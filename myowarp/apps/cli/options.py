"""Options that several commands have, each described once; a field of a command names one as its type."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.task import PHYSICS, RESETS, TASKS
from myowarp.sim.build import num_substeps_of

UNSET = ""
"""What is said of a default that the help text itself explains."""


def longer_steps() -> str:
    """Return by what factor `fast` makes physics steps longer, body by body."""
    factors: dict[str, set[float]] = {}
    for key in TASKS:
        spec = TASKS[key]
        factor = spec.num_substeps / num_substeps_of(spec, PHYSICS["fast"])
        factors.setdefault(spec.body, set()).add(factor)
    parts = []
    for body, found in factors.items():
        low, high = f"{min(found):.2g}", f"{max(found):.2g}"
        parts.append(f"{body} {low}" if low == high else f"{body} {low} to {high}")
    return ", ".join(parts)


def optional(metavar: str) -> object:
    """Return what tyro is told about an option that need not be given, whose field has a docstring."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=UNSET)


def _option(metavar: str, text: str, hint: str | None = None) -> object:
    """Return what tyro is told about an option; `hint` replaces what it says of the default."""
    return tyro.conf.arg(metavar=metavar, help=text, help_behavior_hint=hint)


TASK = 'Task id, with or without "MyoWarp/" (`myowarp tasks` lists them), or file.py:name for your own.'
Task = Annotated[str, _option("ID", TASK)]
OptionalTask = Annotated[
    str | None,
    tyro.conf.Positional,
    _option("ID", TASK, UNSET),
]
Model = Annotated[
    Path | None,
    _option(
        "FILE",
        "Instead of a task: an MJCF file, such as `myowarp convert` writes; random poses of its joints."
        " Physics parity is then the file's own integrator and step.",
        UNSET,
    ),
]
Steps = Annotated[int | None, _option("INT", "Control steps; by default one episode of the task.", UNSET)]
Policy = Annotated[
    str,
    _option(
        "NAME",
        "random, zero, hold (pose tasks: proportional control of the joints), baseline (the trained policy"
        " of the package for the task, or for another version of it; `myowarp baselines list`), baselines/ID"
        " (that of another task),"
        " the folder of a trained policy, excitations over time (.sto, .mot, .csv; a column for each muscle),"
        " package.module:function or file.py:function: a function from observations (num_worlds, n) to"
        " actions (num_worlds, m) in [-1, 1].",
    ),
]
Device = Annotated[
    str | None,
    _option("NAME", "Warp device, such as cpu or cuda:0; by default the GPU if there is one.", UNSET),
]
Physics = Annotated[
    str,
    _option(
        "{" + ",".join(PHYSICS) + "}",
        "parity: MyoSuite's integrator and step. fast: implicit integrator, muscles integrated exactly, and a"
        f" longer step, by a factor that depends on the body: {longer_steps()}.",
    ),
]
Reset = Annotated[
    str | None,
    _option("{" + ",".join(RESETS) + "}", "What episodes start from; by default what the id says.", UNSET),
]
Conditions = Annotated[
    tuple[str, ...],
    _option(
        "[NAME ...]",
        "Muscle conditions besides those of the id, such as fatigue_3ccr 'sarcopenia(strength=0.3)'.",
        UNSET,
    ),
]
Muscle = Annotated[str, _option("{" + ",".join(MUSCLES) + "}", "Muscle model.")]
Overwrite = Annotated[bool, _option("", "Replace output files that exist.")]
TaskIds = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    _option(
        "[ID ...]",
        'Task ids, with or without "MyoWarp/", or file.py:name; none means every registered id.',
        UNSET,
    ),
]
