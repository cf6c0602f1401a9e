"""Parts that steps of `myowarp motion` share: options, checks before work, a motion in parts, last words."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console

from myowarp.apps.cli.options import UNSET, described
from myowarp.disk import check_folder, check_overwrite, in_place, make_folder
from myowarp.extras import to_install
from myowarp.progress import patient_bar

if TYPE_CHECKING:
    from myowarp.motion.loads import Loads
    from myowarp.motion.setup import TrialSetup
    from myowarp.motion.storage import Tables
    from myowarp.motion.trial import Movement
    from myowarp.osim.body.skeleton import Bones

Model = Annotated[Path, tyro.conf.Positional, described("MODEL", "The model, .osim.")]
Recorded = Annotated[Path | None, described("FILE", "Joint angles over time, .mot or .sto.", UNSET)]
Loading = Annotated[Path | None, described("FILE", "OpenSim file of external loads.", UNSET)]
ToolFile = Annotated[
    Path | None,
    described(
        "FILE",
        "Set-up file of OpenSim's tool: files, filter, times, exponent and reserves are taken from it, as far"
        " as the step has them, unless they are given here.",
        UNSET,
    ),
]
FunctionPaths = Annotated[
    Path | None,
    described(
        "FILE",
        "Set of FunctionBasedPath, as Moco's, in place of the paths of the muscles that it names.",
        UNSET,
    ),
]
Contact = Annotated[
    Literal["opensim"] | None,
    described(
        "opensim", "Contact forces of the model act, as OpenSim computes them; by default they rest.", UNSET
    ),
]
Filter = Annotated[
    float | None, described("HZ", "Frequency below which the motion is kept; by default all is.", UNSET)
]
Span = Annotated[
    tuple[float, float] | None, described("START END", "First and last time [s]; by default all.", UNSET)
]
Mode = Annotated[
    Literal["equilibrium", "opensim"],
    described(
        "{equilibrium,opensim}",
        "What muscles can give; opensim: as its static optimisation, rigid tendons without passive force.",
    ),
]
Exponent = Annotated[
    float | None, described("FLOAT", "Of activations in the cost, at least 1; by default 2.", UNSET)
]
Reserve = Annotated[
    float | None,
    described(
        "FLOAT",
        "Moment of a reserve at cost 1 on every coordinate [N m, N]; by default those of the set-up file, or"
        " none.",
        UNSET,
    ),
]
Residual = Annotated[
    float | None,
    described(
        "FLOAT", "The same on coordinates that carry the model through space; by default --reserve.", UNSET
    ),
]
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"], help="Folder for the result.")]
OUT = Path("out/motion")

RENEWED = {
    "contact_forces.sto": "contact forces on ",
    "moments.sto": "joint moments, ",
    "passive_moments.sto": "what springs, ",
    "report.html": '<!doctype html><html lang="en"><meta charset="utf-8"><title>A motion of ',
}
"""Files that several steps write, and how they begin: what one wrote, a later one may write again."""

PATIENCE = 5.0
"""Time after which a bar shows how far a motion is [s]."""

SHOWN = 3
"""The worst of what is listed."""


def say(lines: Iterable[str]) -> None:
    """Say something, a line each."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for line in lines:
        console.print(line, markup=False)


def say_saved(lines: Iterable[str], files: Iterable[str], output: Path) -> None:
    """Say what was found, and where it is."""
    written = [name for name in files if (output / name).exists()]
    say([*lines, f"Saved {', '.join(written)} in {output}"])


def needed(path: Path | None, step: str, option: str) -> Path:
    """Return a file that a step cannot do without.

    Raises:
        ValueError: It is not given.
    """
    if path is None:
        raise ValueError(f"motion {step} needs --{option} FILE")
    return path


