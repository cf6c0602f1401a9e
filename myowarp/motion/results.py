"""Results of the steps of a trial, which write themselves as OpenSim's tools of the same name do.

Angles are in degrees in `.mot`, all else is in `.sto`. Results of parts of a motion, put one after the other
into the same tables, are one file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from myowarp.disk import make_folder
from myowarp.motion.actuators import Actuators
from myowarp.motion.inverse_dynamics import Needed
from myowarp.motion.inverse_kinematics import Fitted
from myowarp.motion.joint_reactions import JointReactions
from myowarp.motion.markers import Markers
from myowarp.motion.movement import ANGLES, Movement, angles_table
from myowarp.motion.muscle_forces import MuscleForces
from myowarp.motion.residuals import Residuals
from myowarp.motion.storage import Storage, Tables
from myowarp.motion.tracking import Tracked
from myowarp.osim.body.model_forces import acts, left_out
from myowarp.osim.body.muscle_paths import MusclePaths
from myowarp.osim.body.skeleton import Bones

RESERVES = "what reserves and motors give, N m and N"
MISSING = "left unbalanced by muscles and reserves, N m and N"


class Result(ABC):
    """A step's result, of all of a motion or of a part of it."""

    @abstractmethod
    def put(self, tables: Tables) -> None:
        """Write it into tables that are open, behind the parts before it."""

    def write(self, folder: Path) -> None:
        """Write its files into a folder, which is made.

        Raises:
            ValueError: The folder cannot be made.
            OSError: A file cannot be written.
        """
        for _ in written([self], folder):
            pass


Found = TypeVar("Found", bound=Result)


def written(results: Iterable[Found], folder: Path) -> Iterator[Found]:
    """Write results of the parts of a motion into a folder, which is made, and yield each.

    Their files take their places when the last one was taken; after an error the folder has what it had.

    Raises:
        As `Result.write`.
    """
    with Tables(folder) as tables:
        for number, found in enumerate(results):
            if not number:
                make_folder(folder)
            found.put(tables)
            yield found


Gap = tuple[str, float, float, bool]
"""A marker, when it was not seen first and last [s], and whether a spline bridged it."""


@dataclass(frozen=True)
class Gaps:
    """Times at which markers were not seen, of all parts of a recording up to one."""

    rows: tuple[Gap, ...] = ()
    going: Mapping[str, tuple[float, bool]] = field(default_factory=dict)
    """First time of those that the last part ended with, and whether they are bridged so far."""

    def after(self, seen: Markers, filled: Markers) -> Gaps:
        """Return those of one part more; a gap that the part before ended with goes on."""
        rows, going, left = list(self.rows), dict[str, tuple[float, bool]](), filled.gaps()
        for name, gaps in seen.gaps().items():
            for first, last in gaps:
                bridged = (first, last) not in left.get(name, ())
                if first == seen.time[0] and name in self.going:
                    first, bridged = self.going[name][0], bridged and self.going[name][1]
                    rows.pop(next(k for k, row in enumerate(rows) if row[:2] == (name, first)))
                if last == seen.time[-1]:
                    going[name] = first, bridged
                rows.append((name, first, last, bridged))
        return Gaps(tuple(rows), going)

    def longest(self) -> list[Gap]:
        """Return them, the longest first."""
        return sorted(self.rows, key=lambda row: row[1] - row[2])


@dataclass(frozen=True, eq=False)
class JointAngles(Result):
    """Joint angles of recorded markers or sensors.

    Attributes:
        bones: The model.
        fitted: The angles, and how markers or sensors fit them.
        recorded: The markers, with gaps filled; None: sensors.
        targets: Weights and wanted values of markers, as `inverse_kinematics` takes them.
        gaps: Times at which markers were not seen, of this part and those before it.
        total: Frames of the recording; None: these are all.
    """

    bones: Bones
    fitted: Fitted
    recorded: Markers | None = None
    targets: Mapping[str, Any] = field(default_factory=dict)
    gaps: Gaps = field(default_factory=Gaps)
    total: int | None = None

    def put(self, tables: Tables) -> None:
        """Write `ik.mot`, `marker_errors.sto` and `gaps.csv`, or `orientation_errors.sto` of sensors."""
        fitted = self.fitted
        angles = angles_table(self.bones.model, fitted.coordinates, fitted.time, fitted.values)
        tables.write("ik.mot", ANGLES, angles, self.total)
        error = Storage(fitted.names, fitted.time, fitted.error)
        if self.recorded is None:
            tables.write("orientation_errors.sto", "angles of sensors, rad", error)
            return
        tables.write("marker_errors.sto", "distances of markers, m", error, self.total)
        rows = [
            (name, f"{first:.9g}", f"{last:.9g}", "yes" if bridged else "no")
            for name, first, last, bridged in self.gaps.longest()
        ]
        tables.write_rows("gaps.csv", [("marker", "first [s]", "last [s]", "filled"), *rows])


