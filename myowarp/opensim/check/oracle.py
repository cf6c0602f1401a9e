"""OpenSim itself as the reference of the check: lengths and moment arms from its Python wheel.

Poses are set coordinate by coordinate, couplers evaluated by us: OpenSim would assemble the model anew at
each, which is a hundred times slower and agrees to 1e-7 rad.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from myowarp.opensim.model import Model
from myowarp.opensim.wrap.moment_arm import STEP, Poses, Reference

Array = np.ndarray

PULLING = ("PathActuator", "Ligament", "Blankevoort1991Ligament", "PathSpring")
"""OpenSim's classes with a path; a muscle is a path actuator."""


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
    try:
        import opensim
    except ImportError as error:
        raise ValueError("reference opensim needs OpenSim; pip install 'myowarp[opensim]'") from error
    opensim.Logger.setLevelString("Off")
    try:
        loaded = opensim.Model(str(source))
        state = loaded.initSystem()
    except RuntimeError as error:
        raise ValueError(f"{source}: OpenSim does not load it: {' '.join(str(error).split())}") from error
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
