"""Coordinates of a recording: which columns they are, and whether their units and times can be.

OpenSim's rule gives the unit of angles (see `storage`). It is not enough where the header says nothing, says
something else in its words, or is wrong: a knee at 60 rad, or a walk within 1.2 degrees. Both readings are
said then; the file is refused where its header does not decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from myowarp.motion.storage import Storage, logger
from myowarp.osim.document.model import Model
from myowarp.osim.document.read.frames import TURN
from myowarp.process import listed

BEYOND = np.pi / 2
"""[rad] behind the end of a range from which, beyond a turn, an angle is doubted."""
NEAR = 0.2
"""[rad] behind the end of a range up to which it may be one of a pose."""
STILL = 0.1
"""[rad] within which a whole recording in degrees is doubted, where it would be a pose in radians."""
POSED = np.radians(20.0)
"""[rad] that such a pose has somewhere."""
ALIKE = 0.8
"""Share of two names from which one may be the other, misspelt (difflib's ratio)."""
SLOW, LASTING = 5.0, 60.0
"""Rate [Hz] below which, and length [s] beyond which times are hardly seconds."""
EVEN, MOST = 0.25, 0.9
"""Share of the usual step by which others may differ, and of the steps which do not, in even recordings."""
MISSING = 2.5
"""Usual steps from which one is a gap; through the place of a single frame splines go well enough."""
HALF_TURN = np.pi
"""[rad] that no joint turns from one row to the next; angles of arc tangents do, where they wrap."""
HELD = 1e-3
"""[rad] or [m] that a recording may have a locked coordinate from its default."""
SHOWN = 5
"""Columns that are named."""


def coordinate_of(label: str) -> str:
    """Return the coordinate of a column, called like it or like its state, `/jointset/knee/angle/value`."""
    return label.split("/")[-2] if label.endswith("/value") else label


def hardly_seconds(path: Path, time: np.ndarray) -> str:
    """Return why times of a recording, shape (rows,), are hardly seconds; "": they may be."""
    lasts = float(time[-1] - time[0])
    rate = (len(time) - 1) / max(lasts, 1e-9)
    if lasts <= LASTING or rate >= SLOW:
        return ""
    return (
        f"the recording {str(path)!r} lasts {lasts:.4g} s at {rate:.2g} Hz; is its time in ms, or in percent?"
    )


def doubtful_times(path: Path, time: np.ndarray) -> Iterator[str]:
    """Yield what is doubtful of the times of a recording through which splines go, shape (rows,)."""
    if doubt := hardly_seconds(path, time):
        yield doubt
    steps = np.diff(time)
    usual = np.median(steps) if len(steps) else 0.0
    if usual and steps.max() > MISSING * usual and np.mean(np.abs(steps - usual) <= EVEN * usual) >= MOST:
        gap = int(steps.argmax())
        yield (
            f"{str(path)!r} has no rows between {time[gap]:.4g} and {time[gap + 1]:.4g} s "
            f"({steps[gap] / usual - 1.0:.0f} are missing), which a spline bridges; fill the gap, or cut the "
            "file there"
        )


class Angles:
    """Coordinates of a recording, which may come in parts; what is doubtful of it is said once.

    Attributes:
        path: The recording.
    """

    def __init__(self, path: Path, model: Model) -> None:
        """Begin with none.

        Args:
            path: The recording.
            model: Whose coordinates they are.
        """
        self.path, self._model, self._told = path, model, set[str]()

    def of(self, table: Storage, coordinates: Iterable[str]) -> dict[str, np.ndarray]:
        """Return those of some coordinates that a table of the recording has [rad] or [m].

        Raises:
            ValueError: A coordinate is there twice, or the header leaves the unit open and it matters.
        """
        names = [coordinate_of(label) for label in table.labels]
        columns: dict[str, np.ndarray] = {}
        for name in coordinates:
            if names.count(name) > 1:
                raise ValueError(f"{str(self.path)!r} has two columns of the coordinate {name!r}")
            if name in names:
                columns[name] = table.values[:, names.index(name)]
        turning = {name: x for name, x in columns.items() if self._model.coordinates[name].rotational}
        if turning and len(table.time):
            self._check(table, turning)
        return columns | ({name: np.radians(x) for name, x in turning.items()} if table.in_degrees else {})

    def check_columns(self, table: Storage, absent: Iterable[str]) -> None:
        """Name columns that no coordinate reads, or a locked one, and doubt times that are hardly seconds.

        Args:
            table: Of the recording.
            absent: Coordinates that are wanted, and that it has not.

        Raises:
            ValueError: Such a column is called nearly like one of them.
        """
        known = {name.lower(): name for name in self._model.coordinates}
        states = {label for label in table.labels if "/" in label and not label.endswith("/value")}
        columns = (coordinate_of(label) for label in table.labels if label not in states)
        unread = [column for column in columns if column not in self._model.coordinates]
        for column in unread:
            for near in get_close_matches(column.lower(), known, 1, ALIKE):
                if (name := known[near]) in absent:
                    raise ValueError(
                        f"{str(self.path)!r} has no {name!r}, and a column {column!r}, which the model does "
                        f"not know; rename the column if it is {name!r}, or remove it, and {name!r} stands "
                        "at its default"
                    )
        if unread:
            said = f"no coordinate of the model reads these columns of {str(self.path)!r}"
            self._say("columns", f"{said}: {listed(unread, SHOWN)}")
        if held := self._held(table):
            self._say(
                "locked",
                f"locked in the model, and not where {str(self.path)!r} has it: {', '.join(held[:SHOWN])}; "
                "OpenSim's inverse dynamics moves it all the same: unlock it if it moves",
            )
        if doubts := [*doubtful_times(self.path, table.time)]:
            self._say("time", "; ".join(doubts))

    def _held(self, table: Storage) -> list[str]:
        """Return the locked coordinates that a table has elsewhere."""
        found = []
        for label, values in zip(table.labels, table.values.T, strict=True):
            known = self._model.coordinates.get(coordinate_of(label))
            if known is not None and known.locked and known.name not in self._model.couplers:
                turns = known.rotational and table.in_degrees
                if np.abs((np.radians(values) if turns else values) - known.default).max(initial=0.0) > HELD:
                    found.append(known.name)
        return found

    def _check(self, table: Storage, turning: dict[str, np.ndarray]) -> None:
        """Ask whether angles, as they stand in the file, can have the unit that it is read in."""
        path, unit = str(self.path), "degrees" if table.in_degrees else "radians"
        if table.unit not in ("", "degrees", "radians"):
            raise ValueError(f"{path!r} has inDegrees={table.unit}; it must be yes or no")
        if table.unit not in ("", unit):
            raise ValueError(
                f"the header of {path!r} says {table.unit}, and OpenSim reads it in {unit}; write the lines "
                "version=1 and inDegrees=yes, or inDegrees=no, into it"
            )
        scale = np.pi / 180.0 if table.in_degrees else 1.0
        most = {name: float(x[np.abs(x).argmax()]) for name, x in turning.items()}
        beyond = [
            name
            for name, x in most.items()
            if abs(scale * x) > TURN and not self._in_range(name, scale * x, BEYOND)
        ]
        if beyond:
            name = max(beyond, key=lambda one: abs(most[one]))
            low, high = np.degrees(self._model.coordinates[name].range)
            turned = np.degrees(most[name])
            text = (
                f"{name} of {path!r} goes to {most[name]:.4g}, in radians {turned:.4g} degrees; its range is "
                f"{low:.4g} to {high:.4g} degrees"
            )
            if not table.unit and not table.in_degrees:
                raise ValueError(
                    f"{text}; a .mot or .sto file says which by a line inDegrees=yes or inDegrees=no"
                )
            if not table.in_degrees:
                raise ValueError(
                    f"{text}; its header says inDegrees=no, so correct it to inDegrees=yes, or write true "
                    "turns in degrees"
                )
            self._say("unit", f"{text}; the file is read in {unit}, as its header says")
        elif table.in_degrees and self._still(most):
            size = max(map(abs, most.values()))
            self._say(
                "unit",
                f"all angles of {path!r} are within {size:.3g} degrees; if they are radians, up to "
                f"{np.degrees(size):.3g} degrees, its header must say version=1 and inDegrees=no",
            )
        elif not table.unit and not table.in_degrees:
            self._say("unit", f"{path!r} is read in radians: its header does not say inDegrees")
        for name, x in () if beyond else turning.items():
            turns = np.abs(scale * np.diff(x))
            if turns.max(initial=0.0) > HALF_TURN:
                k = int(turns.argmax())
                self._say(
                    "jump",
                    f"{name} of {path!r} goes from {x[k]:.4g} to {x[k + 1]:.4g} {unit} in one step, from "
                    f"{table.time[k]:.4g} s on, which a spline follows; unwrap it",
                )

    def _still(self, most: dict[str, float]) -> bool:
        """Whether angles hardly leave 0 in degrees, and are a pose within all ranges in radians."""
        size = max(map(abs, most.values()))
        return POSED <= size <= np.degrees(STILL) and all(
            self._in_range(name, x, NEAR) for name, x in most.items()
        )

    def _in_range(self, name: str, angle: float, slack: float) -> bool:
        """Whether an angle [rad] is in the range of a coordinate, or so far from it at most."""
        low, high = self._model.coordinates[name].range
        return bool(low - slack <= angle <= high + slack)

    def _say(self, what: str, text: str) -> None:
        """Say it, unless something was said of this side of the recording before."""
        if what not in self._told:
            logger.warning("%s", text)
        self._told.add(what)
