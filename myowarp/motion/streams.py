"""Tables over time that are too long for memory: files that are read forwards, a part at a time.

Filters and splines act on a part with a margin on both sides, which is so long that what they have at its
ends has died away: `Margin` says how long. Times must increase in the file.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from myowarp.motion.smooth import check_cutoff
from myowarp.motion.storage import Rows, Storage, check_apart, say_cut

FRAMES = 16384
"""Rows of a part; a longer file is read in parts."""

WHOLE = 2.0**40
"""Rows that no file has."""

FORGOTTEN = 12.0
"""Of the filter: exp(-pi f t) is far below the rounding of float64 after this many 1 / f."""


@dataclass(frozen=True)
class Margin:
    """Rows that are read before and after those of a part.

    A natural spline of fifth degree forgets its ends by 0.43 a row, a cubic one by 0.27; the filter by
    exp(-pi f t). So 64 rows and 12 / f are far below the rounding of float64.

    Attributes:
        rows: At least.
        seconds: At least [s].
        cutoff: Frequency of the filter [Hz]; None: none.
    """

    rows: int = 64
    seconds: float = 0.0
    cutoff: float | None = None

    def at(self, step: float) -> int:
        """Return how many rows that is, in steps of so long [s].

        Raises:
            ValueError: The filter's frequency does not go with such steps.
        """
        seconds = self.seconds
        if self.cutoff is not None:
            check_cutoff(self.cutoff, 1.0 / step)
            seconds = max(seconds, FORGOTTEN / self.cutoff)
        return max(self.rows, 1, int(np.ceil(np.fmin(np.nan_to_num(seconds) / step, WHOLE))))


class Stream(Rows):
    """Rows of a `.sto` or `.mot` file, read forwards in parts."""

    def __init__(self, path: Path, gaps: bool = False) -> None:
        """Read the header.

        Args:
            path: The file.
            gaps: Whether cells may be NaN.

        Raises:
            ValueError: It is no such table.
            OSError: It cannot be read.
        """
        super().__init__(path, gaps)
        self._rows, self._whole = np.empty((0, 1 + len(self.header.labels))), False

    def _time(self, line: str) -> float:
        """Return the time of a line."""
        return float(line.split(None, 1)[0])

    def count(self, span: tuple[float, float] | None = None) -> int:
        """Return how many rows there are, or of how many the times are in a span [s], before any is read.

        Raises:
            ValueError: A time is no number, there are not as many rows as the header says, or none in the
                span.
        """
        begin, end = (-np.inf, np.inf) if span is None else (span[0] - 1e-9, span[1] + 1e-9)
        inside = total = 0
        first, last = np.inf, -np.inf
        for line in self._lines:
            if span is not None:
                try:
                    time = self._time(line)
                    inside += begin <= time <= end
                    first, last = min(first, time), max(last, time)
                except (ValueError, IndexError):
                    self._read = total
                    self._numbers([line])  # says what is wrong
                    raise
            total += 1
        self._ended(total)
        self._rewind()
        if span is None:
            return total
        if not inside:
            raise ValueError(f"no frame of {str(self.path)!r} is between {span[0]:g} and {span[1]:g} s")
        say_cut(first, last, total, span, "recording is")
        return inside

    def _more(self, count: int) -> None:
        """Read up to so many more rows."""
        rows = self.read(count)
        self._whole = not len(rows)
        time = np.concatenate([self._rows[-1:, 0], rows[:, 0]])
        number = np.arange(self._read - len(time), self._read) + 1
        if late := np.flatnonzero(np.diff(time) < 0.0).tolist():
            one, other = number[late[0] : late[0] + 2]
            raise ValueError(
                f"{self.WHAT}s {one} and {other} of {str(self.path)!r} must be in the order of their times; "
                "sort the file, which is too long to be sorted here"
            )
        check_apart(self.path, self.WHAT, time, number)
        self._rows = np.concatenate([self._rows, rows])

    def parts(self, margin: Margin) -> Iterator[tuple[Storage, slice]]:
        """Yield parts of `FRAMES` rows with their margins, and which of the rows are those of the part.

        Raises:
            ValueError: A row is not as it should be.
        """
        size = FRAMES
        self._more(size)
        if not len(self._rows):
            raise self._empty()
        around = margin.at(float(np.diff(self._rows[:, 0]).mean()) if len(self._rows) > 1 else 1.0)
        first = 0
        while True:
            while not self._whole and len(self._rows) < first + size + around:
                self._more(first + size + around - len(self._rows))
            last = min(first + size, len(self._rows))
            yield self.table(self._rows), slice(first, last)
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
        while not self._whole and beyond < rows:
            self._more(FRAMES)
            beyond = int((self._rows[:, 0] > end).sum())
        first = max(int(np.searchsorted(self._rows[:, 0], begin)) - rows, 0)
        self._rows = self._rows[first:]
        return self.table(self._rows[: len(self._rows) - max(beyond - rows, 0)])


def is_long(path: Path) -> bool:
    """Whether a file has more rows than two parts; not of `.csv` files, which are read as a whole.

    Raises:
        OSError: It cannot be read.
    """
    if path.suffix.lower() == ".csv":
        return False
    with path.open("rb") as file:
        return sum(1 for _ in itertools.islice(file, 2 * FRAMES)) == 2 * FRAMES
