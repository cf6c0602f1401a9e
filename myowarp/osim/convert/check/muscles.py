"""Vlt2 and Vlt3: lengths, moment arms and forces of the compiled model against the reference.

Everything is evaluated in held-out random poses. OpenSim has two senses of a moment arm (see `moment_arm`).
Where they agree, its `computeMomentArm` is the judge; where they do not, minus the slope of its length is,
which is what a muscle of that length does. A sample is left out only if the reference has no number, or its
length jumps; such samples are counted, and what has no sample left has no figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from myowarp.osim.body.hill_muscle import ACTIVATIONS
from myowarp.osim.body.moment_arm import PRESENT, Poses, Reference
from myowarp.osim.convert.compose.convert import Converted
from myowarp.osim.convert.tendon.fitted import Fits, MuscleFit

Array = np.ndarray

JUMP = 3.0
"""[m], or 1 along a slide: a slope that no muscle has; the length jumps within the difference."""
SIGN = 1e-3
"""[m] of moment arm beyond which a wrong sign counts."""


@dataclass(frozen=True)
class Spread:
    """Sizes of errors over samples, each NaN where no sample was left; infinite where one is no number."""

    rms: float
    p95: float
    """95th percentile of the absolute value."""
    worst: float

    @classmethod
    def of(cls, errors: Array) -> "Spread":
        """Return the spread of errors of any shape."""
        sizes = np.nan_to_num(np.abs(errors), nan=np.inf, posinf=np.inf).ravel()
        if not sizes.size:
            return cls(np.nan, np.nan, np.nan)
        # Of several infinite values the percentile would be no number.
        p95 = np.sort(sizes)[int(np.ceil(0.95 * sizes.size)) - 1]
        return cls(float(np.sqrt(np.mean(sizes**2))), float(p95), float(sizes.max()))


@dataclass(frozen=True)
class MomentArmError:
    """A muscle or another path and a coordinate, over the poses of the check [m].

    Attributes:
        muscle: Name.
        coordinate: Name.
        error: Of all samples but those left out.
        consistent: Of samples in which OpenSim's two senses agree.
        computed: Of samples where OpenSim computes one, against that alone.
        wrong_signs: Share of judged samples with a sign other than the reference's, where this is over 1 mm.
        peak: Greatest moment arm of the reference, NaN where it has none.
        inconsistent: Share of samples judged by the slope, because the two senses differ.
        excluded: Share of samples left out.
    """

    muscle: str
    coordinate: str
    error: Spread
    consistent: Spread
    computed: Spread
    wrong_signs: float
    peak: float
    inconsistent: float
    excluded: float


@dataclass(frozen=True)
class MuscleError:
    """Length and static force of a muscle; forces in shares of its maximum isometric force.

    Attributes:
        muscle: Name.
        length: Over the poses of the check [m].
        force: Over lengths of these poses and five activations, at the same length.
        force_full: The same at activation 1.
        force_in_pose: As `force`, at the converted path's own length in each pose.
        force_peak: Greatest force of the reference in these poses.
        excluded: Share of poses in which the reference has no length or force.
    """

    muscle: str
    length: Spread
    force: Spread
    force_full: Spread
    force_in_pose: Spread
    force_peak: float
    excluded: float


@dataclass(frozen=True, eq=False)
class Motion:
    """Tendons of the compiled model in n poses.

    Attributes:
        length: [m], shape (n, tendons).
        moment_arm: With respect to the free coordinates [m], shape (n, tendons, free).
    """

    length: Array
    moment_arm: Array


def motion(converted: Converted, model: mujoco.MjModel, poses: Poses) -> Motion:
    """Return lengths and moment arms of all tendons; joints that follow a coordinate count with it."""
    free = converted.coordinates.free()
    count = len(next(iter(poses.coordinates.values()), np.zeros(1)))
    positions, rates = converted.coordinates.rates(model, {name: poses.coordinates[name] for name in free})
    data = mujoco.MjData(model)
    length, arms = np.zeros((count, model.ntendon)), np.zeros((count, model.ntendon, len(free)))
    row = np.repeat(np.arange(model.ntendon), model.ten_J_rownnz)
    column = model.ten_J_colind[: len(row)]
    for index in range(count):
        data.qpos = positions[index]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        length[index] = data.ten_length
        jacobian = np.zeros((model.ntendon, model.nv))
        jacobian[row, column] = data.ten_J.ravel()[: len(row)]
        arms[index] = -jacobian @ rates[index]
    return Motion(length, arms)


def moment_arm_errors(
    converted: Converted, model: mujoco.MjModel, fits: Fits, found: Motion
) -> list[MomentArmError]:
    """Return the errors of all pairs of path and coordinate whose moment arm is not always zero."""
    free, errors = converted.coordinates.free(), []
    for name, reference in fits.references().items():
        tendon = model.tendon(name).id
        for coordinate in reference.moment_arm:
            one = moment_arm_error(
                name, coordinate, reference, found.moment_arm[:, tendon, free.index(coordinate)]
            )
            if not one.peak <= PRESENT:  # one that is no number is shown, too
                errors.append(one)
    return errors


def moment_arm_error(muscle: str, coordinate: str, reference: Reference, found: Array) -> MomentArmError:
    """Return the errors of moment arms of one path about one coordinate.

    Args:
        muscle: Name of the path.
        coordinate: Name of the coordinate.
        reference: Lengths, moment arms and slopes of the path in OpenSim's law.
        found: Moment arms of the converted model in the same postures [m or 1], shape (num_postures,).
    """
    arm, slope = reference.moment_arm[coordinate], reference.slope[coordinate]
    agreed = reference.consistent(coordinate)
    judge = np.where(agreed, arm, slope)
    kept = np.isfinite(judge) & np.isfinite(reference.length) & (agreed | (np.abs(judge) <= JUMP))
    wrong = (judge * found < 0) & (np.abs(judge) > SIGN)
    known = arm[np.isfinite(arm)]
    return MomentArmError(
        muscle,
        coordinate,
        error=Spread.of((found - judge)[kept]),
        consistent=Spread.of((found - arm)[agreed]),
        computed=Spread.of((found - arm)[np.isfinite(arm)]),
        wrong_signs=float(wrong[kept].mean()) if kept.any() else np.nan,
        peak=float(np.abs(known).max()) if known.size else np.nan,
        inconsistent=float(np.mean(kept & ~agreed)),
        excluded=float(1 - kept.mean()),
    )


def muscle_errors(model: mujoco.MjModel, fits: Sequence[MuscleFit], found: Motion) -> list[MuscleError]:
    """Return the errors of lengths and forces of all muscles; those without actuator have no force."""
    errors = []
    for fit in fits:
        expected, own = fit.expected, found.length[:, model.tendon(fit.name).id]
        reference = expected.random.length
        kept = np.isfinite(reference) & np.isfinite(expected.forces).all(axis=1)
        same, there = ((engine_force(fit, lengths) - expected.forces)[kept] for lengths in (reference, own))
        errors.append(
            MuscleError(
                fit.name,
                length=Spread.of((own - reference)[kept]),
                force=Spread.of(same),
                force_full=Spread.of(same[:, -1]),
                force_in_pose=Spread.of(there),
                force_peak=float(expected.forces[kept].max()) if kept.any() else np.nan,
                excluded=float(1 - kept.mean()),
            )
        )
    return errors


def engine_force(fit: MuscleFit, lengths: Array) -> Array:
    """Return the static force of MuJoCo's muscle [max_isometric_force], shape (lengths, activations)."""
    gain, bias, ends = (
        np.array(part) for part in (fit.force.gainprm, fit.force.biasprm, fit.force.length_range)
    )
    rows = [
        (
            mujoco.mju_muscleGain(length, 0.0, ends, 1.0, gain[:9]),
            mujoco.mju_muscleBias(length, ends, 1.0, bias[:9]),
        )
        for length in lengths
    ]
    parts = -np.array(rows)
    return (parts[:, :1] * ACTIVATIONS + parts[:, 1:]) / fit.max_isometric_force
