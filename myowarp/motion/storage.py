"""Motions as OpenSim and SCONE read and write them: tables over time, `.sto` and `.mot`; and plain `.csv`.

A `.sto` or `.mot` file has header lines up to `endheader`, a line of column labels and a row for each time,
separated by tabs or blanks (OpenSim's class `Storage`). Here values are in SI units and radians. Rows are
read forwards, so that a file may be longer than memory (see `streams`).
"""

from __future__ import annotations

import csv
import itertools
import logging
import re
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, NoReturn, Self

import numpy as np

from myowarp.disk import in_place, naming, write_rows
from myowarp.motion.headers import Header, header_of, pair_of, whole_number
from myowarp.osim.document.read.element import MAX_NUMBER, decoded, number_of

logger = logging.getLogger("myowarp")

SUFFIXES = (".sto", ".mot", ".csv")
CLOSE = 1e-7
"""[s] below which two times are no two samples, and splines through them no motion."""
SAME = 1e-8
"""Of values, relative to their size and 1, by which a row that is there twice may differ."""
TAIL = 100
"""Rows before the last one that its digits are compared with."""


@dataclass(frozen=True)
class Storage:
    """A table over time.

    Attributes:
        labels: Names of the columns, without `time`.
        time: Times [s], increasing, shape (rows,).
        values: One row for each time, shape (rows, columns).
        in_degrees: Whether angles are in degrees, as OpenSim reads the file.
        unit: Of angles as the words of the header have it: `degrees`, `radians`, what else it has there, or
            empty.
        title: What the file calls itself.
    """

    labels: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    in_degrees: bool = False
    unit: str = ""
    title: str = ""


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
        self._removed: set[str] = set()
        self._rows: dict[str, Sequence[Sequence[str]]] = {}

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

    def write_rows(self, file: str, rows: Sequence[Sequence[str]]) -> None:
        """Write a `.csv` file of words, in place of the one of the parts before."""
        self._rows[file] = rows

    def remove(self, file: str) -> None:
        """Let a file of an earlier result go, when the others take their places."""
        self._removed.add(file)

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
            for file, rows in self._rows.items():
                write_rows(self.folder / file, rows)
        for file in self._removed:
            (self.folder / file).unlink(missing_ok=True)


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
    with Rows(path, gaps) as rows:
        return rows.whole()


