"""Fatigue of motor units: the three-compartment controller with rest recovery, 3CC-r.

A muscle's motor units are active M_A, resting M_R or fatigued M_F, M_A + M_R + M_F = 1. They follow the
target load TL, the excitation that the policy commands, and the muscle gets M_A instead of it:

    dM_A = c - F dt M_A,    dM_F = F dt M_A - R' dt M_F,    M_R = 1 - M_A - M_F
    c = (1 - exp(-dt / (tau_act s))) min(TL - M_A, M_R)   if M_A < TL
        (1 - exp(-dt s / tau_deact)) (TL - M_A)           otherwise,    s = 0.5 + 1.5 M_A
    R' = r R if TL <= 0.01, the muscle rests, otherwise R

per control step dt, with c limited so that every compartment stays in 0..1.

Sources: Xia, Frey Law (2008), doi:10.1016/j.jbiomech.2008.07.013; Looft, Herkert, Frey-Law (2018),
doi:10.1016/j.jbiomech.2018.06.005; rates by muscle group, which are facts of the body (`Body.fatigue_rates`),
and the rest at zero load: Rakshit et al. (2021), doi:10.1016/j.jbiomech.2021.110695. Step, groups and
threshold are those of MyoSuite 3.0.0, whose `myoFati...` ids have this condition. As there, the muscle's own
activation dynamics then filter M_A once more.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import warp as wp

from myowarp.definitions.body import BODIES, FatigueRates
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.parameter import (
    Clock,
    Curve,
    Fixed,
    Parameter,
    Ramp,
    Uniform,
    Value,
    value_of,
)
from myowarp.definitions.task import Column
from myowarp.kernels.accumulate import add_compensated
from myowarp.kernels.batching import of_world
from myowarp.kernels.launch import launch
from myowarp.kernels.observe import masked_observe
from myowarp.kernels.random import RandomKeys, open_stream

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

REST_LOAD = wp.constant(0.01)  # a muscle rests up to this target load [1]; MyoSuite 3.0.0
FAST = 2.0  # 1/s: a hundred times what is measured, so that a viewer need not wait for minutes
STREAM = wp.constant(zlib.crc32(b"fatigue_3ccr initial_random") & 0x7FFFFFFF)
OTHER = FatigueRates(0.0097, 0.00091, 15.0)
"""Rates where the body has none: "general" of Frey-Law et al. (2012), r of Looft et al. (2018)."""


@dataclass(frozen=True, eq=False)
class Fatigue3CCR(Condition):
    """Muscles whose motor units tire under load and recover, faster at rest.

    `info["fatigue"]` (num_worlds, num_muscles) is the fatigued fraction M_F.

    Attributes:
        affected: Share of the muscle that tires, 0..1; the rest follows the command. At 0 the state rests.
        fatigue_rate: F [1/s], >= 0; None, and muscles that a mapping does not name: by muscle group.
        recovery_rate: R [1/s], >= 0; None as above.
        rest_recovery_factor: r [1], >= 0; None as above.
        initial: Fatigued fraction at the start, 0..1; the rest of the muscle rests.
        initial_random: Start at random: M_A = n p, M_R = n (1 - p), M_F = 1 - n with n, p ~ U(0, 1).
        carry_over: Whether M_F goes on through resets, until the world is seeded anew; M_A starts at 0, like
            the activation. Where episodes start from the last one's end (`reset="none"`) both go on.
        observe: Whether the observation shows M_F, in columns `fatigue`.

    Raises:
        ValueError: `initial` and `initial_random` are both given.
    """

    PHASE = Phase.FATIGUE
    WRITES = ("fatigue",)
    NEUTRAL: ClassVar = {"affected": 0.0}
    NEEDS = "affected"
    AT_START = ("initial",)
    TITLE = "fatigue"
    LABELS: ClassVar = {
        "affected": "share that tires",
        "fatigue_rate": "tiring rate",
        "recovery_rate": "recovery rate",
        "rest_recovery_factor": "faster at rest",
        "initial": "tired at start",
    }

    affected: Value = 1.0
    fatigue_rate: Value | None = None
    recovery_rate: Value | None = None
    rest_recovery_factor: Value | None = None
    initial: Value | None = None
    initial_random: bool = False
    carry_over: bool = False
    observe: bool = False

    def __post_init__(self) -> None:
        if self.initial_random and self.initial is not None:
            raise ValueError("fatigue_3ccr takes initial or initial_random, not both; leave one out")

    def bind(self, scene: Scene, clock: Clock) -> Fatigue3CCREffect:
        """Put all parameters on the device."""
        names = self.muscle_names(scene)
        rates = rates_of(scene.spec.body, names)
        limits = {
            # parameter: (value, neutral, greatest, usual); no more than all of a compartment flows in a step
            "affected": (self.affected, 0.0, 1.0, None),
            "fatigue_rate": (self._rates("fatigue_rate", rates), 0.0, 1.0 / scene.control_dt, FAST),
            "recovery_rate": (self._rates("recovery_rate", rates), 0.0, 1.0 / scene.control_dt, FAST),
            "rest_recovery_factor": (self._rates("rest_recovery_factor", rates), 1.0, np.inf, None),
            "initial": (0.0 if self.initial is None else self.initial, 0.0, 1.0, None),
        }
        parameters = {
            name: Parameter(
                f"fatigue_3ccr {name}", value, scene, names, neutral=neutral, low=0.0, high=high, usual=usual
            )
            for name, (value, neutral, high, usual) in limits.items()
        }
        return Fatigue3CCREffect(self, scene, clock, parameters)

    def _rates(self, name: str, rates: Mapping[str, FatigueRates]) -> Value:
        """Return a rate as given, with the body's for every muscle that is left open."""
        table = {muscle: getattr(own, name) for muscle, own in rates.items()}
        value = getattr(self, name)
        if value is None:
            return table
        if isinstance(value, Ramp):
            start, end = completed(value.start, table), completed(value.end, table)
            return dataclasses.replace(value, start=start, end=end)
        return completed(value, table)


