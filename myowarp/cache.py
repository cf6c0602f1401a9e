"""Results that take seconds to make and never change, kept on disk between runs.

A key names everything the result depends on, package versions included. An entry that cannot be read
is made again, never trusted. `MYOWARP_CACHE_DIR` moves the folder.
"""

import hashlib
import os
from collections.abc import Callable, Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np
import platformdirs

from myowarp.files import in_place

T = TypeVar("T")


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
