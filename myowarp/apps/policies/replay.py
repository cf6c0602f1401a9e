"""A policy from a file: excitations over time, as OpenSim, SCONE or `myowarp rollout --signals` write them.

    myowarp rollout --model arm.xml --policy controls.sto

A column is called like its muscle or motor, with or without `.excitation` behind it and `/forceset/` before
it; CMC's, RRA's and Moco's files have such columns beside others. Between two rows the excitation changes
linearly; before the first row and after the last one it keeps that row's value. A control step holds the
value of its end, so a recording of every step replays itself. A file that begins later than with the end of
the first step, as one of a part of a trial does, begins with the episode.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from myowarp.kernels.action import action_of, excitation
from myowarp.motion.storage import SUFFIXES, Storage
from myowarp.motion.units import hardly_seconds
from myowarp.process import warn_once

if TYPE_CHECKING:
    from myowarp.sim.simulation import Simulation

logger = logging.getLogger("myowarp")

ROUNDING = 1e-3
"""Share of a control step by which the first row of a recording may be later than its end."""


def is_replay(name: str) -> bool:
    """Return whether a policy's name is a file of excitations."""
    return Path(name).suffix.lower() in SUFFIXES


class Replay:
    """Actions that give the muscles the excitations of a file, in each world by the time of its episode."""

    def __init__(self, name: str, storage: Storage, sim: Simulation) -> None:
        """Find the columns of the muscles.

        Args:
            name: What the file is called.
            storage: What `read_storage` returns.
            sim: The simulation whose muscles are excited.

        Raises:
            ValueError: A muscle has no column, or an excitation is outside of 0 to 1.
        """
        scene = sim.scene
        names, self._motors = scene.muscles.names, _motors(storage, sim, name)
        if not names and not self._motors:
            raise ValueError(
                f"policy {name!r} drives muscles or motors; it has no column of one of {scene.spec.key!r}"
            )
        columns = np.array([_column(storage, muscle, name) for muscle in names], int)
        values = storage.values[:, columns]
        if (outside := (values < 0.0) | (values > 1.0)).any():
            row, muscle = np.argwhere(outside)[0]
            raise ValueError(
                f"excitations of {name!r} must be from 0 to 1; {names[muscle]} has {values[row, muscle]:g} "
                f"at {storage.time[row]:g} s"
            )
        if values.size and values.max() > (most := excitation(1.0, scene.spec.linear_excitation)):
            logger.warning("excitations of %s above %.3f become %.3f: actions give no more", name, most, most)
        if doubt := hardly_seconds(Path(name), storage.time):
            logger.warning("%s", doubt)
        begin = storage.time[0]
        if begin > (1.0 + ROUNDING) * scene.control_dt:
            logger.warning("%s begins at %g s; that is the begin of an episode", name, begin)
        else:
            begin = 0.0
        self._name, self._time, self._values = name, storage.time - begin, values
        self._sim, self._actuator_id = sim, scene.muscles.actuator_id

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return actions (num_worlds, num_actions) of the step that comes; 0 for motors without a column."""
        scene = self._sim.scene
        action = np.zeros((len(obs), scene.num_actions), dtype=np.float32)
        time = (self._sim.episode.step_count.numpy() + 1) * scene.control_dt
        if time.max() > (end := self._time[-1]) + ROUNDING * scene.control_dt:
            warn_once(f"{self._name} ends after {end:.4g} s of an episode; its last row holds from there on")
        for muscle, actuator in enumerate(self._actuator_id):
            action[:, actuator] = action_of(
                np.interp(time, self._time, self._values[:, muscle]), scene.spec.linear_excitation
            )
        for motor, controls in self._motors.items():
            action[:, motor] = np.interp(time, self._time, controls)
        return action


def _motors(storage: Storage, sim: Simulation, name: str) -> dict[int, np.ndarray]:
    """Return the actions of motors that have a column, by actuator: where controls are in their ranges."""
    oracle, found = sim.scene.oracle, {}
    for actuator in set(range(oracle.nu)) - set(sim.scene.muscles.actuator_id):
        own = oracle.actuator(actuator).name
        place = _place(storage, own)
        if place is None:
            continue
        low, high = oracle.actuator_ctrlrange[actuator]
        controls = storage.values[:, place]
        if ((controls < low) | (controls > high)).any():
            logger.warning("controls of %s in %s go beyond %g to %g, and are cut", own, name, low, high)
        found[actuator] = np.clip(2.0 * (controls - low) / (high - low) - 1.0, -1.0, 1.0)
    return found


def _place(storage: Storage, own: str) -> int | None:
    """Return the column of an actuator, None: there is none."""
    labels = (own, f"{own}.excitation", f"/forceset/{own}", f"/forceset/{own}.excitation")
    return next((storage.labels.index(label) for label in labels if label in storage.labels), None)


def _column(storage: Storage, own: str, name: str) -> int:
    """Return the column of a muscle's excitation.

    Raises:
        ValueError: There is none.
    """
    place = _place(storage, own)
    if place is not None:
        return place
    raise ValueError(
        f"policy {name!r} has no excitation of muscle {own!r}; it needs a column {own!r} or "
        f"'{own}.excitation' for every muscle"
    )
