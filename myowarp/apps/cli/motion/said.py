"""Last words of steps of `myowarp motion`: the worst of what was found, a line each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from myowarp.motion.emg import Comparison
    from myowarp.motion.residuals import Residuals
    from myowarp.motion.results import Gaps, JointAngles, JointMoments, MotionForces, TrackedMotion
    from myowarp.motion.scaling import Scaled
    from myowarp.osim.body.skeleton import Bones

SHOWN = 3
"""The worst of what is listed."""


def of_scaling(scaled: Scaled) -> list[str]:
    """Return how a model was scaled, markers that fitted worst first."""
    lines = []
    if scaled.unknown:
        lines.append(
            f"bodies of the set-up that are not in the model, and left out: {', '.join(scaled.unknown)}"
        )
    if scaled.pose is not None:
        lines += [f"{marker}: {1e3 * most:.1f} mm off before it was moved"
                  for marker, _, most in scaled.pose.worst()[:SHOWN]]  # fmt: skip
        lines += filter(None, [scaled.pose.doubt()])
    for name, (factor, _) in scaled.measured.items():
        lines.append(f"{name}: factor {factor:.4f}")
    model = scaled.document.model
    return [*lines, f"{model.mass:.1f} kg in {len(model.bodies)} bodies"]


def of_gaps(found: Gaps) -> list[str]:
    """Return the longest gaps of markers that were not filled."""
    rows = found.longest()
    left = [row for row in rows if not row[3]]
    lines = [f"{name} was not seen from {a:.9g} to {b:.9g} s" for name, a, b, _ in left[:SHOWN]]
    if filled := len(rows) - len(left):
        lines.append(f"{filled} gaps were filled; gaps.csv lists all {len(rows)}")
    elif len(left) > SHOWN:
        lines.append(f"gaps.csv lists all {len(rows)}")
    return lines


def of_markers(parts: Iterable[JointAngles]) -> list[str]:
    """Return the longest gaps, how markers of all parts fit, the worst first, and what is likely wrong."""
    from myowarp.motion.inverse_kinematics import FitErrors

    errors, gaps = FitErrors(), list[str]()
    for part in parts:
        errors.add(part.fitted)
        gaps = of_gaps(part.gaps)
    worst = errors.worst()
    lines = [f"{marker}: {1e3 * rms:.1f} mm rms, {1e3 * most:.1f} mm at most"
             for marker, rms, most in worst[:SHOWN]]  # fmt: skip
    lines.append(f"all {len(worst)} markers: {1e3 * errors.rms:.1f} mm rms")
    return [*gaps, *lines, *filter(None, [errors.doubt()])]


def of_sensors(parts: Iterable[JointAngles]) -> list[str]:
    """Return how sensors fit, the worst first."""
    (found,) = parts
    return [f"{name}: {np.degrees(rms):.1f} degrees rms, {np.degrees(most):.1f} degrees at most"
            for name, rms, most in found.fitted.worst()[:SHOWN]]  # fmt: skip


def of_emg(compared: Comparison) -> list[str]:
    """Return how alike activations and electromyograms are, the least alike first."""
    return [f"{one.muscle}: correlation {one.correlation:.2f} at a delay of {1e3 * one.delay:.0f} ms"
            if np.isfinite(one.correlation)
            else f"{one.muscle}: no correlation, as its electromyogram or its activation does not change"
            for one in compared.found[:SHOWN]]  # fmt: skip


def _unit(bones: Bones, number: int) -> str:
    """Return the unit of what acts along a coordinate."""
    return "N m" if bones.model.coordinates[bones.coordinates[number]].rotational else "N"


def _greatest(bones: Bones, most: np.ndarray) -> Iterator[tuple[int, str]]:
    """Yield the joints' coordinates that have most of something, and how much that is, the greatest first."""
    joints = at_joints(bones)
    for k in [k for k in most.argsort()[::-1] if joints[k]][:SHOWN]:
        yield k, f"at {bones.coordinates[k]}: {most[k]:.3g} {_unit(bones, k)} at most"


def at_joints(bones: Bones) -> np.ndarray:
    """Return which coordinates carry no model through space; what acts along the others is a residual."""
    from myowarp.osim.document.kinematics import floating

    root = floating(bones.model)
    return np.array([name not in root for name in bones.coordinates])


class Left:
    """Residuals of a motion, over all its parts."""

    found: Residuals | None = None

    def add(self, part: JointMoments | MotionForces) -> None:
        """Take a part in."""
        self.found = part.residuals if self.found is None else self.found.among(part.residuals)

    def lines(self) -> list[str]:
        """Return the greatest force and moment."""
        return [] if self.found is None else self.found.lines()


class Lacking:
    """The moments of a motion that muscles could not provide, over all its parts."""

    def __init__(self) -> None:
        """Begin with none."""
        self.left = Left()
        self.frames, self.missed, self.full = 0, 0, Counter[str]()
        self.most: dict[str, np.ndarray] = {}
        self.moment = np.zeros(1)

    def add(self, part: MotionForces) -> None:
        """Count a part."""
        self.left.add(part)
        self.bones, found = part.bones, part.solved
        self.frames += len(found.feasible)
        self.missed += int((~found.feasible).sum())
        self.full.update(found.saturated)
        self.moment = np.maximum(self.moment, abs(part.moments.needed.joint_moment).max(axis=0))
        helped = "reserves and motors" if found.motors else "reserve"
        for name, values in (("missing", found.missing), (helped, found.reserve)):
            self.most[name] = np.maximum(abs(values).max(axis=0), self.most.get(name, 0.0))

    def lines(self) -> list[str]:
        """Return what muscles could not do; what they need not, at roots, is apart."""
        lines = self.left.lines()
        if self.missed:
            lines.append(
                f"muscles cannot hold {self.missed} of {self.frames} frames; missing.sto has what is left, "
                "--reserve 1 lets reserves give it"
            )
        for name, most in self.most.items():
            for k, amount in _greatest(self.bones, most):
                if most[k] > 1e-3:
                    share = f"{100.0 * most[k] / max(self.moment[k], 1e-9):.2g} %"
                    lines.append(f"{name} {amount}, {share} of the greatest moment there")
        full = self.full.most_common(SHOWN)
        return lines + [f"{muscle} is fully active in {n} of {self.frames} frames" for muscle, n in full]


def of_tracking(found: TrackedMotion) -> list[str]:
    """Return how far off a simulation is, and what reserves give."""
    lines, bones, off = [], found.bones, found.tracked.off()[0]
    turns = [bones.model.coordinates[name].rotational for name in bones.coordinates]
    shown = np.where(turns, np.degrees(off), 100.0 * off)  # a degree beside a centimetre
    for k in shown.argsort()[::-1][:SHOWN]:
        lines.append(f"{bones.coordinates[k]}: {shown[k]:.2f} {'°' if turns[k] else 'cm'} rms off the motion")
    lines += found.residuals.lines()
    most = abs(found.tracked.reserve[:, 0]).max(axis=0)
    return lines + [f"reserve {amount}" for _, amount in _greatest(bones, most)]