Row = tuple[str, str, Iterable[str], np.ndarray | None]
"""File of a table without `.sto`, title, labels and values; None: there is none, and an older file goes."""


@dataclass(frozen=True, eq=False)
class AlongMotion(Result):
    """A result in all frames of a motion.

    Attributes:
        bones: The model.
        motion: The motion, or a part of one.
    """

    bones: Bones
    motion: Movement

    @abstractmethod
    def rows(self) -> Iterator[Row]:
        """Yield its tables."""

    def put(self, tables: Tables) -> None:
        """Write its tables."""
        for name, title, labels, values in self.rows():
            if values is None:
                tables.remove(f"{name}.sto")
            else:
                table = Storage(tuple(labels), self.motion.time, values)
                tables.write(f"{name}.sto", title, table, self.motion.total)

    def _titled(self, title: str) -> str:
        """Return a title with what acts in OpenSim and is left out here."""
        lost = left_out(self.bones.model)
        return f"{title}; {lost}" if lost else title

    def _along(self, name: str, title: str, values: np.ndarray | None) -> Row:
        """Return a table of what acts along the coordinates, named as OpenSim names it."""
        coordinates = self.bones.model.coordinates
        labels = (
            f"{one}_{'moment' if coordinates[one].rotational else 'force'}" for one in self.bones.coordinates
        )
        return name, self._titled(title), labels, values

    def _beside(self, needed: Needed) -> Iterator[Row]:
        """Yield what acts beside muscles: springs and contacts of the model."""
        title = "what springs, limits, bushings and ligaments of the model give, N m and N"
        yield self._along("passive_moments", title, needed.passive if acts(self.bones.model) else None)
        if (found := needed.contacts) is None:
            yield "contact_forces", "", (), None
            return
        labels = (
            f"{pair.force}.{pair.second.name}.{part}.{axis}"
            for pair in found.pairs
            for part in ("force", "point")
            for axis in "XYZ"
        )
        table = np.concatenate([found.force, found.location], axis=2).reshape(len(self.motion.time), -1)
        title = "contact forces on the geometry that a label names, N, and where they act, m; in ground"
        yield "contact_forces", self._titled(title), labels, table


@dataclass(frozen=True, eq=False)
class JointMoments(AlongMotion):
    """Joint moments that a motion takes under its loads: `moments.sto`, and what acts beside muscles.

    Attributes:
        needed: The moments, and what the model's own springs and contacts do.
        residuals: Disagreement of motion and loads, at roots.
        doubt: What is likely wrong with the loads, or stands for them; "": nothing.
    """

    needed: Needed
    residuals: Residuals
    doubt: str

    def rows(self) -> Iterator[Row]:
        """Yield its tables."""
        title = f"joint moments, N m and N{self.doubt and f'; {self.doubt}'}"
        yield self._along("moments", title, self.needed.joint_moment)
        yield from self._beside(self.needed)


