"""Host snapshot of one world, for rendering."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from myowarp.definitions.scene import Scene
from myowarp.engine.patch import engine_kernels_alone
from myowarp.sim.signals import Signals
from myowarp.sim.simulation import Simulation

SHAPE_FIELDS = ("geom_size", "geom_pos", "geom_quat", "body_pos")
"""Fields of the model that pictures show and tasks draw."""
FLOAT32 = 1e-6  # m, rounding of these fields


class Snapshot(NamedTuple):
    """The content of a picture of a world.

    Attributes:
        qpos: Joint configuration, shape (nq,).
        muscles: What is known of the muscles, by name, an entry for each actuator with a tendon, NaN where
            no muscle pulls it: `activation`, `excitation`, what the muscle model knows of `strength` (peak
            force [N]), `optimal_fiber_length` and present `tendon_length` [m], and `force` [N] and `fatigue`
            where they are computed.
        goals: World positions of the goal's markers [m] by the names of their sites.
        shape: What the world has for itself: (field of the model or data, name of geom, body or height
            field) to values.
        ghost: Configuration that the goal asks for, shape (nq,); None where it asks for none.
        paths: Points of each muscle's path [m], shape (n, 3) each; empty: MuJoCo's tendons are its paths.
        arrows: Begins and ends of the arrows of forces [m], shape (n, 2, 3).
    """

    qpos: np.ndarray
    muscles: Mapping[str, np.ndarray] = {}
    goals: Mapping[str, np.ndarray] = {}
    shape: Mapping[tuple[str, str], np.ndarray] = {}
    ghost: np.ndarray | None = None
    paths: Sequence[np.ndarray] = ()
    arrows: np.ndarray = np.zeros((0, 2, 3))

    @property
    def activation(self) -> np.ndarray | None:
        """Activation of each muscle, NaN where none pulls; None if it is not known."""
        return self.muscles.get("activation")


def snapshot(sim: Simulation, world: int, signals: Signals | None = None) -> Snapshot:
    """Return what a picture of one world shows.

    Args:
        sim: The simulation.
        world: Number of the world.
        signals: Signals of the simulation, for the muscles' forces.
    """
    part = next(part for part in reversed(sim.shards) if part.scene.worlds.first <= world)
    scene, row = part.scene, world - part.scene.worlds.first
    goals, ghost = part.program.goal_markers(row), part.program.goal_pose(row)
    qpos = scene.data.qpos.numpy()[row].copy()
    known = _muscles(scene, row) if scene.muscles.names else {}
    if signals is not None:
        known["force"] = signals.muscles.force.numpy()[world]
    if "fatigue" in part.shown:
        known["fatigue"] = part.shown["fatigue"].numpy()[row]
    muscles = _by_tendon(scene, row, known) if known else {}
    return Snapshot(qpos, muscles, goals, _shape(scene, row), ghost, _paths(scene, row))


def _paths(scene: Scene, world: int) -> list[np.ndarray]:
    """Return `Snapshot.paths` of a world; empty where they are MuJoCo's, more points than fit, or none."""
    if scene.paths is None:
        return []
    oracle, data = scene.oracle, scene.data
    with wp.ScopedDevice(scene.device), engine_kernels_alone():
        mjw.kinematics(scene.model, data)
        mjw.com_pos(scene.model, data)
        scene.paths.launch(scene.model, data)
    points = scene.paths.points(world)
    on_tendon = oracle.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    names = [oracle.tendon(int(tendon)).name for tendon in oracle.actuator_trnid[on_tendon, 0]]
    paths = [points[name] for name in names if name in points]
    fit = len(paths) == len(names) and sum(map(len, paths)) <= 2 * oracle.nwrap and all(map(len, paths))
    return paths if fit and all(np.isfinite(path).all() for path in paths) else []


def _row(array: np.ndarray, world: int) -> np.ndarray:
    """Return the row of a world in an array of which all worlds may share one."""
    return array[world % len(array)]


def _muscles(scene: Scene, world: int) -> dict[str, np.ndarray]:
    """Return what is known of the muscles of a world, shape (num_muscles,) each."""
    muscles, geometry = scene.muscles, scene.muscles.geometry()
    strength = _row(muscles.anatomy.strength.numpy(), world)
    return {
        "activation": muscles.activation.numpy()[world],
        "excitation": scene.data.ctrl.numpy()[world, muscles.actuator_id],
        "strength": strength * _row(geometry.max_isometric_force, world),
        "optimal_fiber_length": _row(geometry.optimal_fiber_length, world),
        "tendon_length": _row(geometry.tendon_length, world),
    }


def _by_tendon(scene: Scene, world: int, known: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return values of muscles as those of the actuators with a tendon that they pull."""
    anatomy, oracle = scene.muscles.anatomy, scene.oracle
    path, transmission = _row(anatomy.path.numpy(), world), _row(anatomy.transmission.numpy(), world)
    on_tendon = oracle.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    spread = np.full((len(known), len(on_tendon)), np.nan)
    spread[:, path] = np.where(transmission > 0.0, np.stack(list(known.values())), np.nan)
    return dict(zip(known, spread[:, on_tendon], strict=True))


def _shape(scene: Scene, world: int) -> dict[tuple[str, str], np.ndarray]:
    """Return `Snapshot.shape` of a world."""
    model, oracle = scene.model, scene.oracle
    shape = {}
    for field in SHAPE_FIELDS:
        nominal = getattr(oracle, field)
        own = _row(getattr(model, field).numpy(), world)
        element = getattr(oracle, field.partition("_")[0])
        for i in np.flatnonzero(np.abs(own - nominal).max(axis=1) > FLOAT32):
            shape[field, element(int(i)).name] = own[i].copy()
    for body in np.flatnonzero(oracle.body_mocapid >= 0):
        for field in ("mocap_pos", "mocap_quat"):
            values = getattr(scene.data, field).numpy()[world, oracle.body_mocapid[body]]
            shape[field, oracle.body(int(body)).name] = values.copy()
    if scene.ground is not None and scene.ground.heights.shape[0] > 1:
        hfield = scene.ground.hfield
        heights = scene.ground.heights.numpy()[world].ravel() / oracle.hfield_size[hfield, 2]
        shape["hfield_data", oracle.hfield(hfield).name] = heights
    return shape
