"""Loads from outside, as OpenSim's `ExternalLoads` names them: columns of a recording, and where they act."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from myowarp.laws.expressions import values_of
from myowarp.motion.inverse_dynamics import Load
from myowarp.motion.setup_words import body_of, file_of, stated
from myowarp.motion.storage import Storage, logger, read_storage
from myowarp.motion.streams import Stream
from myowarp.motion.units import doubtful_times
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.model import GROUND
from myowarp.osim.document.read.element import Element, parse
from myowarp.process import start_warp

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class LoadColumns:
    """Columns of a recording that are a load.

    Attributes:
        name: Of the load.
        body: Where it acts.
        force: First part of the names of three columns [N]; empty: no force.
        point: The same of where the force acts [m]; empty: at the body's origin.
        torque: The same of a torque [N m]; empty: none.
        force_frame: Body in whose axes force and torque are given.
        point_frame: Body in which the point is given.
    """

    name: str
    body: str
    force: str = ""
    point: str = ""
    torque: str = ""
    force_frame: str = "ground"
    point_frame: str = "ground"

    def at(self, recording: Storage, times: np.ndarray) -> Load:
        """Return the load at some times [s], along the natural cubic spline through its rows.

        Raises:
            ValueError: A column is missing, or times lie outside of the recording.
        """
        from scipy.interpolate import CubicSpline

        if times[0] < recording.time[0] - 1e-6 or times[-1] > recording.time[-1] + 1e-6:
            raise ValueError(
                f"load {self.name!r} is recorded from {recording.time[0]:g} to {recording.time[-1]:g} s; the "
                f"motion is from {times[0]:g} to {times[-1]:g} s"
            )

        def columns(prefix: str) -> np.ndarray:
            if not prefix:
                return np.zeros((len(times), 3))
            found = []
            for axis in AXES:
                if prefix + axis not in recording.labels:
                    raise ValueError(
                        f"load {self.name!r} needs the column {prefix + axis!r}; the recording has "
                        f"{', '.join(recording.labels)}"
                    )
                found.append(recording.values[:, recording.labels.index(prefix + axis)])
            curve = CubicSpline(recording.time, np.stack(found, axis=1), bc_type="natural")
            return np.asarray(curve(times))

        force, point, torque = columns(self.force), columns(self.point), columns(self.torque)
        point_frame = self.point_frame if self.point else self.body
        return Load(self.body, force, point, torque, self.force_frame, point_frame, self.name)


def read_loads(path: Path) -> tuple[tuple[LoadColumns, ...], Path | None]:
    """Read a file of `ExternalLoads`.

    Returns:
        The loads that are on, and the file of their columns, beside it unless given whole; None: it names
            none.

    Raises:
        ValueError: It is no such file.
        OSError: It cannot be read.
    """
    root, _ = parse(path)
    loads = root if root.tag == "ExternalLoads" else root.own("ExternalLoads")
    if loads is None:
        raise root.error("holds no <ExternalLoads>")
    found = tuple(_columns(force) for force in loads.objects("objects") if _applies(force))
    if not found:
        logger.warning("%s has no <ExternalForce> that acts", path)
    return found, file_of(loads, "datafile")


def _applies(element: Element) -> bool:
    return not element.flag("isDisabled", default=False) and element.flag("appliesForce", default=True)


def _columns(element: Element) -> LoadColumns:
    """Return which columns an external force is."""
    body = body_of(stated(element, "applied_to_body"))
    if not body:
        raise element.error("says not on which body it acts; <applied_to_body> is needed")
    force, point, torque = (stated(element, f"{part}_identifier") for part in ("force", "point", "torque"))
    if not force and (point or not torque):
        raise element.error(
            f"has {'a point of no force' if point else 'neither a force nor a torque'}; it needs the "
            "columns of one in <force_identifier>, or in <torque_identifier>"
        )
    frames = (
        body_of(stated(element, f"{part}_expressed_in_body") or "ground") for part in ("force", "point")
    )
    return LoadColumns(element.name, body, force, point, torque, *frames)


class Loads:
    """The loads of a file of `ExternalLoads`."""

    def __init__(self, path: Path, forwards: bool = False) -> None:
        """Read the file.

        Args:
            path: The file.
            forwards: Whether the recording is read a part at a time.

        Raises:
            ValueError: A file is not what it should be.
            OSError: A file cannot be read.
        """
        self._columns, source = read_loads(path)
        if source is None:
            raise ValueError(f"{str(path)!r} names no <datafile>; give the file of the recorded forces")
        self._recording = Stream(source) if forwards else read_storage(source)
        if isinstance(self._recording, Storage):
            for doubt in doubtful_times(source, self._recording.time):
                logger.warning("%s", doubt)

    def close(self) -> None:
        """Close the recording."""
        if isinstance(self._recording, Stream):
            self._recording.close()

    def at(self, times: np.ndarray) -> list[Load]:
        """Return the loads at some times [s]; of a recording read forwards, after those asked for before.

        Raises:
            ValueError: The recording does not cover the times.
        """
        table = self._recording
        if isinstance(table, Stream):
            table = table.around(times[0], times[-1])
        return [one.at(table, times) for one in self._columns]


def prescribed_loads(bones: Bones, time: np.ndarray) -> list[Load]:
    """Return what a model's own `PrescribedForce`s put on bodies.

    Args:
        bones: The model.
        time: [s], shape (frames,).
    """
    start_warp()
    found = []
    for one in bones.model.prescribed_forces:
        parts = values_of(one.formulas, time[:, None]).reshape(len(time), 3, 3)
        force, point, torque = parts.swapaxes(0, 1)
        if not one.force_in_ground:
            force, torque = (part @ one.frame.rotation.T for part in (force, torque))
        if not one.point_in_ground:
            point = one.frame.position + point @ one.frame.rotation.T
        axes, place = (GROUND if on else one.body for on in (one.force_in_ground, one.point_in_ground))
        found.append(Load(one.body, force, point, torque, axes, place))
    return found


def loads_at(path: Path, times: np.ndarray) -> list[Load]:
    """Return the loads of a file of `ExternalLoads` at some times [s].

    Args:
        path: The file.
        times: Increasing, shape (frames,).

    Raises:
        ValueError: A file is not what it should be, or does not cover the times.
        OSError: A file cannot be read.
    """
    return Loads(path).at(times)
