"""What `report.json` holds: how far a converted model is from its source, against stated gates."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from myowarp.opensim.build.convert import Converted
from myowarp.opensim.check.frames import KinematicsError, kinematics_error
from myowarp.opensim.model import Note
from myowarp.opensim.wrap.moment_arm import CONSISTENT

if TYPE_CHECKING:
    from myowarp.opensim.check.muscles import MomentArmError, MuscleError
    from myowarp.opensim.fit import Samples
    from myowarp.opensim.fitted import Fits


@dataclass(frozen=True)
class Gate:
    """A figure and what it may be at most."""

    name: str
    value: float
    bound: float
    unit: str

    @property
    def passed(self) -> bool:
        """Whether the figure is within its bound; one that is no number is not."""
        return self.value <= self.bound


REFERENCES = {"own": "own path code, tested against OpenSim 4.6", "opensim": "OpenSim"}
EXACT_FRAMES, FITTED_FRAMES = 1e-6, 0.35
"""[mm]: of models without functions that are fitted, and with."""
MOMENT_ARM = 0.7
"""[mm]: root mean square over consistent samples, mean over pairs of muscle and coordinate."""
FORCE_MAP, FULL_FORCE = 2.5, 3.0
"""[% of max_isometric_force]: root mean square over lengths, mean over muscles; five activations, full."""


@dataclass(frozen=True)
class Check:
    """Vlt1, Vlt2 and Vlt3 of a conversion."""

    kinematics: KinematicsError
    moment_arms: list[MomentArmError]
    muscles: list[MuscleError]
    gates: list[Gate]
    poses: int = 0
    """Of moment arms and forces."""
    notes: list[Note] = field(default_factory=list)
    """What the fits approximate, with these errors."""


def check(converted: Converted, model: mujoco.MjModel, fits: Fits, samples: Samples | None) -> Check:
    """Compare the compiled model with the reference; without fits, frames only."""
    kinematics = kinematics_error(converted, model)
    fitted = any(item.error > 0 for item in converted.coordinates.dependents)
    frames = FITTED_FRAMES if fitted else EXACT_FRAMES
    gates = [Gate("frames, greatest error", kinematics.position * 1e3, frames, "mm")]
    if samples is None:
        return Check(kinematics, [], [], gates)
    # Fits need SciPy, which may be missing.
    from myowarp.opensim.check.muscles import moment_arm_errors, motion, muscle_errors
    from myowarp.opensim.report.approximations import approximations

    found = motion(converted, model, samples.check)
    arms = moment_arm_errors(converted, model, fits, found)
    muscles = muscle_errors(model, fits.muscles, found)
    notes = approximations(converted.model, model, fits, found, arms, muscles)
    if arms:
        gates.append(Gate("moment arms, mean RMS", _mean(arms, "rms") * 1e3, MOMENT_ARM, "mm"))
    if muscles:
        gates.append(Gate("force maps, mean RMS", _mean(muscles, "force") * 100, FORCE_MAP, "%"))
        gates.append(Gate("full activation, mean RMS", _mean(muscles, "force_full") * 100, FULL_FORCE, "%"))
    return Check(kinematics, arms, muscles, gates, len(found.length), notes)


def _mean(errors: Sequence[object], name: str) -> float:
    return float(np.mean([getattr(error, name) for error in errors]))


def _summary(errors: Sequence[object], names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return mean, median and maximum of figures."""
    found = {}
    for name in names if errors else ():
        values = np.array([getattr(error, name) for error in errors])
        found[name] = {
            "mean": float(values.mean()),
            "median": float(np.median(values)),
            "max": float(values.max()),
        }
    return found


def report_of(
    converted: Converted, model: mujoco.MjModel, result: Check, digest: str, reference: str
) -> dict[str, Any]:
    """Return the content of `report.json`; lengths in m, forces in shares of max_isometric_force."""
    source = converted.model
    arms, muscles = result.moment_arms, result.muscles
    return {
        "source": source.source.name,
        "sha256": digest,
        "document": source.version,
        "name": source.name,
        "credits": source.credits,
        "publications": source.publications,
        "counts": {
            "bodies": len(source.bodies),
            "coordinates": len(source.coordinates),
            "joints": model.njnt,
            "equalities": model.neq,
            "muscles": len(source.muscles),
            "markers": len(source.markers),
        },
        "gates": [{**dataclasses.asdict(gate), "passed": gate.passed} for gate in result.gates],
        "kinematics": dataclasses.asdict(result.kinematics),
        "moment_arms": {
            "reference": REFERENCES[reference],
            "poses": result.poses,
            "consistent_within": CONSISTENT,
            "summary": _summary(arms, ("rms", "rms_slope", "rms_all", "rms_slope_all", "inconsistent")),
            "pairs": [dataclasses.asdict(pair) for pair in arms],
        },
        "muscles": {
            "poses": result.poses,
            "summary": _summary(muscles, ("length", "force", "force_full", "force_in_pose", "force_max")),
            "each": [dataclasses.asdict(muscle) for muscle in muscles],
        },
        "notes": [dataclasses.asdict(note) for note in (*converted.notes, *result.notes)],
    }
