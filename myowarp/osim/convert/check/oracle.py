"""OpenSim itself as the reference of the check: lengths, moment arms and dynamics from its Python wheel.

Poses are set coordinate by coordinate, couplers evaluated by us: OpenSim would assemble the model anew at
each, which is a hundred times slower and agrees to 1e-7 rad.
"""

import dataclasses
import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from myowarp.extras import to_install
from myowarp.osim.body.hill_muscle import HillMuscle, known
from myowarp.osim.body.moment_arm import STEP, Poses, Reference
from myowarp.osim.convert.tendon.fitted import Fits
from myowarp.osim.document.kinematics import complete
from myowarp.osim.document.model import Model

if TYPE_CHECKING:
    from myowarp.osim.convert.tendon.fits import Samples

Array = np.ndarray

PULLING = ("PathActuator", "Ligament", "Blankevoort1991Ligament", "PathSpring")
"""OpenSim's classes with a path; a muscle is a path actuator."""

OTHER_SPEEDS = ("BallJoint", "EllipsoidJoint", "FreeJoint", "ScapulothoracicJoint")
"""Joints whose speeds are no derivatives of their coordinates in OpenSim."""


def speaks_of_dynamics(model: Model) -> bool:
    """Whether OpenSim is installed, and its speeds are the derivatives of this model's coordinates."""
    installed = importlib.util.find_spec("opensim") is not None
    return installed and all(joint.type not in OTHER_SPEEDS for joint in model.joints.values())


def opened(source: Path) -> tuple[Any, Any]:
    """Return OpenSim's module, and the model of a file.

    Raises:
        ValueError: OpenSim is not installed, or does not read the file.
    """
    try:
        import opensim
    except ImportError as error:
        raise ValueError(f"reference opensim needs OpenSim; run {to_install('opensim')}") from error
    opensim.Logger.setLevelString("Off")
    try:
        return opensim, opensim.Model(str(source))
    except RuntimeError as error:
        raise ValueError(f"{source}: OpenSim does not load it: {' '.join(str(error).split())}") from error


def opensim_equations(
    source: Path, model: Model, values: Mapping[str, Array], speeds: Array
) -> tuple[Array, Array]:
    """Return what `dynamics.equations` does, from accelerations that OpenSim has under unit forces.

    Raises:
        ValueError: OpenSim is not installed, or does not read the file.
    """
    opensim, loaded = opened(source)
    free = model.independent
    for index in range(loaded.getForceSet().getSize()):
        loaded.updForceSet().get(index).set_appliesForce(False)
    motors = [opensim.CoordinateActuator(name) for name in free]
    for motor, name in zip(motors, free, strict=True):
        motor.setName(f"check-{name}")
        motor.setOptimalForce(1.0)
        loaded.addForce(motor)
    state = loaded.initSystem()
    coupling = {coupler.name for coupler in model.couplers.values()}
    constraints = loaded.getConstraintSet()
    for constraint in (constraints.get(index) for index in range(constraints.getSize())):
        if constraint.getName() not in coupling:
            constraint.setIsEnforced(state, False)
    coordinates = {name: loaded.getCoordinateSet().get(name) for name in model.coordinates}
    for motor in motors:
        motor.overrideActuation(state, True)
        motor.setOverrideActuation(state, 0.0)
    count = len(speeds)
    value, rate = complete(model, values, count), {name: np.zeros(count) for name in model.coordinates}
    rate |= {name: speeds[:, number] for number, name in enumerate(free)}
    waiting = dict(model.couplers)
    while waiting:
        for name in [name for name, coupler in waiting.items() if coupler.independent not in waiting]:
            coupler = waiting.pop(name)
            slope = coupler.function.derivatives(value[coupler.independent])[1]
            rate[name] = slope * rate[coupler.independent]
    responses, still = np.zeros((count, len(free), len(free))), np.zeros((count, len(free)))

    def accelerations() -> list[float]:
        loaded.realizeAcceleration(state)
        return [coordinates[name].getAccelerationValue(state) for name in free]

    for index in range(count):
        for name, coordinate in coordinates.items():
            if not model.coordinates[name].locked:
                coordinate.setValue(state, float(value[name][index]), False)
                coordinate.setSpeedValue(state, float(rate[name][index]))
        still[index] = accelerations()
        for number, motor in enumerate(motors):
            motor.setOverrideActuation(state, 1.0)
            responses[index, :, number] = accelerations() - still[index]
            motor.setOverrideActuation(state, 0.0)
    known = np.isfinite(responses).all(axis=(1, 2)) & np.isfinite(still).all(axis=1)
    M, c = np.full_like(responses, np.nan), np.full_like(still, np.nan)
    M[known] = np.linalg.inv(responses[known])
    c[known] = -np.einsum("njk,nk->nj", M[known], still[known])
    return M, c


