"""Motions as OpenSim and SCONE read and write them: tables over time, `.sto` and `.mot`; and plain `.csv`.

A `.sto` or `.mot` file has header lines up to `endheader`, a line of column labels and a row for each time,
separated by tabs or blanks (OpenSim's class `Storage`). Here values are in SI units and radians.
"""

from __future__ import annotations

import csv
import logging
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import numpy as np

from myowarp.disk import in_place, naming

logger = logging.getLogger("myowarp")

SUFFIXES = (".sto", ".mot", ".csv")


@dataclass(frozen=True)
class Storage:
    """A table over time.

    Attributes:
        labels: Names of the columns, without `time`.
        time: Times [s], increasing, shape (rows,).
        values: One row for each time, shape (rows, columns).
        in_degrees: Whether angles are in degrees.
    """

    labels: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    in_degrees: bool = False


class Tables:
    """Tables in one folder, each whole or in parts; they take their places together, when all are whole.

    A context manager: after an error, or where a process dies, the folder has what it had before.
    """

    def __init__(self, folder: Path) -> None:
        """Begin with none; the folder exists."""
        self.folder = folder
        self._places, self._files = ExitStack(), ExitStack()
        self._open: dict[str, IO[str]] = {}
        self._left: dict[str, int] = {}

    def write(self, file: str, title: str, table: Storage, total: int | None = None) -> None:
        """Write a `.sto` or `.mot` file, or the next part of one.

        Args:
            file: Its name.
            title: What it calls itself.
            table: Its rows, or the next ones.
            total: Rows of the file; None: these are all.

        Raises:
            OSError: The file cannot be written.
        """
        path, rows = self.folder / file, len(table.time)
        if file not in self._open:
            scratch = self._places.enter_context(in_place(path))
            self._open[file] = self._files.enter_context(scratch.open("w", encoding="utf-8"))
            self._left[file] = rows if total is None else total
            degrees = "yes" if table.in_degrees else "no"
            head = (
                f"version=1\nnRows={self._left[file]}\nnColumns={len(table.labels) + 1}\ninDegrees={degrees}"
            )
            labels = "\t".join(("time", *table.labels))
            self._open[file].write(f"{title}\n{head}\nendheader\n{labels}\n")
        self._left[file] -= rows
        with naming(path):
            numbers = np.column_stack([table.time, table.values])
            np.savetxt(self._open[file], numbers, fmt="%.9g", delimiter="\t")
            self._open[file].flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._places:
            self._files.close()
            if error is not None:
                raise error
            for file, left in self._left.items():
                if left:
                    raise RuntimeError(
                        f"{str(self.folder / file)!r} must have {left} rows more; write all parts"
                    )


@contextmanager
def tables_in(output: Path | Tables) -> Iterator[Tables]:
    """Give the tables of a folder, or those that are open already, which stay open."""
    if isinstance(output, Tables):
        yield output
        return
    with Tables(output) as tables:
        yield tables


def write_storage(path: Path, title: str, table: Storage) -> None:
    """Write a `.sto` or `.mot` file.

    Args:
        path: File to write.
        title: What it calls itself.
        table: Its rows.

    Raises:
        OSError: The file cannot be written.
    """
    with Tables(path.parent) as tables:
        tables.write(path.name, title, table)


def read_storage(path: Path, gaps: bool = False) -> Storage:
    """Read a `.sto`, `.mot` or `.csv` file.

    Args:
        path: The file.
        gaps: Whether cells may be NaN.

    Raises:
        ValueError: It is no such table, or a time is there twice.
        OSError: It cannot be read.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{str(path)!r} is no text file; a table over time is .sto, .mot or .csv") from error
    in_degrees = False
    if path.suffix.lower() != ".csv":
        end = next((i for i, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
        if end is None:
            raise ValueError(f"{str(path)!r} has no line 'endheader'; a .sto or .mot file needs one")
        header = [line.replace(" ", "").lower() for line in lines[:end]]
        in_degrees, lines = "indegrees=yes" in header, lines[end + 1 :]
        table = [line.split("\t") if "\t" in line else line.split() for line in lines if line.strip()]
    else:
        try:
            table = [row for row in csv.reader(lines) if row]
        except csv.Error as error:
            raise ValueError(f"{str(path)!r} is no table of comma-separated values: {error}") from error
    table = [[cell.strip() for cell in row] for row in table]
    while table and all(len(row) > 1 and not row[-1] for row in table):  # tabs at the end of every line
        table = [row[:-1] for row in table]
    if len(table) < 2 or not table[0] or table[0][0].lower() != "time":
        raise ValueError(f"{str(path)!r} must have a first column 'time' and at least one row of numbers")
    return _checked(path, table[0], table[1:], in_degrees, gaps)


def _checked(
    path: Path, labels: Sequence[str], rows: Sequence[Sequence[str]], in_degrees: bool, gaps: bool
) -> Storage:
    """Return the table of the cells of a file.

    Raises:
        ValueError: A row is too short or too long, a cell is no finite number, or a time is there twice.
    """
    for number, row in enumerate(rows, 1):
        if len(row) != len(labels):
            raise ValueError(f"row {number} of {str(path)!r} must have {len(labels)} cells, got {len(row)}")
    try:
        values = np.array(rows, dtype=float)
    except ValueError as error:
        raise ValueError(f"{str(path)!r} has a cell that is no number: {error}") from error
    if not (np.isfinite(values) | (gaps & np.isnan(values) & (np.arange(len(labels)) > 0))).all():
        raise ValueError(f"{str(path)!r} must hold finite numbers; row {_first_bad(values)} does not")
    values = in_order(path, "row", values)
    if len(set(labels)) < len(labels):
        twice = next(label for label in labels if list(labels).count(label) > 1)
        raise ValueError(f"{str(path)!r} has the column {twice!r} twice")
    return Storage(tuple(labels[1:]), values[:, 0], values[:, 1:], in_degrees)


def in_order(path: Path, what: str, table: np.ndarray) -> np.ndarray:
    """Return rows in the order of their times, the first column, and say where they were not.

    Raises:
        ValueError: A time is no number, or is there twice.
    """
    time = table[:, 0]
    if not np.isfinite(time).all():
        row = 1 + int(np.argmin(np.isfinite(time)))
        raise ValueError(f"times of {str(path)!r} must be finite numbers; that of {what} {row} is not")
    order = np.argsort(time, kind="stable")
    again = np.flatnonzero(np.diff(time[order]) <= 0.0)
    if len(again):
        one, other = sorted(order[again[0] : again[0] + 2] + 1)
        raise ValueError(
            f"times of {str(path)!r} must differ; those of {what}s {one} and {other} are both "
            f"{time[one - 1]:g} s"
        )
    if late := int((np.diff(time) < 0.0).sum()):
        logger.warning("%s: %ss are not in the order of their times, in %d places; sorted", path, what, late)
    return table[order]


def _first_bad(values: np.ndarray) -> int:
    """Return the number of the first row with an entry that is not finite, from 1 on."""
    return 1 + int(np.argmin(np.isfinite(values).all(axis=1)))
