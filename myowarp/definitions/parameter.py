"""Parameters of conditions: one number, one per world, drawn at random, or changing over time.

    value(t) = (1 - s) start + s end,    s = clip((t - onset) / duration, 0, 1)

with t the time of the episode or of the whole life of the world, which begins with a seeded reset. Before and
after the change the value is exactly start and end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import warp as wp

from myowarp.definitions.muscle import muscle_index
from myowarp.definitions.registry import check_choice
from myowarp.kernels.random import RandomKeys, open_stream, stream_of
from myowarp.kernels.write import is_finite, write

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

SPANS = ("episode", "life")


@dataclass(frozen=True)
class Uniform:
    """A number drawn from U(low, high).

    Attributes:
        low: Lower bound.
        high: Upper bound.
        per: "episode" draws anew in every episode, "life" once for every seeded reset.
        each: Whether every muscle draws its own number, or all of a world share one.
    """

    low: float
    high: float
    per: str = "episode"
    each: bool = False


@dataclass(frozen=True)
class Ramp:
    """A number that changes from `start` to `end`.

    Attributes:
        start: Before the onset: a number, one per world, or a `Uniform`.
        end: After the change, of the same kinds.
        onset: When the change begins [s].
        duration: How long it takes [s]; 0 is a step.
        of: Time since the begin of the "episode", or of the "life", which goes on through resets.
    """

    start: Fixed | Uniform
    end: Fixed | Uniform
    onset: float = 0.0
    duration: float = 0.0
    of: str = "episode"


Fixed = float | Sequence[float] | npt.NDArray[np.floating] | Mapping[str, float]
"""A number; one per world (num_worlds,); one per world and muscle (num_worlds, num_muscles); or by muscle
name, the muscles that are not named keeping the neutral value."""

Value = Fixed | Uniform | Ramp


@wp.struct
class Clock:
    """Time of every world; arrays (num_worlds,).

    Attributes:
        step_count: Control steps since the episode began.
        life_count: Control steps since the world was seeded.
        control_dt: Duration of a control step [s].
    """

    step_count: wp.array[int]
    life_count: wp.array[int]
    control_dt: float


@wp.struct
class Curve:
    """A parameter on the device.

    Attributes:
        start: Value before the onset, shape (1 or num_worlds, 1 or num_muscles).
        end: Value after the change, of the same shape.
        onset: When the change begins [control steps]; in seconds, the step at 10 x 0.02 s could come before
            0.2 s in float32.
        duration: How long it takes [control steps].
        lifelong: Whether time counts from the seeded reset rather than from the episode's begin.
    """

    start: wp.array2d[float]
    end: wp.array2d[float]
    onset: float
    duration: float
    lifelong: bool


@wp.func
def value_of(curve: Curve, clock: Clock, worldid: int, i: int) -> float:
    """Return the value of entry i in a world now."""
    row, column = worldid % curve.start.shape[0], i % curve.start.shape[1]
    steps = wp.where(curve.lifelong, clock.life_count[worldid], clock.step_count[worldid])
    elapsed = float(steps) - curve.onset
    share = wp.where(elapsed >= 0.0, 1.0, 0.0)
    if curve.duration > 0.0:
        share = wp.clamp(elapsed / curve.duration, 0.0, 1.0)
    return (1.0 - share) * curve.start[row, column] + share * curve.end[row, column]


@wp.kernel(enable_backward=False)
def draw_uniform(
    # Params:
    low: float,
    high: float,
    lifelong: bool,
    stream: int,
    # In:
    keys: RandomKeys,
    mask: wp.array[bool],
    # Out:
    values: wp.array2d[float],
):
    """values ~ U(low, high) in the worlds of the mask; lifelong ones in the first episode only."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    if lifelong and keys.episode[worldid] != 1:
        return
    state = open_stream(keys, worldid, stream)
    for i in range(values.shape[1]):
        values[worldid, i] = wp.randf(state, low, high)


