"""A task with an extension: what that adds to the task and program of the family, and its kernels."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from myowarp.definitions.program import Program
from myowarp.definitions.scene import Scene
from myowarp.definitions.task import Column, RewardTerm, TaskSpec
from myowarp.engine.world_function import kernel_around, parameter_type
from myowarp.kernels.launch import launch
from myowarp.kernels.observe import masked_observe
from myowarp.tasks.quantities import QUANTITIES, Present


@dataclass(frozen=True)
class Block:
    """Columns that an extension adds to the observation or to the terms of the reward.

    Attributes:
        name: Name of the block.
        source: The function; or a name in `QUANTITIES`, all of which is observed.
        size: Number of columns; None: as many as the quantity has.
        unit: Unit of its numbers.
        doc: What they are.
        weight: Weight of a reward.
    """

    name: str
    source: wp.Function | str
    size: int | None = 1
    unit: str = ""
    doc: str = ""
    weight: float = 0.0


@dataclass(frozen=True)
class Extension:
    """What an extended task has beyond its family.

    Attributes:
        rewards: New terms of the reward.
        observations: New blocks of the observation.
        weights: New weights of the family's terms, name and weight.
        sites: Names of the sites whose positions `site_xpos` holds.
    """

    rewards: tuple[Block, ...] = ()
    observations: tuple[Block, ...] = ()
    weights: tuple[tuple[str, float], ...] = ()
    sites: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Extended(TaskSpec):
    """What an extended task adds to that of its family, of which it is a subclass."""

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
        sizes = {"qpos": nq, "qvel": nv, "site_xpos": 3 * len(self.extension.sites)}
        added = (
            Column(b.name, sizes.get(str(b.source), num_muscles) if b.size is None else b.size, b.unit, b.doc)
            for b in self.extension.observations
        )
        return (*super().columns(nq, nv, num_muscles), *added)  # type: ignore[safe-super]

    def reward_terms(self) -> tuple[RewardTerm, ...]:
        """The family's terms, under new weights where there are such, then the extension's."""
        weights = dict(self.extension.weights)
        own = super().reward_terms()  # type: ignore[safe-super]
        terms = (replace(term, weight=weights.get(term.name, term.weight)) for term in own)
        return (*terms, *(RewardTerm(b.name, b.weight, b.unit, b.doc) for b in self.extension.rewards))


class ExtendedProgram(Program):
    """What an extended task launches beside the program of its family, of which it is a subclass."""

    spec: Extended

    def __init__(self, spec: Extended, scene: Scene) -> None:
        """Find what the functions read, and make their kernels.

        Raises:
            ValueError: A parameter is neither a quantity nor an array of the program.
        """
        super().__init__(spec, scene)
        rewards, observations = spec.extension.rewards, spec.extension.observations
        names = [name for block in (*rewards, *observations) for name in reads(block.source)]
        self._present = Present(scene, names, spec.extension.sites)
        self._is_updated = False
        self._every = wp.ones(scene.num_worlds, dtype=bool)
        columns = spec.columns(scene.oracle.nq, scene.oracle.nv, len(scene.muscles.names))
        ends = np.cumsum([column.size for column in columns]).tolist()
        firsts = [0, *ends][len(columns) - len(observations) : -1]
        first_term = len(spec.reward_terms()) - len(rewards)
        self._observers = [
            self._writer(block, column) for block, column in zip(observations, firsts, strict=True)
        ]
        self._scorers = [self._writer(block, first_term + k) for k, block in enumerate(rewards)]

    def observe(self, mask: wp.array, obs: wp.array) -> None:
        """Write the family's columns, then the extension's."""
        super().observe(mask, obs)  # type: ignore[safe-super]
        if not self._is_updated:
            self._present.update()
        self._is_updated = False
        for write in self._observers:
            write(mask, obs)

    def score(self, step_count: wp.array, terms: wp.array, solved: wp.array, failed: wp.array) -> None:
        """Write the family's terms, then the extension's; the next observation is of the same state."""
        super().score(step_count, terms, solved, failed)  # type: ignore[safe-super]
        self._present.update()
        self._is_updated = True
        for write in self._scorers:
            write(self._every, terms)

    def _writer(self, block: Block, column: int) -> Callable[[wp.array, wp.array], None]:
        """Return what launches the columns of a block into the rows of a mask."""
        if isinstance(block.source, str):
            values = self._present.arrays[block.source]
            if values.dtype is wp.vec3f:
                shape = (values.shape[0], 3 * values.shape[1])
                values = wp.array(ptr=values.ptr, dtype=float, shape=shape, device=values.device)
            return lambda mask, out: masked_observe(mask, values, column, out)
        arrays = {name: self._array(block, name) for name in reads(block.source)}
        kernel = kernel_around(block.source, block.size or 1)

        def write(mask: wp.array, out: wp.array) -> None:
            launch(kernel, self.scene.num_worlds, mask=mask, column=column, out=out, **arrays)

        return write

    def _array(self, block: Block, name: str) -> wp.array:
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
        check_type(block, name, arrays[name].dtype, arrays[name].ndim)
        return arrays[name]


def reads(source: wp.Function | str) -> tuple[str, ...]:
    """Return the names of what a block reads."""
    return (source,) if isinstance(source, str) else tuple(inspect.signature(source.func).parameters)


def check_type(block: Block, name: str, dtype: type, ndim: int) -> None:
    """Raise ValueError if a parameter is annotated with another type than a world's part of an array has."""
    function = typing.cast(Any, block.source)
    if parameter_type(function, name) != (dtype, ndim - 1):
        kind = NAMES.get(dtype, dtype.__name__)
        wanted = f"wp.array[{kind}]" if ndim == 2 else kind
        annotation = typing.get_type_hints(function.func)[name]
        got = getattr(annotation, "__name__", str(annotation))
        raise ValueError(f"parameter {name!r} of {block.name!r} must be of type {wanted}, got {got}")


NAMES = {wp.float32: "float", wp.vec3f: "wp.vec3", wp.quatf: "wp.quat", wp.int32: "int", wp.bool: "bool"}
"""How types are written."""


@cache
def extended_family(family: type[TaskSpec]) -> Callable[..., TaskSpec]:
    """Return the subclass of a task family whose tasks have an extension."""
    program = type(family.program.__name__, (ExtendedProgram, family.program), {})
    body = {"program": program, "__doc__": family.__doc__, "__module__": family.__module__}
    return dataclass(frozen=True, kw_only=True)(type(family.__name__, (Extended, family), body))
