"""Tables over time that are too long for memory: files that are read forwards, a part at a time.

Filters and splines act on a part with a margin on both sides, which is so long that what they have at its
ends has died away: `Margin` says how long. Times must increase in the file.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from myowarp.motion.storage import Storage

FRAMES = 16384
"""Rows of a part; a longer file is read in parts."""


@dataclass(frozen=True)
class Margin:
    """What is read before and after the rows of a part.

    A natural spline of fifth degree forgets its ends by 0.43 a row, a cubic one by 0.27; the filter by
    exp(-pi f t). So 64 rows and 12 / f are far below the rounding of float64.

    Attributes:
        rows: At least.
        seconds: At least [s].
    """

    rows: int = 64
    seconds: float = 0.0

    @classmethod
    def of(cls, cutoff: float | None) -> Margin:
        """Return the margin of a filter's frequency [Hz]; None: none."""
        return cls() if cutoff is None else cls(seconds=12.0 / cutoff)


class Stream:
    """Rows of a `.sto` or `.mot` file, read forwards; a context manager that closes it.

    Attributes:
        path: The file.
        labels: Names of the columns, without `time`.
        in_degrees: Whether angles are in degrees.
    """

    def __init__(self, path: Path) -> None:
        """Read the header.

        Raises:
            ValueError: It is no such table.
            OSError: It cannot be read.
        """
        self.path = path
        self._file = path.open(encoding="utf-8-sig")
        try:
            self.labels, self.in_degrees = self._header()
        except ValueError:
            self.close()
            raise
        self._lines = (line for line in self._file if line.strip())
        self._rows, self._read, self._ended = np.empty((0, 1 + len(self.labels))), 0, False

    def _header(self) -> tuple[tuple[str, ...], bool]:
        """Read the lines before the numbers; return names of columns, and whether angles are in degrees.

        Raises:
            ValueError: They are not what they should be.
        """
        header = list(itertools.takewhile(lambda line: line.strip().lower() != "endheader", self._file))
        names = next((line for line in self._file if line.strip()), "")
        cells = [cell.strip() for cell in (names.split("\t") if "\t" in names else names.split())]
        while cells and not cells[-1]:
            cells.pop()
        if len(cells) < 2 or cells[0].lower() != "time":
            raise ValueError(
                f"{str(self.path)!r} must have a line 'endheader' and then a first column 'time'"
            )
        degrees = any(line.replace(" ", "").strip().lower() == "indegrees=yes" for line in header)
        return tuple(cells[1:]), degrees

    def _numbers(self, lines: list[str]) -> np.ndarray:
        """Return time and values of some lines.

        Raises:
            ValueError: A line has not one finite number for each column.
        """
        where = f"rows {self._read + 1} to {self._read + len(lines)} of {str(self.path)!r}"
        try:
            rows = np.loadtxt(lines, comments=None, ndmin=2)
        except ValueError as error:
            raise ValueError(f"{where} must be numbers, one for each column: {error}") from error
        if rows.shape[1] != self._rows.shape[1]:
            raise ValueError(f"{where} must have {self._rows.shape[1]} cells, got {rows.shape[1]}")
        if not np.isfinite(rows).all():
            raise ValueError(f"{where} must be finite numbers")
        return rows

    def _time(self, line: str) -> float:
        """Return the time of a line."""
        return float(line.split(None, 1)[0])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def count(self, span: tuple[float, float] | None = None) -> int:
        """Read all rows, and return how many there are, or of how many the times are in a span [s]."""
        if span is None:
            return sum(1 for _ in self._lines)
        begin, end = span[0] - 1e-9, span[1] + 1e-9
        return sum(begin <= self._time(line) <= end for line in self._lines)

    def _more(self, count: int) -> None:
        """Read up to so many more rows.

        Raises:
            ValueError: A row is not what it should be, or a time is not after the one before.
        """
        lines = list(itertools.islice(self._lines, count))
        if not lines:
            self._ended = True
            return
        rows = self._numbers(lines)
        time = np.concatenate([self._rows[-1:, 0], rows[:, 0]])
        if not (np.diff(time) > 0.0).all():
            where = f"rows {self._read + 1} to {self._read + len(lines)} of {str(self.path)!r}"
            raise ValueError(f"{where} must have times that increase, as the file is read in parts; sort it")
        self._rows, self._read = np.concatenate([self._rows, rows]), self._read + len(rows)

    def _table(self, rows: slice) -> Storage:
        """Return some of the rows that are here."""
        return Storage(self.labels, self._rows[rows, 0], self._rows[rows, 1:], self.in_degrees)

    def parts(self, margin: Margin) -> Iterator[tuple[Storage, slice]]:
        """Yield parts of `FRAMES` rows with their margins, and which of the rows are those of the part.

        Raises:
            ValueError: A row is not as it should be.
        """
        size = FRAMES
        self._more(size)
        if not len(self._rows):
            raise ValueError(f"{str(self.path)!r} has no row")
        step = float(np.diff(self._rows[:, 0]).mean()) if len(self._rows) > 1 else 1.0
        around = max(margin.rows, 1, int(np.ceil(margin.seconds / step)))
        first = 0
        while True:
            while not self._ended and len(self._rows) < first + size + around:
                self._more(first + size + around - len(self._rows))
            last = min(first + size, len(self._rows))
            yield self._table(slice(None)), slice(first, last)
            if last == len(self._rows):
                return
            first = min(last, around)
            self._rows = self._rows[last - first :]

    def around(self, begin: float, end: float, rows: int = Margin.rows) -> Storage:
        """Return the rows of a span of time [s], and so many before and after; spans follow each other.

        Raises:
            ValueError: A row is not as it should be.
        """
        beyond = int((self._rows[:, 0] > end).sum())
        while not self._ended and beyond < rows:
            self._more(FRAMES)
            beyond = int((self._rows[:, 0] > end).sum())
        first = max(int(np.searchsorted(self._rows[:, 0], begin)) - rows, 0)
        self._rows = self._rows[first:]
        return self._table(slice(0, len(self._rows) - max(beyond - rows, 0)))


def is_long(path: Path) -> bool:
    """Whether a file has more rows than two parts; not of `.csv` files, which are read as a whole.

    Raises:
        OSError: It cannot be read.
    """
    if path.suffix.lower() == ".csv":
        return False
    with path.open("rb") as file:
        return sum(1 for _ in itertools.islice(file, 2 * FRAMES)) == 2 * FRAMES