def rates_of(body: str, muscles: Sequence[str]) -> dict[str, FatigueRates]:
    """Return the rates of muscles, named with or without `_r`; `OTHER` where the body has none."""
    known = BODIES[body].fatigue_rates
    return {muscle: known.get(muscle.removesuffix("_r"), OTHER) for muscle in muscles}


def completed(value: Fixed | Uniform, table: dict[str, float]) -> Fixed | Uniform:
    """Return a value in which a mapping names every muscle of `table`."""
    if not isinstance(value, Mapping):
        return value
    muscles = list(table)
    return table | {muscles[muscle_index(muscle, muscles)]: number for muscle, number in value.items()}


@wp.struct
class MotorUnitParams:
    """Parameters of all muscles.

    Attributes:
        actuator_id: Actuator of each muscle, shape (num_muscles,).
        activation_time_constant: tau_act [s], shape (1 or num_worlds, num_muscles).
        deactivation_time_constant: tau_deact [s], shape (1 or num_worlds, num_muscles).
        affected: Share of the muscle that tires [1].
        fatigue_rate: F [1/s].
        recovery_rate: R [1/s].
        rest_recovery_factor: r [1].
        initial: M_F at the start [1].
    """

    actuator_id: wp.array[int]
    activation_time_constant: wp.array2d[float]
    deactivation_time_constant: wp.array2d[float]
    affected: Curve
    fatigue_rate: Curve
    recovery_rate: Curve
    rest_recovery_factor: Curve
    initial: Curve


@wp.struct
class MotorUnits:
    """State of all muscles; arrays (num_worlds, num_muscles).

    Attributes:
        active_fraction: M_A [1].
        resting_fraction: M_R = 1 - M_A - M_F [1].
        fatigued_fraction: M_F [1].
        rounding: What the sum M_F has rounded away [1].
    """

    active_fraction: wp.array2d[float]
    resting_fraction: wp.array2d[float]
    fatigued_fraction: wp.array2d[float]
    rounding: wp.array2d[float]


@wp.func
def motor_unit_flow(
    active: float,
    fatigued: float,
    target_load: float,
    rise: float,
    fall: float,
    tired: float,
    recovered: float,
) -> float:
    """Return c, what flows from rest to activity in a step.

    `rise` and `fall` are the shares of the way to the target load that a step goes; `tired` = F dt M_A,
    `recovered` = R' dt M_F.
    """
    resting = 1.0 - active - fatigued
    missing = target_load - active
    flow = wp.where(missing > 0.0, rise * wp.min(missing, resting), fall * missing)
    least = wp.max(tired - active, resting - 1.0 + recovered)
    most = wp.min(1.0 - active + tired, resting + recovered)
    return wp.clamp(flow, least, most)


