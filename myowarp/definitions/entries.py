"""Names and units of the single numbers of a vector, by the names in a model.

Blocks that most tasks observe are here as (unit, meaning, names, source), the end of a `task.Column`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import mujoco

from myowarp.kernels.world_function import Row

if TYPE_CHECKING:
    from mujoco import MjModel


class Entry(NamedTuple):
    """One number of a vector."""

    name: str
    unit: str


Names = Sequence[str | Entry] | Callable[["MjModel"], Sequence[Entry]]
"""Names of the numbers of a block in their order, with units where they differ; or a function that finds both
in a model."""

PER_STEP = "per control step"

XYZ = ("x", "y", "z")
PLACE = tuple(Entry(axis, "m") for axis in XYZ)
QUATERNION = tuple(Entry(f"quaternion {part}", "1") for part in "wxyz")
TURN = tuple(Entry(f"about {axis}", "rad") for axis in XYZ)

_COORDINATES = {
    mujoco.mjtJoint.mjJNT_FREE: (*PLACE, *QUATERNION),
    mujoco.mjtJoint.mjJNT_BALL: QUATERNION,
    mujoco.mjtJoint.mjJNT_SLIDE: (Entry("", "m"),),
    mujoco.mjtJoint.mjJNT_HINGE: (Entry("", "rad"),),
}
_VELOCITIES = _COORDINATES | {
    mujoco.mjtJoint.mjJNT_FREE: (*PLACE, *TURN),
    mujoco.mjtJoint.mjJNT_BALL: TURN,
}


FREE_RATES = tuple(Entry(name, f"{unit} {PER_STEP}") for name, unit in (*PLACE, *TURN))


def entries(names: Names, unit: str, model: MjModel) -> tuple[Entry, ...]:
    """Return names with units; `unit` is that of names without one."""
    found = names(model) if callable(names) else names
    return tuple(entry if isinstance(entry, Entry) else Entry(entry, unit) for entry in found)


def axes(points: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the coordinates of points, three for each."""
    return tuple(f"{point} {axis}" for point in points for axis in XYZ)


def coordinates(model: MjModel) -> tuple[Entry, ...]:
    """Return the entries of `qpos`."""
    return _of_joints(model, _COORDINATES)


def velocities(model: MjModel) -> tuple[Entry, ...]:
    """Return the entries of `qvel` times the control step."""
    return tuple(Entry(name, f"{unit} {PER_STEP}") for name, unit in _of_joints(model, _VELOCITIES))


def muscles(model: MjModel) -> tuple[Entry, ...]:
    """Return the muscles, one number of unit 1 for each."""
    ids = range(model.nu)
    kinds = model.actuator_dyntype
    return tuple(Entry(model.actuator(i).name, "1") for i in ids if kinds[i] == mujoco.mjtDyn.mjDYN_MUSCLE)


def _of_joints(
    model: MjModel, parts: dict[mujoco.mjtJoint, tuple[Entry, ...]], joints: Iterable[int] | None = None
) -> tuple[Entry, ...]:
    """Return the entries of some joints, or all, a joint's name before each of its parts."""
    return tuple(
        Entry(f"{model.joint(joint).name or joint} {name}".rstrip(), unit)
        for joint in (range(model.njnt) if joints is None else joints)
        for name, unit in parts[mujoco.mjtJoint(model.jnt_type[joint])]
    )


def of_joints(model: MjModel, joints: Iterable[int]) -> tuple[Entry, ...]:
    """Return the entries of `qpos` that belong to some joints."""
    return _of_joints(model, _COORDINATES, map(int, joints))


COORDINATES = ("rad", "position of each joint (hinge: angle)", coordinates, Row("qpos"))
VELOCITIES = (
    f"rad {PER_STEP}",
    "velocity of each joint times the control step",
    velocities,
    Row("qvel", factor="control_dt"),
)
ACTIVATION = ("1", "activation of each muscle, 0 to 1", muscles, Row("activation"))
