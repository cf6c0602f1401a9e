"""Recorded markers: `.trc` files, as Motion Analysis writes and OpenSim reads them.

Five lines come before the numbers: the file's name, names and values of `DataRate`, `NumFrames`,
`NumMarkers`, `Units` and others, names of markers, each over three columns, and X1 Y1 Z1 ... An empty cell is
a marker that was not seen, and so is NaN. Here positions are in metres.

Source: OpenSim documentation, *Marker (.trc) Files*.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from myowarp.disk import in_place
from myowarp.motion.storage import Storage, in_order
from myowarp.motion.streams import Stream

UNITS = {"mm": 1e-3, "millimeters": 1e-3, "cm": 1e-2, "centimeters": 1e-2, "m": 1.0, "meters": 1.0}
"""Metres of each unit, by lower-case name."""


@dataclass(frozen=True, eq=False)
class Markers:
    """Places of markers over time.

    Attributes:
        names: Of markers.
        time: [s], increasing, shape (frames,).
        positions: [m], NaN where a marker was not seen, shape (frames, markers, 3).
    """

    names: tuple[str, ...]
    time: np.ndarray
    positions: np.ndarray

    def between(self, start: float, end: float) -> Markers:
        """Return the frames from `start` to `end` [s], both included.

        Raises:
            ValueError: There is none.
        """
        kept = (self.time >= start - 1e-9) & (self.time <= end + 1e-9)
        if not kept.any():
            raise ValueError(
                f"no frame between {start:g} and {end:g} s; the recording is from {self.time[0]:g} to "
                f"{self.time[-1]:g} s"
            )
        return Markers(self.names, self.time[kept], self.positions[kept])

    def filled(self, most: float) -> Markers:
        """Return the markers with gaps bridged by natural cubic splines through all that was seen.

        Gaps at the beginning or end, and those that are longer, stay.

        Args:
            most: Longest gap that is bridged, from the last frame before it to the first one after it [s].

        Raises:
            ValueError: The time is not above 0.
        """
        from scipy.interpolate import CubicSpline

        if not most > 0.0:
            raise ValueError(f"the longest gap that is filled must be above 0 s, got {most:g} s")
        positions = self.positions.copy()
        for number in range(len(self.names)):
            seen = np.flatnonzero(np.isfinite(positions[:, number]).all(axis=1))
            if len(seen) < 3:
                continue
            curve = CubicSpline(self.time[seen], positions[seen, number], bc_type="natural")
            for before, after in itertools.pairwise(seen):
                if after > before + 1 and self.time[after] - self.time[before] <= most + 1e-9:
                    inside = slice(before + 1, after)
                    positions[inside, number] = curve(self.time[inside])
        return Markers(self.names, self.time, positions)

    def gaps(self) -> dict[str, list[tuple[float, float]]]:
        """Return when markers were not seen: first and last time of each gap [s], by marker."""
        missing = np.isnan(self.positions).any(axis=2)
        found: dict[str, list[tuple[float, float]]] = {}
        for number, name in enumerate(self.names):
            edge = np.diff(missing[:, number].astype(int), prepend=0, append=0)
            first, after = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
            if len(first):
                found[name] = [(float(self.time[a]), float(self.time[b - 1])) for a, b in zip(first, after)]  # noqa: B905
        return found


def read_trc(path: Path) -> Markers:
    """Read a `.trc` file.

    Raises:
        ValueError: It is none, its unit is unknown, a row does not fit, or a time is there twice.
        OSError: It cannot be read.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{str(path)!r} is no text file; markers come as .trc") from error
    names, unit = _header(path, lines)
    rows = [(number, line) for number, line in enumerate(lines[5:], 6) if line.strip()]
    table = _numbers(path, names, rows)
    if not len(table):
        raise ValueError(f"{str(path)!r} has no frame")
    return _placed(names, in_order(path, "frame", table), unit)