class Rows:
    """Rows of a `.sto`, `.mot` or `.csv` file, read forwards; a context manager that closes it.

    Attributes:
        path: The file.
        header: What it has before them.
    """

    WHAT = "row"
    COUNT = "nRows"

    def __init__(self, path: Path, gaps: bool = False) -> None:
        """Read the header.

        Args:
            path: The file.
            gaps: Whether cells may be NaN.

        Raises:
            ValueError: It is no such table.
            OSError: It cannot be read.
        """
        self.path, self._gaps, self._csv = path, gaps, path.suffix.lower() == ".csv"
        # Digits and letters that are not ASCII are in no number; the header is decoded by itself.
        self._file = path.open(encoding="ascii", errors="surrogateescape")
        try:
            self.header = self._head()
            self._begin = self._file.tell()
        except BaseException:
            self.close()
            raise
        self._rewind()
        self._counted = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _rewind(self) -> None:
        """Go back to the first row."""
        self._file.seek(self._begin)
        self._lines = (line for line in self._file if line.strip())
        self._read = 0

    def _text(self, lines: Sequence[str]) -> list[str]:
        """Return lines as text, UTF-8 or else Latin-1, as models are read."""
        whole = "".join(lines)
        if "\0" in whole:
            raise ValueError(f"{str(self.path)!r} is no text file in UTF-8 or Latin-1")
        return decoded(whole.encode("ascii", "surrogateescape"))[0].split("\n")

    def _head(self) -> Header:
        """Read the lines before the rows."""
        lines, ended = [], self._csv
        while not ended and (line := self._file.readline()):
            lines.append(line)
            ended = pair_of(line)[0].lower() == "endheader"
        while (line := self._file.readline()) and not line.strip():
            pass
        *head, names = self._text([*lines, line.rstrip("\n")])
        if not ended:
            raise ValueError(f"{str(self.path)!r} has no line 'endheader'; a .sto or .mot file needs one")
        labels = self._cells(names)
        self._spare = names[len(names.rstrip(", ")) :].count(",")  # at the end of every line
        if len(labels) < 2 or labels[0].lower() != "time":
            raise ValueError(
                f"{str(self.path)!r} must have a first column 'time', and at least one more, got "
                f"{names.strip()[:60]!r}"
            )
        header = header_of(head, labels[1:], self.path.suffix.lower() == ".mot")
        if not all(labels):
            raise ValueError(f"{str(self.path)!r} has a column without a name, before {labels[-1]!r}")
        self._once("column", header.labels)
        self._compare("nColumns", header.columns, len(labels), "columns", refused=header.counts)
        return header

    def _once(self, what: str, names: Sequence[str]) -> None:
        """Check that names differ."""
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"{str(self.path)!r} has the {what} {twice!r} twice")

    def _compare(self, name: str, stated: str, there: int, what: str, refused: bool) -> None:
        """Refuse a count of the header that does not match, or say so where OpenSim does not go by it."""
        if not stated or whole_number(stated) == there:
            return
        text = f"{str(self.path)!r} says {name}={stated} and has {there} {what}"
        if refused:
            raise ValueError(f"{text}; restore what is missing, or correct its header")
        logger.warning("%s", text)

    def _cells(self, line: str, count: int = 0) -> list[str]:
        """Return the cells of a line, at least so many where that many are there."""
        if self._csv:
            try:
                cells = next(csv.reader([line]), [])
            except csv.Error as error:
                raise ValueError(
                    f"{str(self.path)!r} is no table of comma-separated values: {error}"
                ) from error
        elif "\t" in line and len(line.split()) != count:
            cells = line.split("\t")
        else:
            cells = line.split()
        cells = [cell.strip() for cell in cells]
        while len(cells) > count and not cells[-1]:  # tabs at the end of lines
            cells.pop()
        return cells

    def _numbers(self, lines: list[str]) -> np.ndarray:
        """Return time and values of some lines."""
        try:
            if self._csv:
                lines = [line.rstrip().removesuffix("," * self._spare) or "," for line in lines]
                table = np.loadtxt(lines, comments=None, ndmin=2, delimiter=",", quotechar='"')
            else:
                table = np.loadtxt(lines, comments=None, ndmin=2)
        except ValueError:
            self._explain(lines)
        if table.shape != (len(lines), 1 + len(self.header.labels)):
            self._explain(lines)
        return table

    def _explain(self, lines: Sequence[str]) -> NoReturn:
        """Say what is wrong with the first of some lines that is no row of numbers."""
        labels = ("time", *self.header.labels)
        for number, line in enumerate(lines, self._read + 1):
            cells, where = self._cells(line, len(labels)), f"{self.WHAT} {number} of {str(self.path)!r}"
            if len(cells) != len(labels):
                raise ValueError(f"{where} must have {len(labels)} cells, got {len(cells)}")
            if not all(cells):
                raise ValueError(f"{where} has an empty cell in column {labels[cells.index('')]!r}")
            self._check_cells(number, cells)
        raise ValueError(f"{self.WHAT}s from {self._read + 1} on of {str(self.path)!r} are no numbers")

    def _check_cells(self, number: int, cells: Sequence[str]) -> None:
        """Check that the cells of the row of a number are numbers, or empty."""
        for label, cell in zip(("time", *self.header.labels), cells, strict=False):
            try:
                number_of(cell or "0")
            except ValueError:
                text = cell.encode("ascii", "surrogateescape").decode("utf-8", "replace")[:60]
                raise ValueError(
                    f"{self.WHAT} {number} of {str(self.path)!r} has a cell that is no number: {text!r} in "
                    f"column {label!r}"
                ) from None

    def _within(self, table: np.ndarray) -> None:
        """Check that numbers are finite, and that squares of them are."""
        right = np.abs(table) < MAX_NUMBER
        if self._gaps and not right.all():
            right[:, 1:] |= np.isnan(table[:, 1:])
        if not right.all():
            row, column = np.argwhere(~right)[0]
            raise ValueError(
                f"{str(self.path)!r} must hold finite numbers below {MAX_NUMBER:g} in size; {self.WHAT} "
                f"{self._read + row + 1} has {table[row, column]:g} in column "
                f"{('time', *self.header.labels)[column]!r}"
            )

    def read(self, count: int | None = None) -> np.ndarray:
        """Return time and values of up to so many more rows, or of all; no rows at the end of the file.

        Raises:
            ValueError: A row is not what it should be, or the file has not as many as it says.
        """
        lines = list(itertools.islice(self._lines, count))
        if not lines:
            self._ended(self._read)
            return np.empty((0, 1 + len(self.header.labels)))
        if not lines[-1].endswith("\n"):
            self._cut(lines[-1 - TAIL :])
        table = self._numbers(lines)
        self._within(table)
        self._read += len(table)
        return table

    def _ended(self, count: int) -> None:
        """Compare the number of rows with what the header says, once."""
        if not self._counted:
            self._counted = True
            self._compare(self.COUNT, self.header.rows, count, f"{self.WHAT}s", refused=self.header.counts)

    def _cut(self, lines: Sequence[str]) -> None:
        """Say where a file ends in the middle of a line, and maybe of a number."""
        words = (self._cells(line, count=1)[-1] for line in lines)
        *before, last = (re.split(r"[.eE]", word)[-1].strip("+-") for word in words)
        if before and all(len(digits) > len(last) for digits in before):
            logger.warning(
                "%s ends without a line break, and its last number has fewer digits than those above it; if "
                "the file was cut short, restore it",
                self.path,
            )

    def whole(self) -> Storage:
        """Return all rows, in the order of their times.

        Raises:
            ValueError: There is none, or one is not what it should be.
        """
        table = self.read()
        if not len(table):
            raise self._empty()
        self._ended(len(table))
        return self.table(in_order(self.path, self.WHAT, table))

    def _empty(self) -> ValueError:
        """Return what is wrong with a file without rows."""
        return ValueError(f"{str(self.path)!r} must have at least one {self.WHAT} of numbers")

    def table(self, rows: np.ndarray) -> Storage:
        """Return rows, the first column of which is time, with the names of the columns."""
        head = self.header
        return Storage(head.labels, rows[:, 0], rows[:, 1:], head.in_degrees, head.unit, head.title)


