"""Motors of a model: what each does along the coordinates at control 1, as unknowns of a static optimisation.

A motor gives its optimal force times its control, which is bounded and costs |control|^p as an activation
does: OpenSim's static optimisation takes them so. In inverse dynamics they rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from myowarp.motion.inverse_dynamics import Load, inverse_dynamics
from myowarp.osim.body.moment_arm import coordinates_between, leading
from myowarp.osim.body.moment_arm import crossed as of_path
from myowarp.osim.body.muscle_paths import muscle_paths
from myowarp.osim.body.skeleton import Bones
from myowarp.osim.document.dynamics import rates
from myowarp.osim.document.elements import BodyActuator, CoordinateActuator, PathActuator
from myowarp.osim.document.model import GROUND, Model


@dataclass(frozen=True, eq=False)
class Actuators:
    """Motors in all frames of a motion.

    Attributes:
        names: Of motors that act on an independent coordinate.
        optimal: Force at control 1 [N m] or [N], shape (motors,).
        lower: Least controls.
        upper: Greatest.
        effect: What each does at control 1 [N m] or [N], shape (frames, motors, coordinates).
        crossed: For each motor the numbers of coordinates that it acts on.
        loads: What each puts on bodies at control 1; nothing for those of coordinates and paths.
        paths: Names of those that pull along a path.
    """

    names: tuple[str, ...]
    optimal: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    effect: np.ndarray
    crossed: tuple[tuple[int, ...], ...]
    loads: tuple[tuple[Load, ...], ...]
    paths: frozenset[str]

    def acting(self, control: np.ndarray) -> list[Load]:
        """Return what motors put on bodies at controls, shape (frames, motors)."""
        return [
            replace(load, force=load.force * given[:, None], torque=load.torque * given[:, None])
            for loads, given in zip(self.loads, control.T, strict=True)
            for load in loads
        ]


def actuators_of(bones: Bones, values: np.ndarray) -> Actuators | None:
    """Return the motors of a model along a motion; None: it has none that acts on a free coordinate.

    Args:
        bones: The model.
        values: Of the independent coordinates [rad] or [m], shape (frames, coordinates).
    """
    model, still = bones.model, np.zeros_like(values)
    items: list[CoordinateActuator | PathActuator | BodyActuator] = [*model.coordinate_actuators]
    items += [*model.path_actuators, *model.body_actuators]
    crossed = [_crossed(model, item) for item in items]
    kept = [number for number, own in enumerate(crossed) if own]
    if not kept:
        return None
    effects: list[np.ndarray] = []
    if model.coordinate_actuators:
        rate = rates(model, dict(zip(bones.coordinates, values.T, strict=True)), still).rate
        effects += [one.optimal_force * rate[one.coordinate][1:].T for one in model.coordinate_actuators]
    if model.path_actuators:
        paths = muscle_paths(bones, values, still, [one.name for one in model.path_actuators])
        effects += [
            one.optimal_force * paths.moment_arm[:, number] for number, one in enumerate(model.path_actuators)
        ]
    loads = [_loads(one, len(values)) for one in model.body_actuators]
    if loads:
        bare = inverse_dynamics(bones, values, still, still, passive=False).joint_moment
        pushed = (inverse_dynamics(bones, values, still, still, own, passive=False) for own in loads)
        effects += [bare - needed.joint_moment for needed in pushed]
    each: list[Sequence[Load]] = [*[()] * (len(items) - len(loads)), *loads]
    low, high = np.array([items[k].control_range for k in kept]).T
    return Actuators(
        tuple(items[k].name for k in kept),
        np.array([items[k].optimal_force for k in kept]),
        low,
        high,
        np.stack(effects, axis=1)[:, kept],
        tuple(tuple(bones.coordinates.index(name) for name in crossed[k]) for k in kept),
        tuple(tuple(each[k]) for k in kept),
        frozenset(one.name for one in model.path_actuators),
    )


def _crossed(model: Model, item: CoordinateActuator | PathActuator | BodyActuator) -> list[str]:
    """Return the independent coordinates that a motor can act on."""
    if isinstance(item, PathActuator):
        return of_path(model, item.path)
    if isinstance(item, CoordinateActuator):
        return leading(model, [item.coordinate])
    return leading(model, coordinates_between(model, [item.body, item.reaction]))


def _loads(item: BodyActuator, frames: int) -> Sequence[Load]:
    """Return what a motor on a body puts on it, and the opposite elsewhere, at control 1."""
    along = np.tile(item.optimal_force * item.axis, (frames, 1))
    none, place = np.zeros_like(along), np.tile(item.location, (frames, 1))
    axes = GROUND if item.in_ground else item.body
    if item.kind == "point":
        return [Load(item.body, along, place, none, axes, item.body)]
    return [Load(item.body, none, place, along, axes), Load(item.reaction, none, place, -along, axes)]
