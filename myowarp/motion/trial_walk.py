"""The walk of a recorded trial: a folder of `myowarp motion`, the person's model and the ground's forces.

A treadmill's belt is seen by the feet that stand on it: it moves as their heels do from 20 to 40 % of a
contact, when soles are flat.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from myowarp.laws.metabolics import BASAL_RATE
from myowarp.motion.gait import vertical_forces
from myowarp.motion.movement import motion_in, read_motion
from myowarp.motion.storage import Storage, read_storage
from myowarp.motion.strides import JOINTS, SIDES, Walk, muscle_groups
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.kinematics import complete, forward, station

MODEL, LOADS = "scaled.osim", "grf.xml"
"""The person's model and the forces as steps of `myowarp motion` call them."""
ACTIVATIONS = ("activations.sto", "emg.sto")
"""Of muscles, the first that is there counts; columns without a side are left out."""
FLAT = 0.2, 0.4
"""Share of a contact in which the sole is flat on the ground."""
UPRIGHT = 0.9
"""Share of gravity along -y at least."""
LEAST_BELT = 0.3
"""Speed of standing feet from which they stand on a belt [m/s]."""

logger = logging.getLogger("myowarp")


def read_walk(trial: Path, model: Path | None = None, loads: Path | None = None) -> Walk:
    """Return the walk of a trial, with what its folder has besides joint angles.

    `moments.sto` and `passive_moments.sto` together are the joint moments; `metabolic_powers.sto` and the
    rate at rest are the metabolic rate. Ground's y is up.

    Args:
        trial: Folder of `myowarp motion`.
        model: The person's model; None: `scaled.osim` of the folder.
        loads: OpenSim's file of the forces of the ground on both feet; None: `grf.xml` of the folder.

    Raises:
        ValueError: A file is missing or not what it should be, or the model has no legs.
        OSError: A file cannot be read.
    """
    model, loads = _there(trial, model, MODEL, "model"), _there(trial, loads, LOADS, "loads")
    bones = Bones.read(model, "cpu")
    motion = read_motion(motion_in(trial), bones)
    names = [f"{one}_{side}" for one in JOINTS.values() for side in SIDES]
    feet = {side: f"calcn_{side}" for side in SIDES}
    lacks = [name for name in names if name not in bones.coordinates]
    lacks += [name for name in feet.values() if name not in bones.bodies]
    if lacks:
        raise ValueError(f"a walk needs both legs, of which {str(model)!r} has no {', '.join(lacks)}")
    gravity = bones.model.gravity
    if not -gravity[1] > UPRIGHT * np.linalg.norm(gravity):
        x, y, z = gravity
        raise ValueError(
            f"a walk needs a model whose y is up; gravity of {str(model)!r} is {x:g} {y:g} {z:g}"
        )
    found = vertical_forces(loads)
    if found is None or set(found[1]) != set(SIDES):
        raise ValueError(f"{str(loads)!r} must have forces of the ground on a body of each side, _r and _l")
    values = dict(zip(bones.coordinates, motion.values.T, strict=True))
    frames = forward(bones.model, complete(bones.model, values, len(motion.time)))
    bodies = bones.model.bodies.values()
    mass = bones.model.mass
    first_moments = [body.mass * station(frames, body.name, body.mass_center) for body in bodies]
    center = np.sum(first_moments, axis=0) / mass
    level = {side: frames[foot][1][:, [0, 2]] * (1.0, -1.0) for side, foot in feet.items()}
    curves: dict[str, np.ndarray] = {}
    moments = [_table(trial / name) for name in ("moments.sto", "passive_moments.sto")]
    for joint, name, side in ((j, f"{c}_{s}", s) for j, c in JOINTS.items() for s in SIDES):
        sign = flexion(*bones.model.coordinates[name].range) if joint == "knee" else 1.0
        curves[f"{joint}_angle_{side}"] = sign * np.degrees(values[name])
        if moments[0] is not None:
            parts = (_column(table, f"{name}_moment", motion.time) for table in moments if table is not None)
            curves[f"{joint}_moment_{side}"] = -sign * sum(parts, np.zeros(len(motion.time))) / mass
    active = next((table for name in ACTIVATIONS if (table := _table(trial / name)) is not None), None)
    if active is not None:
        for group, columns in muscle_groups(active.labels).items():
            curves[group] = _between(active, active.values[:, columns].mean(axis=1), motion.time)
    burned = _table(trial / "metabolic_powers.sto")
    rate = None if burned is None else _between(burned, burned.values.sum(axis=1), motion.time)
    walk = Walk(
        mass,
        motion.time,
        center[:, [0, 2, 1]] * (1.0, -1.0, 1.0),
        level,
        curves,
        *found,
        None if rate is None else rate / mass + BASAL_RATE,
    )
    belt = belt_velocity(walk)
    if np.linalg.norm(belt) < LEAST_BELT:
        return walk
    logger.warning("%s: feet stand on a belt that moves at %.3g m/s", trial, np.linalg.norm(belt))
    return over_ground(walk, belt)


def belt_velocity(walk: Walk) -> np.ndarray:
    """Return the level velocity of feet that stand [m/s], the median over contacts, shape (2,)."""
    found = []
    for side, (begin, end) in walk.contacts.items():
        for first, last in zip(begin, end, strict=True):
            if np.isfinite((first, last)).all():
                flat = [first + share * (last - first) for share in FLAT]
                places = [walk.at(walk.foot[side], time) for time in flat]
                found.append((places[1] - places[0]) / (flat[1] - flat[0]))
    known = [velocity for velocity in found if np.isfinite(velocity).all()]
    return np.median(known, axis=0) if known else np.zeros(2)


def over_ground(walk: Walk, belt: np.ndarray) -> Walk:
    """Return a walk on a belt as one over ground, which goes ahead by as much as the belt comes back."""
    way = np.outer(walk.time, belt)
    center = walk.center - np.column_stack([way, np.zeros(len(way))])
    return replace(walk, center=center, foot={side: place - way for side, place in walk.foot.items()})


def flexion(low: float, high: float) -> float:
    """Return the sign of a knee's flexion, the direction in which its range is the longer one.

    Raises:
        ValueError: It is as long in both.
    """
    if np.isclose(-low, high):
        raise ValueError(
            f"a knee's range must be longer where it flexes, so that its sign is known; it is {low:.4g} to "
            f"{high:.4g} rad"
        )
    return 1.0 if abs(high) > abs(low) else -1.0


def _there(trial: Path, given: Path | None, name: str, option: str) -> Path:
    """Return a file of a trial."""
    path = given or trial / name
    if not path.is_file():
        raise ValueError(f"trial {str(trial)!r} needs --{option} FILE, or {name} in it; there is no {path}")
    return path


def _table(path: Path) -> Storage | None:
    """Return a table; None: there is none."""
    return read_storage(path) if path.is_file() else None


def _column(table: Storage, label: str, time: np.ndarray) -> np.ndarray:
    """Return a column at some times [s]; what a table lacks is unknown."""
    if label not in table.labels:
        return np.full(len(time), np.nan)
    return _between(table, table.values[:, table.labels.index(label)], time)


def _between(table: Storage, values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return values (rows,) of a table at some times [s], NaN outside of it."""
    return np.interp(time, table.time, values, left=np.nan, right=np.nan)
