"""Tasks that observe lengths, velocities and forces of muscles: those of the state that a step led to."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import warp as wp

from myowarp.definitions.entries import Entry, muscles
from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import TaskSpec
from myowarp.sim.present import present_muscles, present_paths


class MuscleProgram(Program):
    """A task, bound to a scene, that brings muscles to the present state before it scores and observes."""

    def __init__(self, spec: TaskSpec, scene: Scene) -> None:
        """Prepare the launches."""
        super().__init__(spec, scene)
        self._present_muscles = present_muscles(scene, self._bring_paths)
        self._is_present = False

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        self.bring_muscles()
        self._is_present = True
        super().score(step_count, terms, solved, failed)

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Observe; muscles and bodies of the scored state are those that `score` has found."""
        if not self._is_present:
            self.bring_muscles()
        self._is_present = False
        super().observe(mask, obs)

    def bring_muscles(self) -> None:
        """Launch what brings muscles, and what follows from them, to the present state."""
        self._present_muscles()

    def _bring_paths(self) -> None:
        (self.bring_paths or partial(present_paths, self.scene))()


def of_muscles(unit: str) -> Callable[[mujoco.MjModel], tuple[Entry, ...]]:
    """Return a function that finds the muscles of a model, one number of a unit for each."""
    return lambda model: tuple(Entry(name, unit) for name, _ in muscles(model))
