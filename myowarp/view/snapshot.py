"""Host snapshot of one world, for rendering."""

from typing import NamedTuple

import mujoco
import numpy as np

from myowarp.sim.shards import Shards
from myowarp.sim.simulation import Simulation
from myowarp.spec.scene import Scene

SHAPE_FIELDS = ("geom_size", "body_pos")  # of the model, which pictures show and tasks draw
FLOAT32 = 1e-6  # m, rounding of these fields


class Snapshot(NamedTuple):
    """What a picture of a world shows.

    Attributes:
        qpos: Joint configuration, shape (nq,).
        activation: For every actuator with a tendon the activation of the muscle that pulls it, NaN if none
            does; None without muscles.
        goals: World positions of the goal's markers [m] by the names of their sites.
        shape: What the world has for itself: (field of the model or data, name of geom or body) to values.
    """

    qpos: np.ndarray
    activation: np.ndarray | None
    goals: dict[str, np.ndarray]
    shape: dict[tuple[str, str], np.ndarray]


def snapshot(sim: Simulation | Shards, world: int) -> Snapshot:
    """Return what a picture of one world shows."""
    part = next(part for part in reversed(sim.parts) if part.scene.worlds.first <= world)
    scene, world = part.scene, world - part.scene.worlds.first
    goals = part.program.goal_markers(world)
    qpos, muscles, shape = scene.data.qpos.numpy()[world].copy(), scene.muscles, _shape(scene, world)
    if not muscles.names:
        return Snapshot(qpos, None, goals, shape)
    path, transmission = (
        values.numpy()[world % values.shape[0]]
        for values in (muscles.anatomy.path, muscles.anatomy.transmission)
    )
    on_tendon = scene.oracle.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    activation = np.full(len(on_tendon), np.nan)
    activation[path] = np.where(transmission > 0.0, muscles.activation.numpy()[world], np.nan)
    return Snapshot(qpos, activation[on_tendon], goals, shape)


def _shape(scene: Scene, world: int) -> dict[tuple[str, str], np.ndarray]:
    """Return `Snapshot.shape` of a world."""
    model, oracle = scene.model, scene.oracle
    shape = {}
    for field in SHAPE_FIELDS:
        values = getattr(model, field).numpy()
        own, nominal = values[world % len(values)], getattr(oracle, field)
        element = getattr(oracle, field.partition("_")[0])
        for i in np.flatnonzero(np.abs(own - nominal).max(axis=1) > FLOAT32):
            shape[field, element(int(i)).name] = own[i].copy()
    for body in np.flatnonzero(oracle.body_mocapid >= 0):
        quat = scene.data.mocap_quat.numpy()[world, oracle.body_mocapid[body]]
        shape["mocap_quat", oracle.body(int(body)).name] = quat.copy()
    return shape
