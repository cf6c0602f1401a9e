"""Motor noise: excitations scatter, the more the stronger they are.

    u <- clip(u + s u n1 + c n2, 0, 1),   n1, n2 ~ N(0, 1) for every muscle and control step

The numbers depend on a world's seed, episode and step and on the muscle, on nothing else. Source: MyoSuite
3.0.0, its optional motor noise, whose preset is the default here.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import warp as wp

from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.parameter import Clock, Curve, Parameter, Value, value_of
from myowarp.kernels.random import RandomKeys, normal_pair, open_step_stream

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

STREAM = wp.constant(zlib.crc32(b"motor_noise") & 0x7FFFFFFF)


@dataclass(frozen=True, eq=False)
class MotorNoise(Condition):
    """Noisy excitations of muscles; motors are exact.

    Attributes:
        signal: Standard deviation per unit of excitation [1], >= 0.
        constant: Standard deviation at no excitation [1], >= 0.
    """

    PHASE = Phase.NOISE
    WRITES = ("motor noise",)
    NEUTRAL: ClassVar = {"signal": 0.0, "constant": 0.0}
    TITLE = "noise of the motor command"
    LABELS: ClassVar = {"signal": "noise of effort", "constant": "noise at rest"}

    signal: Value = 0.103
    constant: Value = 0.185

    def bind(self, scene: Scene, clock: Clock) -> MotorNoiseEffect:
        """Put the standard deviations on the device."""

        def parameter(field: str) -> Parameter:
            value, names, whole = getattr(self, field), self.muscle_names(scene), "full excitation"
            return Parameter(f"motor_noise {field}", value, scene, names, neutral=0.0, low=0.0, whole=whole)

        return MotorNoiseEffect(scene, clock, parameter("signal"), parameter("constant"))


@wp.func
def noisy_excitation(excitation: float, signal: float, constant: float, noise: wp.vec2) -> float:
    """Return clip(u + s u n1 + c n2, 0, 1)."""
    return wp.clamp(excitation + signal * excitation * noise[0] + constant * noise[1], 0.0, 1.0)


@wp.kernel(enable_backward=False)
def add_motor_noise(
    # Params:
    actuator_id: wp.array[int],
    signal_curve: Curve,
    constant_curve: Curve,
    # In:
    keys: RandomKeys,
    clock: Clock,
    # Data out:
    ctrl_out: wp.array2d[float],
):
    """u <- clip(u + s u n1 + c n2, 0, 1)."""
    worldid, muscleid = wp.tid()
    actuatorid = actuator_id[muscleid]
    step = open_step_stream(keys, worldid, STREAM, clock.step_count[worldid])
    ctrl_out[worldid, actuatorid] = noisy_excitation(
        ctrl_out[worldid, actuatorid],
        value_of(signal_curve, clock, worldid, muscleid),
        value_of(constant_curve, clock, worldid, muscleid),
        normal_pair(wp.rand_init(wp.int32(step), muscleid)),
    )


class MotorNoiseEffect(Effect):
    """Motor noise in a scene."""

    def __init__(self, scene: Scene, clock: Clock, signal: Parameter, constant: Parameter) -> None:
        self.scene, self.clock = scene, clock
        self.signal, self.constant = self.drawn = signal, constant
        self.actuator_id = wp.array(scene.muscles.actuator_id, dtype=int)

    def act(self) -> None:
        """Launch `add_motor_noise`."""
        scene = self.scene
        wp.launch(
            add_motor_noise,
            dim=scene.muscles.activation.shape,
            inputs=[self.actuator_id, self.signal.curve, self.constant.curve, scene.keys, self.clock],
            outputs=[scene.data.ctrl],
        )


CONDITIONS.add("motor_noise", MotorNoise)
