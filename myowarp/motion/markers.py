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

from myowarp.disk import NUMBER, in_place
from myowarp.motion.storage import Header, Storage, logger, rows_between
from myowarp.motion.streams import Stream
from myowarp.process import listed

UNITS = {"mm": 1e-3, "millimeters": 1e-3, "cm": 1e-2, "centimeters": 1e-2, "m": 1.0, "meters": 1.0}
"""Metres of each unit, by lower-case name."""
SHOWN = 5
"""Markers that are named."""
UNLIKE = 0.25
"""Share by which steps of time may differ from those of the rate in the header; rounded ones do."""


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
        kept = rows_between(self.time, start, end, "recording is")
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

        if not 0.0 < most < np.inf:
            raise ValueError(f"the longest gap that is filled must be above 0 s and finite, got {most:g} s")
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
    with MarkerStream(path) as stream:
        return stream.placed(stream.whole())


class MarkerStream(Stream):
    """Rows of a `.trc` file, read forwards; in the file's unit, NaN where a marker was not seen."""

    WHAT = "frame"
    COUNT = "NumFrames"

    def __init__(self, path: Path) -> None:
        """Read the header.

        Raises:
            ValueError: It is no such file, its unit is unknown, or it has not as many markers as it says.
            OSError: It cannot be read.
        """
        super().__init__(path, gaps=True)
        self._told = False

    def _head(self) -> Header:
        lines = self._text([self._file.readline() for _ in range(5)])
        axes = lines[4].split("\t") if len(lines) > 5 else []
        if not lines[0].startswith("PathFileType") or not axes or NUMBER.fullmatch((axes * 2)[1]):
            raise ValueError(
                f"{str(self.path)!r} must begin with 'PathFileType' and have five lines before its numbers"
            )
        facts = dict(zip(lines[1].split(), lines[2].split(), strict=False))
        unit = facts.get("Units", "")
        if unit.lower() not in UNITS:
            raise ValueError(f"{str(self.path)!r} has the unit {unit!r}; known are {', '.join(UNITS)}")
        names = tuple(cell.strip() for cell in lines[3].split("\t")[2:] if cell.strip())
        if not names:
            raise ValueError(
                f"{str(self.path)!r} names no marker in line 4, or its cells are not separated by tabs"
            )
        self._once("marker", names)
        self._compare("NumMarkers", facts.get("NumMarkers", ""), len(names), "markers", refused=True)
        self._names, self._unit, self._rate = names, UNITS[unit.lower()], facts.get("DataRate", "")
        labels = tuple(f"{name} {axis}" for name in names for axis in "XYZ")
        # OpenSim's inverse kinematics reads all frames that are there.
        return Header(labels, rows=facts.get("NumFrames", ""), counts=False)

    def _numbers(self, lines: list[str]) -> np.ndarray:
        columns = 1 + len(self.header.labels)
        table = np.full((len(lines), columns), np.nan)
        for number, (row, line) in enumerate(zip(table, lines, strict=True), self._read + 1):
            cells = line.split("\t")[1:]
            while len(cells) > columns and not cells[-1].strip():
                cells.pop()
            # Markers at the end that were not seen may be left out, unless it is the file that ends.
            if len(cells) != columns and (
                len(cells) > columns or len(cells) % 3 != 1 or not cells[-1].strip() or line[-1] != "\n"
            ):
                raise ValueError(
                    f"{self.WHAT} {number} of {str(self.path)!r} must have {columns + 1} cells for "
                    f"{len(self._names)} markers, separated by tabs, got {len(cells) + 1}"
                )
            try:
                row[: len(cells)] = [float(cell) if cell else np.nan for cell in cells]
                plain = "_" not in line  # which Python's float takes for nothing
            except ValueError:
                plain = False
            if not plain:
                cells = [cell.strip() for cell in cells]
                self._check_cells(number, cells)
                row[: len(cells)] = [float(cell) if cell else np.nan for cell in cells]
        seen = ~np.isnan(table[:, 1:].reshape(len(lines), -1, 3))
        if len(part := np.argwhere(seen.any(axis=2) & ~seen.all(axis=2))):
            frame, marker = part[0]
            raise ValueError(
                f"{self.WHAT} {self._read + frame + 1} of {str(self.path)!r} has only a part of the "
                f"coordinates of marker {self._names[marker]!r}; it must have all three, or none"
            )
        return table

    def _time(self, line: str) -> float:
        return float(line.split("\t", 2)[1])

    def placed(self, table: Storage) -> Markers:
        """Return the markers of some rows, in metres; those at exactly 0 0 0 were not seen, which is said.

        So is a rate in the header that is not that of the times.
        """
        if NUMBER.fullmatch(self._rate) and len(table.time) > 1:
            step = float(np.median(np.diff(table.time)))
            if abs(float(self._rate) * step - 1.0) > UNLIKE:
                logger.warning(
                    "%r says DataRate=%s, and its times are at %.4g Hz; the times count",
                    *(str(self.path), self._rate, 1.0 / step),
                )
            self._rate = ""
        positions = self._unit * table.values.reshape(len(table.time), len(self._names), 3)
        nowhere = (positions == 0.0).all(axis=2)
        if nowhere.any() and not self._told:
            frame, marker = np.argwhere(nowhere)[0]
            logger.warning(
                "%s: markers at exactly 0 0 0 count as not seen, first %s at %g s",
                self.path,
                self._names[marker],
                table.time[frame],
            )
            self._told = True
        positions[nowhere | ~np.isfinite(positions).all(axis=2)] = np.nan
        return Markers(self._names, table.time, positions)


def say_unmatched(known: Sequence[str], recorded: Markers) -> None:
    """Say which recorded markers a model does not know, and which of its own are not in the recording.

    Markers that have two names, one here and one there, count in no pose.
    """
    unknown = [name for name in recorded.names if name not in known]
    if not unknown:
        return
    advice = ""
    if unseen := [name for name in known if name not in recorded.names]:
        advice = f"; the recording has no {listed(unseen, SHOWN)}: rename markers that are the same"
        if 2 * len(unknown) > len(recorded.names):
            advice += ", or take the model of this trial"
    logger.warning(
        "%d of %d markers are not in the model, and left out: %s%s",
        *(len(unknown), len(recorded.names), listed(unknown, SHOWN), advice),
    )


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
        lines.append("\t".join([str(number), f"{time:.9g}", *cells, ""]))  # OpenSim needs the last tab
    with in_place(path) as scratch:
        scratch.write_text("\n".join(lines) + "\n", encoding="utf-8")
