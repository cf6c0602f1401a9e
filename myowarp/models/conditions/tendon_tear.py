"""Tendon tear: from some time on, tendons pass on a part of their muscles' force, or nothing.

    F <- c F   from `time` on

Active and passive force alike; a torn muscle still activates. Source: Caggiano et al. (2022),
arXiv:2205.13600, which removes single muscles of the thumb (FPL, OP, EPB, APL) after training.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import warp as wp

from myowarp.definitions.body import BODIES
from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase
from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.parameter import SPANS, Clock, Curve, Parameter, Value, value_of
from myowarp.definitions.registry import check_choice

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec

ROUNDING = wp.constant(1.0 + 4.0e-7)
"""A tear at 0.2 s comes with the step that begins at 10 x 0.02 s, whichever is larger in float32, where their
ratio is off by 2e-7."""


@dataclass(frozen=True, eq=False)
class TendonTear(Condition):
    """Torn tendons.

    Attributes:
        muscles: Name or names of muscles; the side suffix `_r` may be left out. None: those that the body
            names (`Body.torn`), FPL in the hand.
        time: When they tear [s], >= 0: the first control step that does not begin before it.
        transmission: What is left of the force they pass on, 0..1; 1 is healthy.
        of: Whether `time` counts from the begin of the "episode", or of the "life", which goes on through
            resets.
    """

    PHASE = Phase.TRANSMISSION
    NEUTRAL: ClassVar = {"transmission": 1.0}
    TITLE = "torn tendon"
    LABELS: ClassVar = {"transmission": "force passed on"}

    muscles: str | Sequence[str] | None = None
    time: Value = 0.0
    transmission: Value = 0.0
    of: str = "episode"

    def __post_init__(self) -> None:
        """Check what does not depend on the body."""
        check_choice("tendon_tear time of", self.of, SPANS)
        if self.muscles is not None and not isinstance(self.muscles, Sequence):
            raise ValueError(f"tendon_tear muscles must be a name or several in a list, got {self.muscles!r}")
        if self.muscles is not None and not self.muscles:
            raise ValueError("tendon_tear needs at least one muscle, got none")

    @classmethod
    def neutral(cls, spec: TaskSpec) -> TendonTear:
        """Return one of all muscles."""
        return cls(BODIES[spec.body].muscle_names, transmission=1.0)

    def check(self, spec: TaskSpec) -> None:
        """Raise ValueError if the body lacks a muscle."""
        self.indices(spec.body, BODIES[spec.body].muscle_names)

    def indices(self, body: str, names: Sequence[str]) -> list[int]:
        """Return which of the muscles of a body, called `names`, tear.

        Raises:
            ValueError: A muscle is unknown, and the message lists the close names; or none is named.
        """
        muscles = BODIES[body].torn if self.muscles is None else self.muscles
        if not muscles:
            raise ValueError(f"tendon_tear needs the muscles that tear in body {body!r}, got none")
        muscles = [muscles] if isinstance(muscles, str) else muscles
        return list(dict.fromkeys(muscle_index(muscle, names) for muscle in muscles))

    def bind(self, scene: Scene, clock: Clock) -> TendonTearEffect:
        """Put times and transmissions on the device."""
        indices = self.indices(scene.spec.body, scene.muscles.names)
        torn = [scene.muscles.names[i] for i in indices]

        def parameter(field: str, neutral: float, high: float) -> Parameter:
            name = f"tendon_tear {field} of {', '.join(torn)}"
            value = getattr(self, field)
            return Parameter(name, value, scene, torn, neutral=neutral, low=0.0, high=high)

        parameters = parameter("time", 0.0, float("inf")), parameter("transmission", 1.0, 1.0)
        return TendonTearEffect(scene, clock, indices, *parameters, lifelong=self.of == "life")


@wp.struct
class Tear:
    """Torn muscles, with time and extent.

    Attributes:
        muscles: Muscles, shape (num_torn,).
        time: When [s].
        transmission: Factor on their force from then on [1].
        lifelong: Whether time counts from the seeded reset rather than from the episode's begin.
    """

    muscles: wp.array[int]
    time: Curve
    transmission: Curve
    lifelong: bool


@wp.kernel(enable_backward=False)
def tear_tendons(
    # Params:
    tear: Tear,
    # In:
    clock: Clock,
    # Out:
    transmission: wp.array2d[float],
):
    """transmission[muscle] *= c from its time on."""
    worldid, i = wp.tid()
    steps = wp.where(tear.lifelong, clock.life_count[worldid], clock.step_count[worldid])
    if float(steps) * ROUNDING >= value_of(tear.time, clock, worldid, i) / clock.control_dt:
        transmission[worldid, tear.muscles[i]] *= value_of(tear.transmission, clock, worldid, i)


class TendonTearEffect(Effect):
    """A tendon tear in a scene."""

    def __init__(
        self,
        scene: Scene,
        clock: Clock,
        indices: Sequence[int],
        time: Parameter,
        transmission: Parameter,
        *,
        lifelong: bool,
    ) -> None:
        self.scene, self.clock, self.drawn = scene, clock, (time, transmission)
        self.tear = Tear()
        self.tear.muscles = wp.array(indices, dtype=int)
        self.tear.time, self.tear.transmission = time.curve, transmission.curve
        self.tear.lifelong = lifelong

    def act(self) -> None:
        """Launch `tear_tendons`."""
        transmission = self.scene.muscles.anatomy.transmission
        wp.launch(
            tear_tendons,
            dim=(self.scene.num_worlds, self.tear.muscles.shape[0]),
            inputs=[self.tear, self.clock],
            outputs=[transmission],
        )


CONDITIONS.add("tendon_tear", TendonTear)
