"""Map from OpenSim coordinates to MuJoCo joints: the sidecar `coordinates.json`.

A free coordinate q has a joint with the value scale * q. All other joints follow one joint each by a
quartic, as the equality of the same name says; `couplings.json` says what the quartic stands for.
Moment arms with respect to a coordinate collect all joints that follow it: with the Jacobian of `rates`,
dl/dq = sum over joints of dl/dqpos * dqpos/dq.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from myowarp.osim.bundle.couplings import couplings

Array = np.ndarray


@dataclass(frozen=True)
class MappedCoordinate:
    """A coordinate of the OpenSim model."""

    name: str
    joint: str | None
    """Joint that shows it; None: none does, since it is locked, or moves bodies by splines only."""
    scale: float
    """joint value = scale * coordinate."""
    kind: str
    """free, coupled (follows another one), locked."""
    rotational: bool
    default: float
    """[rad] or [m]."""
    range: tuple[float, float]
    """Over which it is sampled [rad] or [m]; a limit of the joint if `clamped`."""
    clamped: bool


@dataclass(frozen=True)
class Dependent:
    """A joint that follows another one: value = c[0] + c[1] x + ... + c[4] x^4."""

    joint: str
    of: str
    """Joint x."""
    polynomial: tuple[float, float, float, float, float]
    error: float
    """Greatest error of the value over the range of the coordinate [rad] or [m]; 0: exact."""
    slope_error: float
    """Root mean square error of the slope [1/rad or 1/m of the above]."""


@dataclass(frozen=True)
class CoordinateMap:
    """All coordinates, and all joints that follow."""

    coordinates: tuple[MappedCoordinate, ...]
    dependents: tuple[Dependent, ...]
    """Each after the joint that it follows."""

    def free(self) -> list[str]:
        """Return the coordinates that may be chosen."""
        return [coordinate.name for coordinate in self.coordinates if coordinate.kind == "free"]

    def qpos(self, model: mujoco.MjModel, values: Mapping[str, Array]) -> Array:
        """Return joint positions.

        Args:
            model: Compiled from the same conversion.
            values: Of free coordinates [rad] or [m], shape (n,); the others stand at default.

        Returns:
            Shape (n, nq).
        """
        return self.rates(model, values)[0]

    def rates(self, model: mujoco.MjModel, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return joint positions, shape (n, nq), and their slopes by the free coordinates, (n, nv, free).

        All joints have one degree of freedom, so that nq = nv.
        """
        count = max((np.size(value) for value in values.values()), default=1)
        free = self.free()
        position = np.zeros((count, model.nq))
        slope = np.zeros((count, model.nv, len(free)))
        for coordinate in self.coordinates:
            if coordinate.kind == "free" and coordinate.joint is not None:
                joint = model.joint(coordinate.joint)
                value = np.asarray(values.get(coordinate.name, coordinate.default), float)
                position[:, joint.qposadr[0]] = coordinate.scale * value
                slope[:, joint.dofadr[0], free.index(coordinate.name)] = coordinate.scale
        for tie in couplings(model):
            value, rate, _ = tie.derivatives(position[:, tie.driver])
            position[:, tie.joint] = value
            slope[:, tie.joint] = rate[:, None] * slope[:, tie.driver]
        return position, slope

    @classmethod
    def read(cls, path: Path) -> "CoordinateMap":
        """Return what a `coordinates.json` says."""
        entry = json.loads(path.read_text())
        return cls(
            tuple(MappedCoordinate(**one) for one in entry["coordinates"]),
            tuple(Dependent(**one) for one in entry["dependents"]),
        )

    def as_json(self) -> dict[str, object]:
        """Return the content of `coordinates.json`."""
        return dataclasses.asdict(self)
