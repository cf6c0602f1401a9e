"""A task with an extension: what that adds to the task and program of the family, and its kernels."""

from __future__ import annotations

import typing
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import warp as wp

from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, RewardTerm, TaskSpec
from myowarp.kernels.world_function import (
    Row,
    num_counted,
    parameter_type,
    parameters,
    world_kernels,
)
from myowarp.tasks.quantities import QUANTITIES, SITES, Present


@dataclass(frozen=True)
class Extension:
    """Additions of an extended task to its family.

    Attributes:
        rewards: New terms of the reward.
        observations: New blocks of the observation; one of size 0 shows all of a quantity.
        weights: New weights of the family's terms, name and weight.
        sites: Names of the sites whose positions `site_xpos` holds.
    """

    rewards: tuple[RewardTerm, ...] = ()
    observations: tuple[Column, ...] = ()
    weights: tuple[tuple[str, float], ...] = ()
    sites: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Extended(TaskSpec):
    """The task of an extended family, a subclass of the family's.

    Its additions show no source here: `ExtendedProgram` writes them, whose `site_xpos` is another one.
    """

    extension: Extension

    @property
    def sites(self) -> tuple[str, ...]:
        """The family's and the extension's."""
        return tuple(dict.fromkeys((*super().sites, *self.extension.sites)))

    @property
    def uses_kinematics(self) -> bool:
        """Whether the family or the extension reads positions."""
        return super().uses_kinematics or bool(self.extension.sites)

    def columns(self, nq: int, nv: int, num_muscles: int) -> tuple[Column, ...]:
        """The family's blocks, then the extension's."""
        sizes = {"qpos": nq, "qvel": nv, SITES: 3 * len(self.extension.sites)}
        added = (
            replace(b, size=b.size or sizes.get(reads(b)[0], num_muscles), source=None)
            for b in self.extension.observations
        )
        return (*super().columns(nq, nv, num_muscles), *added)  # type: ignore[safe-super]

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """The family's terms, under new weights where there are such, then the extension's."""
        weights = dict(self.extension.weights)
        own = super().reward_terms()  # type: ignore[safe-super]
        terms = (replace(term, weight=weights.get(term.name, term.weight)) for term in own)
        return (*terms, *(replace(term, source=None) for term in self.extension.rewards))


class ExtendedProgram(Program):
    """The program of an extended task, a subclass of its family's."""

    spec: Extended

    def __init__(self, spec: Extended, scene: Scene) -> None:
        """Find what the functions read, and make their kernels.

        Raises:
            ValueError: A parameter is neither a quantity nor an array of the program.
        """
        super().__init__(spec, scene)
        rewards, observations = spec.extension.rewards, spec.extension.observations
        names = reads(*rewards, *observations)
        self._present = Present(scene, names, spec.extension.sites)
        self._is_updated = False
        self._scored, self._observed = (
            {name: self._array(block, name) for block in blocks for name in reads(block)}
            for blocks in (rewards, observations)
        )
        sources = (None,) * (len(self.columns) - len(observations)) + tuple(b.source for b in observations)
        terms = (None,) * (len(spec.reward_terms()) - len(rewards)) + tuple(term.source for term in rewards)
        sizes = zip(sources, self.columns, strict=True)
        self._added_count = wp.array(
            [num_counted(source, column.size) for source, column in sizes], dtype=int
        )
        self._added = world_kernels(f"{spec.family}_extension", sources, (), terms, frozenset(names))

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Write the family's columns, then the extension's."""
        super().observe(mask, obs)
        if not self._is_updated:
            self._present.update()
        self._is_updated = False
        if self._observed:
            self.launch(self._added[0], mask=mask, count=self._added_count, obs=obs, **self._observed)

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Write the family's terms, then the extension's; the next observation is of the same state."""
        super().score(step_count, terms, solved, failed)
        self._present.update()
        self._is_updated = True
        if self._scored:
            flags = {"solved": solved, "failed": failed}
            self.launch(self._added[1], step_count=step_count, terms=terms, **flags, **self._scored)

    def _array(self, block: Column | RewardTerm, name: str) -> wp.array:
        """Return the array behind a parameter, (num_worlds, ...).

        Raises:
            ValueError: There is none, or it is of another type than annotated.
        """
        worlds = self.scene.num_worlds
        own = {
            key: array
            for key, array in vars(self).items()
            if isinstance(array, wp.array)
            and array.ndim in (1, 2)
            and array.shape[0] == worlds
            and key[0] != "_"
        }
        arrays = own | self._present.arrays
        if name not in arrays:
            raise ValueError(
                f"{block.name!r} reads {name!r}, which task {self.spec.key!r} has not; "
                f"available: {', '.join(dict.fromkeys([*QUANTITIES, *own]))}"
            )
        if not isinstance(block.source, Row):
            check_type(block, name, arrays[name].dtype, arrays[name].ndim)
        return arrays[name]


def reads(*blocks: Column | RewardTerm) -> tuple[str, ...]:
    """Return the names of what blocks read."""
    sources = [block.source for block in blocks]
    names = ((source.array,) if isinstance(source, Row) else parameters(source) for source in sources)
    return tuple(name for read in names for name in read)


def check_type(block: Column | RewardTerm, name: str, dtype: type, ndim: int) -> None:
    """Raise ValueError if a parameter is annotated with another type than a world's part of an array has."""
    function: wp.Function = block.source
    if parameter_type(function, name) != (dtype, ndim - 1):
        kind = NAMES.get(dtype, dtype.__name__)
        wanted = f"wp.array[{kind}]" if ndim == 2 else kind
        annotation = typing.get_type_hints(function.func)[name]
        got = getattr(annotation, "__name__", str(annotation))
        raise ValueError(f"parameter {name!r} of {block.name!r} must be of type {wanted}, got {got}")


NAMES = {wp.float32: "float", wp.vec3f: "wp.vec3", wp.quatf: "wp.quat", wp.int32: "int", wp.bool: "bool"}
"""Names of types."""


@cache
def extended_family(family: type[TaskSpec]) -> Callable[..., TaskSpec]:
    """Return the subclass of a task family whose tasks have an extension."""
    program = type(family.program.__name__, (ExtendedProgram, family.program), {})
    body = {"program": program, "__doc__": family.__doc__, "__module__": family.__module__}
    return dataclass(frozen=True, kw_only=True)(type(family.__name__, (Extended, family), body))
