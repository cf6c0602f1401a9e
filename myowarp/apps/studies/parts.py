"""Results in parts: a partitioned Parquet dataset that a command which was killed goes on with.

out/settings.json             what the results depend on
out/results/part-00000.parquet
out/summary/part-00000.parquet    written last: its part is done
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from myowarp.disk import in_place, version

SETTINGS, RESULTS, SUMMARY, LOCK, PART = "settings.json", "results", "summary", ".lock", "part-"


def part(output: Path, folder: str, index: int) -> Path:
    """Return the file of a part."""
    return output / folder / f"{PART}{index:05d}.parquet"


def agree(output: Path, what: str, settings: Mapping[str, Any]) -> None:
    """Keep what the results depend on.

    Args:
        output: Folder of the dataset.
        what: Of what, for messages.
        settings: All that the results depend on, as JSON holds it; the version of MyoWarp is added.

    Raises:
        ValueError: Results of other settings are there, or files that are no results.
    """
    wanted = {"myowarp": version("myowarp"), **settings}
    path = output / SETTINGS
    for folder in (RESULTS, SUMMARY):
        for file in (output / folder).iterdir():
            if not file.name.startswith((PART, ".")):
                raise ValueError(f"{str(file)!r} is no part of a {what} but is read as one; move it away")
    if any((output / SUMMARY).glob(f"{PART}*")):
        try:
            recorded = {**json.loads(path.read_text())}
        except (OSError, ValueError, TypeError) as error:
            raise ValueError(
                f"folder {str(output)!r} holds a {what} whose {SETTINGS} is damaged or missing ({error}); "
                "choose another --output"
            ) from error
        check_settings(f"folder {str(output)!r} holds a {what} of", recorded, wanted)
    with in_place(path) as scratch:
        scratch.write_text(json.dumps(wanted, indent=1) + "\n")


def check_settings(
    what: str, there: Mapping[str, Any], here: Mapping[str, Any], remedy: str = "choose another --output"
) -> None:
    """Raise ValueError if results depend on other settings than those wanted.

    Args:
        what: Of what, for the message, up to "other settings".
        there: Settings of the results, read from JSON.
        here: Those wanted, as JSON holds them.
        remedy: What the user can do.
    """
    for name in sorted(there.keys() | here.keys()):
        if there.get(name) != here.get(name):
            raise ValueError(
                f"{what} other settings ({name} is {there.get(name)!r} there and {here.get(name)!r} here); "
                f"{remedy}"
            )


def remove_damaged(output: Path, keys: Iterable[Mapping[str, Sequence[Any]]]) -> int:
    """Remove the summaries of parts that cannot be read or are of something else; return how many.

    Args:
        output: Folder of the dataset.
        keys: Of each part, columns of its summary as they must be.
    """
    import pyarrow as pa
    from pyarrow import parquet

    damaged = 0
    for index, wanted in enumerate(keys):
        if not (path := part(output, SUMMARY, index)).exists():
            continue
        try:
            parquet.read_metadata(part(output, RESULTS, index))
            found = parquet.ParquetFile(path).read(list(wanted)).to_pydict()
        except (OSError, KeyError, pa.ArrowException):
            found = {}
        if found != {name: list(column) for name, column in wanted.items()}:
            path.unlink()
            damaged += 1
    return damaged
