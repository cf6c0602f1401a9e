"""A task bound to a scene: the arrays of its goals, and the launches of its kernels."""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from myowarp.kernels.launch import launch

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import TaskSpec


class Program(abc.ABC):
    """A task bound to the arrays of a scene; a family subclasses it and names it as `TaskSpec.program`.

    Its methods only launch kernels, so that a whole environment step can be captured as one graph.

    Attributes:
        spec: The task.
        scene: What it is bound to.
        first: First column of each block of the observation, shape (num_blocks,).
    """

    spec: TaskSpec

    def __init__(self, spec: TaskSpec, scene: Scene) -> None:
        """Resolve names, allocate arrays on Warp's current device."""
        self.spec, self.scene = spec, scene
        columns = spec.columns(scene.oracle.nq, scene.oracle.nv, len(scene.muscles.names))
        self.first = wp.array(np.cumsum([0, *(column.size for column in columns[:-1])]), dtype=int)

    def launch(self, kernel: wp.Kernel, **given: Any) -> None:
        """Launch a kernel with a thread for each world.

        An argument that is not given by name is an attribute of that name: the program's, the task's, the
        scene's, or that of the scene's data, model or muscles.
        """
        scene = self.scene
        owners = (self, self.spec, scene, scene.data, scene.model, scene.muscles)
        launch(kernel, scene.num_worlds, *owners, **given)

    def sample_start(self, mask: wp.array) -> None:
        """Draw what an episode starts from, in the worlds of `mask` (num_worlds,) bool.

        The common start configuration is in place; objects, and their properties, are drawn here.
        """

    def sample_goal(self, mask: wp.array) -> None:
        """Draw what the episode asks for, in the worlds of `mask` (num_worlds,) bool."""

    def advance(self, step_count: wp.array) -> None:
        """Move what moves by itself to a step of the episode, before the step is scored and observed.

        Args:
            step_count: Steps of the episode, the present one included, shape (num_worlds,).
        """

    @abc.abstractmethod
    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Write `obs` (num_worlds, obs_size) in the worlds of `mask`."""

    @abc.abstractmethod
    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Write the raw reward terms (num_worlds, num_terms), and whether a world is solved, failed.

        It changes nothing else. `step_count` is that of `advance`.
        """

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return world positions [m] of the goal's markers in one world by site name; host, for pictures."""
        return {}

    def goal_pose(self, world: int) -> np.ndarray | None:
        """Return the configuration (nq,) that the goal asks for in one world, or None; host, for pictures."""
        return None
