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
from myowarp.kernels.launch import launch
from myowarp.kernels.random import RandomKeys, open_stream, stream_of
from myowarp.kernels.write import is_finite, write
from myowarp.process import warn_once

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene

SPANS = ("episode", "life")
MOST = 4.0
"""Largest share that is no slip of percent: the strongest brace of `reproduce cohort-exo`."""


def say_percent(what: str, factor: float) -> None:
    """Say that a factor is beyond `MOST`, as one in percent is."""
    if factor > MOST:
        share = f"for {factor:g} % write {factor / 100.0:g}"
        warn_once(f"{what} of {factor:g} is {factor:g} times the model's; {share}")


@dataclass(frozen=True)
class Uniform:
    """A number drawn from U(low, high).

    Attributes:
        low: Lower bound; a number, or one per world.
        high: Upper bound, of the same kinds.
        per: "episode" draws anew in every episode, "life" once for every seeded reset.
        each: Whether every muscle draws its own number, or all of a world share one.
    """

    low: float | Sequence[float] | npt.NDArray[np.floating]
    high: float | Sequence[float] | npt.NDArray[np.floating]
    per: str = "episode"
    each: bool = False


@dataclass(frozen=True)
class Ramp:
    """A number that changes from `start` to `end`.

    Attributes:
        start: Before the onset: a number, one per world, or a `Uniform`.
        end: After the change, of the same kinds.
        onset: When the change begins [s], of the same kinds; one time for all muscles.
        duration: How long it takes [s]; 0 is a step.
        of: Time since the begin of the "episode", or of the "life", which goes on through resets.
    """

    start: Fixed | Uniform
    end: Fixed | Uniform
    onset: float | Sequence[float] | npt.NDArray[np.floating] | Uniform = 0.0
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
        onset: When the change begins [control steps], shape (1 or num_worlds, 1); in seconds, the step at
            10 x 0.02 s could come before 0.2 s in float32.
        duration: How long it takes [control steps].
        lifelong: Whether time counts from the seeded reset rather than from the episode's begin.
    """

    start: wp.array2d[float]
    end: wp.array2d[float]
    onset: wp.array2d[float]
    duration: float
    lifelong: bool


@wp.func
def value_of(curve: Curve, clock: Clock, worldid: int, i: int) -> float:
    """Return the value of entry i in a world now."""
    row, column = worldid % curve.start.shape[0], i % curve.start.shape[1]
    steps = wp.where(curve.lifelong, clock.life_count[worldid], clock.step_count[worldid])
    elapsed = float(steps) - curve.onset[worldid % curve.onset.shape[0], 0]
    share = wp.where(elapsed >= 0.0, 1.0, 0.0)
    if curve.duration > 0.0:
        share = wp.clamp(elapsed / curve.duration, 0.0, 1.0)
    return (1.0 - share) * curve.start[row, column] + share * curve.end[row, column]


@wp.kernel(enable_backward=False)
def draw_uniform(
    # Params:
    lifelong: bool,
    stream: int,
    # In:
    low: wp.array2d[float],
    high: wp.array2d[float],
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
    row = worldid % low.shape[0]
    for i in range(values.shape[1]):
        values[worldid, i] = wp.randf(state, low[row, 0], high[row, 0])


@dataclass(frozen=True)
class Drawn:
    """A draw of a parameter; bounds have one row for all worlds where they agree.

    Attributes:
        low: Lower bounds, shape (1 or num_worlds, 1).
        high: Upper bounds, of the same shape.
        lifelong: Whether it stays until a world is seeded again.
        values: What was drawn, shape (num_worlds, 1 or num_muscles).
        stream: Of random numbers.
    """

    low: wp.array
    high: wp.array
    lifelong: bool
    values: wp.array
    stream: int


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
        whole: str = "",
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
            whole: Of a share: what 1 is, such as "the healthy one"; more than `MOST` of it is refused.

        Raises:
            ValueError: The value has a wrong shape, is out of its range, or names an unknown muscle.
        """
        self.name, self.worlds, self.names = name, scene.worlds, tuple(names)
        self.neutral, self.bounds, self.usual, self.whole = neutral, (low, high), usual, whole
        self.draws: list[Drawn] = []
        self.curve = Curve()
        ramp = value if isinstance(value, Ramp) else Ramp(value, value)
        check_choice(f"{name} ramp of", ramp.of, SPANS)
        if np.ndim(ramp.duration):
            raise ValueError(f"{name} duration must be one time for all worlds, got {ramp.duration!r}")
        self.curve.duration = float(self._times("duration", ramp.duration)[0, 0]) / scene.control_dt
        self.curve.lifelong = ramp.of == "life"
        ends = (ramp.start, ramp.end) if isinstance(value, Ramp) else (value,)
        shape = np.broadcast_shapes(*(self._shape(end) for end in ends))  # both ends of a ramp have one
        if self.worlds.adjustable and not any(isinstance(end, Uniform) for end in ends):
            shape = (self.worlds.number, max(len(self.names), 1))
        arrays = [self._array(end, shape, scene, number) for number, end in enumerate(ends)]
        self.curve.start, self.curve.end = arrays[0], arrays[-1]
        self.curve.onset = self._onset(ramp.onset, scene)
        scene.parameters.append(self)

    def _shape(self, value: Fixed | Uniform) -> tuple[int, ...]:
        """Return the shape of a value on the device: (1 or num_worlds, 1 or num_muscles)."""
        if isinstance(value, Uniform):
            return self.worlds.number, max(len(self.names), 1) if value.each else 1
        return self._fixed(value).shape

    def _array(self, value: Fixed | Uniform, shape: tuple[int, ...], scene: Scene, number: int) -> wp.array:
        """Return a value on the device; what is drawn is zero until `sample` fills it in."""
        if isinstance(value, Uniform):
            return self._drawn(value, *self._bounds(value), shape[1], scene, number)
        return wp.array(np.broadcast_to(self._fixed(value), shape).copy(), dtype=float)

    def _onset(self, value: object, scene: Scene) -> wp.array:
        """Return when the change begins [control steps], shape (1 or num_worlds, 1)."""
        if not isinstance(value, Uniform):
            return wp.array(self._own(self._times("onset", value)) / scene.control_dt, dtype=float)
        low, high = (self._own(self._times("onset", bound)) for bound in (value.low, value.high))
        self._check_order("onset ", low, high)
        return self._drawn(value, low / scene.control_dt, high / scene.control_dt, 1, scene, 2)

    def _drawn(
        self, value: Uniform, low: np.ndarray, high: np.ndarray, columns: int, scene: Scene, number: int
    ) -> wp.array:
        """Return an array (num_worlds, columns) that `sample` fills in, between bounds."""
        check_choice(f"{self.name} drawn per", value.per, SPANS)
        low, high = np.broadcast_arrays(low, high)
        least, most = (wp.array(limit.copy(), dtype=float) for limit in (low, high))
        values = scene.zeros(f"condition.{self.name.replace(' ', '.')}.{len(self.draws)}", columns)
        self.draws.append(Drawn(least, most, value.per == "life", values, stream_of(f"{self.name} {number}")))
        return values

    def _times(self, what: str, value: object) -> np.ndarray:
        """Return times [s] as (1 or num_worlds, 1), checked."""
        times = self._numbers(value)
        wrong = times[~((times >= 0.0) & is_finite(times))]
        if wrong.size or times.shape[1] > 1:
            got = repr(value) if times.size == 1 else f"{(*wrong, *times.flat)[0]:g} for one of its worlds"
            raise ValueError(f"{self.name} {what} must be a finite time >= 0 s, got {got}")
        return times

    def _own(self, numbers: np.ndarray) -> np.ndarray:
        """Return the rows of this scene's worlds, of numbers for the worlds of all ranks."""
        return numbers if len(numbers) == 1 else numbers[self.worlds.given]

    def _fixed(self, value: Fixed) -> np.ndarray:
        """Return what is not drawn, shape (1 or num_worlds, 1 or num_muscles)."""
        numbers = self._by_name(value) if isinstance(value, Mapping) and self.names else self._numbers(value)
        self._check_range(numbers)
        return self._own(numbers)

    def _bounds(self, value: Uniform) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of what is drawn, each of shape (1 or num_worlds, 1), checked."""
        low, high = (self._numbers(bound) for bound in (value.low, value.high))
        for bound in (low, high):
            self._check_range(bound)
        if max(low.shape[1], high.shape[1]) > 1:
            raise ValueError(f"{self.name} must be drawn between bounds that are one number a world")
        self._check_order("", low, high)
        return self._own(low), self._own(high)

    def _check_order(self, what: str, low: np.ndarray, high: np.ndarray) -> None:
        """Raise if a lower bound is above an upper one."""
        low, high = np.broadcast_arrays(low, high)
        if (wrong := low > high).any():
            got = f"got {low[wrong][0]:g} and {high[wrong][0]:g}"
            raise ValueError(f"{self.name} {what}must be drawn with low <= high, {got}")

    def _numbers(self, value: object) -> np.ndarray:
        """Return numbers as (1 or num_worlds, 1 or num_muscles)."""
        worlds = self.worlds.everywhere
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
        if self.whole and (most := numbers.max(initial=0.0)) > MOST:
            raise ValueError(
                f"{self.name} must be at most {MOST:g} times {self.whole}, got {most:g}; "
                f"for {most:g} % write {most / 100.0:g}"
            )

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
        for draw in self.draws:
            launch(draw_uniform, self.worlds.number, draw, keys=keys, mask=mask)
