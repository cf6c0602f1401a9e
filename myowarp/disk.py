"""Files that are written whole or not at all, and results that are kept on disk between runs.

A key of the cache names everything the result depends on, package versions included. An entry is kept with
its SHA-256: one that was changed is made again, never trusted. `MYOWARP_CACHE_DIR` moves the folder; where it
cannot be written, a temporary one takes its place.
"""

import contextlib
import csv
import errno
import hashlib
import io
import logging
import math
import os
import re
import secrets
import socket
import stat
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import IO, Any, TypeVar

import mujoco
import numpy as np
import platformdirs

T = TypeVar("T")

logger = logging.getLogger("myowarp")
SCRATCH = ".myowarp-"
"""Prefix of files that are being written; readers of datasets skip names with a leading dot."""
NO_FILE = "is no file and is left alone; choose another name"
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
NUMBER = re.compile(r"[ \t]*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?[ \t]*")
OURS = frozenset({"myowarp", "abc", "builtins"})
"""Packages that define what is ours, base classes of Python's included."""


@contextlib.contextmanager
def in_place(path: Path) -> Iterator[Path]:
    """Give the path of a scratch file beside `path`, and move it to `path` if the block succeeds.

    Otherwise the scratch file is deleted, and what was at `path` stays. A link at `path` is replaced; what it
    points to is left alone. A folder that does not exist is made.

    Raises:
        OSError: Nothing can be written there, in one sentence that names the path.
        ValueError: The folder cannot be made.
    """
    if path.exists() and not path.is_file():
        raise OSError(f"output {str(path)!r} {NO_FILE}")
    if not path.parent.exists():
        make_folder(path.parent)
    with naming(path):
        handle, name = tempfile.mkstemp(suffix=path.suffix, prefix=SCRATCH, dir=path.parent)
        scratch = Path(name)
        try:
            with os.fdopen(handle) as held:
                with contextlib.suppress(OSError):
                    _flock(held)
                yield scratch
            mask = os.umask(0)
            os.umask(mask)
            scratch.chmod(0o666 & ~mask)
            scratch.replace(path)
        except BaseException:
            scratch.unlink(missing_ok=True)
            raise


def write_rows(path: Path, rows: Iterable[Iterable[object]]) -> None:
    """Write a table of comma-separated values.

    Raises:
        OSError: The file cannot be written.
    """
    with in_place(path) as scratch, scratch.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Say of which output an error of the disk is, and what to do.

    Raises:
        OSError: The error in one sentence.
    """
    try:
        yield
    except OSError as error:
        ours = Path(str(error.filename or "")).name.startswith(SCRATCH)
        if not (ours or error.errno in NO_ROOM):
            raise
        remedy = "make room there" if error.errno in NO_ROOM else "its folder must be writable"
        why = os.strerror(error.errno) if error.errno else type(error).__name__
        raise OSError(
            f"output {str(path)!r} cannot be written ({why}); {remedy}, or choose another folder"
        ) from error


def sentence(error: BaseException) -> str:
    """Return an error as a sentence; those of the system name the file, and no number."""
    if isinstance(error, OSError) and error.strerror:
        if error.errno in NO_ROOM:
            return f"a file cannot be written ({os.strerror(error.errno)}); make room on the disk"
        if error.filename is not None:
            return f"{str(error.filename)!r} cannot be used: {error.strerror}"
    if isinstance(error, UnicodeEncodeError):
        part = error.object[max(error.start - 40, 0) : error.end + 40]
        return f"{part!r} has characters that are none of {error.encoding}; choose another name"
    return str(error)


def sweep(folder: Path) -> None:
    """Delete the scratch files that processes which died have left in a folder."""
    for scratch in folder.glob(f"{SCRATCH}*"):
        with contextlib.suppress(OSError), scratch.open("rb") as file:
            if _flock(file):
                scratch.unlink()


def _flock(file: IO[Any], *, wait: bool = False) -> bool:
    """Lock an open file until it is closed or the process dies; return False if another process holds it.

    Raises:
        OSError: This system or disk has no locks.
    """
    try:
        import fcntl
    except ImportError:
        raise OSError(errno.ENOLCK, "no locks on this system") from None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    return True


@contextlib.contextmanager
def locked(path: Path, *, wait: bool) -> Iterator[None]:
    """Hold a lock file during the block; the system lets go of it when a process dies.

    Args:
        path: The file; it is made if it does not exist, says which process holds it or did, and stays.
        wait: Whether to wait for another process that holds it.

    Raises:
        ValueError: Another process holds it, or it is a link.
        OSError: The file cannot be written.
    """
    if path.is_symlink():
        raise ValueError(f"lock {str(path)!r} is a link, and a lock is a file of its own; delete the link")
    with path.open("a+") as file:
        try:
            free = _flock(file, wait=wait)
        except OSError as error:  # Windows and some network file systems have none of these locks
            free = True
            logger.warning(
                "folder %s cannot be locked (%s); start nothing else in it", path.parent, error.strerror
            )
        if not free:
            file.seek(0)
            raise ValueError(
                f"folder {str(path.parent)!r} is in use by {file.read() or 'another process'}; wait for it, "
                "or choose another --output"
            )
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}")
        file.flush()
        yield


def existing(folder: Path) -> Path:
    """Return the nearest folder or file that exists: the path itself, or one above it.

    Raises:
        OSError: No system takes such a name.
    """
    return next(path for path in (folder, *folder.absolute().parents) if path.exists())


def check_folder(folder: Path) -> None:
    """Raise a clear error now if files could not be written into a folder, which may not exist yet.

    Raises:
        ValueError: It is a file, or there is no permission, or no system takes such a name.
    """
    try:
        there = existing(folder)
        right = there.is_dir() and os.access(there, os.W_OK)
    except OSError:  # such as a name that is too long
        right = False
    if not right:
        raise ValueError(
            f"output {str(folder)!r} cannot be written; it must be a folder, or a new one, and writable"
        )


def make_folder(folder: Path) -> None:
    """Make a folder, and those in which it lies, where they do not exist; sweep it.

    Raises:
        ValueError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"output {str(folder)!r} cannot be made ({error.strerror}); it must be a folder, or a new one, "
            "and writable"
        ) from error
    sweep(folder)


