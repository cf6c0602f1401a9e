"""Accelerations of a converted model in what steps it: plain MuJoCo, and the step that a check is handed in.

Gravity and forces along coordinates are all that acts: muscles, springs, dampers, limits, contacts and
constraints that close loops are off.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

from myowarp.osim.bundle.coordinate_map import CoordinateMap

Array = np.ndarray

OFF = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_LIMIT
    | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    | mujoco.mjtDisableBit.mjDSBL_SPRING
    | mujoco.mjtDisableBit.mjDSBL_DAMPER
)


@dataclass(frozen=True, eq=False)
class States:
    """n states of k independent coordinates, and what acts; each field has shape (n, k).

    Attributes:
        values: [rad] or [m].
        speeds: [rad/s] or [m/s].
        forces: Along them [N m] or [N].
        gravity: Whether there is gravity, for all states.
    """

    values: Array
    speeds: Array
    forces: Array
    gravity: bool = True


class Engine(Protocol):
    """An engine that steps a converted model."""

    def accelerations(self, states: States) -> Array:
        """Return u'' [rad/s^2] or [m/s^2], shape (n, k)."""

    def inertia(self, values: Array) -> Array | None:
        """Return the mass matrix at coordinates (n, k), shape (n, k, k); None: only seen in accelerations."""


NewStep = Callable[[CoordinateMap, mujoco.MjSpec], Engine]
"""Makes the step that is checked, of a map and of a spec, which it may change."""


class Joints:
    """Joints of a model that show its free coordinates."""

    def __init__(self, coordinates: CoordinateMap, model: mujoco.MjModel) -> None:
        self.map, self.model = coordinates, model
        shown = [entry for entry in coordinates.coordinates if entry.kind == "free"]
        self.moving = np.array([entry.joint is not None for entry in shown])
        self.joint = np.array([model.joint(entry.joint).id for entry in shown if entry.joint], int)
        self.scale = np.array([entry.scale for entry in shown if entry.joint])

    def state(self, states: States) -> tuple[Array, Array, Array]:
        """Return qpos, qvel and qfrc_applied, each of shape (n, nv)."""
        qpos, slope = self.map.rates(self.model, dict(zip(self.map.free(), states.values.T, strict=True)))
        force = np.zeros_like(qpos)
        force[:, self.joint] = states.forces[:, self.moving] / self.scale
        return qpos, np.einsum("nij,nj->ni", slope, states.speeds), force

    def coordinates(self, qacc: Array) -> Array:
        """Return accelerations of the coordinates from those of joints; 0 for one that moves nothing."""
        found = np.zeros((len(qacc), len(self.moving)))
        found[:, self.moving] = qacc[:, self.joint] / self.scale
        return found


class PlainMuJoCo:
    """MuJoCo C: joints that follow are held by equalities."""

    def __init__(self, coordinates: CoordinateMap, model: mujoco.MjModel) -> None:
        self.joints, self.model = Joints(coordinates, model), model

    def accelerations(self, states: States) -> Array:
        """Return u'', from `mj_forward`."""
        model, opt = self.model, self.model.opt
        before = opt.disableflags
        opt.disableflags = before | OFF | mujoco.mjtDisableBit.mjDSBL_ACTUATION
        if not states.gravity:
            opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
        data, qacc = mujoco.MjData(model), np.zeros((len(states.values), model.nv))
        data.eq_active &= model.eq_type == mujoco.mjtEq.mjEQ_JOINT
        for index, (qpos, qvel, force) in enumerate(zip(*self.joints.state(states), strict=True)):
            data.qpos, data.qvel, data.qfrc_applied, data.qacc_warmstart = qpos, qvel, force, 0.0
            mujoco.mj_forward(model, data)
            qacc[index] = data.qacc
        opt.disableflags = before
        return self.joints.coordinates(qacc)

    def inertia(self, values: Array) -> None:
        """Return nothing: what its springs pass on is seen in accelerations."""
