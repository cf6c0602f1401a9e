"""Which worlds a simulation steps, and the arrays that it shares with those that step the others.

On many cores the worlds are parts of one whole (`myowarp.sim.shards`). A part is a simulation of its own,
with arrays of its own, but for what is written and read from outside: state, actions, results. These are
slices of arrays over all worlds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import warp as wp


@dataclass(frozen=True)
class Worlds:
    """A range of worlds.

    Attributes:
        first: The first of them, counted among all.
        number: How many there are.
        total: How many there are in all parts.
        shared: Arrays over all worlds by name, the same dictionary in every part.
    """

    first: int
    number: int
    total: int
    shared: dict[str, wp.array] = field(default_factory=dict, repr=False)

    @classmethod
    def all(cls, number: int) -> Worlds:
        """Return the worlds of a simulation that steps them all."""
        return cls(0, number, number)

    def split(self, parts: int) -> list[Worlds]:
        """Return parts that differ by one world at most."""
        ends = [self.number * i // parts for i in range(parts + 1)]
        return [
            Worlds(self.first + begin, end - begin, self.total, self.shared)
            for begin, end in itertools.pairwise(ends)
        ]

    @property
    def own(self) -> slice:
        """Which rows of an array over all worlds are theirs."""
        return slice(self.first, self.first + self.number)

    def share(self, name: str, holder: Any, fields: Iterable[str] | None = None) -> None:
        """Replace arrays (number, ...) of an object by slices, with their values, of arrays over all worlds.

        Args:
            name: What the object is called in every part.
            holder: The object, whose arrays no launch has been captured with yet.
            fields: Its attributes that are arrays with a row for each world; None: all of a Warp struct.
        """
        if self.number == self.total:
            return
        for key in holder._cls.vars if fields is None else fields:
            array = getattr(holder, key)
            whole = self.shared.get(f"{name}.{key}")
            if whole is None:
                whole = wp.zeros((self.total, *array.shape[1:]), dtype=array.dtype, device=array.device)
                self.shared[f"{name}.{key}"] = whole
            if not array.size:
                continue
            slot = whole[self.own]
            wp.copy(slot, array)
            setattr(holder, key, slot)

    def join(self, name: str, holder: Any) -> Any:
        """Set the attributes of an object that are shared under this name to the arrays over all worlds."""
        for key, whole in self.shared.items():
            owner, _, attribute = key.partition(".")
            if owner == name:
                setattr(holder, attribute, whole)
        return holder