@dataclass(frozen=True, eq=False)
class MuscleAnalysis(AlongMotion):
    """Muscles along a motion: lengths, velocities, moment arms, forces, and powers of both forces together.

    Attributes:
        paths: Lengths, velocities and moment arms.
        active: Forces at full activation with a rigid tendon [N], shape (frames, muscles).
        passive: Passive forces in equilibrium [N], likewise.
        needed: What springs and contacts of the model do meanwhile.
    """

    paths: MusclePaths
    active: np.ndarray
    passive: np.ndarray
    needed: Needed

    def rows(self) -> Iterator[Row]:
        """Yield its tables."""
        paths, names = self.paths, self.paths.muscles
        power = -(self.active + self.passive) * paths.velocity
        arms = {
            f"{muscle}.{coordinate}": paths.moment_arm[:, i, k]
            for i, (muscle, crossed) in enumerate(zip(names, paths.crossed, strict=True))
            for k, coordinate in enumerate(self.bones.coordinates)
            if k in crossed
        }
        yield "lengths", "lengths of muscle and tendon, m", names, paths.length
        yield "velocities", "velocities of muscle and tendon, m/s, lengthening > 0", names, paths.velocity
        yield "active_forces", "active forces at full activation, rigid tendon, N", names, self.active
        yield "passive_forces", "passive forces, N", names, self.passive
        yield "full_powers", "powers at full activation, W, shortening > 0", names, power
        yield "moment_arms", "moment arms, m", arms, np.stack(list(arms.values()), axis=1)
        yield from self._beside(self.needed)


@dataclass(frozen=True, eq=False)
class MotionForces(AlongMotion):
    """Forces that give the moments of a motion at the least cost.

    Attributes:
        moments: The joint moments.
        solved: Forces and activations of muscles, reserves, and what is missing.
        metabolic_power: Of each muscle [W], without the rate at rest, shape (frames, muscles).
        actuators: Motors of the model; None: it has none.
        reactions: Forces and moments of joints on their children.
    """

    moments: JointMoments
    solved: MuscleForces
    metabolic_power: np.ndarray
    actuators: Actuators | None
    reactions: JointReactions

    @property
    def residuals(self) -> Residuals:
        """Share of roots that muscles leave over."""
        return Residuals.of(self.bones, self.motion.time, self.solved.reserve + self.solved.missing)

    def rows(self) -> Iterator[Row]:
        """Yield its tables, those of the moments first."""
        yield from self.moments.rows()
        found, reactions, actuators = self.solved, self.reactions, self.actuators
        for name, title, values in (
            ("activations", "activations", found.activation),
            ("forces", "forces of muscles, N", found.force),
            ("powers", "powers of muscles, W, shortening > 0", found.power),
            ("metabolic_powers", "metabolic powers of muscles, W, without the rate at rest",
             self.metabolic_power),
        ):  # fmt: skip
            yield name, self._titled(title), found.muscles, values
        given = None if actuators is None else found.control * actuators.optimal
        yield "actuators", self._titled("what motors give, N m and N"), found.motors, given
        labels = (  # of OpenSim's JointReaction: on the child, in ground
            f"{joint}_on_{child}_in_ground_{part}{axis}"
            for joint, child in zip(reactions.joints, reactions.children, strict=True)
            for part in "fmp"
            for axis in "xyz"
        )
        parts = np.concatenate([reactions.force, reactions.moment, reactions.point], axis=2)
        table = parts.reshape(len(self.motion.time), -1)
        yield "joint_reactions", self._titled("joint reactions, N, N m and m"), labels, table
        yield self._along("reserves", RESERVES, found.reserve)
        yield self._along("missing", MISSING, found.missing)


@dataclass(frozen=True, eq=False)
class TrackedMotion(AlongMotion):
    """A simulation that follows a motion.

    Attributes:
        tracked: The simulation, one world; its times are those of `motion`.
    """

    tracked: Tracked

    @property
    def residuals(self) -> Residuals:
        """Share of reserves and motors at roots."""
        return Residuals.of(self.bones, self.tracked.time, self.tracked.reserve[:, 0])

    def put(self, tables: Tables) -> None:
        """Write `tracked.mot`, and its tables."""
        found = self.tracked
        angles = angles_table(self.bones.model, found.coordinates, found.time, found.values[:, 0])
        tables.write("tracked.mot", ANGLES, angles)
        super().put(tables)

    def rows(self) -> Iterator[Row]:
        """Yield its tables."""
        found = self.tracked
        for name, title, values in (
            ("excitations", "excitations", found.excitation),
            ("activations", "activations", found.activation),
            ("fiber_lengths", "fiber lengths, m", found.fiber_length),
            ("forces", "forces of muscles, N", found.force),
        ):
            yield name, self._titled(title), found.muscles, values[:, 0]
        yield self._along("reserves", RESERVES, found.reserve[:, 0])