def check_results(output: Path, files: Iterable[str], overwrite: bool, renewed: Iterable[str] = ()) -> None:
    """Raise a clear error now if results could not be written, or would replace others; say which may.

    Args:
        output: Their folder.
        files: Their names.
        overwrite: Whether they may replace others.
        renewed: Those of them that may replace what an earlier step wrote.

    Raises:
        ValueError: As it says.
    """
    check_folder(output)
    again = [name for name in renewed if _begins(output / name, RENEWED[name])]
    own = [output / name for name in files if name not in again]
    check_overwrite(own, overwrite, "folder with --output")
    if again:
        say([f"An earlier step wrote {', '.join(again)} in {output}; this one replaces it"])


def _begins(path: Path, text: str) -> bool:
    """Whether a file begins with a text."""
    if not path.is_file() or path.is_symlink():
        return False
    with path.open("rb") as file:
        return file.read(len(text.encode())) == text.encode()


def setup_of(file: Path | None, **stated: Any) -> TrialSetup:
    """Return how a trial is solved: what is stated, and else what a set-up file has.

    Raises:
        ValueError: The file is none, or a number is out of bounds.
        OSError: A file cannot be read.
    """
    from myowarp.motion.setup import TrialSetup
    from myowarp.motion.tool_setup import read_tool_setup

    return (TrialSetup() if file is None else read_tool_setup(file)).stating(**stated)


def bones_of(model: Path, setup: TrialSetup, function_paths: Path | None = None) -> Bones:
    """Return a model as a set-up has it, and say what it leaves out.

    Raises:
        As `Bones.read`.
    """
    from myowarp.osim.body.skeleton import Bones

    bones, lines = setup.model_of(
        Bones.read(model, function_paths=function_paths, contact=setup.contact is not None)
    )
    say(lines)
    return bones


def absent_from(motion: Movement) -> list[str]:
    """Return which coordinates a motion has not, in one line or none."""
    return [f"not in the file, and at default: {', '.join(motion.absent)}"] if motion.absent else []


def along(
    bones: Bones,
    setup: TrialSetup,
    motion: Path,
    output: Path,
    solve: Callable[[Movement, Tables, Loads | None], object],
) -> list[str]:
    """Do a step along a motion, in parts where it is long; return what is to be said.

    Args:
        bones: The model.
        setup: Of the trial.
        motion: Its joint angles.
        output: Folder of the tables that `solve` writes.
        solve: Does the step for a part of the motion.

    Raises:
        ValueError: A file is not what it should be.
        OSError: A file cannot be read or written.
    """
    from myowarp.motion import trial
    from myowarp.motion.loads import Loads
    from myowarp.motion.storage import Tables
    from myowarp.motion.streams import is_long

    make_folder(output)
    lines: list[str] = []
    loads, advance = None, None
    with contextlib.ExitStack() as stack:
        if setup.loads is not None:
            loads = stack.enter_context(contextlib.closing(Loads(setup.loads, forwards=is_long(motion))))
        tables = stack.enter_context(Tables(output))
        for part in trial.read_parts(motion, bones, setup.cutoff, setup.span):
            if part.first == 0:
                lines += absent_from(part)
                frames = part.total or len(part.time)
                advance = stack.enter_context(patient_bar("Motion", "frames", frames, patience=PATIENCE))
            solve(part, tables, loads)
            if advance is not None:
                advance(len(part.time))
    return lines


def write_page(output: Path, model: Path, motion: Path | None) -> None:
    """Write the page on what a folder has.

    Raises:
        ValueError: It has no table of a step, or a file is not what it should be.
        OSError: A file cannot be read or written.
        ImportError: matplotlib is not installed.
    """
    from myowarp.apps.reports.motion import page
    from myowarp.osim.document.read.model import read_model

    text = page(output, read_model(model), motion)
    with in_place(output / "report.html") as scratch:
        scratch.write_text(text, encoding="utf-8")


def page_of(output: Path, model: Path, motion: Path) -> list[str]:
    """Write the page where matplotlib is installed; return what is to be said."""
    if importlib.util.find_spec("matplotlib") is None:
        return [f"no page: it needs matplotlib; run {to_install('plot')}"]
    write_page(output, model, motion)
    return []
