"""Contents of `report.json`: losses, and how far a model is from its source, against gates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from myowarp.disk import plain
from myowarp.osim.body.moment_arm import CONSISTENT
from myowarp.osim.convert.check.dynamics import QUANTITIES, Dynamics
from myowarp.osim.convert.check.frames import KinematicsError, kinematics_error
from myowarp.osim.convert.check.gates import (
    ENGINES,
    EXCLUDED,
    Gate,
    arm_gates,
    dynamics_gates,
    frame_gates,
    muscle_gates,
)
from myowarp.osim.convert.compose.convert import Converted
from myowarp.osim.document.model import Loss, Note

if TYPE_CHECKING:
    from myowarp.osim.convert.check.judge import Judgement
    from myowarp.osim.convert.check.muscles import MomentArmError, MuscleError
    from myowarp.osim.convert.tendon.fits import Samples
    from myowarp.osim.convert.tendon.fitted import Fits


REFERENCES = {
    "own": "own code for paths, tested against OpenSim 4.6",
    "opensim": "OpenSim",
}
FRAMES = "own forward kinematics of the document, tested against OpenSim 4.6"
FORCES = "own code for Hill muscles, tested against OpenSim 4.6"

MASSLESS = Loss(
    "/bodyset",
    "the document's masses leave coordinates without inertia; small ones were added, and accelerations are "
    "not compared",
    code="massless",
    effect="mass",
)


@dataclass(frozen=True)
class Check:
    """All checks of a conversion."""

    kinematics: KinematicsError
    dynamics: Dynamics
    gates: list[Gate]
    moment_arms: list[MomentArmError] = field(default_factory=list)
    muscles: list[MuscleError] = field(default_factory=list)
    poses: int = 0
    """Of moment arms and forces."""
    notes: list[Note] = field(default_factory=list)
    """Approximations by the fits, with these errors."""
    judgement: Judgement | None = None
    """None without fits."""


def check(
    converted: Converted, model: mujoco.MjModel, fits: Fits, samples: Samples | None, dynamics: Dynamics
) -> Check:
    """Compare the compiled model with the reference; without fits, frames and dynamics only."""
    kinematics = kinematics_error(converted, model)
    fitted = any(item.error > 0 for item in converted.coordinates.dependents)
    gates = [*frame_gates(kinematics, fitted), *dynamics_gates(dynamics)]
    lost: list[Note] = []
    if dynamics.coordinates and dynamics.samples is None:
        bodies = converted.couplings.bodies
        added = sum(model.body(name).mass[0] - mass for name, (mass, _) in bodies.items())
        lost.append(dataclasses.replace(MASSLESS, largest=float(added), unit="kg"))
    if samples is None:
        return Check(kinematics, dynamics, gates, notes=lost)
    # Fits need SciPy, which may be missing.
    from myowarp.osim.convert.check.judge import judge
    from myowarp.osim.convert.check.muscles import moment_arm_errors, motion, muscle_errors
    from myowarp.osim.convert.report.approximations import approximations

    found = motion(converted, model, samples.check)
    arms = moment_arm_errors(converted, model, fits, found)
    muscles = muscle_errors(model, fits.muscles, found)
    notes = approximations(converted.model, model, fits, found, arms, muscles)
    gates += [*arm_gates(arms), *muscle_gates(muscles)]
    judged = judge(converted, model, fits, samples, found)
    gates += judged.gates()
    notes = [*lost, *notes]
    return Check(kinematics, dynamics, gates, arms, muscles, len(found.length), notes, judgement=judged)


ARM_FIGURES: dict[str, Callable[[Any], float]] = {
    "rms": lambda pair: pair.error.rms,
    "p95": lambda pair: pair.error.p95,
    "worst": lambda pair: pair.error.worst,
    "rms_consistent": lambda pair: pair.consistent.rms,
    "rms_computed": lambda pair: pair.computed.rms,
    "inconsistent": lambda pair: pair.inconsistent,
    "wrong_signs": lambda pair: pair.wrong_signs,
    "excluded": lambda pair: pair.excluded,
}
"""Of pairs of muscle and coordinate; what each is, `check.muscles.MomentArmError` says."""
MUSCLE_FIGURES: dict[str, Callable[[Any], float]] = {
    "length": lambda muscle: muscle.length.rms,
    "length_worst": lambda muscle: muscle.length.worst,
    "force": lambda muscle: muscle.force.rms,
    "force_full": lambda muscle: muscle.force_full.rms,
    "force_worst": lambda muscle: muscle.force.worst,
    "force_in_pose": lambda muscle: muscle.force_in_pose.rms,
    "force_in_pose_p95": lambda muscle: muscle.force_in_pose.p95,
    "force_in_pose_worst": lambda muscle: muscle.force_in_pose.worst,
    "excluded": lambda muscle: muscle.excluded,
}


def _summary(
    errors: Sequence[Any], figures: dict[str, Callable[[Any], float]]
) -> dict[str, dict[str, float]]:
    """Return mean, median and maximum of figures over what has them, and for how many there is none."""
    found = {}
    for name, figure in figures.items() if errors else ():
        values = np.array([figure(error) for error in errors])
        known = values[~np.isnan(values)]
        if known.size:
            found[name] = {
                "mean": float(known.mean()),
                "median": float(np.median(known)),
                "max": float(known.max()),
            }
    return found


def _lost(loss: Loss) -> dict[str, Any]:
    """Return a loss as JSON holds it, without the words of its element."""
    return {name: value for name, value in vars(loss).items() if name != "names"}


def _dynamics(dynamics: Dynamics) -> dict[str, Any]:
    """Return what a report says about dynamics; shares of what the reference has."""
    samples = dynamics.samples
    if samples is None:
        return {"reference": dynamics.reference, "engines": {}}
    engines = {}
    for key, engine in dynamics.engines.items():
        table = []
        for place, name in enumerate(dynamics.coordinates):
            row: dict[str, Any] = {"coordinate": name}
            for quantity in QUANTITIES:
                errors = engine.errors[quantity][:, place]
                row[quantity] = {"mean": float(errors.mean()), "worst": float(errors.max())}
            table.append(row)
        engines[key] = {
            "name": ENGINES[key],
            "accelerations": {
                "median": float(np.median(engine.states)),
                "worst": float(engine.states.max()),
                "condition_of_worst": engine.condition,
            },
            "coordinates": table,
        }
    return {
        "reference": dynamics.reference,
        "samples": {
            name: len(part[0].values)
            for name, part in (("rest", samples.rest), ("states", samples.states), ("motion", samples.motion))
        },
        "undetermined": samples.undetermined,
        "reference_from_own_equations": {
            "median": float(np.median(samples.disagreement)),
            "worst": float(samples.disagreement.max()),
        },
        "engines": engines,
    }


def _judged(judgement: Judgement | None) -> dict[str, Any]:
    """Return what a report says of joint torques and paths, three ways."""
    if judgement is None:
        return {}
    return {"verdict": judgement.verdict(), **dataclasses.asdict(judgement)}


def report_of(
    converted: Converted,
    model: mujoco.MjModel,
    result: Check,
    digest: str,
    reference: str,
    accepted: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the content of `report.json`; lengths in m, forces in shares of max_isometric_force."""
    source = converted.model
    arms, muscles = result.moment_arms, result.muscles
    notes = (*converted.notes, *result.notes)
    losses = [note for note in notes if isinstance(note, Loss)]
    return plain(
        {
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
            "left_out": [_lost(loss) | {"accepted": loss.code in accepted} for loss in losses],
            "gates": [{**dataclasses.asdict(gate), "passed": gate.passed} for gate in result.gates],
            "kinematics": {"reference": FRAMES, **dataclasses.asdict(result.kinematics)},
            "dynamics": _dynamics(result.dynamics),
            "moment_arms": {
                "reference": REFERENCES[reference],
                "poses": result.poses,
                "consistent_within": CONSISTENT,
                "excluded_at_most": EXCLUDED / 100,
                "summary": _summary(arms, ARM_FIGURES),
                "pairs": [dataclasses.asdict(pair) for pair in arms],
            },
            "muscles": {
                "reference": FORCES,
                "poses": result.poses,
                "summary": _summary(muscles, MUSCLE_FIGURES),
                "each": [dataclasses.asdict(muscle) for muscle in muscles],
            },
            "judge": _judged(result.judgement),
            "notes": [dataclasses.asdict(note) for note in notes if not isinstance(note, Loss)],
        }
    )