@wp.kernel(enable_backward=False)
def tire_motor_units(
    # Params:
    params: MotorUnitParams,
    # In:
    clock: Clock,
    # Data out:
    ctrl_out: wp.array2d[float],
    # Out:
    state: MotorUnits,
):
    """One step of the compartments; ctrl = (1 - affected) TL + affected M_A."""
    worldid, muscleid = wp.tid()
    affected = value_of(params.affected, clock, worldid, muscleid)
    if affected == 0.0:
        return
    actuatorid = params.actuator_id[muscleid]
    target_load = ctrl_out[worldid, actuatorid]
    active = state.active_fraction[worldid, muscleid]
    fatigued = state.fatigued_fraction[worldid, muscleid]
    dt = clock.control_dt
    recovery_rate = value_of(params.recovery_rate, clock, worldid, muscleid)
    if target_load <= REST_LOAD:
        recovery_rate *= value_of(params.rest_recovery_factor, clock, worldid, muscleid)
    tired = value_of(params.fatigue_rate, clock, worldid, muscleid) * dt * active
    recovered = wp.min(recovery_rate * dt, 1.0) * fatigued

    scale = 0.5 + 1.5 * active
    rise = 1.0 - wp.exp(-dt / (of_world(params.activation_time_constant, worldid, muscleid) * scale))
    fall = 1.0 - wp.exp(-dt * scale / of_world(params.deactivation_time_constant, worldid, muscleid))
    active += motor_unit_flow(active, fatigued, target_load, rise, fall, tired, recovered) - tired
    total = add_compensated(fatigued, state.rounding[worldid, muscleid], tired - recovered)
    state.active_fraction[worldid, muscleid] = active
    state.fatigued_fraction[worldid, muscleid] = total[0]
    state.rounding[worldid, muscleid] = total[1]
    state.resting_fraction[worldid, muscleid] = 1.0 - active - total[0]
    ctrl_out[worldid, actuatorid] = (1.0 - affected) * target_load + affected * active


@wp.kernel(enable_backward=False)
def restart_motor_units(
    # Params:
    params: MotorUnitParams,
    initial_random: bool,
    carry_over: bool,
    # In:
    clock: Clock,
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    state: MotorUnits,
):
    """M_A = 0 and M_F = initial, or both drawn, or M_F as it is if it is finite and states carry over."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    draws = open_stream(keys, worldid, STREAM)
    keeps = carry_over and keys.episode[worldid] != 1
    for i in range(state.active_fraction.shape[1]):
        fresh = wp.randf(draws)
        share = wp.randf(draws)
        active = float(0.0)
        fatigued = state.fatigued_fraction[worldid, i]
        if not (keeps and wp.isfinite(fatigued)):
            fatigued = value_of(params.initial, clock, worldid, i)
            if initial_random:
                fatigued = 1.0 - fresh
                active = fresh * share
            state.rounding[worldid, i] = 0.0
        state.active_fraction[worldid, i] = active
        state.fatigued_fraction[worldid, i] = fatigued
        state.resting_fraction[worldid, i] = 1.0 - active - fatigued


class Fatigue3CCREffect(Effect):
    """3CC-r in a scene.

    Attributes:
        params: Parameters of the muscles.
        state: Their compartments.
    """

    def __init__(
        self, condition: Fatigue3CCR, scene: Scene, clock: Clock, parameters: Mapping[str, Parameter]
    ) -> None:
        self.scene, self.clock, self.parameters = scene, clock, parameters
        self.drawn = parameters.values()
        self.initial_random = bool(condition.initial_random)
        self.carry_over = bool(condition.carry_over)
        muscles = scene.muscles
        self.params = MotorUnitParams()
        self.params.actuator_id = wp.array(muscles.actuator_id, dtype=int)
        self.params.activation_time_constant = muscles.activation_time_constant
        self.params.deactivation_time_constant = muscles.deactivation_time_constant
        for name, parameter in parameters.items():
            setattr(self.params, name, parameter.curve)
        self.state = MotorUnits()
        for name in ("active_fraction", "resting_fraction", "fatigued_fraction", "rounding"):
            setattr(self.state, name, scene.zeros(f"condition.fatigue_3ccr.{name}", len(muscles.names)))
        self.info = {"fatigue": self.state.fatigued_fraction}
        if condition.observe:
            self.columns = (
                Column("fatigue", len(muscles.names), "1", "fatigued fraction of each muscle", muscles.names),
            )

    def reset(self, mask: wp.array) -> None:
        """Launch `restart_motor_units`."""
        launch(restart_motor_units, self.scene.num_worlds, self, self.scene, mask=mask)

    def act(self) -> None:
        """Launch `tire_motor_units`."""
        launch(tire_motor_units, self.state.active_fraction.shape, self, self.scene.data)

    def observe(self, mask: wp.array, obs: wp.array, column: int) -> None:
        """Write the fatigued fractions."""
        if self.columns:
            masked_observe(mask, self.state.fatigued_fraction, column, obs)


CONDITIONS.add("fatigue_3ccr", Fatigue3CCR)
