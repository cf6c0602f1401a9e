"""Files that are written whole or not at all, and results that are kept on disk between runs.

A key of the cache names everything the result depends on, package versions included. An entry that cannot be
read is made again, never trusted. `MYOWARP_CACHE_DIR` moves the folder.
"""

import contextlib
import hashlib
import os
import secrets
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import mujoco
import numpy as np
import platformdirs

T = TypeVar("T")

OURS = frozenset({"myowarp", "abc", "builtins"})
"""Packages that define what is ours, base classes of Python's included."""


@contextlib.contextmanager
def in_place(path: Path) -> Iterator[Path]:
    """Give the path of a scratch file beside `path`, and move it to `path` if the block succeeds.

    Otherwise the scratch file is deleted, and what was at `path` stays.
    """
    handle, name = tempfile.mkstemp(suffix=path.suffix, dir=path.parent)
    os.close(handle)
    scratch = Path(name)
    try:
        yield scratch
        mask = os.umask(0)
        os.umask(mask)
        scratch.chmod(0o666 & ~mask)
        scratch.replace(path)
    except BaseException:
        scratch.unlink(missing_ok=True)
        raise


def check_folder(folder: Path) -> None:
    """Raise a clear error now if files could not be written into a folder, which may not exist yet.

    Raises:
        ValueError: It is a file, or there is no permission.
    """
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise ValueError(
            f"output {str(folder)!r} cannot be written; it must be a folder, or a new one, and writable"
        )


def check_output(path: Path | None, *suffixes: str) -> None:
    """Raise a clear error now if a file could not be written after the work is done.

    Args:
        path: File to be written; None: none.
        suffixes: Endings that it may have.

    Raises:
        ValueError: Wrong suffix, no such folder, or no permission.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"output {str(path)!r} must end in {' or '.join(suffixes)}")
    if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise ValueError(f"output {str(path)!r} cannot be written; its folder must exist and be writable")


@cache
def version(package: str) -> str:
    """Return the version of an installed package."""
    return metadata.version(package)


def cache_dir() -> Path:
    """Return the folder of the cache; it may not exist yet."""
    default = platformdirs.user_cache_dir("myowarp")
    return Path(os.environ.get("MYOWARP_CACHE_DIR", default))


def files_digest(files: Iterable[Path]) -> str:
    """Return a digest of what files hold, in their order."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def is_ours(*definers: object) -> bool:
    """Whether functions, classes and their bases are all defined in this package."""
    return all(name.partition(".")[0] in OURS for name in _modules(definers))


def code_digest(*definers: object) -> str:
    """Return a digest of the files that define functions, classes and their bases: an edit makes it another.

    What a user's own file imports from other files of the user's counts too; installed packages do not. Code
    that is in no file, such as that of a notebook, has another digest in each process.
    """
    waiting = _modules(definers)
    files: dict[str, Path] = {}
    while waiting:
        name = waiting.pop()
        module = sys.modules.get(name)
        if name in files or module is None or name.partition(".")[0] in sys.stdlib_module_names:
            continue
        files[name] = path = Path(getattr(module, "__file__", None) or "")
        if not path.is_file():
            return secrets.token_hex()
        if not _is_users(path):
            continue
        for other in _modules(vars(module).values()):
            file = getattr(sys.modules.get(other), "__file__", None)
            if file is not None and _is_users(Path(file)):
                waiting.add(other)
    return files_digest(sorted(files.values()))


def _is_users(path: Path) -> bool:
    """Whether a file belongs to neither this package nor another installed one."""
    installed = [Path(__file__).parent, *map(Path, sysconfig.get_paths().values())]
    return path.suffix == ".py" and not any(folder in path.parents for folder in installed)


def _modules(objects: Iterable[object]) -> set[str]:
    """Return the names of the modules that define objects; of a class, of its bases too."""
    found = set()
    for thing in objects:
        if isinstance(thing, ModuleType):
            found.add(thing.__name__)
            continue
        thing = getattr(thing, "func", thing)  # of Warp's functions and kernels
        for base in getattr(thing, "__mro__", (thing,)):
            found.add(str(getattr(base, "__module__", None)))
    return found


def model_digest(model: mujoco.MjModel) -> str:
    """Return a digest of everything a compiled model holds."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).hexdigest()


def cached(
    key: tuple[object, ...],
    suffix: str,
    make: Callable[[], T],
    save: Callable[[T, str], None],
    load: Callable[[str], T],
) -> T:
    """Return the object that `key` names: loaded from disk if there, else made and saved.

    Args:
        key: What the result depends on; `repr` must identify it. Versions of mujoco and myo-sim are
            added.
        suffix: File suffix, dot included.
        make: Builds the object.
        save: Writes the object to a path.
        load: Reads it back; raises ValueError, EOFError or OSError on a damaged file.

    Returns:
        The object. A cache folder that cannot be written only costs time.
    """
    versions = (version("mujoco"), version("myo-sim"))
    digest = hashlib.sha256(repr((key, versions)).encode()).hexdigest()[:24]
    path = cache_dir() / f"{digest}{suffix}"
    if path.exists():
        try:
            return load(str(path))
        except (ValueError, EOFError, OSError):
            pass  # damaged or unreadable: made again below
    entry = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with in_place(path) as scratch:
            save(entry, str(scratch))
    except OSError:
        pass  # without a cache the next start takes as long as this one
    return entry
