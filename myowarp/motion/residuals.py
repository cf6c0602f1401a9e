"""Residuals of a motion: what it and its loads disagree by, at joints that carry the model through space.

Hicks et al. (2015), doi:10.1115/1.4029304, ask for forces below a twentieth of the greatest external force;
here it is a twentieth of the weight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from myowarp.motion.inverse_dynamics import Load, Needed
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import floating

SMALL = 0.05
"""Share of the weight up to which a residual is not doubted."""
FAR = 0.5
"""Distance of a centre of pressure from the origin of its body [m] from which it is doubted."""
LOADED = 0.5
"""Share of a load's greatest force from which its centre of pressure is looked at."""

Peak = tuple[float, str, float]
"""Size, coordinate, and time [s]."""
NONE: Peak = (0.0, "", 0.0)


@dataclass(frozen=True)
class Residuals:
    """The greatest residuals of a motion.

    Attributes:
        weight: Of the model [N].
        force: The greatest force [N]; of no coordinate where none slides.
        moment: The greatest moment [N m], likewise.
    """

    weight: float
    force: Peak = NONE
    moment: Peak = NONE

    @classmethod
    def of(cls, bones: Bones, time: np.ndarray, given: np.ndarray) -> Residuals:
        """Return those of a motion.

        Args:
            bones: The model.
            time: [s], shape (frames,).
            given: What acts along independent coordinates and is no muscle's [N m] or [N], shape (frames,
                coordinates).
        """
        model, peaks = bones.model, {True: NONE, False: NONE}
        for name in floating(model):
            size = np.abs(given[:, bones.coordinates.index(name)])
            k, turns = int(size.argmax()), model.coordinates[name].rotational
            peaks[turns] = max(peaks[turns], (float(size[k]), name, float(time[k])))
        mass = sum(body.mass for body in model.bodies.values())
        return cls(mass * float(np.linalg.norm(model.gravity)), peaks[False], peaks[True])

    def among(self, other: Residuals) -> Residuals:
        """Return the greatest of these and others of the same model."""
        return Residuals(self.weight, max(self.force, other.force), max(self.moment, other.moment))

    @property
    def share(self) -> str:
        """The greatest force, as a share of the weight, and where and when it is."""
        force, name, time = self.force
        part = f" ({100.0 * force / self.weight:.0f} % of the weight)" if self.weight else ""
        return f"{force:.0f} N{part} at {name}, at {time:.4g} s"

    def lines(self) -> list[str]:
        """Return the greatest force and the greatest moment in one line; none where nothing moves freely."""
        said = [self.share] if self.force[1] else []
        if self.moment[1]:
            said.append(f"{self.moment[0]:.3g} N m at {self.moment[1]}, at {self.moment[2]:.4g} s")
        return [f"residuals at the root: {'; '.join(said)}"] if said else []

    def doubt(self, loaded: bool) -> str:
        """Return what is likely wrong with the loads, or that there are none; "": little is left."""
        if not self.force[0] > SMALL * self.weight:
            return ""
        if not loaded:
            return f"no external loads: {self.share}, carry the weight"
        left = f"more than {100.0 * SMALL:.0f} % of the weight is left at the root"
        return f"check sign, unit and bodies of the loads, and the filter: {left}"


def astray(bones: Bones, needed: Needed, loads: Sequence[Load]) -> Iterator[str]:
    """Yield which recorded loads act far from their bodies.

    Args:
        bones: The model.
        needed: Where bodies are.
        loads: Those of a recording bear names; others are the model's own.
    """
    for load in loads:
        size, body = np.linalg.norm(load.force, axis=1), bones.number(load.body)
        if not load.name or body < 0 or not size.any():
            continue
        point, frame = load.point, bones.number(load.point_frame)
        if frame >= 0:
            turned = np.einsum("fij,fj->fi", needed.rotation[:, frame], point)
            point = needed.origin[:, frame] + turned
        off = np.linalg.norm(point - needed.origin[:, body], axis=1)
        if (most := float(off[size >= LOADED * size.max()].max())) > FAR:
            place = f"the centre of pressure of {load.name!r} is {most:.2g} m from {load.body}"
            yield f"{place}: wrong foot or unit?"
