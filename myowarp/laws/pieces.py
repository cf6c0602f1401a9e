"""Piecewise polynomials: joints that follow others, points of paths that move, curves of ligaments."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

EVERYWHERE = (-np.inf, np.inf)


@dataclass(frozen=True)
class Pieces:
    """A piecewise polynomial of one variable.

    Attributes:
        breaks: Where pieces begin, ascending; the first piece also covers all below.
        coefficients: Of each piece, ascending in powers of x minus its beginning.
        held: Beyond it the value stays as at its ends; slopes do not, as those of OpenSim's moving points.
    """

    breaks: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    held: tuple[float, float] = EVERYWHERE

    def derivatives(self, x: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return f(x), f'(x) and f''(x), each in the shape of `x`."""
        x = np.asarray(x, float)
        breaks, table = self._table
        piece = np.maximum(np.searchsorted(breaks, x, side="right") - 1, 0)
        d = x - breaks[piece]
        value, slope, bend = np.zeros((3, *x.shape))
        for coefficient in table[::-1, piece]:
            bend = bend * d + 2 * slope
            slope = slope * d + value
            value = value * d + coefficient
        if np.isfinite(self.held).any():
            value = dataclasses.replace(self, held=EVERYWHERE).derivatives(np.clip(x, *self.held))[0]
        return value, slope, bend

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Breaks, shape (n,), and coefficients, shape (terms, n)."""
        rows = zip_longest(*self.coefficients, fillvalue=0.0)
        return np.array(self.breaks), np.array(list(rows))

    def value(self, x: ArrayLike) -> np.ndarray:
        """Return f(x)."""
        return self.derivatives(x)[0]

    def derivative(self, x: ArrayLike) -> np.ndarray:
        """Return f'(x)."""
        return self.derivatives(x)[1]

    def scaled(self, scale: float) -> "Pieces":
        """Return scale f(x)."""
        rows = tuple(tuple(scale * c for c in row) for row in self.coefficients)
        return Pieces(self.breaks, rows, self.held)

    def entry(self) -> list[object]:
        """Return what a text says of it: breaks, coefficients, and where it is held if it is."""
        held = [self.held] if np.isfinite(self.held).any() else []
        return [self.breaks, self.coefficients, *held]


def line(slope: float, offset: float = 0.0) -> Pieces:
    """Return slope x + offset."""
    return Pieces((0.0,), ((offset, slope),))
