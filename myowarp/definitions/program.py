"""A task bound to a scene: the arrays of its goals, and the launches of its kernels."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from myowarp.kernels.launch import find, launch
from myowarp.kernels.random import stream_of
from myowarp.kernels.reset import sample_uniform
from myowarp.kernels.world_function import (
    GIVEN,
    Measures,
    Source,
    num_counted,
    parameter_type,
    parameters,
    world_kernels,
)

if TYPE_CHECKING:
    from myowarp.definitions.scene import Scene
    from myowarp.definitions.task import Draw, TaskSpec


class Program:
    """A task bound to the arrays of a scene; a family may subclass it and name it as `TaskSpec.program`.

    Its methods only launch kernels, so that a whole environment step can be captured as one graph. A subclass
    allocates what the task's functions read by name; what the task draws is allocated here, as
    `scene.zeros("task.<array>")`.

    Attributes:
        spec: The task.
        scene: What it is bound to.
        first: First column of each block of the observation, shape (num_blocks,).
        bring_paths: Launches the part of the physics step that computes bodies, paths and their velocities,
            with the stages that it uses, for tasks that observe these; None until the stages are known.
    """

    bring_paths: Callable[[], None] | None = None

    spec: TaskSpec

    def __init__(self, spec: TaskSpec, scene: Scene) -> None:
        """Resolve names, allocate arrays on Warp's current device."""
        self.spec, self.scene = spec, scene
        self.columns = spec.columns(scene.oracle.nq, scene.oracle.nv, len(scene.muscles.names))
        self.first = wp.array(np.cumsum([0, *(column.size for column in self.columns[:-1])]), dtype=int)
        self._count = wp.array(
            [num_counted(column.source, column.size) for column in self.columns], dtype=int
        )
        self._drawn = [self._allocate(draw) for draw in spec.draws if draw.array]

    def _allocate(self, draw: Draw) -> tuple[str, dict[str, Any]]:
        """Make the array that a draw fills; return when it is drawn, and the arguments of its kernel."""
        drawn = self.scene.zeros(f"task.{draw.array}", draw.size)
        setattr(self, draw.array, drawn)
        bounds = {name: wp.array(getattr(draw, name), dtype=float) for name in ("low", "high", "choices")}
        stream = stream_of(draw.name) if draw.stream is None else draw.stream
        return draw.when, {"drawn": drawn, "stream": stream, **bounds}

    @property
    def owners(self) -> tuple[object, ...]:
        """Objects whose attributes are the arguments of kernels and functions."""
        scene = self.scene
        return self, self.spec, scene, scene.data, scene.model, scene.muscles

    def launch(self, kernel: wp.Kernel, **given: Any) -> None:
        """Launch a kernel with a thread for each world.

        An argument that is not given by name is an attribute of that name: the program's, the task's, the
        scene's, or that of the scene's data, model or muscles.
        """
        launch(kernel, self.scene.num_worlds, *self.owners, **given)

    def _sample(self, when: str, mask: wp.array) -> None:
        for drawn_at, arguments in self._drawn:
            if drawn_at == when:
                self.launch(sample_uniform, mask=mask, **arguments)

    def sample_start(self, mask: wp.array) -> None:
        """Draw what an episode starts from, in the worlds of `mask` (num_worlds,) bool.

        The common start configuration is in place; objects, and their properties, are drawn here.
        """
        self._sample("start", mask)

    def sample_goal(self, mask: wp.array) -> None:
        """Draw what the episode asks for, in the worlds of `mask` (num_worlds,) bool."""
        self._sample("goal", mask)

    def advance(self, step_count: wp.array) -> None:
        """Move what moves by itself to a step of the episode, before the step is scored and observed.

        Args:
            step_count: Steps of the episode, the present one included, shape (num_worlds,).
        """

    @cached_property
    def _kernels(self) -> tuple[wp.Kernel, wp.Kernel]:
        """Kernels that write observation and reward by the functions that the task names."""
        terms = tuple(term.source for term in self.spec.reward_terms())
        sources = tuple(column.source for column in self.columns)
        return self.around(sources, tuple(self.spec.measures.items()), terms)

    def around(
        self,
        sources: tuple[Source | None, ...],
        measures: Measures,
        terms: tuple[wp.Function | None, ...],
    ) -> tuple[wp.Kernel, wp.Kernel]:
        """Return `world_kernels` around functions; they get rows of what has a dimension more than they read.

        Raises:
            ValueError: Nothing has the name of a parameter, or what has such rows has not one for each world.
        """
        functions = [f for f in (*sources, *terms, *dict(measures).values()) if isinstance(f, wp.Function)]
        rows = {"step_count"}
        reader = f"task {self.spec.key!r}"
        for function, name in ((f, name) for f in functions for name in parameters(f)):
            if name in (*rows, *GIVEN, *dict(measures)):
                continue
            try:
                array = find(name, self.owners, reader)
            except TypeError as error:
                raise ValueError(str(error)) from None
            if getattr(array, "ndim", 0) <= parameter_type(function, name)[1]:
                continue
            if array.shape[0] != self.scene.num_worlds:
                raise ValueError(
                    f"{reader} reads {name!r} world by world, of which there is one for all; a field of the "
                    "model needs to be among the task's `batched`"
                )
            rows.add(name)
        return world_kernels(self.spec.family, sources, measures, terms, frozenset(rows))

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Write `obs` (num_worlds, obs_size) in the worlds of `mask`."""
        self.launch(self._kernels[0], mask=mask, count=self._count, obs=obs)

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Write the raw reward terms (num_worlds, num_terms), and whether a world is solved, failed.

        It changes nothing else. `step_count` is that of `advance`.
        """
        self.launch(self._kernels[1], step_count=step_count, terms=terms, solved=solved, failed=failed)

    def goal_markers(self, world: int) -> dict[str, np.ndarray]:
        """Return world positions [m] of the goal's markers in one world by site name; host, for pictures."""
        return {}

    def goal_pose(self, world: int) -> np.ndarray | None:
        """Return the configuration (nq,) that the goal asks for in one world, or None; host, for pictures."""
        return None
