"""The worlds of a scene, and the arrays that it shares with the scenes of the others.

On many cores the worlds are parts of one whole (`myowarp.sim.simulation`). A part owns its arrays, except
those used from outside: state, actions and results are rows of arrays over all worlds.

The whole may itself be one of several equal ranks, each in a process of its own: then worlds are numbered
through all ranks, and parameters are given for all of their worlds.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import warp as wp


@dataclass(frozen=True)
class Worlds:
    """A range of worlds.

    Attributes:
        first: The first of them, counted among all.
        number: How many there are.
        total: How many there are in all parts of this process.
        whole: Arrays over all worlds by name, the same dictionary in every part.
        adjustable: Whether parameters of conditions have an entry for each world and muscle even where all
            agree, so that `Parameter.set` can change one while the worlds are stepped.
        rank: Which of how many ranks this process is: (r, n), r from 0 to n - 1.
    """

    first: int
    number: int
    total: int
    whole: dict[str, wp.array] = field(default_factory=dict, repr=False)
    adjustable: bool = False
    rank: tuple[int, int] = (0, 1)

    @classmethod
    def all(cls, number: int, adjustable: bool = False, rank: tuple[int, int] = (0, 1)) -> Worlds:
        """Return the worlds of a simulation that steps them all."""
        return cls(0, number, number, adjustable=adjustable, rank=rank)

    def split(self, parts: int) -> list[Worlds]:
        """Return parts that differ by one world at most."""
        ends = [self.number * i // parts for i in range(parts + 1)]
        return [
            replace(self, first=self.first + begin, number=end - begin)
            for begin, end in itertools.pairwise(ends)
        ]

    @property
    def offset(self) -> int:
        """Number of this process's first world among those of all ranks."""
        return self.rank[0] * self.total

    @property
    def everywhere(self) -> int:
        """Return the number of worlds in all ranks."""
        return self.rank[1] * self.total

    @property
    def given(self) -> slice:
        """Return their rows of a parameter over the worlds of all ranks."""
        return slice(self.offset + self.first, self.offset + self.first + self.number)

    @property
    def own(self) -> slice:
        """Return their rows of an array over all worlds."""
        return slice(self.first, self.first + self.number)

    def rows(self, name: str, array: wp.array) -> wp.array:
        """Return what takes the place of an array: rows of one over all worlds, with the same values.

        Args:
            name: What it is called in every part, with its owner: `data.qpos`.
            array: The array (number, ...), which no launch has been captured with yet.
        """
        if self.number == self.total:
            self.whole[name] = array
            return array
        if name not in self.whole:
            shape = self.total, *array.shape[1:]
            self.whole[name] = wp.zeros(shape, dtype=array.dtype, device=array.device)
        if not array.size:
            return array
        rows = self.whole[name][self.own]
        wp.copy(rows, array)
        return rows

    def join(self, owner: str, holder: Any) -> Any:
        """Set the attributes of an object to the arrays over all worlds of this owner."""
        for name, array in self.whole.items():
            theirs, _, attribute = name.rpartition(".")
            if theirs == owner:
                setattr(holder, attribute, array)
        return holder
