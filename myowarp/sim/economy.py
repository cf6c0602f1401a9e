"""Costs of an episode: metabolic rates, and of a body that walks speed and cost of transport.

All are means over the episode. A body that falls does not walk: of a free root nothing is said in an episode
that failed, part of which is the fall. Speed is the distance from the root's first place to its last one,
level, over the time; the cost of transport is the rate per kilogram over the speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from myowarp.sim.metabolics import LAWS, WHOLE_BODY_UNITS

if TYPE_CHECKING:
    from myowarp.sim.signals import Signals
    from myowarp.sim.simulation import Simulation

WALKING_UNITS = {"speed": "m/s"} | {f"{law}_per_kg_m": "J/kg/m" for law in LAWS}
"""Figures of a free root besides the rates, with units; `..._per_kg_m` is the cost of transport."""
UNITS = WHOLE_BODY_UNITS | WALKING_UNITS
"""All figures, with units."""
SOURCES = dict(zip(LAWS, ("Bhargava 2004", "Umberger 2010"), strict=True))
LEAST_SPEED = 0.1
"""m/s: what is slower does not walk, and has no cost of transport."""
ABSURD_RATE = 20.0
"""W/kg: people spend as much at 5 m/s, as running costs 4 J/kg/m (Margaria 1963, J Appl Physiol 18:367)."""


def free_root(model: mujoco.MjModel) -> int:
    """Return where in qpos the place of a free root begins whose tree has muscles, -1 where there is none."""
    sites = model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE]
    trees = set(model.body_rootid[model.site_bodyid[sites]].tolist()) - {0}
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        if int(model.body_rootid[model.jnt_bodyid[joint]]) in trees:
            return int(model.jnt_qposadr[joint])
    return -1


class Economy:
    """Rates, speed and cost of transport of the present episode of every world.

    Attributes:
        units: Unit of each figure, by name.
    """

    def __init__(self, sim: Simulation, signals: Signals) -> None:
        """Begin in the state in which the worlds are."""
        self._signals, self._dt, self._root = signals, sim.scene.control_dt, free_root(sim.scene.oracle)
        self.units = WHOLE_BODY_UNITS | (WALKING_UNITS if self._root >= 0 else {})
        self._steps = np.zeros(sim.num_worlds, dtype=int)
        self._sums = {name: np.zeros(sim.num_worlds) for name in WHOLE_BODY_UNITS}
        self._first, self._last = np.zeros((2, sim.num_worlds, 2))
        self.start(np.ones(sim.num_worlds, dtype=bool))

    def start(self, mask: np.ndarray) -> None:
        """Count anew in worlds that stand where an episode starts, (num_worlds,) bool."""
        self._steps[mask] = 0
        for total in self._sums.values():
            total[mask] = 0.0
        self._first[mask] = self._last[mask] = self._places()[mask]

    def copy(self, source: int, target: int) -> None:
        """Let a world have come as far as another one."""
        for array in (self._steps, *self._sums.values(), self._first, self._last):
            array[target] = array[source]

    def see(self, mask: np.ndarray) -> None:
        """Count the step that was made, in worlds whose episode it belongs to, (num_worlds,) bool."""
        self._steps += mask
        for name, total in self._sums.items():
            total[mask] += self._signals.whole_body[name].numpy()[mask]
        self._last[mask] = self._places()[mask]

    def _places(self) -> np.ndarray:
        """Return where roots are, level [m], shape (num_worlds, 2)."""
        if self._root < 0:
            return self._first
        return self._signals.qpos.numpy()[:, self._root : self._root + 2]

    def means(self, failed: np.ndarray | bool = False) -> dict[str, np.ndarray]:
        """Return the figures by name, (num_worlds,) each, NaN where nothing can be said.

        Args:
            failed: Whose episode failed, (num_worlds,) bool.
        """
        steps = np.where(self._steps, self._steps, np.nan)
        found = {name: total / steps for name, total in self._sums.items()}
        if self._root < 0:
            return found
        speed = np.linalg.norm(self._last - self._first, axis=1) / (steps * self._dt)
        walks = np.where(speed < LEAST_SPEED, np.nan, speed)
        found["speed"] = speed
        found |= {f"{law}_per_kg_m": found[f"{law}_per_kg"] / walks for law in LAWS}
        return {name: np.where(failed, np.nan, values) for name, values in found.items()}


def word(name: str) -> str:
    """Return what a figure is, for people."""
    law, _, per = name.partition("_")
    what = "cost of transport" if per == "per_kg_m" else "metabolic rate"
    return f"{what}, {SOURCES[law]}" if law in SOURCES else name


def heading(name: str, mass: float | None) -> str:
    """Return a figure and its unit, for people; the model's mass [kg] stands beside a rate per kilogram."""
    of = f" of the model, {mass:.3g} kg" if mass is not None and UNITS[name] == "W/kg" else ""
    return f"{word(name)} [{UNITS[name]}{of}]"


def doubt(figures: Mapping[str, float | None]) -> str:
    """Return, in a sentence, that the metabolic rate of a walk is above `ABSURD_RATE`; "" where none is."""
    speed, *rates = (figures.get(name) for name in ("speed", *(f"{law}_per_kg" for law in LAWS)))
    most = max((rate for rate in rates if rate is not None and np.isfinite(rate)), default=0.0)
    if speed is None or most <= ABSURD_RATE:
        return ""
    return (
        f"absurd metabolic rate: up to {most:.1f} W/kg, where a person who runs at 5 m/s spends "
        f"{ABSURD_RATE:g}; do not compare it with people"
    )


def as_text(figures: Mapping[str, float | None]) -> str:
    """Return speed, rate and cost of transport of a walk by the law of Bhargava; "" where one is unknown.

    A rate above `ABSURD_RATE` is marked.
    """
    names = ("speed", "bhargava2004_per_kg", "bhargava2004_per_kg_m")
    speed, rate, cost = (np.nan if (value := figures.get(name)) is None else value for name in names)
    if not np.isfinite((speed, rate)).all():
        return ""
    transport = f", {cost:.1f} J/kg/m" if np.isfinite(cost) else ""
    mark = f" (absurd: over {ABSURD_RATE:g})" if rate > ABSURD_RATE else ""
    return f"{speed:.2f} m/s, {rate:.1f} W/kg{mark}{transport}"