class Parameter:
    """A parameter bound to worlds and muscles.

    Attributes:
        curve: What kernels read through `value_of`.
        usual: Greatest value that a slider offers; None: it follows from the bounds.
    """

    def __init__(
        self,
        name: str,
        value: Value,
        scene: Scene,
        names: Sequence[str],
        *,
        neutral: float,
        low: float = -np.inf,
        high: float = np.inf,
        usual: float | None = None,
    ) -> None:
        """Check a value and put it on the current Warp device.

        Args:
            name: Name for messages and for the random stream, such as "sarcopenia strength".
            value: The value.
            scene: Where it lives; a value with one entry per world is one for all parts of its worlds.
            names: Names of the muscles that the parameter's columns stand for; () for one number a world.
            neutral: Value of muscles that a mapping does not name.
            low: Least value allowed.
            high: Greatest value allowed.
            usual: Greatest value that a slider offers.

        Raises:
            ValueError: The value has a wrong shape, is out of its range, or names an unknown muscle.
        """
        self.name, self.worlds, self.names = name, scene.worlds, tuple(names)
        self.neutral, self.bounds, self.usual = neutral, (low, high), usual
        self.draws: list[tuple[Uniform, wp.array, int]] = []
        self.curve = Curve()
        ends = (value,) if not isinstance(value, Ramp) else (value.start, value.end)
        if isinstance(value, Ramp):
            check_choice(f"{name} ramp of", value.of, SPANS)
            self.curve.onset = self._finite("onset", value.onset) / scene.control_dt
            self.curve.duration = self._finite("duration", value.duration) / scene.control_dt
            self.curve.lifelong = value.of == "life"
        numbers = [self._before_draws(end) if isinstance(end, Uniform) else self._fixed(end) for end in ends]
        shape = np.broadcast_shapes(*(array.shape for array in numbers))  # both ends of a ramp have one
        if self.worlds.adjustable and not any(isinstance(end, Uniform) for end in ends):
            shape = (self.worlds.number, max(len(self.names), 1))
        arrays = []
        for number, (end, array) in enumerate(zip(ends, numbers, strict=True)):
            if isinstance(end, Uniform):
                values = scene.zeros(f"condition.{name.replace(' ', '.')}.{len(self.draws)}", shape[1])
                self.draws.append((end, values, stream_of(f"{name} {number}")))
            else:
                values = wp.array(np.broadcast_to(array, shape).copy(), dtype=float)
            arrays.append(values)
        self.curve.start, self.curve.end = arrays[0], arrays[-1]
        scene.parameters.append(self)

    def _finite(self, what: str, number: float) -> float:
        """Return a duration, checked."""
        if not (isinstance(number, (int, float)) and number >= 0.0 and is_finite(number)):
            raise ValueError(f"{self.name} {what} must be a finite time >= 0 s, got {number!r}")
        return float(number)

    def _fixed(self, value: Fixed) -> np.ndarray:
        """Return what is not drawn, shape (1 or num_worlds, 1 or num_muscles)."""
        numbers = self._by_name(value) if isinstance(value, Mapping) and self.names else self._numbers(value)
        self._check_range(numbers)
        return numbers if len(numbers) == 1 else numbers[self.worlds.given]

    def _before_draws(self, value: Uniform) -> np.ndarray:
        """Return zeros, shape (num_worlds, 1 or num_muscles), where `sample` is to fill in what is drawn."""
        check_choice(f"{self.name} drawn per", value.per, SPANS)
        limits = self._numbers([value.low, value.high], worlds=2)
        self._check_range(limits)
        if value.low > value.high:
            raise ValueError(f"{self.name} must be drawn with low <= high, got {value.low} and {value.high}")
        return np.zeros((self.worlds.number, max(len(self.names), 1) if value.each else 1))

    def _numbers(self, value: object, worlds: int | None = None) -> np.ndarray:
        """Return numbers as (1 or num_worlds, 1 or num_muscles)."""
        worlds = self.worlds.everywhere if worlds is None else worlds
        try:
            numbers = np.asarray("none" if value is None else value, dtype=np.float64)  # NumPy makes it nan
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{self.name} must be numbers, got {value!r}") from None
        columns = len(self.names)
        if numbers.ndim == 0:
            return numbers.reshape(1, 1)
        if numbers.shape == (worlds,):
            return numbers.reshape(worlds, 1)
        if columns and numbers.shape == (worlds, columns):
            return numbers
        shapes = f"({worlds},)" + (f" or ({worlds}, {columns})" if columns else "")
        raise ValueError(f"{self.name} must be one number or of shape {shapes}, got shape {numbers.shape}")

    def _by_name(self, value: Mapping[str, float]) -> np.ndarray:
        """Return numbers by muscle name as (1, num_muscles)."""
        numbers = np.full((1, len(self.names)), self.neutral)
        for muscle, number in value.items():
            index = muscle_index(muscle, self.names)
            if np.ndim(number):
                raise ValueError(f"{self.name} of muscle {muscle!r} must be one number, got {number!r}")
            numbers[0, index] = self._numbers(number)[0, 0]
        return numbers

    def _check_range(self, numbers: np.ndarray) -> None:
        """Raise if a number is out of range."""
        low, high = self.bounds
        wrong = numbers[~((numbers >= low) & (numbers <= high) & is_finite(numbers))]
        if wrong.size:
            finite = "finite in float32" if np.isfinite(wrong[0]) else "finite"
            span = f"in {low:g}..{high:g}" if high < np.inf else finite
            if high == np.inf and low > -np.inf:
                span = f">= {low:g}" if wrong[0] < low else f"{finite} and >= {low:g}"
            raise ValueError(f"{self.name} must be {span}, got {wrong[0]:g}")

    def values(self, world: int) -> np.ndarray:
        """Return what a world has now, before its change over time, shape (1 or num_muscles,)."""
        values = self.curve.start.numpy()
        return values[world % len(values)]

    def set(self, numbers: npt.ArrayLike, worlds: Sequence[int], columns: Sequence[int]) -> None:
        """Change numbers of worlds that are `adjustable`; from the next step on they have them.

        Args:
            numbers: New numbers, one or as many as columns.
            worlds: Which worlds.
            columns: Which muscles; of a number that is one for the whole world, 0.

        Raises:
            ValueError: A number is out of its range; nothing was changed.
        """
        numbers = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
        self._check_range(numbers)
        for array in {array.ptr: array for array in (self.curve.start, self.curve.end)}.values():
            values = array.numpy()
            chosen = columns if values.shape[1] > 1 else [0]
            values[np.ix_(worlds, chosen)] = numbers if len(numbers) == len(chosen) else numbers[0]
            write(array, values)

    def sample(self, keys: RandomKeys, mask: wp.array) -> None:
        """Draw in the worlds of `mask` (num_worlds,) bool."""
        for uniform, values, stream in self.draws:
            low, high, lifelong = float(uniform.low), float(uniform.high), uniform.per == "life"
            wp.launch(
                draw_uniform,
                dim=self.worlds.number,
                inputs=[low, high, lifelong, stream, keys, mask],
                outputs=[values],
            )
