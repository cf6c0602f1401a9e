"""Stretch reflex: a muscle is excited by the speed at which its path grows longer.

    u <- clip(u + gain max(v(t - delay), 0) / (l_0 v_max), 0, 1)

in every physics step, with the velocity v of the musculotendon path, its optimal fiber length l_0 and maximum
contraction velocity v_max; u is the command for the muscle, noise and fatigue included. A high gain is
spasticity. Sources: OpenSim 4.6, class ToyReflexController, which has no delay, adds up without a bound, and
sees the speed of the same moment rather than of a physics step before; van der Krogt et al. (2016),
doi:10.1186/s12984-016-0170-5, for reflexes on velocity in spastic muscles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import warp as wp

from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.kernels.batching import of_world
from myowarp.kernels.launch import launch
from myowarp.kernels.reset import masked_fill
from myowarp.kernels.write import is_finite

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

LONGEST_DELAY = 0.5  # s


@dataclass(frozen=True, eq=False)
class StretchReflex(Condition):
    """Muscles that resist being stretched fast.

    Attributes:
        gain: Excitation at the maximum contraction velocity [1], >= 0; 0 is no reflex.
        delay: From stretch to excitation [s], 0 to 0.5; the nearest number of physics steps, at least one.
    """

    PHASE = Phase.ROUTING
    WRITES = ("stretch reflexes",)
    NEUTRAL: ClassVar = {"gain": 0.0}
    TITLE = "stretch reflex (spasticity)"
    LABELS: ClassVar = {"gain": "reflex gain"}

    gain: Value = 1.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check what is the same in all worlds."""
        number = isinstance(self.delay, (int, float)) and not isinstance(self.delay, bool)
        if not (number and is_finite(np.array(self.delay)) and 0.0 <= self.delay <= LONGEST_DELAY):
            raise ValueError(
                f"stretch_reflex delay must be a time from 0 to {LONGEST_DELAY:g} s, got {self.delay!r}"
            )

    def bind(self, scene: Scene, clock: Clock) -> StretchReflexEffect:
        """Put gains on the device.

        Raises:
            ValueError: Nothing is known of the muscles' fibers.
        """
        names = self.muscle_names(scene)
        gain = Parameter("stretch_reflex gain", self.gain, scene, names, neutral=0.0, low=0.0, usual=2.0)
        return StretchReflexEffect(scene, clock, gain, float(self.delay))


@wp.struct
class Stretches:
    """Stretches that are still to excite muscles.

    Attributes:
        drive: Command for each muscle without the reflex [1], shape (num_worlds, num_muscles).
        pending: Relative speeds of the last steps, in a ring, shape (num_worlds, steps, num_muscles).
        place: Where the oldest of them is, which is due, shape (num_worlds, num_muscles).
    """

    drive: wp.array2d[float]
    pending: wp.array3d[float]
    place: wp.array2d[int]


@wp.func
def with_reflex(drive: float, gain: float, stretch: float) -> float:
    """Return clip(u + gain stretch, 0, 1); the command itself where there is no stretch."""
    if gain * stretch > 0.0:
        return wp.clamp(drive + gain * stretch, 0.0, 1.0)
    return drive


@wp.kernel(enable_backward=False)
def begin_reflexes(
    # Params:
    actuator_id: wp.array[int],
    curve: Curve,
    # In:
    clock: Clock,
    # Data out:
    ctrl_out: wp.array2d[float],
    # Out:
    stretches: Stretches,
):
    """drive = ctrl; ctrl = drive with the reflex to the stretch that is due."""
    worldid, muscleid = wp.tid()
    drive = ctrl_out[worldid, actuator_id[muscleid]]
    due = stretches.pending[worldid, stretches.place[worldid, muscleid], muscleid]
    gain = value_of(curve, clock, worldid, muscleid)
    stretches.drive[worldid, muscleid] = drive
    ctrl_out[worldid, actuator_id[muscleid]] = with_reflex(drive, gain, due)


@wp.kernel(enable_backward=False)
def stretch_muscles(
    # Params:
    actuator_id: wp.array[int],
    fastest: wp.array2d[float],
    curve: Curve,
    # In:
    velocity: wp.array2d[float],
    clock: Clock,
    # Data out:
    ctrl_out: wp.array2d[float],
    # Out:
    stretches: Stretches,
):
    """Remember max(v, 0) / (l_0 v_max); ctrl of the next physics step = drive with the reflex that is due."""
    worldid, muscleid = wp.tid()
    place = stretches.place[worldid, muscleid]
    speed = velocity[worldid, muscleid] / of_world(fastest, worldid, muscleid)
    stretches.pending[worldid, place, muscleid] = wp.max(speed, 0.0)
    place = (place + 1) % stretches.pending.shape[1]
    stretches.place[worldid, muscleid] = place
    gain, due = value_of(curve, clock, worldid, muscleid), stretches.pending[worldid, place, muscleid]
    ctrl_out[worldid, actuator_id[muscleid]] = with_reflex(stretches.drive[worldid, muscleid], gain, due)


class StretchReflexEffect(Effect):
    """Stretch reflexes in a scene."""

    def __init__(self, scene: Scene, clock: Clock, gain: Parameter, delay: float) -> None:
        self.scene, self.clock, self.gain, self.drawn = scene, clock, gain, (gain,)
        self.curve = gain.curve
        muscles = scene.muscles
        geometry, number = muscles.geometry(), len(muscles.names)
        fastest = np.atleast_2d(geometry.optimal_fiber_length * geometry.max_contraction_velocity)
        if not (fastest > 0.0).all():
            raise ValueError(
                "stretch_reflex needs the optimal fiber length and maximum contraction velocity of all "
                f"muscles, which {type(muscles).__name__} does not know"
            )
        rows = 1 if (fastest == fastest[0]).all() else None  # worlds that are alike share one
        self.fastest = wp.array(fastest[:rows], dtype=float)
        self.actuator_id = wp.array(muscles.actuator_id, dtype=int)
        steps = max(1, round(delay * scene.num_substeps / scene.control_dt))
        stretches = self.stretches = Stretches()
        owner = "condition.stretch_reflex"
        stretches.drive = scene.zeros(f"{owner}.drive", number)
        stretches.pending = scene.zeros(f"{owner}.pending", steps, number)
        stretches.place = scene.zeros(f"{owner}.place", number, dtype=int)

    def reset(self, mask: wp.array) -> None:
        """Nothing was stretched."""
        masked_fill(mask, self.stretches.pending, 0.0)

    def act(self) -> None:
        """Launch `begin_reflexes`."""
        launch(begin_reflexes, self.stretches.drive.shape, self, self.scene.data)

    def act_in_substep(self) -> None:
        """Launch `stretch_muscles`."""
        muscles = self.scene.muscles
        launch(stretch_muscles, self.stretches.drive.shape, self, self.scene.data, velocity=muscles.velocity)


CONDITIONS.add("stretch_reflex", StretchReflex)
