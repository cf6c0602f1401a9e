"""Vlt2 and Vlt3: lengths, moment arms and forces of the compiled model against the reference.

Everything is evaluated in held-out random poses. OpenSim has two senses of a moment arm (see
`moment_arm`); samples where they differ are counted, and errors are stated with and without them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from myowarp.opensim.build.convert import Converted
from myowarp.opensim.fitted import Fits, MuscleFit
from myowarp.opensim.muscle.force import ACTIVATIONS
from myowarp.opensim.wrap.moment_arm import PRESENT, Poses, Reference

Array = np.ndarray


@dataclass(frozen=True)
class MomentArmError:
    """A muscle or another path and a coordinate; root mean squares over the poses of the check [m].

    Attributes:
        muscle: Name.
        coordinate: Name.
        rms: Against `computeMomentArm`, consistent samples.
        rms_slope: Against the slope of the length, consistent samples.
        rms_all: Against `computeMomentArm`, all samples.
        rms_slope_all: Against the slope of the length, all samples.
        peak: Greatest moment arm of the reference [m].
        inconsistent: Share of samples in which the two senses differ.
    """

    muscle: str
    coordinate: str
    rms: float
    rms_slope: float
    rms_all: float
    rms_slope_all: float
    peak: float
    inconsistent: float


@dataclass(frozen=True)
class MuscleError:
    """Length and static force of a muscle; forces in shares of its maximum isometric force.

    Attributes:
        muscle: Name.
        length: Root mean square over the poses of the check [m].
        force: Root mean square over lengths of these poses and five activations, at the same length.
        force_full: The same at activation 1.
        force_in_pose: As `force`, with the converted path's own length in each pose.
        force_max: Greatest difference at the same length.
        force_peak: Greatest force of the reference in these poses.
    """

    muscle: str
    length: float
    force: float
    force_full: float
    force_in_pose: float
    force_max: float
    force_peak: float


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
            one = _pair(name, coordinate, reference, found.moment_arm[:, tendon, free.index(coordinate)])
            if one.peak > PRESENT:
                errors.append(one)
    return errors


def _pair(muscle: str, coordinate: str, reference: Reference, found: Array) -> MomentArmError:
    arm, slope = reference.moment_arm[coordinate], reference.slope[coordinate]
    kept = reference.consistent(coordinate)
    return MomentArmError(
        muscle,
        coordinate,
        rms=_rms((found - arm)[kept]),
        rms_slope=_rms((found - slope)[kept]),
        rms_all=_rms(found - arm),
        rms_slope_all=_rms(found - slope),
        peak=float(np.abs(arm).max()),
        inconsistent=float(1 - kept.mean()),
    )


def muscle_errors(model: mujoco.MjModel, fits: Sequence[MuscleFit], found: Motion) -> list[MuscleError]:
    """Return the errors of lengths and forces of all muscles; those without actuator have no force."""
    errors = []
    for fit in fits:
        expected, own = fit.expected, found.length[:, model.tendon(fit.name).id]
        reference = expected.random.length
        same, there = (engine_force(fit, lengths) - expected.forces for lengths in (reference, own))
        errors.append(
            MuscleError(
                fit.name,
                length=_rms(own - reference),
                force=_rms(same),
                force_full=_rms(same[:, -1]),
                force_in_pose=_rms(there),
                force_max=float(np.abs(same).max()),
                force_peak=float(expected.forces.max()),
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


def _rms(values: Array) -> float:
    """Return a root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
