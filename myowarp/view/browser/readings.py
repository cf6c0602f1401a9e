"""Quantities that a session can trace: of muscles, joints, devices and rewards, with their units.

Each is read in the shown world and in its twin. Musculotendon lengths and moment arms r = -dl/dq are those of
MuJoCo C in the state that is shown; a joint's muscle torque is sum_m r_m F_m over the muscles' tensions F_m.
"""

from __future__ import annotations

from itertools import compress
from typing import NamedTuple

import mujoco
import numpy as np

from myowarp.view.browser.session import Session
from myowarp.view.drawing import style as look
from myowarp.view.drawing.snapshot import Snapshot


class Kind(NamedTuple):
    """A quantity.

    Attributes:
        unit: Its unit; "1" for none.
        items: What has it: names of muscles, joints, devices or terms.
    """

    unit: str
    items: tuple[str, ...]


class Moment(NamedTuple):
    """The shown world and its twin at one time.

    Attributes:
        time: Time since the session was opened [s].
        episode: Number of the shown world's episode.
        seen: What the shown world and the twin look like.
        values: Values (2, num_items) of each quantity in both, by its name; NaN for a twin that is not shown.
        targets: Values (num_items,) that are wanted, by name of the quantity; NaN where none is.
    """

    time: float
    episode: int
    seen: tuple[Snapshot, Snapshot]
    values: dict[str, np.ndarray]
    targets: dict[str, np.ndarray]


