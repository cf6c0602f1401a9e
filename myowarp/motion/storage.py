"""Motions as OpenSim and SCONE read and write them: tables over time, `.sto` and `.mot`; and plain `.csv`.

A `.sto` or `.mot` file has header lines up to `endheader`, a line of column labels and a row for each time,
separated by tabs or blanks (OpenSim's class `Storage`). Here values are in SI units and radians.
"""

from __future__ import annotations

import csv
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

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


def write_storage(path: Path, name: str, storage: Storage, first: int = 0, total: int | None = None) -> None:
    """Write a `.sto` or `.mot` file, or a part of it behind the parts before.

    Args:
        path: File to write.
        name: What the file calls itself.
        storage: The table.
        first: Number of its first row in the file.
        total: Rows of the file, where that is not all of them.

    Raises:
        OSError: The file cannot be written.
    """
    rows, columns = storage.values.shape
    degrees, rows = "yes" if storage.in_degrees else "no", total or rows
    with path.open("a" if first else "w") as file:
        if not first:
            file.write(
                f"{name}\nversion=1\nnRows={rows}\nnColumns={columns + 1}\ninDegrees={degrees}\nendheader\n"
            )
            file.write("\t".join(("time", *storage.labels)) + "\n")
        np.savetxt(file, np.column_stack([storage.time, storage.values]), fmt="%.9g", delimiter="\t")


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