def along_coordinates(fits: Fits, samples: Samples) -> dict[str, Any]:
    """Return OpenSim's moment arms over the range of each coordinate, the others at their defaults.

    Returns:
        By coordinate: its `values` [rad or m], and the moment arm [m] of each muscle on it, under `muscles`.
    """
    found: dict[str, Any] = {}
    for name, poses in samples.sweeps.items():
        arms = {
            fit.name: fit.expected.sweeps[name].moment_arm[name]
            for fit in fits.muscles
            if name in fit.expected.sweeps
        }
        if arms:
            rounded = {muscle: [float(f"{arm:.5g}") for arm in own] for muscle, own in arms.items()}
            values = [float(f"{value:.7g}") for value in poses.coordinates[name]]
            found[name] = {"values": values, "muscles": rounded}
    return found


def alike(notes: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return notes by what they have in common: what was done, without what follows a colon.

    Args:
        notes: `notes` of a report.
    """
    groups: dict[str, list[dict[str, Any]]] = {}
    for note in notes:
        groups.setdefault(note["rule"].partition(":")[0], []).append(note)
    return groups


def left_out(losses: list[dict[str, Any]]) -> list[tuple[str, str, str, str]]:
    """Return what was left out by code: code, effect and size, what was done, and elements; most come first.

    Args:
        losses: `left_out` of a report.
    """
    groups: dict[str, list[dict[str, Any]]] = {}
    for loss in losses:
        groups.setdefault(loss["code"], []).append(loss)
    rows: list[tuple[str, str, str, str]] = []
    for code, group in sorted(groups.items(), key=lambda item: (item[1][0]["accepted"], -len(item[1]))):
        known = [loss for loss in group if loss["largest"] is not None]
        size = "size unknown"
        if group[0]["effect"] != "control":
            size += "; OpenSim, if installed, measures it"
        if known:
            most = max(known, key=lambda loss: loss["largest"])
            size = f"up to {most['largest']:.3g} {most['unit']}"
        accepted = ", accepted by you" if group[0]["accepted"] else ""
        said = f"{len(group)}, {group[0]['effect']}, {size}{accepted}"
        rules = "; ".join(dict.fromkeys(loss["rule"] for loss in group))
        rows.append((code, said, rules, ", ".join(loss["path"] for loss in group)))
    return rows
