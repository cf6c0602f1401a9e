"""Work that steps of `myowarp motion` share: set-up, checks before it, a motion in parts, last words."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console

from myowarp.disk import check_folder, check_overwrite, in_place
from myowarp.extras import to_install
from myowarp.progress import patient_bar

if TYPE_CHECKING:
    from myowarp.apps.cli.motion.options import Along
    from myowarp.motion.movement import Movement
    from myowarp.motion.results import AlongMotion
    from myowarp.motion.setup import TrialSetup
    from myowarp.motion.steps import Loaded
    from myowarp.osim.body.skeleton import Bones

    Step = Callable[[Bones, TrialSetup, Loaded], AlongMotion]

Found = TypeVar("Found")

RENEWED = {
    "contact_forces.sto": "contact forces on ",
    "moments.sto": "joint moments, ",
    "passive_moments.sto": "what springs, ",
    "report.html": '<!doctype html><html lang="en"><meta charset="utf-8"><title>A motion of ',
}
"""Files that several steps write, and how they begin: what one wrote, a later one may write again."""

PATIENCE = 5.0
"""Time after which a bar shows how far a motion is [s]."""


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


def check_results(
    output: Path, files: Iterable[str], overwrite: bool, renewed: Iterable[str] = ()
) -> Callable[[], object]:
    """Raise a clear error now if results could not be written, or would replace others; say which may.

    Args:
        output: Their folder.
        files: Their names.
        overwrite: Whether they may replace others.
        renewed: Those of them that may replace what an earlier step wrote.

    Returns:
        Checks again, before results take their places: another process may have written there meanwhile.

    Raises:
        ValueError: As it says.
    """

    def check() -> list[str]:
        again = [name for name in renewed if _begins(output / name, RENEWED[name])]
        own = [output / name for name in files if name not in again]
        check_overwrite(own, overwrite, "folder with --output")
        return again

    check_folder(output)
    if again := check():
        say([f"An earlier step wrote {', '.join(again)} in {output}; this one replaces it"])
    return check


def checked(results: Iterable[Found], check: Callable[[], object]) -> Iterator[Found]:
    """Yield results, and check once the last one was taken."""
    yield from results
    check()


def _begins(path: Path, text: str) -> bool:
    """Whether a file begins with a text."""
    if not path.is_file() or path.is_symlink():
        return False
    with path.open("rb") as file:
        return file.read(len(text.encode())) == text.encode()


def setup_of(command: Any, **more: Any) -> TrialSetup:
    """Return how a trial is solved: what a command states, and else what its set-up file has.

    Args:
        command: Its options bear the names of the set-up's fields, but for `filter`.
        more: Fields that are not as an option has them.

    Raises:
        ValueError: The file is none, or a number is out of bounds.
        OSError: A file cannot be read.
    """
    from myowarp.apps.cli.motion.options import Along
    from myowarp.motion.setup import MOTIONS, POSES, TrialSetup
    from myowarp.motion.tool_setup import read_tool_setup

    said = TrialSetup() if command.setup is None else read_tool_setup(command.setup)
    said.check_tool(MOTIONS if isinstance(command, Along) else POSES)
    stated = vars(command) | {"cutoff": getattr(command, "filter", None)} | more
    for name in ("markers", "orientations", "motion", "loads"):
        file = getattr(said, name)
        if file is not None and stated.get(name, file) is None and not file.is_file():
            raise ValueError(
                f"{str(said.file)!r} names {str(file)!r}, which is not there; give --{name} FILE"
            )
    names = [one.name for one in fields(TrialSetup) if one.name in stated]
    return said.stating(**{name: stated[name] for name in names})


def bones_of(command: Along, setup: TrialSetup) -> Bones:
    """Return the model of a step along a motion as a set-up has it, and say what it leaves out.

    Raises:
        As `Bones.read`.
    """
    from myowarp.osim.body.skeleton import Bones

    acts = setup.contact is not None
    read = Bones.read(command.model, function_paths=command.function_paths, contact=acts)
    bones, lines = setup.model_of(read)
    say([*applied(setup), *lines])
    return bones


def applied(setup: TrialSetup) -> list[str]:
    """Return what a set-up file and the options beside it come to, in one line; none without a file."""
    if setup.file is None:
        return []
    times = "all times" if setup.span is None else "{:g} to {:g} s".format(*setup.span)
    kept = "no filter" if setup.cutoff is None else f"a filter of {setup.cutoff:g} Hz"
    loads = "no loads" if setup.loads is None else f"loads {setup.loads.name}"
    return [f"With {setup.file.name} ({setup.tool}): {times}, {kept}, {loads}"]


def absent_from(motion: Movement) -> list[str]:
    """Return which coordinates a motion has not, in one line or none."""
    if not motion.absent:
        return []
    absent, every = len(motion.absent), motion.values.shape[1]
    wrong = f" (is it of this model? {every - absent} of {every} are there)" if 2 * absent > every else ""
    return [f"not in the file, and at default: {', '.join(motion.absent)}{wrong}"]


def along(
    command: Along,
    setup: TrialSetup,
    step: Step,
    files: Iterable[str],
    renewed: Iterable[str],
    each: Callable[[Any], None] = lambda found: None,
) -> list[str]:
    """Do a step along a motion, in parts where it is long, and write it; return what is to be said.

    Args:
        command: Its options.
        setup: Of the trial.
        step: Solves a part.
        files: As `check_results` has them.
        renewed: The same.
        each: Is told what was found of each part.

    Raises:
        ValueError: A file is not what it should be.
        OSError: A file cannot be read or written.
    """
    from myowarp.motion.results import written

    lines: list[str] = []
    needed(setup.motion, step.__name__, "motion")
    check = check_results(command.output, files, command.overwrite, renewed)
    bones = bones_of(command, setup)
    for found in written(checked(_solved(bones, setup, step), check), command.output):
        if not found.motion.first:
            lines += absent_from(found.motion)
        each(found)
    return lines


def _solved(bones: Bones, setup: TrialSetup, step: Step) -> Iterator[AlongMotion]:
    """Yield what a step finds of each part of a motion, and draw a bar where that takes long."""
    from myowarp.motion.steps import moved_in_parts

    with ExitStack() as stack:
        advance: Callable[[int], None] | None = None
        for part in moved_in_parts(bones, setup):
            if advance is None:
                frames = part.total or len(part.time)
                bar = patient_bar("Motion", "frames", frames, patience=PATIENCE)
                advance = stack.enter_context(bar)
            yield step(bones, setup, part)
            advance(len(part.time))


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


def page_of(command: Along, motion: Path) -> list[str]:
    """Write the page of a step along a motion, where it is short; return what is to be said.

    Raises:
        As `write_page`.
    """
    from myowarp.motion.streams import is_long

    if is_long(motion):
        return ["no page: the motion is too long for one"]
    if importlib.util.find_spec("matplotlib") is None:
        return [f"no page: it needs matplotlib; run {to_install('plot')}"]
    write_page(command.output, command.model, motion)
    return []
