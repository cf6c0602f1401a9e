"""The folder of a run: whether it is free, who holds it, and the checkpoint with which it goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from myowarp.apps.policies.checkpoint import (
    FOLDER,
    LEARNER,
    STATE,
    Checkpoint,
    CheckpointError,
    last_saved,
    load_checkpoint,
)
from myowarp.disk import locked, make_folder

LOCK = ".lock"


def load_resumable(run: Path, ranks: int) -> Checkpoint:
    """Read the last checkpoint of a run, which is to go on.

    Args:
        run: Folder of the run.
        ranks: How many processes go on with it.

    Raises:
        CheckpointError: As of `load_checkpoint`; it holds a policy alone, is of the trainer before this one,
            or is named in place of its run.
        ValueError: The run began with another number of ranks.
    """
    checkpoint = load_checkpoint(run, learning=True)
    manifest, before = checkpoint.manifest, checkpoint.manifest.get("ranks", 1)
    if STATE not in manifest["files"]:
        raise CheckpointError(f"checkpoint {str(run)!r} holds a policy alone and cannot be resumed")
    if manifest.get("learner") != LEARNER:
        raise CheckpointError(
            f"run {str(run)!r} is one of the trainer before this one, and cannot go on; its policy plays, "
            f"and a new run can start from it with --parent {run}"
        )
    if checkpoint.folder == run and run.absolute().parent.name == FOLDER:
        raise CheckpointError(f"--resume {str(run)!r} is a checkpoint in a run; name the run's folder")
    if before != ranks:
        raise ValueError(
            f"run {str(run)!r} goes on with the number of ranks that it began with, {before}, got {ranks}"
        )
    return checkpoint


def occupied(run: Path) -> bool:
    """Whether the folder of a run, which may not exist yet, holds anything.

    Raises:
        ValueError: Another process trains in it.
    """
    if (run / LOCK).exists():
        with locked(run / LOCK, wait=False):
            pass
    return run.is_dir() and any(file.name != LOCK for file in run.iterdir())


@contextmanager
def held(run: Path, last: Checkpoint | None, command: str) -> Iterator[None]:
    """Keep the folder of a run from all other processes during the block.

    Args:
        run: The folder; it is made if it does not exist.
        last: Its last checkpoint when the run was planned; None: there was none.
        command: The command that goes on with the run.

    Raises:
        ValueError: Another process holds it, or has trained in it since the run was planned.
        OSError: It cannot be written.
    """
    make_folder(run)
    with locked(run / LOCK, wait=False):
        if last_saved(run) != (last and last.folder):
            raise ValueError(
                f"folder {str(run)!r} has a new checkpoint, which another process wrote just now; go "
                f"on with {command}"
            )
        yield
