"""Fatigue that takes peak force: the model of Ma et al. (2009), whose equation the MyoSuite paper uses.

    F_upd = F_max exp(-s),    ds/dt = k F_act / F_max,    F_act = F_upd a f_L f_V

The active force is that of the tired muscle, F_act, so that with c = a f_L f_V the solution is closed:

    F_upd(t) = F_max / (1 + k int_0^t c dt)

The muscles integrate c in every physics step (`MuscleModel.workload`), this effect takes the integral over
once per control step. There is no recovery; excitation and passive force stay.

Sources: Caggiano et al. (2022), arXiv:2205.13600, where k = 1 without a unit; Ma, Chablat, Bennis, Zhang
(2009), doi:10.1016/j.ergon.2008.04.004, where k is in 1/min. The default is 1/min. The paper's grid has 1/s
(`rate=60`, see `tasks/paper.py`), with which a fully active muscle loses half of its force in one second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import warp as wp

from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.definitions.task import Column
from myowarp.kernels.accumulate import add_compensated
from myowarp.kernels.launch import launch
from myowarp.kernels.observe import masked_observe
from myowarp.kernels.random import RandomKeys

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

MINUTE = wp.constant(60.0)  # s
LARGEST_START = 0.99  # a muscle that starts with no force at all would be a torn one


@dataclass(frozen=True, eq=False)
class FatigueMa2009(Condition):
    """Muscles that lose peak force with the active force that they produce, and do not recover.

    `info["fatigue"]` (num_worlds, num_muscles) is the share of the peak force that was lost when the last
    control step began.

    Attributes:
        rate: k, how fast force is lost [1/min], >= 0.
        initial: Share of the peak force that is lost at the start, 0..0.99.
        carry_over: Whether fatigue goes on through resets, until the world is seeded anew; where episodes
            start from the last one's end (`reset="none"`) it always does.
        observe: Whether the observation shows it, in columns `fatigue`.
    """

    PHASE = Phase.STRENGTH
    WRITES = ("fatigue",)
    NEUTRAL: ClassVar = {"rate": 0.0}
    AT_START = ("initial",)
    TITLE = "fatigue (Ma 2009)"
    LABELS: ClassVar = {"rate": "tiring rate", "initial": "tired at start"}

    rate: Value = 1.0
    initial: Value = 0.0
    carry_over: bool = False
    observe: bool = False

    def bind(self, scene: Scene, clock: Clock) -> FatigueMa2009Effect:
        """Put rates and initial fatigue on the device."""
        names = self.muscle_names(scene)
        scene.muscles.record_workload()
        rate = Parameter("fatigue_ma2009 rate", self.rate, scene, names, neutral=0.0, low=0.0)
        initial = Parameter(
            "fatigue_ma2009 initial", self.initial, scene, names, neutral=0.0, low=0.0, high=LARGEST_START
        )
        return FatigueMa2009Effect(self, scene, clock, rate, initial)


@wp.struct
class Exhaustion:
    """State of all muscles; arrays (num_worlds, num_muscles).

    Attributes:
        exhaustion: k int c dt, from its value at the start on [1].
        rounding: What its sum has rounded away [1].
        fatigue: Share of the peak force that is lost [1].
    """

    exhaustion: wp.array2d[float]
    rounding: wp.array2d[float]
    fatigue: wp.array2d[float]


@wp.func
def force_left(exhaustion: float) -> float:
    """Return F_upd / F_max."""
    return 1.0 / (1.0 + exhaustion)


@wp.kernel(enable_backward=False)
def exhaust(
    # Params:
    rate_curve: Curve,
    # In:
    clock: Clock,
    # Out:
    state: Exhaustion,
    workload: wp.array2d[float],
    strength: wp.array2d[float],
):
    """exhaustion += k workload, strength *= 1 / (1 + exhaustion); the workload starts anew."""
    worldid, muscleid = wp.tid()
    term = value_of(rate_curve, clock, worldid, muscleid) / MINUTE * workload[worldid, muscleid]
    workload[worldid, muscleid] = 0.0
    total = add_compensated(state.exhaustion[worldid, muscleid], state.rounding[worldid, muscleid], term)
    left = force_left(total[0])
    state.exhaustion[worldid, muscleid] = total[0]
    state.rounding[worldid, muscleid] = total[1]
    state.fatigue[worldid, muscleid] = total[0] * left
    strength[worldid, muscleid] *= left


@wp.kernel(enable_backward=False)
def restart_exhaustion(
    # Params:
    initial_curve: Curve,
    carry_over: bool,
    # In:
    clock: Clock,
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    state: Exhaustion,
    workload: wp.array2d[float],
):
    """exhaustion = f / (1 - f), f the initial fatigue; only what is not finite if states carry over."""
    worldid, muscleid = wp.tid()
    if not mask[worldid]:
        return
    keeps = carry_over and keys.episode[worldid] != 1
    if not (keeps and wp.isfinite(workload[worldid, muscleid])):
        workload[worldid, muscleid] = 0.0
    if not (keeps and wp.isfinite(state.exhaustion[worldid, muscleid])):
        lost = value_of(initial_curve, clock, worldid, muscleid)
        state.exhaustion[worldid, muscleid] = lost / (1.0 - lost)
        state.rounding[worldid, muscleid] = 0.0
        state.fatigue[worldid, muscleid] = lost


class FatigueMa2009Effect(Effect):
    """Fatigue after Ma et al. in a scene.

    Attributes:
        state: What the muscles have gone through.
    """

    def __init__(
        self, condition: FatigueMa2009, scene: Scene, clock: Clock, rate: Parameter, initial: Parameter
    ) -> None:
        self.scene, self.clock, self.rate, self.initial = scene, clock, rate, initial
        self.drawn = rate, initial
        self.carry_over = bool(condition.carry_over)
        muscles = scene.muscles
        self.state = Exhaustion()
        for name in ("exhaustion", "rounding", "fatigue"):
            setattr(self.state, name, scene.zeros(f"condition.fatigue_ma2009.{name}", len(muscles.names)))
        scene.adopt("condition.fatigue_ma2009", muscles, ("workload",))
        self.info = {"fatigue": self.state.fatigue}
        if condition.observe:
            self.columns = (
                Column(
                    "fatigue",
                    len(muscles.names),
                    "1",
                    "share of the peak force that each muscle has lost",
                    muscles.names,
                ),
            )

    def reset(self, mask: wp.array) -> None:
        """Launch `restart_exhaustion`."""
        scene, initial = self.scene, self.initial.curve
        dim = scene.muscles.workload.shape
        launch(restart_exhaustion, dim, self, scene, scene.muscles, initial_curve=initial, mask=mask)

    def act(self) -> None:
        """Launch `exhaust`."""
        muscles = self.scene.muscles
        launch(exhaust, muscles.workload.shape, self, muscles, muscles.anatomy, rate_curve=self.rate.curve)

    def observe(self, mask: wp.array, obs: wp.array, column: int) -> None:
        """Write the share of the peak force that is lost."""
        if self.columns:
            masked_observe(mask, self.state.fatigue, column, obs)


CONDITIONS.add("fatigue_ma2009", FatigueMa2009)
