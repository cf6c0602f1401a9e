"""Blocks that an environment adds to a task's observation: a memory of the episode, or what it is told.

    myowarp train ID --conditions ... --observe history=8     the last 8 observations and actions
    myowarp train ID --conditions ... --observe parameters    what the conditions make of the body now

A policy without a state of its own infers from a history what changed; one that is told the parameters
shows what there was to infer. Source: Kumar et al. 2021, *RMA: rapid motor adaptation*, arXiv:2107.04034.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from myowarp.definitions.entries import Entry
from myowarp.definitions.parameter import Clock, Curve, Parameter, value_of
from myowarp.definitions.task import Column
from myowarp.kernels.launch import launch
from myowarp.kernels.observe import masked_observe

if TYPE_CHECKING:
    from mujoco import MjModel

    from myowarp.definitions.scene import Scene

HISTORY, PARAMETERS = SENSES = "history", "parameters"
MOST_STEPS = 1000  # of a history


def check_senses(names: Sequence[str]) -> None:
    """Raise ValueError, in one sentence, if a text names no sense, or two name one."""
    kinds = [_read(name)[0] for name in names]
    if len({*kinds}) < len(kinds):
        raise ValueError(f"observe must name each sense once, got {' '.join(names)}")


def _read(name: str) -> tuple[str, int]:
    """Return a sense and its number of steps; 0: it has none."""
    kind, equals, steps = name.partition("=")
    if name == PARAMETERS:
        return kind, 0
    if kind == HISTORY and equals and steps.isdecimal() and 1 <= int(steps) <= MOST_STEPS:
        return kind, int(steps)
    raise ValueError(
        f"observe must be {PARAMETERS}, or {HISTORY}=STEPS with 1 to {MOST_STEPS} steps, got {name!r}"
    )


def bind_senses(
    names: Sequence[str], scene: Scene, clock: Clock, action: wp.array, columns: Sequence[Column]
) -> tuple[Sense, ...]:
    """Return the senses of a scene, on the current Warp device.

    Args:
        names: Of senses.
        scene: The scene, with its conditions bound.
        clock: Time of the worlds.
        action: Actions, shape (num_worlds, num_actions).
        columns: What the task and the conditions observe.

    Raises:
        ValueError: There is no such sense, or there are no parameters to be told.
    """
    check_senses(names)
    found: list[Sense] = []
    for name in names:
        kind, steps = _read(name)
        found.append(History(steps, scene, action, columns) if kind == HISTORY else Told(scene, clock))
    return tuple(found)


class Sense:
    """A block of the observation, after those of task and conditions.

    Attributes:
        column: What it is.
    """

    column: Column

    def remember(self, mask: wp.array, obs: wp.array) -> None:
        """Keep what the worlds of a mask have observed before the step that they have just done."""

    def forget(self, mask: wp.array) -> None:
        """Begin anew in the worlds of a mask, which open an episode."""

    def observe(self, mask: wp.array, obs: wp.array, column: int) -> None:
        """Write its block of `obs`, from `column` on, in the worlds of a mask."""
        raise NotImplementedError


class History(Sense):
    """The last observations and the actions that followed, the latest first; zeros before the episode.

    Attributes:
        action: Actions, shape (num_worlds, num_actions).
        size: Numbers that task and conditions observe.
        past: What is remembered, shape (num_worlds, steps x (size + num_actions)).
    """

    def __init__(self, steps: int, scene: Scene, action: wp.array, columns: Sequence[Column]) -> None:
        self.action, size = action, sum(column.size for column in columns)
        doc = f"the last {steps} observations, each with the action that followed it, the latest first"

        def names(model: MjModel) -> list[Entry]:  # thousands, which only a description reads
            once = [entry for column in columns for entry in column.entries(model)]
            acted = (f"action of {model.actuator(i).name}" for i in range(scene.num_actions))
            once += [Entry(name, "1") for name in acted]
            return [Entry(f"{e.name} {k + 1} back", e.unit) for k in range(steps) for e in once]

        self.column = Column(HISTORY, steps * (size + scene.num_actions), "1", doc, names)
        self.past = scene.zeros("sense.history", self.column.size)
        self.size = size

    def remember(self, mask: wp.array, obs: wp.array) -> None:
        """Launch `push`."""
        wp.launch(push, dim=mask.shape[0], inputs=[mask, obs, self.action, self.size], outputs=[self.past])

    def forget(self, mask: wp.array) -> None:
        """Launch `clear`."""
        wp.launch(clear, dim=self.past.shape, inputs=[mask], outputs=[self.past])

    def observe(self, mask: wp.array, obs: wp.array, column: int) -> None:
        """Copy what is remembered."""
        masked_observe(mask, self.past, column, obs)


class Told(Sense):
    """The parameters of all conditions as they are now, those of muscles for every muscle.

    Attributes:
        clock: Time of the worlds.
    """

    def __init__(self, scene: Scene, clock: Clock) -> None:
        self._parameters: list[Parameter] = scene.parameters
        self.clock = clock
        if not self._parameters:
            raise ValueError(f"observe {PARAMETERS} needs conditions, which have them; got none")
        names = tuple(
            f"{parameter.name} {muscle}".rstrip()
            for parameter in self._parameters
            for muscle in parameter.names or ("",)
        )
        self.column = Column(
            PARAMETERS, len(names), "1", "parameters of the conditions now, each in its own unit", names
        )

    def now(self) -> np.ndarray:
        """Return what all worlds are told, shape (num_worlds, size)."""
        worlds = self.clock.step_count.shape[0]
        told = wp.zeros((worlds, self.column.size), dtype=float, device=self.clock.step_count.device)
        with wp.ScopedDevice(told.device):
            self.observe(wp.ones(worlds, dtype=bool), told, 0)
        return told.numpy()

    def observe(self, mask: wp.array, obs: wp.array, column: int) -> None:
        """Launch `tell` for each parameter."""
        for parameter in self._parameters:
            number = max(len(parameter.names), 1)
            launch(tell, (mask.shape[0], number), parameter, self, mask=mask, column=column, obs=obs)
            column += number


@wp.kernel(enable_backward=False)
def push(
    # In:
    mask: wp.array[bool],
    obs: wp.array2d[float],
    action: wp.array2d[float],
    size: int,
    # Out:
    past: wp.array2d[float],
):
    """past = (obs[:size], action, past without its oldest step) in the worlds of the mask."""
    worldid = wp.tid()
    if not mask[worldid]:
        return
    step = size + action.shape[1]
    for k in range(past.shape[1] - step):
        i = past.shape[1] - 1 - k
        past[worldid, i] = past[worldid, i - step]
    for i in range(size):
        past[worldid, i] = obs[worldid, i]
    for i in range(action.shape[1]):
        past[worldid, size + i] = wp.clamp(action[worldid, i], -1.0, 1.0)


@wp.kernel(enable_backward=False)
def clear(
    # In:
    mask: wp.array[bool],
    # Out:
    past: wp.array2d[float],
):
    """past = 0 in the worlds of the mask."""
    worldid, i = wp.tid()
    if mask[worldid]:
        past[worldid, i] = 0.0


@wp.kernel(enable_backward=False)
def tell(
    # In:
    mask: wp.array[bool],
    curve: Curve,
    clock: Clock,
    column: int,
    # Out:
    obs: wp.array2d[float],
):
    """obs[world, column + i] = curve(t) of entry i, in the worlds of the mask."""
    worldid, i = wp.tid()
    if mask[worldid]:
        obs[worldid, column + i] = value_of(curve, clock, worldid, i)