def in_order(path: Path, what: str, table: np.ndarray) -> np.ndarray:
    """Return rows in the order of their times, the first column, and say where they were not.

    A row that says the same once more, as the last one of OpenSim's RRA, is left out.

    Raises:
        ValueError: A time is there twice with other values, or nearly.
    """
    time = table[:, 0]
    order = np.argsort(time, kind="stable")
    one, other = table[order[:-1]], table[order[1:]]
    close = np.abs(other - one) <= SAME * (1.0 + np.abs(one))
    again = (one[:, 0] == other[:, 0]) & (close | (np.isnan(one) & np.isnan(other))).all(axis=1)
    if again.any():
        first = np.flatnonzero(again)[0]
        logger.warning(
            "%s: %s %d says the same as %d; left out", path, what, order[first + 1] + 1, order[first] + 1
        )
        order = order[np.concatenate([[True], ~again])]
    check_apart(path, what, time[order], order + 1)
    if late := int((np.diff(time) < 0.0).sum()):
        logger.warning("%s: %ss are not in the order of their times, in %d places; sorted", path, what, late)
    return table[order]


def within(time: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return which times are from `start` to `end` [s], both included."""
    return np.asarray((time >= start - 1e-9) & (time <= end + 1e-9))


def rows_between(time: np.ndarray, start: float, end: float, whose: str) -> np.ndarray:
    """Return what `within` does, and say what is not there; `whose` times they are, and its verb, is for it.

    Raises:
        ValueError: There is none.
    """
    kept = within(time, start, end)
    if not kept.any():
        raise ValueError(
            f"no frame between {start:g} and {end:g} s; the {whose} from {time[0]:g} to {time[-1]:g} s"
        )
    say_cut(float(time[0]), float(time[-1]), len(time), (start, end), whose)
    return kept


def say_cut(first: float, last: float, count: int, span: tuple[float, float], whose: str) -> None:
    """Say that a span begins or ends more than a frame outside of the times that are there, where it does.

    Args:
        first: The first time that is there [s].
        last: The last one.
        count: Of frames.
        span: First and last time that are wanted [s], of which either may be infinite.
        whose: Times they are, and its verb.
    """
    (start, end), frame = span, (last - first) / max(count - 1, 1) + 1e-9
    if -np.inf < start < first - frame or last + frame < end < np.inf:
        logger.warning("of %g to %g s, the %s only from %g to %g s", start, end, whose, first, last)


def check_apart(path: Path, what: str, time: np.ndarray, number: np.ndarray) -> None:
    """Check that times which do not decrease are those of different samples.

    Args:
        path: The file.
        what: What a time is of.
        time: [s].
        number: Of each, in the file.

    Raises:
        ValueError: Two are the same, or nearly.
    """
    near = np.flatnonzero(np.diff(time) < CLOSE)
    if not len(near):
        return
    (one, other), (begin, end) = sorted(number[near[0] : near[0] + 2]), time[near[0] : near[0] + 2]
    raise ValueError(
        f"times of {str(path)!r} must differ; those of {what}s {one} and {other} are both {begin:g} s"
        if begin == end
        else f"times of {str(path)!r} must be {CLOSE:g} s apart at least; those of {what}s {one} and {other} "
        f"are {end - begin:g} s apart; leave one of them out"
    )
