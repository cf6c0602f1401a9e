"""Size of forces that were left out: the greatest in random poses at rest.

A bushing is evaluated by us, everything else by OpenSim, where it is installed: what its force or constraint
records there, the model assembled so that constraints can hold.
"""

import contextlib
import dataclasses
import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from myowarp.osim.convert.check.oracle import opened
from myowarp.osim.document.elements import Bushing
from myowarp.osim.document.kinematics import Frames, forward, random_poses
from myowarp.osim.document.model import Loss, Model, Note

Array = np.ndarray

POSES, SEED = 50, 3


@np.errstate(all="ignore")
def sized(source: Path, model: Model, notes: Sequence[Note]) -> tuple[Note, ...]:
    """Return notes in which losses have their sizes, as far as they can be known here."""
    lost = {note.path: note for note in notes if isinstance(note, Loss) and note.largest is None}
    poses = random_poses(model, POSES, SEED)
    found: dict[str, tuple[float, str]] = {}
    frames = forward(model, poses)
    for bushing in model.bushings:
        if f"/forceset/{bushing.name}" in lost and not bushing.formulas:
            found[f"/forceset/{bushing.name}"] = _bushing_load(bushing, frames)
    others = [path for path in lost if path not in found]
    if others and importlib.util.find_spec("opensim") is not None:
        with contextlib.suppress(ValueError, RuntimeError):  # what we read, OpenSim need not load
            found |= _recorded(source, model, poses, others)
    return tuple(
        dataclasses.replace(note, largest=found[note.path][0], unit=found[note.path][1])
        if isinstance(note, Loss) and note.path in found
        else note
        for note in notes
    )


def _bushing_load(bushing: Bushing, frames: Frames) -> tuple[float, str]:
    """Return the greatest torque of a bushing, or its greatest force if it has no rotational stiffness."""
    (turn, at), (turn_to, at_to) = (
        (frames[body][0] @ frame.rotation, frames[body][1] + frames[body][0] @ frame.position)
        for body, frame in zip(bushing.bodies, bushing.frames, strict=True)
    )
    if not bushing.rotational_stiffness.any():
        moved = np.einsum("nji,nj->ni", turn, at_to - at) * bushing.translational_stiffness
        return float(np.abs(moved).max()), "N"
    R = turn.transpose(0, 2, 1) @ turn_to
    # Angles of R = X(a) Y(b) Z(c).
    angles = np.stack(
        [
            np.arctan2(-R[:, 1, 2], R[:, 2, 2]),
            np.arcsin(np.clip(R[:, 0, 2], -1, 1)),
            np.arctan2(-R[:, 0, 1], R[:, 0, 0]),
        ],
        axis=1,
    )
    return float(np.abs(angles * bushing.rotational_stiffness).max()), "N m"


def _recorded(
    source: Path, model: Model, poses: Mapping[str, Array], paths: Sequence[str]
) -> dict[str, tuple[float, str]]:
    """Return the greatest number that OpenSim records of each force or constraint, and its unit."""
    _, loaded = opened(source)
    state = loaded.initSystem()
    sets = {"forceset": loaded.getForceSet(), "constraintset": loaded.getConstraintSet()}
    items = {}
    for path in paths:
        _, place, *rest = path.split("/")
        if place in sets and sets[place].getIndex("/".join(rest)) >= 0:
            items[path] = sets[place].get("/".join(rest))
    free = model.independent
    found: dict[str, tuple[float, str]] = {}
    for index in range(POSES if items else 0):
        for name in free:
            loaded.getCoordinateSet().get(name).setValue(state, float(poses[name][index]), False)
        try:
            loaded.assemble(state)
            loaded.realizeAcceleration(state)
        except RuntimeError:
            continue  # no pose near this one lets all constraints hold
        for path, item in items.items():
            labels, values = item.getRecordLabels(), item.getRecordValues(state)
            for number in range(values.getSize()):
                value = abs(values.get(number))
                if np.isfinite(value) and value >= found.get(path, (0.0, ""))[0]:
                    torque = "torque" in labels.get(number).lower()
                    found[path] = value, "N m" if torque else "N"
    return found
