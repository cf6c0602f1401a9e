"""Files that are either written whole or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


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