class Readings:
    """The quantities of a session.

    Attributes:
        kinds: Quantities by name.
        first: What is traced at first, quantity and item: the strongest muscle, and a joint.
    """

    def __init__(self, session: Session) -> None:
        """Find out what there is."""
        self._session, sim = session, session.sim
        self._model, oracle = sim.full_model, sim.scene.oracle
        self._data = mujoco.MjData(self._model)
        hinges = np.isin(self._model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
        root = self._model.body(session.held).id if session.held else -1
        self._joints = np.flatnonzero(hinges)
        still = self._model.jnt_bodyid[self._joints] == root
        self._joints = self._joints[np.argsort(still, kind="stable")]  # what is held says least
        self._dofs, self._places = self._model.jnt_dofadr[self._joints], self._model.jnt_qposadr[self._joints]
        self._turns = self._model.jnt_type[self._joints] == mujoco.mjtJoint.mjJNT_HINGE
        self._tendons = {
            i: int(self._model.actuator(oracle.actuator(i).name).trnid[0])
            for i in range(oracle.nu)
            if oracle.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_TENDON
        }
        self._devices = np.flatnonzero(oracle.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        joints = tuple(self._model.joint(int(joint)).name for joint in self._joints)
        hinged, sliding = (tuple(compress(joints, mask)) for mask in (self._turns, ~self._turns))
        muscles = tuple(sim.scene.muscles.names) if session.signals is not None else ()
        self._pairs = self._crossing()
        devices = tuple(oracle.actuator(int(device)).name for device in self._devices)
        arms = tuple(f"{muscles[muscle]} at {joints[joint]}" for muscle, joint in self._pairs)
        kinds = {
            "activation": Kind("1", muscles),
            "excitation": Kind("1", muscles),
            "force": Kind("N", muscles),
            "musculotendon length": Kind("m", muscles),
            "fatigue": Kind("1", muscles if session.signals and "fatigue" in session.signals.info else ()),
            "moment arm": Kind("m", arms),
            "joint angle": Kind("°", hinged),
            "joint translation": Kind("m", sliding),
            "muscle torque": Kind("N m", hinged if muscles else ()),
            "muscle force along a slide": Kind("N", sliding if muscles else ()),
            "device torque": Kind("N m", devices),
            "reward term": Kind("1", ("total", *session.terms)),
        }
        self.kinds = {name: kind for name, kind in kinds.items() if kind.items}
        self.first = [("joint angle", joint) for joint in hinged[:1]]
        if muscles:
            strongest = sim.scene.muscles.geometry().max_isometric_force[0].argmax()
            self.first.insert(0, ("activation", muscles[int(strongest)]))

    def read(self) -> Moment:
        """Return what there is now."""
        session = self._session
        seen = session.seen(session.world)
        own = self._of(session.world, seen)
        if session.beside:
            twin = session.seen(session.twin)
            its = self._of(session.twin, twin)
        else:
            twin, its = seen, {name: np.full(len(values), np.nan) for name, values in own.items()}
        values = {name: np.stack((own[name], its[name])) for name in self.kinds}
        known = seen.ghost is not None and session.file is None
        targets = self._at_joints(np.asarray(seen.ghost)) if known else {}
        return Moment(session.elapsed, session.episode, (seen, twin), values, targets)

    def _at_joints(self, qpos: np.ndarray) -> dict[str, np.ndarray]:
        """Return where joints are in a configuration, hinges [deg] and slides [m]."""
        values = qpos[self._places]
        return {"joint angle": np.degrees(values[self._turns]), "joint translation": values[~self._turns]}

    def _of(self, world: int, seen: Snapshot) -> dict[str, np.ndarray]:
        """Return the values of a world, by quantity."""
        session, sim = self._session, self._session.sim
        found = {
            **self._at_joints(seen.qpos),
            "device torque": sim.scene.data.actuator_force.numpy()[world, self._devices]
            * sim.scene.oracle.actuator_gear[self._devices, 0],
            "reward term": np.array(
                [sim.transition.reward.numpy()[world], *session.terms_of(world).values()]
            ),
        }
        if session.signals is None:
            return found
        muscles = session.signals.muscles
        force = muscles.force.numpy()[world]
        arms = self._arms(world, seen)
        torque = force @ arms
        found |= {
            "activation": muscles.activation.numpy()[world],
            "excitation": muscles.excitation.numpy()[world],
            "force": force,
            "musculotendon length": muscles.length.numpy()[world],
            "moment arm": arms[tuple(np.array(self._pairs, dtype=int).reshape(-1, 2).T)],
            "muscle torque": torque[self._turns],
            "muscle force along a slide": torque[~self._turns],
        }
        if "fatigue" in session.signals.info:
            found["fatigue"] = session.signals.info["fatigue"].numpy()[world]
        return {name: np.asarray(values, dtype=float) for name, values in found.items()}

    def _arms(self, world: int, seen: Snapshot) -> np.ndarray:
        """Return moment arms of a world's muscles about the joints [m], shape (num_muscles, num_joints)."""
        if not np.isfinite(seen.qpos).all():
            return np.full((len(self._session.sim.scene.muscles.names), len(self._joints)), np.nan)
        look.pose(self._model, self._data, seen.qpos, seen.shape)
        path = self._session.sim.scene.muscles.anatomy.path.numpy()
        tendons = [self._tendons[int(actuator)] for actuator in path[world % len(path)]]
        return self.moment_arms(tendons)

    def moment_arms(self, tendons: list[int]) -> np.ndarray:
        """Return moment arms of tendons in the pose of the data [m], shape (num_tendons, num_joints)."""
        return -jacobian(self._model, self._data)[tendons][:, self._dofs]

    def _crossing(self) -> list[tuple[int, int]]:
        """Return muscles and joints that their paths cross."""
        if self._session.signals is None:
            return []
        joint_of = {int(dof): joint for joint, dof in enumerate(self._dofs)}
        path = self._session.sim.scene.muscles.anatomy.path.numpy()[0]
        rows, columns = _entries(self._model)
        crossed = [columns[rows == self._tendons[int(actuator)]] for actuator in path]
        return [
            (muscle, joint_of[int(dof)])
            for muscle, dofs in enumerate(crossed)
            for dof in dofs
            if int(dof) in joint_of
        ]


def _entries(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return tendon and degree of freedom of each entry of `ten_J`."""
    counts = model.ten_J_rownnz
    return np.repeat(np.arange(model.ntendon), counts), model.ten_J_colind[: counts.sum()]


def jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return dl/dq of all tendons in the pose of the data, shape (ntendon, nv)."""
    found = np.zeros((model.ntendon, model.nv))
    entries = _entries(model)
    found[entries] = data.ten_J[: len(entries[0])]
    return found
