"""Endurance of a muscle under a held load: 3CC-r in the simulation, in closed form, and measured.

A held load f keeps M_A = f, so that M_F follows dM_F/dt = F f - R M_F and the reserve M_R is used up when
M_F = 1 - f, after

    t = -ln(1 - R (1 - f) / (F f)) / R

and never, if f < R / (F + R). Measured: t = 17.98 f^-2.21 s, elbow, power model of a meta-analysis (Frey Law,
Avin 2010, doi:10.1080/00140130903389068). The rates are those of the elbow's flexors and extensors (Rakshit
et al. 2021), which were fitted to other data.
"""

from __future__ import annotations

import math

import numpy as np

from myowarp.apps.rollouts.run import Each, Step, run
from myowarp.apps.studies.reproduce.arm import CONTROL_DT, MUSCLES, arms
from myowarp.apps.studies.reproduce.experiment import Lab, Tick
from myowarp.definitions.body import FatigueRates
from myowarp.kernels.action import action_of
from myowarp.models.bodies.arm_muscles import FATIGUE_RATES
from myowarp.models.conditions import Fatigue3CCR

LOADS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  # of the maximum
LONGEST, QUICK_LONGEST = 600.0, 120.0  # s
FELL_SHORT = 0.01  # of the load: when it is no longer held


def measured(load: float) -> float:
    """Return how long people hold a share of their elbow's maximum [s] (Frey Law, Avin 2010)."""
    return 17.98 * load**-2.21


def closed_form(load: float, rates: FatigueRates) -> float:
    """Return how long 3CC-r holds a load [s]; infinity if for ever."""
    spent = rates.recovery_rate * (1.0 - load) / (rates.fatigue_rate * load)
    return -math.log(1.0 - spent) / rates.recovery_rate if spent < 1.0 else math.inf


def largest_deviation(seconds: np.ndarray) -> float:
    """Return by what share simulated endurance, (loads, 6), is off the closed form at most."""
    exact = np.array([[closed_form(load, FATIGUE_RATES[muscle]) for muscle in MUSCLES] for load in LOADS])
    return float(np.nanmax(np.abs(seconds / exact - 1.0)))


def simulated(lab: Lab) -> np.ndarray:
    """Return how long the muscles hold each of `LOADS` [s], shape (loads, 6); NaN: to the end."""
    longest = QUICK_LONGEST if lab.quick else LONGEST
    lab.expect(1)
    return lab.kept(
        "endurance", {"loads": LOADS, "longest": longest}, lambda tick: _hold(lab, longest, tick)
    )["seconds"]


def _hold(lab: Lab, longest: float, tick: Tick) -> dict[str, np.ndarray]:
    """Drive all muscles at each load until the active fraction falls short of it."""
    sim = arms((Fatigue3CCR(),), len(LOADS), lab.setup)
    loads = np.array(LOADS)[:, None]
    held = np.tile(action_of(loads), (1, len(MUSCLES))).astype(np.float32)
    seconds = np.full((len(LOADS), len(MUSCLES)), np.nan)
    steps = round(longest / CONTROL_DT)

    def look(step: Step) -> None:
        if step.number % 50:
            return
        # Motor units that are neither active nor tired are the reserve; without it the load is not held.
        reserve = 1.0 - loads - sim.info["fatigue"].numpy()
        short = (reserve < FELL_SHORT * loads) & np.isnan(seconds)
        seconds[short] = step.number * CONTROL_DT
        tick(step.number / steps)

    same = np.zeros(len(LOADS), dtype=int)
    run(sim, lambda obs: held, steps, Each(look), seeds=same, again=False)
    return {"seconds": seconds}
