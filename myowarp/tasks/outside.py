"""Tasks from files and modules of the user's: `my_task.py:reach`, `package.module:reach`.

The file is run once, as Python runs a script: files beside it can be imported, also where files of another
folder have the same names (`neighbours`). It offers the tasks that it registers or holds as `TaskSpec`.
"""

from __future__ import annotations

import re
import traceback
from pathlib import Path
from types import ModuleType

from myowarp.definitions.task import TASKS, TaskSpec, register
from myowarp.tasks.neighbours import import_beside, import_file
from myowarp.tasks.variants import Variant, find_variant, variants_of


def find_task(name: str) -> Variant:
    """Return what a task on the command line stands for.

    Args:
        name: Id, with or without "MyoWarp/"; or a file or module, a colon, and the name of a task in it: its
            id, with or without version, the function under `@task`, or the variable that holds it.

    Raises:
        ValueError: There is no such id, file or task, or the file fails.
    """
    source, colon, wanted = name.rpartition(":")
    if not colon and name.endswith(".py"):
        source = name
    elif not colon:
        return find_variant(name)
    offered = tasks_of(source)
    wanted = wanted.removeprefix("MyoWarp/") if colon else ""
    if wanted in offered:
        return offered[wanted]
    versions = [key for key in offered if re.fullmatch(rf"{re.escape(wanted)}-v\d+", key)]
    if len(versions) == 1:
        return offered[versions[0]]
    keys = ", ".join(dict.fromkeys(variant.task for variant in offered.values())) or "none"
    if not wanted:
        raise ValueError(f"{source} needs the name of a task after a colon; tasks in it: {keys}")
    problem = f"has {len(versions)} versions of task" if versions else "has no task"
    raise ValueError(f"{source} {problem} {wanted!r}; tasks in it: {keys}")


def tasks_of(source: str) -> dict[str, Variant]:
    """Return the tasks of a file or module by every name that they have there.

    Raises:
        ValueError: There is no such file or module, or it fails.
    """
    before = set(TASKS)
    module = load(source)
    if module in _OFFERED:
        return _OFFERED[module]
    keys = dict.fromkeys(key for key in TASKS if key not in before)
    named: dict[str, str] = {}
    for name, value in vars(module).items():
        key = getattr(value, "key", None) if callable(value) or isinstance(value, TaskSpec) else None
        if isinstance(value, TaskSpec):
            register(value)
        if isinstance(key, str) and key in TASKS:
            named[name] = key
    keys |= dict.fromkeys(named.values())
    offered = {name: Variant(key) for name, key in named.items()}
    for key in keys:
        offered |= {env_id.removeprefix("MyoWarp/"): found for env_id, found in variants_of(key).items()}
    _OFFERED[module] = offered
    return offered


_OFFERED: dict[ModuleType, dict[str, Variant]] = {}
"""Variants of modules that were run: they register once."""


def load(source: str) -> ModuleType:
    """Import a Python file by its path, or a module by its name.

    Raises:
        ValueError: There is none, or it fails; the message says where.
    """
    path = Path(source)
    is_file = source.endswith(".py")
    if is_file and not path.is_file():
        raise ValueError(f"file {source!r} does not exist")
    try:
        return import_file(path.absolute()) if is_file else import_beside(Path.cwd(), source)
    except ModuleNotFoundError as error:
        if not is_file and error.name and f"{source}.".startswith(f"{error.name}."):
            raise ValueError(f"module {source!r} does not exist; a file ends in .py") from error
        raise ValueError(f"{source} cannot be imported: {_reason(error)}") from error
    except (Exception, SystemExit) as error:
        raise ValueError(f"{source} cannot be imported: {_reason(error)}") from error


def _reason(error: Exception | SystemExit) -> str:
    """Return where and why a module failed: its own last line on the way to the error."""
    if isinstance(error, SyntaxError):
        return f"line {error.lineno}: {error.msg}" if error.lineno else str(error.msg)
    frames = traceback.extract_tb(error.__traceback__)
    where = [f"line {frame.lineno}: " for frame in frames if frame.name == "<module>"]
    return f"{where[-1] if where else ''}{type(error).__name__}: {' '.join(str(error).split())}"