def _header(path: Path, lines: Sequence[str]) -> tuple[tuple[str, ...], float]:
    """Return names of markers, and the metres of a unit, of a file that begins with these lines.

    Raises:
        ValueError: They are not those of a `.trc` file, or the unit is unknown.
    """
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise ValueError(
            f"{str(path)!r} must begin with 'PathFileType' and have five lines before its numbers"
        )
    facts = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    unit = facts.get("Units", "")
    if unit.lower() not in UNITS:
        raise ValueError(f"{str(path)!r} has the unit {unit!r}; known are {', '.join(UNITS)}")
    names = tuple(cell.strip() for cell in lines[3].split("\t")[2:] if cell.strip())
    if not names:
        raise ValueError(f"{str(path)!r} names no marker in line 4, or its cells are not separated by tabs")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{str(path)!r} has the marker {twice!r} twice")
    return names, UNITS[unit.lower()]


def _numbers(path: Path, names: tuple[str, ...], rows: Sequence[tuple[int, str]]) -> np.ndarray:
    """Return time and places of numbered lines, in the file's unit, NaN where a marker was not seen.

    Raises:
        ValueError: A row does not fit.
    """
    table = np.full((len(rows), 1 + 3 * len(names)), np.nan)
    for row, (number, line) in zip(table, rows, strict=True):
        cells = [cell.strip() for cell in line.split("\t")[1:]]
        while len(cells) > len(row) and not cells[-1]:
            cells.pop()
        if len(cells) > len(row):
            raise ValueError(
                f"line {number} of {str(path)!r} must have {len(row) + 1} cells for {len(names)} "
                f"markers, got "
                f"{len(cells) + 1}"
            )
        try:
            row[: len(cells)] = [float(cell) if cell else np.nan for cell in cells]
        except ValueError as error:
            raise ValueError(
                f"line {number} of {str(path)!r} has a cell that is no number: {error}"
            ) from error
    return table


def _placed(names: tuple[str, ...], table: np.ndarray, unit: float) -> Markers:
    """Return the markers of the numbers of a file, in metres."""
    time = table[:, 0]
    positions = unit * table[:, 1:].reshape(len(table), len(names), 3)
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    return Markers(names, time, positions)


class MarkerStream(Stream):
    """Rows of a `.trc` file, read forwards; in the file's unit, NaN where a marker was not seen."""

    def _header(self) -> tuple[tuple[str, ...], bool]:
        lines = list(itertools.islice(self._file, 5))
        self._names, self._unit = _header(self.path, [*lines, ""])
        return tuple(f"{name} {axis}" for name in self._names for axis in "XYZ"), False

    def _numbers(self, lines: list[str]) -> np.ndarray:
        rows = _numbers(self.path, self._names, list(enumerate(lines, self._read + 6)))
        if not np.isfinite(rows[:, 0]).all():
            late = self._read + 1 + int(np.argmin(np.isfinite(rows[:, 0])))
            raise ValueError(
                f"times of {str(self.path)!r} must be finite numbers; that of frame {late} is not"
            )
        return rows

    def _time(self, line: str) -> float:
        return float(line.split("\t", 2)[1])

    def placed(self, table: Storage) -> Markers:
        """Return the markers of some rows, in metres."""
        return _placed(self._names, np.column_stack([table.time, table.values]), self._unit)


def write_trc(path: Path, markers: Markers) -> None:
    """Write a `.trc` file, in millimetres.

    Raises:
        OSError: The file cannot be written.
    """
    frames, count = markers.positions.shape[:2]
    step = np.diff(markers.time).mean() if frames > 1 else 0.0
    rate = f"{1.0 / step if step else 1.0:.2f}"
    head = "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames"
    facts: Sequence[object] = (rate, rate, frames, count, "mm", rate, 1, frames)
    axes = [f"{axis}{number}" for number in range(1, count + 1) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(head.split()),
        "\t".join(map(str, facts)),
        "Frame#\tTime\t" + "\t\t\t".join(markers.names),
        "\t\t" + "\t".join(axes),
        "",
    ]
    for number, (time, row) in enumerate(zip(markers.time, markers.positions, strict=True), 1):
        cells = ["" if np.isnan(x) else f"{1e3 * x:.6f}" for x in row.ravel()]
        lines.append("\t".join([str(number), f"{time:.9g}", *cells]))
    with in_place(path) as scratch:
        scratch.write_text("\n".join(lines) + "\n", encoding="utf-8")
