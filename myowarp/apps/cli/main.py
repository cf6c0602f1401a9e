"""The command `myowarp`: its subcommands, and how an error ends it."""

import contextlib
import difflib
import functools
import gc
import io
import os
import re
import signal
import sys
from collections.abc import Callable, Mapping
from dataclasses import make_dataclass
from importlib.metadata import version
from typing import Annotated, Any, Union

import tyro
import warp as wp
from rich.console import Console

from myowarp.apps.cli.adapt import Adapt
from myowarp.apps.cli.audit import Audit
from myowarp.apps.cli.baselines import Baselines
from myowarp.apps.cli.cohort import Cohort
from myowarp.apps.cli.convert import Convert
from myowarp.apps.cli.demo import Demo
from myowarp.apps.cli.describe import Describe
from myowarp.apps.cli.eval import Eval
from myowarp.apps.cli.examples import Examples
from myowarp.apps.cli.export import Export
from myowarp.apps.cli.gait import GaitCommand
from myowarp.apps.cli.improve import Improve
from myowarp.apps.cli.motion import Motion
from myowarp.apps.cli.plot import Plot
from myowarp.apps.cli.record import Record
from myowarp.apps.cli.reproduce import Reproduce
from myowarp.apps.cli.rollout import Rollout
from myowarp.apps.cli.score import Score
from myowarp.apps.cli.sweep import Sweep
from myowarp.apps.cli.tasks import Tasks
from myowarp.apps.cli.train import Train
from myowarp.apps.cli.view import View
from myowarp.apps.cli.warmup import Warmup
from myowarp.definitions.registry import did_you_mean
from myowarp.disk import sentence

ABOUT = """Musculoskeletal motor control, simulated in thousands of worlds at once.

COMMAND --help explains a command; --version prints versions."""
COMMANDS: dict[str, type[Callable[[], None]]] = {
    "demo": Demo,
    "examples": Examples,
    "tasks": Tasks,
    "describe": Describe,
    "rollout": Rollout,
    "record": Record,
    "view": View,
    "plot": Plot,
    "cohort": Cohort,
    "adapt": Adapt,
    "audit": Audit,
    "train": Train,
    "improve": Improve,
    "gait": GaitCommand,
    "eval": Eval,
    "score": Score,
    "baselines": Baselines,
    "reproduce": Reproduce,
    "sweep": Sweep,
    "export": Export,
    "convert": Convert,
    "motion": Motion,
    "warmup": Warmup,
}
VERSIONS = ("mujoco", "mujoco-warp", "warp-lang", "myo-sim")
"""Packages that numbers depend on, besides ours."""
CONFIG = (tyro.conf.FlagCreatePairsOff,)
LONG = re.compile("--[a-z]")
ALIKE = 0.73  # of difflib: a slip of the fingers, and not another word
OPTION = re.compile(r"^[│ ] (?:-\w(?: \w+)?, )?(--[a-z][a-z-]*)", re.MULTILINE)
"""An option, where tyro's help begins to explain it."""


def _one_of(commands: Mapping[str, type], depth: int = 1) -> Any:
    """Return commands as tyro has them: with the whole help of the one asked for, else with one sentence.

    Args:
        commands: By name; one that has `COMMANDS` of its own has the chosen one as `chosen`.
        depth: Where the name stands on the command line.
    """
    kinds = []
    for name, kind in commands.items():
        brief = None if name in sys.argv[depth : depth + 1] else (kind.__doc__ or "").splitlines()[0]
        if below := getattr(kind, "COMMANDS", None):
            chosen = ("chosen", Annotated[_one_of(below, depth + 1), tyro.conf.arg(name="")])
            kind = make_dataclass(kind.__name__, [chosen], bases=(kind,), namespace={"__doc__": kind.__doc__})
        kinds.append(Annotated[kind, tyro.conf.subcommand(name=name, description=brief, prefix_name=False)])
    return Union[tuple(kinds)]  # noqa: UP007


def _unknown_word() -> str:
    """Return which command, step or option does not exist, and the nearest that does; "" where all exist."""
    typed, beside, kinds, kind = "", "", COMMANDS, object
    for word in sys.argv[1:]:
        if word in kinds:
            typed, beside, kind = f"{typed} {word}".strip(), typed, kinds[word]
            if not (below := getattr(kind, "COMMANDS", None)):
                break
            kinds = below
        elif not word.startswith("-"):
            hint = did_you_mean(word, kinds) or f"myowarp {typed}".strip() + " --help lists them"
            return f"{f'{typed} has no step' if typed else 'there is no command'} {word!r}; {hint}"
    else:
        return ""
    own = _options(kind)
    given = (word.partition("=")[0].replace("_", "-") for word in sys.argv[1:] if LONG.match(word))
    if (option := next((name for name in given if name not in own), None)) is None:
        return ""
    owners = dict.fromkeys(own, typed)
    for name, other in kinds.items() if beside else ():  # steps are about one motion, commands are not
        for known in _options(other):
            owners.setdefault(known, f"{beside} {name}")
    if not (near := difflib.get_close_matches(option, owners, 1, ALIKE)):
        return f"{typed} has no option {option}; myowarp {typed} --help lists its options"
    owner = "it" if owners[near[0]] == typed else owners[near[0]]
    return f"{typed} has no option {option}; {owner} has {near[0]}"


def _options(kind: type) -> list[str]:
    """Return the options of a command, as its help lists them."""
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
        tyro.cli(kind, args=["--help"], config=CONFIG)
    return OPTION.findall(shown.getvalue())


def _speak_utf8() -> None:
    """Begin again in Python's UTF-8 mode where the locale is ASCII, for paths with umlauts.

    In other locales a sign that the terminal lacks is shown by its number, and ends nothing.
    """
    if sys.getfilesystemencoding() == "ascii" and os.environ.get("PYTHONUTF8") != "1":
        os.execve(sys.executable, sys.orig_argv, os.environ | {"PYTHONUTF8": "1"})
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def command() -> None:
    """Entry point of the command, in a process of its own."""
    _speak_utf8()
    gc.freeze()  # half a million objects of Warp's stay to the end; not looking through them saves a second
    try:
        try:
            main()
        finally:
            sys.stdout.flush()  # not at the end of the interpreter, which complains
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    except BrokenPipeError:  # who reads has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + 13)  # SIGPIPE, which Windows does not name: what a shell reports of other tools


def _chosen() -> Callable[[], None]:
    """Return the command that was typed.

    Raises:
        ValueError: There is no such command, or it does not have an option.
        SystemExit: It was only explained, or tyro has said what is wrong.
    """
    read: Callable[..., Callable[[], None]] = functools.partial(
        tyro.cli, _one_of(COMMANDS), prog="myowarp", description=ABOUT, config=CONFIG
    )
    try:
        return read(console_outputs=False)
    except SystemExit:
        if sentence := _unknown_word():
            raise ValueError(sentence) from None
        return read()


def main() -> None:
    """Run the command; errors are one sentence and exit status 2."""
    if sys.argv[1:] == ["--version"]:
        print(f"myowarp {version('myowarp')} ({', '.join(f'{name} {version(name)}' for name in VERSIONS)})")
        return
    wp.config.log_level = wp.LOG_ERROR
    try:
        _chosen()()
    except BrokenPipeError:
        raise
    except (ValueError, OSError, RuntimeError, ImportError, MemoryError) as error:
        console = Console(stderr=True, highlight=False, soft_wrap=True)
        console.print(f"myowarp: {sentence(error)}", style="red", markup=False, emoji=False)
        sys.exit(2)


if __name__ == "__main__":
    command()
