"""Joint angles over time: read from files, smoothed and differentiated, in parts where long; and written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from myowarp.motion.markers import Markers
from myowarp.motion.smooth import derivatives
from myowarp.motion.storage import Storage, read_storage, rows_between, within, write_storage
from myowarp.motion.streams import Margin, Stream, is_long
from myowarp.motion.units import Angles
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, forward, station
from myowarp.osim.document.model import Model

ANGLES = "Coordinates"
"""Name of a file of joint angles, in its header."""
FOUND = ("tracked.mot", "ik.mot")
"""Joint angles that a folder of `myowarp motion` may have, the first that is there is taken."""
NO_MOTION = ("Speeds", "Accelerations", "PositionErrors")
"""Names of files of OpenSim's tools whose columns are named by coordinates and hold none."""


@dataclass(frozen=True, eq=False)
class Movement:
    """A motion in the independent coordinates of a model.

    Attributes:
        time: [s], shape (frames,).
        values: [rad] or [m], shape (frames, coordinates).
        speeds: Their derivatives by time.
        accelerations: Their second derivatives.
        absent: Coordinates that the file has not, which stand at their default.
        first: Number of the first frame, where these are a part of a motion.
        total: Frames of the motion; None: these are all.
    """

    time: np.ndarray
    values: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    absent: tuple[str, ...]
    first: int = 0
    total: int | None = None

    @property
    def moved(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values, speeds and accelerations."""
        return self.values, self.speeds, self.accelerations

    def between(self, start: float, end: float) -> Movement:
        """Return the frames from `start` to `end` [s], both included; the filter has seen all.

        Raises:
            ValueError: There is none.
        """
        return self.part(rows_between(self.time, start, end, "motion is"))

    def part(self, frames: np.ndarray, first: int = 0, total: int | None = None) -> Movement:
        """Return some frames, of which the first has a number in a motion of so many."""
        values, speeds, accelerations = (rows[frames] for rows in self.moved)
        return Movement(self.time[frames], values, speeds, accelerations, self.absent, first, total)


def motion_in(path: Path) -> Path:
    """Return the joint angles of a folder of `myowarp motion`, or the file that is given itself.

    Raises:
        ValueError: The folder has none.
    """
    if not path.is_dir():
        return path
    for name in FOUND:
        if (path / name).is_file():
            return path / name
    raise ValueError(f"{str(path)!r} has neither of {', '.join(FOUND)}; give the file itself")


def read_motion(path: Path, bones: Bones, cutoff: float | None = None) -> Movement:
    """Return the motion of a `.mot` or `.sto` file, smoothed and differentiated.

    Columns are named by coordinates, or as OpenSim's states, `/jointset/knee_r/knee_angle_r/value`. Others
    are named, and left alone. Coordinates that follow others do so, whatever the file says.

    Args:
        path: The file.
        bones: The model.
        cutoff: Frequency of the filter [Hz]; None: none.

    Raises:
        ValueError: The file is none, has no coordinate of the model or a column called nearly like one, or is
            too short.
        OSError: It cannot be read.
    """
    return _moved(Angles(path, bones.model), read_storage(path), bones, cutoff)


def _moved(angles: Angles, table: Storage, bones: Bones, cutoff: float | None) -> Movement:
    """Return the motion of a table."""
    if table.title in NO_MOTION:
        raise ValueError(
            f"{str(angles.path)!r} calls itself {table.title!r}; a motion holds coordinates, as OpenSim's "
            "tools write them into the file that ends in _Kinematics_q.sto"
        )
    found = angles.of(table, bones.coordinates)
    if not found:
        raise ValueError(
            f"{str(angles.path)!r} has no column of a coordinate; the model has "
            f"{', '.join(bones.coordinates)}"
        )
    absent = tuple(name for name in bones.coordinates if name not in found)
    angles.check_columns(table, absent)
    still = np.full(len(table.time), 1.0)
    defaults = (bones.model.coordinates[name].default for name in bones.coordinates)
    columns = {name: still * x for name, x in zip(bones.coordinates, defaults, strict=True)} | found
    values = np.stack(list(columns.values()), axis=1)
    return Movement(
        table.time,
        *derivatives(table.time, values, table.time, cutoff),
        absent,
    )


def read_parts(
    path: Path, bones: Bones, cutoff: float | None = None, span: tuple[float, float] | None = None
) -> Iterator[Movement]:
    """Yield the motion of a long file in parts; what is written of them one after the other is one file.

    A file that is not long gives one part. Times of a long one must increase. The filter and the splines see
    so much of the frames before and after a part that nothing but rounding differs from those of all.

    Args:
        path: The file.
        bones: The model.
        cutoff: Frequency of the filter [Hz]; None: none.
        span: First and last time [s]; None: all.

    Raises:
        ValueError: As `read_motion`; or there is no frame in the span.
        OSError: The file cannot be read.
    """
    if not is_long(path):
        motion = read_motion(path, bones, cutoff)
        yield motion if span is None else motion.between(*span)
        return
    angles, first = Angles(path, bones.model), 0
    with Stream(path) as stream:
        total = stream.count(span)
        for table, own in stream.parts(Margin(cutoff=cutoff)):
            kept = np.zeros(len(table.time), bool)
            kept[own] = within(table.time[own], *span) if span else True
            if kept.any():
                part = _moved(angles, table, bones, cutoff).part(kept, first, total)
                yield part
                first += len(part.time)


def marker_places(bones: Bones, time: np.ndarray, values: np.ndarray) -> Markers:
    """Return where the model's markers are along a motion: what cameras without noise would see.

    Args:
        bones: The model.
        time: [s], shape (frames,).
        values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).

    Raises:
        ValueError: The model has no marker.
    """
    model = bones.model
    if not model.markers:
        raise ValueError(f"model {model.name!r} has no marker; give a MarkerSet")
    whole = complete(model, dict(zip(bones.coordinates, np.asarray(values).T, strict=True)), len(time))
    frames = forward(model, whole)
    places = [station(frames, marker.body, marker.location) for marker in model.markers.values()]
    return Markers(tuple(model.markers), np.asarray(time, float), np.stack(places, axis=1))


def angles_table(model: Model, coordinates: Sequence[str], time: np.ndarray, values: np.ndarray) -> Storage:
    """Return a motion in degrees, with all coordinates of the model, as it is written."""
    whole = complete(model, dict(zip(coordinates, values.T, strict=True)), len(time))
    columns = [np.degrees(v) if model.coordinates[name].rotational else v for name, v in whole.items()]
    return Storage(tuple(whole), time, np.stack(columns, axis=1), True)


def write_angles(
    path: Path, model: Model, coordinates: Sequence[str], time: np.ndarray, values: np.ndarray
) -> None:
    """Write a motion in degrees, with all coordinates of the model.

    Raises:
        OSError: The file cannot be written.
    """
    write_storage(path, ANGLES, angles_table(model, coordinates, time, values))