def check_output(path: Path | None, *suffixes: str) -> None:
    """Raise a clear error now if a file could not be written after the work is done.

    Args:
        path: File to be written; None: none.
        suffixes: Endings that it may have.

    Raises:
        ValueError: Wrong suffix, no file, no folder that could be made, or no permission.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"output {str(path)!r} must end in {' or '.join(suffixes)}")
    if path.exists() and not path.is_file():
        raise ValueError(f"output {str(path)!r} {NO_FILE}")
    check_folder(path.parent)


def check_overwrite(paths: Iterable[Path | None], overwrite: bool, other: str = "name") -> None:
    """Raise a clear error now if files are there that would be replaced, or one would be written twice.

    Args:
        paths: Files to be written; None: none.
        overwrite: Whether they may be replaced.
        other: What the user may choose otherwise.

    Raises:
        ValueError: One is there and may not be replaced, or two are the same.
    """
    seen: set[Path] = set()
    for path in filter(None, paths):
        if path.resolve() in seen:
            raise ValueError(f"output {str(path)!r} is asked for twice; give each output a file of its own")
        seen.add(path.resolve())
        if os.path.lexists(path) and not overwrite:
            raise ValueError(
                f"output {str(path)!r} exists; choose another {other}, or replace it with --overwrite"
            )


def shipped(path: str) -> Path:
    """Return a file or folder that the wheel brings along, by its path in the repository."""
    package = Path(__file__).parent
    inside = package / "shipped" / path
    return inside if inside.exists() else package.parent / path


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: NaN and infinity as None."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    return [plain(entry) for entry in value] if isinstance(value, list | tuple) else value


@cache
def version(package: str) -> str:
    """Return the version of an installed package."""
    return metadata.version(package)


def cache_dir() -> Path:
    """Return the folder of the cache; it may not exist yet, or be read-only."""
    default = platformdirs.user_cache_dir("myowarp")
    return Path(os.environ.get("MYOWARP_CACHE_DIR", default))


@cache
def writable_folder(folder: Path, variable: str) -> Path:
    """Return a folder in which files can be kept: `folder` or, which a line says, a temporary one.

    Args:
        folder: Where they should be kept; it is made if it does not exist.
        variable: Name of the environment variable that moves it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        reason = "" if os.access(folder, os.W_OK | os.X_OK) else "no permission to write"
    except OSError as error:
        reason = error.strerror or type(error).__name__
    if not reason:
        sweep(folder)
        return folder
    instead = _temporary_folder() / variable.lower()
    instead.mkdir(exist_ok=True)
    logger.warning(
        "cache folder %s cannot be written (%s), %s is used; set %s to a folder that can be written",
        *(folder, reason, instead, variable),
    )
    return instead


