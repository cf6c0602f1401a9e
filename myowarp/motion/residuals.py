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
"""Distance of a centre of pressure from the origin of its body [m] from which it is doubted; and lever at
which a force turns as much as a torque from which that is."""
LOADED = 0.5
"""Share of a load's greatest force from which its centre of pressure is looked at."""
MOSTLY = 0.5
"""Share of these frames from which a load lies under another body, being nearer to it; the foot that swings
past the one that stands is nearer in fewer."""
PUSHING = 0.25
"""Share of the weight from which loads are said to carry the model."""
OTHER = 0.1
"""Share of the weight from which loads that carry so much more or less are another person's."""
HEAVY = 1000.0
"""Mass from which a model is no person [kg]."""

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
        carried: Sums over the frames in which recorded loads push up [N]: of what they carry, and of what
            holds the model up, over its weight and acceleration.
    """

    weight: float
    force: Peak = NONE
    moment: Peak = NONE
    carried: tuple[float, float] = (0.0, 0.0)

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
        return cls(model.mass * float(np.linalg.norm(model.gravity)), peaks[False], peaks[True])

    def among(self, other: Residuals) -> Residuals:
        """Return the greatest of these and others of the same model."""
        loads, whole = (a + b for a, b in zip(self.carried, other.carried, strict=True))
        peaks = max(self.force, other.force), max(self.moment, other.moment)
        return Residuals(self.weight, *peaks, (loads, whole))

    @property
    def share(self) -> str:
        """The greatest force, as a share of the weight, and where and when it is."""
        force, name, time = self.force
        part = f" ({100.0 * force / self.weight:.0f} % of the weight)" if self.weight else ""
        return f"{force:.0f} N{part} at {name}, at {time:.4g} s"

    def lines(self) -> list[str]:
        """Return the greatest force and moment, if anything moves freely, and doubt whose loads they are."""
        said = [self.share] if self.force[1] else []
        if self.moment[1]:
            said.append(f"{self.moment[0]:.3g} N m at {self.moment[1]}, at {self.moment[2]:.4g} s")
        lines = [f"residuals at the root: {'; '.join(said)}"] if said else []
        loads, whole = self.carried
        if whole > 0.0 and abs(loads / whole - 1.0) > OTHER:
            lines.append(
                f"loads carry {100.0 * loads / whole:.0f} % of the weight: is the model this person's?"
            )
        return lines

    def doubt(self, loaded: bool) -> str:
        """Return what is likely wrong with the loads, or that there are none; "": little is left."""
        if not self.force[0] > SMALL * self.weight:
            return ""
        if not loaded:
            return f"no external loads: {self.share}, carry the weight"
        left = f"more than {100.0 * SMALL:.0f} % of the weight is left at the root"
        return f"check sign, unit and bodies of the loads, and the filter: {left}"


def too_heavy(bones: Bones) -> Iterator[str]:
    """Yield that a model weighs more than a person."""
    if (mass := bones.model.mass) > HEAVY:
        yield f"the model {bones.model.name!r} weighs {mass:,.0f} kg: are its masses in grams?"


def carried(bones: Bones, needed: Needed, loads: Sequence[Load]) -> tuple[float, float]:
    """Return `Residuals.carried`; zeros where no load pushes, or no single root is free.

    Args:
        bones: The model.
        needed: What its motion takes under the loads.
        loads: Those of a recording bear names; others are the model's own.
    """
    model, gravity = bones.model, np.array(bones.model.gravity, float)
    roots = {model.joints[model.coordinates[name].joint].child for name in floating(model)}
    own = [load for load in loads if load.name and bones.number(load.body) >= 0]
    if len(roots) != 1 or not own or not gravity.any():
        return 0.0, 0.0
    pull = float(np.linalg.norm(gravity))
    up, lift = -gravity / pull, np.zeros(len(needed.origin))
    for load in own:
        frame = bones.number(load.force_frame)
        turned = np.einsum("fij,fj->fi", needed.rotation[:, frame], load.force)
        lift += (turned if frame >= 0 else load.force) @ up
    pushed = lift > PUSHING * model.mass * pull
    return float(lift[pushed].sum()), float(
        (lift + needed.force[:, bones.number(roots.pop())] @ up)[pushed].sum()
    )


def astray(bones: Bones, needed: Needed, loads: Sequence[Load]) -> Iterator[str]:
    """Yield which recorded loads act under another's body or far from their own, or turn it too much.

    Args:
        bones: The model.
        needed: Where bodies are.
        loads: Those of a recording bear names; others are the model's own.
    """
    own = [one for one in loads if one.name and bones.number(one.body) >= 0 and one.force.any()]
    for load in own:
        size, point = np.linalg.norm(load.force, axis=1), load.point
        if (frame := bones.number(load.point_frame)) >= 0:
            turned = np.einsum("fij,fj->fi", needed.rotation[:, frame], point)
            point = needed.origin[:, frame] + turned
        pushing = size >= LOADED * size.max()
        off = {
            one.body: np.linalg.norm(point - needed.origin[:, bones.number(one.body)], axis=1)[pushing]
            for one in own
        }
        nearer = {body: float((away < off[load.body]).mean()) for body, away in off.items()}
        other, most = max(nearer, key=nearer.__getitem__), float(off[load.body].max())
        if nearer[other] > MOSTLY:
            where = f"nearer to {other} in {100.0 * nearer[other]:.0f} % of the frames in which it pushes"
            yield f"{load.name!r} acts on {load.body} and lies {where}: are left and right swapped?"
        elif most > FAR:
            place = f"the centre of pressure of {load.name!r} is {most:.2g} m from {load.body}"
            yield f"{place}: wrong foot or unit?"
        if (turning := float(np.linalg.norm(load.torque, axis=1).max())) > FAR * size.max():
            sizes = f"{turning:.3g} N m, beside a force of {size.max():.3g} N at most"
            yield f"the torque of {load.name!r} goes to {sizes}: is it in N mm?"
