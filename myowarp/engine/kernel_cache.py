"""Machine code that Warp keeps on disk: where it can be written, and compiled anew where it was damaged.

Warp runs what it finds: a flipped bit ends the process without a word, at every start. So the folder of each
module gets a list of the SHA-256 of its files once they were compiled, and they are compared before they are
loaded. Files without a list were left by other programs or an older version, and get theirs then.
"""

import contextlib
import functools
import hashlib
import json
import re
import shutil
import tempfile
import time
from pathlib import Path

import warp as wp

from myowarp.disk import in_place
from myowarp.process import warn_once

SUMS = "myowarp.json"
SOURCES = (".cpp", ".cu")  # are not read again

BUILD = re.compile(r".+_p\d+_t\d+")
"""Folder in which a process and its thread compile a module, before Warp moves it into place."""
ABANDONED = 86_400.0
"""Time without a change after which nobody compiles there [s]; a cache may be shared between machines."""

_sound: set[tuple[Path, str]] = set()
"""Folder and device of what this process has compared."""


def load_module(module: wp.Module, device: wp.Device, block_dim: int) -> Path | None:
    """Load a module, compiled if its machine code is not on disk, or is not what was written.

    Returns:
        The folder whose files were not what was written; None: they were, or there were none.

    Raises:
        RuntimeError: What is damaged cannot be removed.
    """
    if not hasattr(module, "get_module_identifier"):
        warn_once("Warp has changed: machine code that was damaged on disk is not found out")
        wp.force_load(device, [module], block_dim)
        return None
    folder = Path(wp.config.kernel_cache_dir) / module.get_module_identifier(block_dim)
    if (folder, device.alias) in _sound:
        wp.force_load(device, [module], block_dim)
        return None
    listed = _listed(folder)
    damaged = listed is not None and listed != _sums(folder)
    if damaged:
        _remove(folder)
        listed = None
    if listed is None:
        _sweep(folder.parent)
    wp.force_load(device, [module], block_dim)
    if listed is None or len(listed) != len(_files(folder)):  # for another device, there are more now
        with contextlib.suppress(OSError), in_place(folder / SUMS) as scratch:
            scratch.write_text(json.dumps(_sums(folder)))
    _sound.add((folder, device.alias))
    return folder if damaged else None


@functools.cache
def _sweep(cache: Path) -> None:
    """Delete folders in which processes that were killed have compiled."""
    with contextlib.suppress(OSError):
        for folder in filter(lambda path: BUILD.fullmatch(path.name), list(cache.iterdir())):
            if time.time() - folder.stat().st_mtime > ABANDONED:
                shutil.rmtree(folder, ignore_errors=True)


def _listed(folder: Path) -> dict[str, str] | None:
    """Return the list of a folder; None: there is none."""
    try:
        listed = json.loads((folder / SUMS).read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return {}
    return listed if isinstance(listed, dict) else {}


def _sums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of the files of a folder that are loaded, by name."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in _files(folder)}


def _files(folder: Path) -> list[Path]:
    """Return the files of a folder that are loaded."""
    return sorted(file for file in folder.glob("wp_*") if file.suffix not in SOURCES)


def _remove(folder: Path) -> None:
    """Remove a folder, at once for other processes."""
    try:
        if folder.is_symlink():
            folder.unlink()
            return
        aside = Path(tempfile.mkdtemp(dir=folder.parent))
        folder.rename(aside / folder.name)
        shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        raise RuntimeError(
            f"compiled kernels in {str(folder)!r} are damaged and cannot be removed ({error}); remove them "
            "or set WARP_CACHE_PATH to another folder"
        ) from error