def _temporary_folder() -> Path:
    """Return a temporary folder that only this user can write, the same in every process if possible."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "")
    folder = Path(tempfile.gettempdir()) / f"myowarp-{user}"
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and (
            os.name == "nt" or (found.st_uid == user and stat.S_IMODE(found.st_mode) == 0o700)
        ):
            return folder
    # Somebody else's is there, and machine code is run from here.
    return Path(tempfile.mkdtemp(prefix="myowarp-"))


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
        if not is_users(path):
            continue
        for other in _modules(vars(module).values()):
            file = getattr(sys.modules.get(other), "__file__", None)
            if file is not None and is_users(Path(file)):
                waiting.add(other)
    return files_digest(sorted(files.values()))


def is_users(path: Path) -> bool:
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


def model_bytes(model: mujoco.MjModel) -> bytes:
    """Return everything that a compiled model holds."""
    content = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def model_from_bytes(content: bytes) -> mujoco.MjModel:
    """Return the model that `model_bytes` was given."""
    return mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": content})


def model_digest(model: mujoco.MjModel) -> str:
    """Return a digest of everything that a compiled model holds."""
    return hashlib.sha256(model_bytes(model)).hexdigest()


def array_bytes(array: np.ndarray) -> bytes:
    """Return an array in the .npy format."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def array_from_bytes(content: bytes) -> np.ndarray:
    """Return the array that `array_bytes` was given."""
    return np.load(io.BytesIO(content), allow_pickle=False)


def cached(
    key: tuple[object, ...],
    make: Callable[[], T],
    save: Callable[[T], bytes],
    load: Callable[[bytes], T],
) -> T:
    """Return the object that `key` names: loaded from disk if there, else made and saved.

    Args:
        key: What the result depends on; `repr` must identify it. Versions of mujoco and myo-sim are
            added.
        make: Builds the object.
        save: Returns the object as bytes.
        load: Returns the object that `save` was given; raises ValueError for one that is no longer of use.

    Returns:
        The object. A cache folder that cannot be written only costs time.
    """
    versions = (version("mujoco"), version("myo-sim"))
    name = hashlib.sha256(repr((key, versions)).encode()).hexdigest()[:24] + ".cache"
    folders = cache_dir(), writable_folder(cache_dir(), "MYOWARP_CACHE_DIR")
    for path in dict.fromkeys(folder / name for folder in folders):
        try:
            return load(_checked(path.read_bytes()))
        except (FileNotFoundError, NotADirectoryError):
            pass
        except (ValueError, OSError) as error:
            logger.warning("cached file %s is made again: %s", path, error)
    entry = make()
    content = save(entry)
    try:
        with in_place(folders[1] / name) as scratch:
            scratch.write_bytes(hashlib.sha256(content).digest() + content)
    except OSError as error:
        logger.warning(
            "result %s is not kept, and made again at the next start: %s", folders[1] / name, error
        )
    return entry


def _checked(data: bytes) -> bytes:
    """Return what follows its own digest.

    Raises:
        ValueError: It is not what was written.
    """
    size = hashlib.sha256().digest_size
    if hashlib.sha256(data[size:]).digest() != data[:size]:
        raise ValueError("it was damaged or changed")
    return data[size:]


def csv_rows(path: Path, called: str) -> list[list[str]]:
    """Return the rows of a .csv, the names of the columns first; empty rows are left out.

    Args:
        path: The file; comma, semicolon or tab separates, whichever its first line has most of.
        called: What the file is called in messages.

    Raises:
        ValueError: It is no such file.
        OSError: It cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        delimiter = max(",;\t", key=text.partition("\n")[0].count)
        rows = list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter))
    except UnicodeDecodeError as error:
        raise ValueError(f"{called} is not UTF-8 text ({error})") from error
    except csv.Error as error:
        raise ValueError(f"{called} is no CSV file ({error})") from error
    return [row for row in rows if any(map(str.strip, row))]


def number_in(cell: str) -> float:
    """Return the number that a cell of a table holds, as one would write it.

    Raises:
        ValueError: It holds none; Python's own `float` takes "1_0" for 10, digits of all scripts and more.
    """
    if not NUMBER.fullmatch(cell):
        raise ValueError(f"{cell!r} is no number")
    return float(cell)