def opensim_references(
    source: Path, model: Model, poses: Poses, along: Mapping[str, Sequence[str]]
) -> dict[str, Reference]:
    """Return what OpenSim says about muscles, ligaments and path actuators.

    Args:
        source: The .osim file.
        model: The same as read by us.
        poses: With neighbours along all coordinates in `along`.
        along: By name, the coordinates that it depends on.

    Raises:
        ValueError: OpenSim is not installed, or does not read the file.
    """
    opensim, loaded = opened(source)
    state = loaded.initSystem()
    coordinates = {name: loaded.getCoordinateSet().get(name) for name in model.coordinates}
    classes = [getattr(opensim, name) for name in PULLING]
    forces = [loaded.getForceSet().get(name) for name in along]
    pulling = {
        force.getName(): next(filter(None, (c.safeDownCast(force) for c in classes))) for force in forces
    }
    for coordinate in coordinates.values():
        coordinate.setLocked(state, False)

    def place(values: Mapping[str, Array], index: int) -> None:
        for name, coordinate in coordinates.items():
            coordinate.setValue(state, float(values[name][index]), False)
        loaded.realizePosition(state)

    count = len(next(iter(poses.coordinates.values())))
    lengths = {name: np.zeros(count) for name in along}
    arms = {name: {coordinate: np.zeros(count) for coordinate in along[name]} for name in along}
    slopes = {name: {coordinate: np.zeros(count) for coordinate in along[name]} for name in along}
    for index in range(count):
        place(poses.coordinates, index)
        for name, item in pulling.items():
            lengths[name][index] = item.getLength(state)
            for coordinate in along[name]:
                arm = item.getPath().computeMomentArm(state, coordinates[coordinate])
                arms[name][coordinate][index] = arm
        for coordinate, sides in poses.beside.items():
            for (values, _), sign in zip(sides, (1.0, -1.0), strict=True):
                place(values, index)
                for name in (name for name in along if coordinate in along[name]):
                    slopes[name][coordinate][index] += sign * pulling[name].getLength(state) / (2 * STEP)
    return {name: Reference(lengths[name], arms[name], slopes[name]) for name in along}


def against_opensim(source: Path, model: Model, samples: "Samples", fits: Fits) -> Fits:
    """Return the same fits with OpenSim's own lengths and moment arms in the random poses of the check.

    Raises:
        ValueError: OpenSim is not installed, or does not read the file.
    """
    from myowarp.osim.convert.tendon.force import ACTIVATIONS  # fits need SciPy, other references do not

    along = {name: list(reference.moment_arm) for name, reference in fits.references().items()}
    found = opensim_references(source, model, samples.check, along)
    muscles = []
    for fit in fits.muscles:
        hill, _ = known(HillMuscle.of(model.muscles[fit.name]))
        forces = hill.tendon_force(ACTIVATIONS, found[fit.name].length[:, None])
        expected = dataclasses.replace(fit.expected, random=found[fit.name], forces=forces)
        muscles.append(dataclasses.replace(fit, expected=expected))
    return Fits(muscles, [dataclasses.replace(fit, expected=found[fit.name]) for fit in fits.others])
